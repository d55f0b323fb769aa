"""Ways between configurations on which a robot touches nothing.

The straight way in joint space where that is free; else rapidly-exploring random trees
from both ends (RRT-Connect, Kuffner and LaValle, ICRA 2000) first near the straight way
and then farther around it, whose way is then made shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
        checks: Most configurations that are looked at for one way: a few seconds.
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
        places = self.places(a, b)
        # A few places far apart first: most ways that are blocked are so for long.
        return all(self.collisions.free(places[k::7]).all() for k in range(7))

    def places(self, a: Floats, b: Floats) -> Floats:
        """Places of the straight way that are checked, shape (P, n)."""
        clearance = float(self.collisions.clearances.max(initial=0.0))
        moved = float(np.abs(b - a) @ self.collisions.reach)
        step = max(2.0 * clearance, OPTIONS.least)
        return np.linspace(a, b, 1 + max(1, int(np.ceil(moved / step))))

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
        path = _connected(self, a, b, rng)
        return None if path is None else self._shorter(path, rng)[1:-1]

    def _shorter(self, path: Floats, rng: np.random.Generator) -> Floats:
        """A way with fewer and nearer configurations, shape (M, n)."""
        path = self._pruned(path)
        for _ in range(OPTIONS.shortcuts):
            (i, j), (s, t) = np.sort(rng.integers(0, len(path) - 1, 2)), rng.random(2)
            first = path[i] + s * (path[i + 1] - path[i])
            last = path[j] + t * (path[j + 1] - path[j])
            if i != j and self.is_free(first, last):
                path = np.concatenate([path[: i + 1], [first, last], path[j + 1 :]])
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


def _connected(
    ways: Ways, a: Floats, b: Floats, rng: np.random.Generator
) -> Floats | None:
    """A way by two trees that grow towards each other, shape (M, n), or none."""
    tree, other = _Tree(ways, a), _Tree(ways, b)
    drawn = 0
    while tree.checks + other.checks < OPTIONS.checks:
        drawn += 1
        # Around the straight way, the farther the later.
        around = min(OPTIONS.near * (1.0 + drawn / OPTIONS.growth), np.pi)
        low, high = np.minimum(a, b), np.maximum(a, b)
        low = np.minimum(low, np.maximum(ways.lower, low - around))
        high = np.maximum(high, np.minimum(ways.upper, high + around))
        sample = ways.chains.follow(rng.uniform(low, high)[None])[0]
        last, _ = tree.grow(sample, OPTIONS.branch)
        if last is not None:
            end, met = other.grow(tree.nodes[last], np.inf)
            if met and end is not None:
                way = [*tree.branch(last)[::-1], *other.branch(end)[1:]]
                return np.array(way if tree.nodes[0] is a else way[::-1])
        tree, other = other, tree
    return None


class _Tree:
    """A tree of free configurations.

    Args:
        ways: What is free.
        root: Its first configuration, shape (n,).

    Attributes:
        nodes: Its configurations.
        checks: Number of configurations that were looked at.
    """

    def __init__(self, ways: Ways, root: Floats) -> None:
        self.nodes, self.checks = [root], 0
        self._ways, self._parents = ways, [0]

    def grow(self, target: Floats, longest: float) -> tuple[int | None, bool]:
        """Grow a branch towards a configuration.

        Returns:
            The last new node, none if there is none, or the node that is there already;
            and whether it is the target.
        """
        away = np.abs(np.array(self.nodes) - target) @ self._ways.collisions.reach
        at = int(away.argmin())
        if away[at] == 0.0:
            return at, True
        whole = min(1.0, longest / float(away[at]))
        parts = max(1, int(np.ceil(whole * float(away[at]) / OPTIONS.branch)))
        begin, new = self.nodes[at], None
        for k in range(1, parts + 1):
            # The very target at the end: rounding would keep the trees apart.
            q = begin + (k * whole / parts) * (target - begin)
            q = target if k == parts and whole == 1.0 else q
            places = self._ways.places(self.nodes[at], q)[1:]
            self.checks += len(places)
            if not self._ways.collisions.free(places).all():
                return new, False
            self.nodes.append(q)
            self._parents.append(at)
            at = new = len(self.nodes) - 1
        return new, whole == 1.0

    def branch(self, node: int) -> list[Floats]:
        """The configurations from a node to the root."""
        found = [self.nodes[node]]
        while node:
            node = self._parents[node]
            found.append(self.nodes[node])
        return found
