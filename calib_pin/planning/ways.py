"""Ways between configurations on which a robot touches nothing.

The straight way in joint space where that is free; else rapidly-exploring random trees
from both ends (RRT-Connect, Kuffner and LaValle, ICRA 2000) first near the straight way
and then farther around it, whose way is then made shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.progress import Progress

VIA = -1
"""Row of a configuration that only leads around something."""


@dataclass(frozen=True)
class WayOptions:
    """Sizes of a search.

    Attributes:
        checks: Most configurations that are looked at for one way.
        branch: Longest new branch, as the motion of the robot's points [m].
        near: How far around the straight way the first samples are [rad, m].
        growth: Samples after which they are as far again.
        shortcuts: Tries to make a way shorter.
        least: Least motion of points between two places that are checked [m].
    """

    checks: int = 10_000
    branch: float = 0.3
    near: float = 0.5
    growth: int = 40
    shortcuts: int = 40
    least: float = 0.01


OPTIONS = WayOptions()
"""The default options."""


@dataclass(frozen=True)
class Passage:
    """A motion through configurations.

    Attributes:
        q: All its configurations, shape (M, n) [rad, m].
        row: Which of those that it goes through each is, `VIA` for others, shape (M,).
        blocked: The rows to which no free way was found; the straight one stays.
    """

    q: Floats
    row: Indices
    blocked: tuple[int, ...]

    @staticmethod
    def straight(q: Floats, blocked: Sequence[int] = ()) -> Passage:
        """The straight ways through configurations, shape (N, n)."""
        return Passage(q, np.arange(len(q)), tuple(blocked))

    def of(self, rows: Indices) -> Indices:
        """The same for rows that are a choice of others, shape (N,) -> (M,)."""
        return np.where(self.row == VIA, VIA, rows[self.row])

    @property
    def vias(self) -> int:
        """Number of configurations that only lead around something."""
        return int((self.row == VIA).sum())


@dataclass(frozen=True)
class Ways:
    """Ways of a robot on which it touches nothing.

    Two places of a way are checked if the points of the robot move by more than twice
    the clearance between them, so that what keeps off at both touches nothing between.

    Attributes:
        chains: The joints.
        collisions: Collisions to avoid.
        lower: Lower limits, shape (n,) [rad, m].
        upper: Upper limits, shape (n,) [rad, m].
    """

    chains: Chains
    collisions: Collisions
    lower: Floats
    upper: Floats

    def is_free(self, a: Floats, b: Floats) -> bool:
        """Whether nothing touches on the straight way, ends of shape (n,) included."""
        places = np.linspace(a, b, 1 + self._pieces(a, b))
        # A few places far apart first: most ways that are blocked are so for long.
        return all(self.collisions.free(places[k::7]).all() for k in range(7))

    def through(
        self,
        q: Floats,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> Passage:
        """A motion through configurations in their order.

        Args:
            q: The configurations, shape (N, n) [rad, m].
            rng: Source of chance; every way has its own.
            progress: Told the part that is done, 0 to 1.
        """
        parts, rows, blocked = [q[:1]], [np.arange(len(q[:1]))], []
        for k, own in enumerate(rng.spawn(max(len(q) - 1, 0)), 1):
            if progress is not None:
                progress(k / len(q))
            around = self.around(q[k - 1], q[k], own)
            if around is None:
                blocked.append(k)
                around = q[:0]
            parts += [around, q[k : k + 1]]
            rows += [np.full(len(around), VIA), np.array([k])]
        return Passage(np.concatenate(parts), np.concatenate(rows), tuple(blocked))

    def checked(
        self,
        q: Floats,
        rng: np.random.Generator | None = None,
        progress: Progress | None = None,
    ) -> Passage:
        """The straight ways; the same as `through` for what must not be changed."""
        blocked = []
        for k in range(1, len(q)):
            if progress is not None:
                progress(k / len(q))
            if not self.is_free(q[k - 1], q[k]):
                blocked.append(k)
        return Passage.straight(q, blocked)

    def around(self, a: Floats, b: Floats, rng: np.random.Generator) -> Floats | None:
        """Configurations between two, by which straight ways are free.

        Args:
            a: The first, shape (n,) [rad, m].
            b: The last, shape (n,) [rad, m].
            rng: Source of chance.

        Returns:
            The configurations, shape (V, n), none where the straight way is free; None
            if no way was found.
        """
        if self.is_free(a, b):
            return np.empty((0, len(a)))
        if not self.collisions.free(np.array([a, b])).all():
            return None
        path = _Search(self, a, b, rng).run()
        return None if path is None else self._shorter(path, rng)[1:-1]

    @cached_property
    def _step(self) -> float:
        """Motion of points between two places that are checked [m]."""
        clearance = float(self.collisions.clearances.max(initial=0.0))
        return max(2.0 * clearance, OPTIONS.least)

    @cached_property
    def reach(self) -> Floats:
        """Bounds of the motion of the robot's points by each joint, shape (n,)."""
        return self.collisions.reach

    def _pieces(self, a: Floats, b: Floats) -> int:
        return max(1, int(np.ceil(float(np.abs(b - a) @ self.reach) / self._step)))

    def _shorter(self, path: Floats, rng: np.random.Generator) -> Floats:
        """A way with fewer and nearer configurations, shape (M, n)."""
        path = self._pruned(path)
        for _ in range(OPTIONS.shortcuts):
            if len(path) < 3:
                break
            (i, j), (s, t) = np.sort(rng.integers(0, len(path) - 1, 2)), rng.random(2)
            if i == j:
                continue
            first = path[i] + s * (path[i + 1] - path[i])
            last = path[j] + t * (path[j + 1] - path[j])
            if self.is_free(first, last):
                ends = np.array([first, last])
                path = np.concatenate([path[: i + 1], ends, path[j + 1 :]])
        return self._pruned(path)

    def _pruned(self, path: Floats) -> Floats:
        """The way without configurations that can be left out."""
        kept = [0]
        while kept[-1] < len(path) - 1:
            last = kept[-1]
            farther = range(len(path) - 1, last + 1, -1)
            straight = (k for k in farther if self.is_free(path[last], path[k]))
            kept.append(next(straight, last + 1))
        return path[kept]


class _Search:
    """Two trees of free configurations that grow towards each other."""

    def __init__(
        self, ways: Ways, a: Floats, b: Floats, rng: np.random.Generator
    ) -> None:
        self._ways, self._rng = ways, rng
        self._nodes: tuple[list[Floats], list[Floats]] = ([a], [b])
        self._parents: tuple[list[int], list[int]] = ([0], [0])
        self._low, self._high = np.minimum(a, b), np.maximum(a, b)
        self._left = OPTIONS.checks

    def run(self) -> Floats | None:
        """A way from the first to the last configuration, shape (M, n), or none."""
        tree, drawn = 0, 0
        while self._left > 0:
            drawn += 1
            last, _ = self._grow(tree, self._sample(drawn), OPTIONS.branch)
            if last is not None:
                node = self._nodes[tree][last]
                end, met = self._grow(1 - tree, node, np.inf)
                if met and end is not None:
                    halves = [self._branch(tree, last), self._branch(1 - tree, end)]
                    first, second = halves if tree == 0 else halves[::-1]
                    return np.array([*first[::-1], *second[1:]])
            tree = 1 - tree
        return None

    def _sample(self, drawn: int) -> Floats:
        """A configuration around the straight way, the farther the later."""
        around = min(OPTIONS.near * (1.0 + drawn / OPTIONS.growth), np.pi)
        ways = self._ways
        low = np.minimum(self._low, np.maximum(ways.lower, self._low - around))
        high = np.maximum(self._high, np.minimum(ways.upper, self._high + around))
        return np.asarray(ways.chains.follow(self._rng.uniform(low, high)[None])[0])

    def _grow(
        self, tree: int, target: Floats, longest: float
    ) -> tuple[int | None, bool]:
        """Grow a branch towards a configuration.

        Returns:
            The last new node, none if there is none, or the node that is there already;
            and whether it is the target.
        """
        nodes, ways = self._nodes[tree], self._ways
        away = np.abs(np.array(nodes) - target) @ ways.reach
        near = int(away.argmin())
        if away[near] == 0.0:
            return near, True
        whole = min(1.0, longest / float(away[near]))
        parts = max(1, int(np.ceil(whole * float(away[near]) / OPTIONS.branch)))
        new = None
        for k in range(1, parts + 1):
            # The very target at the end: rounding would keep the trees apart.
            q = nodes[near] + (k * whole / parts) * (target - nodes[near])
            q = target if k == parts and whole == 1.0 else q
            before = nodes[near if new is None else new]
            places = np.linspace(before, q, 1 + ways._pieces(before, q))[1:]
            self._left -= len(places)
            if not ways.collisions.free(places).all():
                return new, False
            self._parents[tree].append(near if new is None else new)
            nodes.append(q)
            new = len(nodes) - 1
        return new, whole == 1.0

    def _branch(self, tree: int, node: int) -> Sequence[Floats]:
        """The configurations from a node to the root of its tree."""
        found = [self._nodes[tree][node]]
        while node:
            node = self._parents[tree][node]
            found.append(self._nodes[tree][node])
        return found
