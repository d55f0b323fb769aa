"""The visit of planned configurations: their order, and the turns of joints.

The order is an open traveling-salesman path by nearest neighbors and 2-opt (Croes
1958), where the way between two configurations is the largest joint movement, which
sets the time. A move that is blocked counts as very long; whether one is blocked is
asked only for moves of the path that stands, because asking is expensive.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.turns import TURN
from calib_pin.observations import Indices
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.workspace import Workspace

ROUNDS = 30
"""Times that a path with blocked moves is improved anew."""

SAME = 1e-9
"""Relative change of the information of a configuration, and gain in length of a path
[rad, m], up to which it is the same."""


def visits(
    workspace: Workspace,
    rows: IdentificationRows,
    q: Floats,
    aim: Indices,
    start: Floats | None,
) -> tuple[Floats, Indices, tuple[int, ...]]:
    """Configurations in an order of short travel, joints in their middle turn.

    Joints are turned only where nothing that is estimated depends on it: a gear's gain
    does.

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
    chains, collisions = workspace.problem.chains, workspace.collisions
    blocked: Callable[[Floats, Floats], bool] | None = None
    if collisions is not None:

        def blocked(a: Floats, b: Floats) -> bool:
            return not collisions.move_is_free(a, b)

    # Joints that others do not follow, and that follow none.
    tied = {*chains.mimics, *(mimic.leader for mimic in chains.mimics.values())}
    free = chains.revolute & [name not in tied for name in chains.joints]
    middle = 0.5 * (workspace.lower + workspace.upper)
    turned = q - np.where(free, np.round((q - middle) / TURN), 0.0) * TURN
    if _same(rows, turned, q, aim) and workspace.inside(turned, aim).all():
        q = turned
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
    return q[order], aim[order], closed


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
        long = len(path) * float(way.max())  # Than any way of free moves.
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
            if change[k] < -SAME:
                tour[i : j[k] + 1] = tour[i : j[k] + 1][::-1].copy()
                improved = True
    return [int(place) for place in tour[1:-1]]
