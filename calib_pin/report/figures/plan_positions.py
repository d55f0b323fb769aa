"""The tool positions of a plan, in their order."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.plan import Plan
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    MUTED,
    WIDTH,
    Drawn,
    marks,
)
from calib_pin.report.figures.views import FOOT, SIDES, Sides

ROOM = np.array([0.22, 0.13])
"""Width and height of a number; one that would stand on another is left out [inch]."""


def planned_positions(plan: Plan) -> Drawn | None:
    """Positions of the tool from three sides, numbered, with the way between them."""
    points = tool_positions(plan)
    if len(points) == 0:
        return None
    views = Sides.of(points)
    figure = Figure(figsize=(WIDTH, 0.15 + views.height + FOOT))
    for axes, side in zip(views.axes(figure, 0.15), SIDES, strict=True):
        _way(axes, points[:, side], views.scale)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return Drawn(
        "planned-positions",
        "Planned positions of the tool",
        f"The {len(points)} configurations in the order of the plan, from three sides; "
        f"the square is the first. Straight lines, {length:.2f} m in all, join one "
        "with the next; the robot itself moves on curves.",
        figure,
    )


def tool_positions(plan: Plan) -> Floats:
    """Tool points of the nominal robot in the base link, shape (K, 3) [m]."""
    error = plan.problem.error
    T = error.poses(plan.q, np.zeros(len(error.parameters)))
    to_base = error.base.inverse().homogeneous
    return np.asarray(T[:, :3, 3] @ to_base[:3, :3].T + to_base[:3, 3])


def _way(axes: Axes, spots: Floats, scale: float) -> None:
    """The path, its stops, and the numbers that have room.

    Args:
        axes: A view.
        spots: Positions in it, shape (K, 2) [m].
        scale: Inches per meter.
    """
    axes.plot(*spots.T, color=MUTED, linewidth=0.7, alpha=0.5)
    axes.plot(*spots.T, **marks(AFTER, "o", 4.5))
    axes.plot(*spots[:1].T, **marks(BEFORE, "s", 6.5))
    told: list[Floats] = []
    for k, spot in enumerate(spots):
        if any((np.abs(spot - other) * scale < ROOM).all() for other in told):
            continue
        told.append(spot)
        axes.annotate(
            str(k + 1),
            spot,
            xytext=(3.0, 2.5),
            textcoords="offset points",
            fontsize=7.5,
            color=INK,
        )
