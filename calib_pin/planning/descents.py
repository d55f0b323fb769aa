"""Descents of configurations along the gradient of a criterion, each by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.planning.objective import Found, Listener, Objective
from calib_pin.planning.workspace import Workspace
from calib_pin.solvers import Status, projected_descent

EXPLORING, REFINING = (1e-3, 60), (1e-6, 200)
"""Tolerance and steps of the descents before and after; costs are logarithms."""


@dataclass(frozen=True)
class Descent:
    """A set of configurations to go down from.

    Attributes:
        q: Configurations, shape (K, n) [rad, m].
        aim: Position of what is measured at each among those of the workspace, (K,).
        sharpnesses: Those of the cost in successive descents.
        limits: Tolerance and steps of each of them.
        begin: Number of descents of the whole search before these.
    """

    q: Floats
    aim: Indices
    sharpnesses: tuple[float, ...]
    limits: tuple[float, int]
    begin: int


@dataclass(frozen=True)
class Descents:
    """The part that all descents of a search share.

    Attributes:
        objective: What is to be small.
        workspace: The constraints of configurations.
        listener: Told how far the search is; may stop it.
        total: Number of all descents of the search.
    """

    objective: Objective
    workspace: Workspace
    listener: Listener
    total: int


def descend(shared: Descents, task: Descent) -> tuple[Found, ...]:
    """Go down from a set, with a sharper and sharper cost.

    Returns:
        What each of the descents has found, each from where the one before ended.
    """
    found = list[Found]()
    q = task.q
    for done, sharpness in enumerate(task.sharpnesses, task.begin):
        told = partial(shared.listener.told, "gradient", done / shared.total)
        found.append(_descent(shared, q, task.aim, sharpness, task.limits, told))
        q = found[-1].q
    return tuple(found)


def _descent(
    shared: Descents,
    q: Floats,
    aim: Indices,
    sharpness: float,
    limits: tuple[float, int],
    told: Callable[[], bool],
) -> Found:
    """Go down from a set; what it may not reach it does not."""
    objective, workspace = shared.objective, shared.workspace
    cost = objective.cost(q, aim)
    start = Found(q, aim, cost, "gradient", Status.STALLED)
    if told() or not np.isfinite(cost):
        return start

    settled = partial(workspace.settled, aim=aim)

    def smooth(q: Floats) -> tuple[float, Floats]:
        rows, pullback = objective.rows.linearize(settled(q), aim)
        found = objective.information(rows)
        if found is None:
            return np.inf, np.zeros_like(q)
        cost, by_M = objective.criterion.slope(found, sharpness)
        return cost, pullback(2.0 * rows @ by_M)

    result = projected_descent(
        smooth,
        np.column_stack([workspace.lower, workspace.upper]),
        q,
        allowed=lambda q: workspace.allowed(settled(q), aim),
        callback=lambda nit, x, fun: told(),
        tolerance=limits[0],
        max_iterations=limits[1],
    )
    q = settled(result.x)
    # Points that were held up may have come too close to others that moved.
    if not workspace.allowed(q, aim).all():
        return start
    return Found(q, aim, objective.cost(q, aim), "gradient", result.status)
