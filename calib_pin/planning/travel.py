"""The visit of planned configurations: their order, turns of joints, ways between.

The order is an open traveling-salesman path by nearest neighbors and 2-opt (Croes
1958), where the way between two configurations is the largest joint movement, which
sets the time. A move that is blocked counts as very long; whether one is blocked is
asked only for moves of the path that stands, because asking is expensive.

A way on which the robot touches nothing is the straight one in joint space where that
is free; else rapidly-exploring random trees
from both ends (RRT-Connect, Kuffner and LaValle, ICRA 2000) first near the straight way
and then farther around it, whose way is then made shorter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.turns import TURN, shortest_turns
from calib_pin.observations import Indices
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.workspace import Workspace
from calib_pin.progress import Progress

ROUNDS = 30
"""Times that a path with blocked moves is improved anew."""

ROUNDING = 1e-12
"""Gain in length below which two paths count as equally long [rad, m]."""

DETOUR = 1e3
"""Factor by which a blocked move is longer than the longest free one."""

SAME = 1e-9
"""Relative change of the information of a configuration up to which it is the same."""


def visits(
    workspace: Workspace,
    rows: IdentificationRows,
    q: Floats,
    aim: Indices,
    start: Floats | None,
) -> tuple[Floats, Indices, tuple[int, ...]]:
    """Configurations in the order and in the turns of short travel.

    A joint stands in another turn only where nothing that is estimated depends on it:
    a gear's gain does.

    Args:
        workspace: The configurations that may be measured.
        rows: What is measured at a configuration.
        q: The configurations, shape (K, n) [rad, m].
        aim: What is measured at each, shape (K,).
        start: Where the robot stands before the first, shape (n,).

    Returns:
        Configurations and aims in the order of visits, and the places in it to which
        the straight move is blocked.
    """
    chains, lower, upper = workspace.problem.chains, workspace.lower, workspace.upper
    blocked: Callable[[Floats, Floats], bool] | None = None
    if workspace.collisions is not None:
        ways = Ways(chains, workspace.collisions, lower, upper)

        def blocked(a: Floats, b: Floats) -> bool:
            return not ways.is_free(a, b)

    # Joints that others do not follow, and that follow none.
    tied = {*chains.mimics, *(mimic.leader for mimic in chains.mimics.values())}
    free = chains.revolute & [name not in tied for name in chains.joints]

    def allowed(turned: Floats, q: Floats, aim: Indices) -> bool:
        same = np.array_equal(turned, q) or _same(rows, turned, q, aim)
        return same and bool(workspace.allowed(turned, aim).all())

    middle = 0.5 * (lower + upper)
    turned = q - np.where(free, np.round((q - middle) / TURN), 0.0) * TURN
    q = turned if allowed(turned, q, aim) else q
    # A tool is mounted and an instrument placed only once.
    places: dict[tuple[str, ...], list[int]] = {}
    for k, one in enumerate(aim):
        places.setdefault(workspace.aims.each[one].key[1:], []).append(k)
    order, closed, ahead = np.empty(0, np.intp), tuple[int, ...](), start
    for members in map(np.array, places.values()):
        found, shut = shortest_order(q[members], ahead, blocked)
        closed += tuple(len(order) + place for place in shut)
        order = np.concatenate([order, members[found]])
        ahead = q[order[-1]]
    q, aim = q[order], aim[order]
    turned = shortest_turns(q, lower, upper, free, start)
    if not np.array_equal(turned, q) and allowed(turned, q, aim):
        way = turned if start is None else np.concatenate([start[None], turned])
        moves = enumerate(pairwise(way), 1 if start is None else 0)
        shut = tuple(k for k, (a, b) in moves if blocked is not None and blocked(a, b))
        if len(shut) <= len(closed):
            q, closed = turned, shut
    return q, aim, closed


def _same(rows: IdentificationRows, a: Floats, b: Floats, aim: Indices) -> bool:
    """Whether configurations tell the same, each (K, n)."""
    first, second = rows.rows(a, aim), rows.rows(b, aim)
    # Rows of the same information may differ by a rotation.
    G, H = (np.swapaxes(R, 1, 2) @ R for R in (first, second))
    return bool(np.abs(G - H).max(initial=0.0) <= SAME * np.abs(G).max(initial=1.0))


def shortest_order(
    q: Floats,
    start: Floats | None = None,
    blocked: Callable[[Floats, Floats], bool] | None = None,
) -> tuple[NDArray[np.intp], tuple[int, ...]]:
    """Order configurations for short travel.

    Args:
        q: Configurations, shape (K, n) [rad, m].
        start: Where the robot stands before the first, shape (n,).
        blocked: Whether the straight move between two configurations is blocked.

    Returns:
        The order, shape (K,), and the places in it to which the move is blocked, the
        one from `start` included.

    Examples:
        >>> order, _ = shortest_order(np.array([[0.0], [2.0], [1.0], [3.0]]))
        >>> order.tolist() in ([0, 2, 1, 3], [3, 1, 2, 0])
        True
    """
    places = q if start is None else np.concatenate([start[None], q])
    way = np.abs(places[:, None] - places[None]).max(axis=2)
    fixed = 0 if start is None else 1
    path = _improved(_nearest_neighbors(way), way, fixed)
    closed: list[int] = []
    if blocked is not None:
        known: dict[tuple[int, int], bool] = {}
        long = DETOUR * max(float(way.max()), 1.0)
        latest, closed = path, list(range(len(path)))
        for _ in range(ROUNDS):
            moves = [(min(move), max(move)) for move in pairwise(latest)]
            fresh = [move for move in moves if move not in known]
            known |= {(a, b): blocked(places[a], places[b]) for a, b in fresh}
            here = [k for k, move in enumerate(moves, 1) if known[move]]
            if len(here) < len(closed):
                path, closed = latest, here
            longer = [move for move in fresh if known[move]]
            if not longer:
                break
            for a, b in longer:
                way[a, b] = way[b, a] = long
            latest = _improved(latest, way, fixed)
    order = np.array([place - fixed for place in path[fixed:]], np.intp)
    return order, tuple(k - fixed for k in closed)


def _nearest_neighbors(way: Floats) -> list[int]:
    """A path from the first place that goes on to the nearest one."""
    path, left = [0], np.arange(len(way)) > 0
    while left.any():
        path.append(int(np.where(left, way[path[-1]], np.inf).argmin()))
        left[path[-1]] = False
    return path


def _improved(path: list[int], way: Floats, fixed: int) -> list[int]:
    """Reverse parts of a path as long as that makes it shorter (2-opt)."""
    count = len(path)
    # A place without distance, at both ends, stands for the open ends.
    closed = np.zeros((len(way) + 1, len(way) + 1))
    closed[:-1, :-1] = way
    tour = np.array([len(way), *path, len(way)])
    improved = True
    while improved:
        improved = False
        for i in range(1 + fixed, count):
            # Reverse tour[i .. j].
            j = np.arange(i + 1, count + 1)
            before, first = tour[i - 1], tour[i]
            change = closed[before, tour[j]] + closed[first, tour[j + 1]]
            change -= closed[before, first] + closed[tour[j], tour[j + 1]]
            k = int(change.argmin())
            if change[k] < -ROUNDING:
                tour[i : j[k] + 1] = tour[i : j[k] + 1][::-1].copy()
                improved = True
    return [int(place) for place in tour[1:-1]]


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
    def straight(q: Floats) -> Passage:
        """The straight ways through configurations, shape (N, n)."""
        return Passage(q, np.arange(len(q)), ())

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
        rng: np.random.Generator | None,
        progress: Progress | None = None,
    ) -> Passage:
        """A motion through configurations in their order.

        Args:
            q: The configurations, shape (N, n) [rad, m].
            rng: Source of chance; every way has its own. None where the straight ways
                must not be changed.
            progress: Told the part that is done, 0 to 1.
        """
        parts, rows, blocked = [q[:1]], [np.arange(len(q[:1]))], []
        ways = max(len(q) - 1, 0)
        for k, own in enumerate(rng.spawn(ways) if rng else [None] * ways, 1):
            if progress is not None:
                progress(k / len(q))
            around = self.around(q[k - 1], q[k], own)
            if around is None:
                blocked.append(k)
                around = q[:0]
            parts += [around, q[k : k + 1]]
            rows += [np.full(len(around), VIA), np.array([k])]
        return Passage(np.concatenate(parts), np.concatenate(rows), tuple(blocked))

    def around(
        self, a: Floats, b: Floats, rng: np.random.Generator | None
    ) -> Floats | None:
        """Configurations between two, by which straight ways are free.

        Args:
            a: The first, shape (n,) [rad, m].
            b: The last, shape (n,) [rad, m].
            rng: Source of chance; None to look for no other way.

        Returns:
            The configurations, shape (V, n), none where the straight way is free; None
            if no way was found.
        """
        if self.is_free(a, b):
            return np.empty((0, len(a)))
        if rng is None or not self.collisions.free(np.array([a, b])).all():
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
