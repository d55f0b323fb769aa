"""Figures of a plan: its accuracy by count, and its positions."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.plan import Plan
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    MUTED,
    Drawn,
    log_axis,
    marks,
    panels,
)
from calib_pin.report.figures.workspace import SIDES, views
from calib_pin.report.tables import number, unit_of

SMALL = ("condition", "prediction")
"""Criteria that are to be small."""


def criterion_by_count(plan: Plan) -> Drawn | None:
    """The criterion and the tool-point uncertainty by number of configurations."""
    unit, factor = unit_of("m")
    name, of_unit, scale = plan.criterion, "", 1.0
    position = factor * np.array([step.position for step in plan.steps])
    curves = [(f"tool-point uncertainty [{unit}]", position, np.nan)]
    if plan.criterion == "prediction":
        name, of_unit, scale = "tool-point uncertainty", f" {unit}", factor
        curves = [(curves[0][0], position, factor * plan.random)]
    else:
        values = np.array([step.value for step in plan.steps])
        curves.insert(0, (plan.criterion, values, plan.random))
    curves = [curve for curve in curves if (curve[1] > 0.0).any()]
    if len(plan.steps) < 2 or not curves:
        return None
    figure, (row,) = panels(1, len(curves), 2.1, top=0.15, gap=0.85)
    counts = np.array([step.count for step in plan.steps], float)
    for axes, curve in zip(row, curves, strict=True):
        _curve(axes, counts, *curve, len(plan.q))
    size = "smaller" if plan.criterion in SMALL else "larger"
    own, random = (number(scale * value) for value in (plan.value, plan.random))
    return Drawn(
        "criterion-by-count",
        "Accuracy against number of configurations",
        f"Below {len(plan.q)} configurations the best part of the plan, above it the "
        f"plan with more candidates. Planned: {name} {own}{of_unit}; random baseline: "
        f"{random}{of_unit}; {size} is better. Where a curve is flat, further "
        "measurements gain little.",
        figure,
    )


def _curve(
    axes: Axes, counts: Floats, label: str, values: Floats, random: float, planned: int
) -> None:
    """A measure of accuracy, that of the plan, and that of random configurations."""
    own = counts == planned
    axes.plot(counts, values, color=AFTER, marker="o", markersize=3.0)
    ring = marks(INK, "o", 9.0, hollow=True)
    axes.plot(counts[own], values[own], **ring, label=f"planned, {planned}")
    if np.isfinite(random):
        cross, name = marks(BEFORE, "X", 8.0), f"random baseline, {planned}"
        axes.plot(planned, random, **cross, label=name)
    log_axis(axes, "y", values, np.array([random]))
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel("configurations")
    axes.set_ylabel(label)
    axes.legend(loc="lower right" if values[-1] > values[0] else "upper right")


def planned_positions(plan: Plan) -> Drawn | None:
    """Positions of the tool from three sides in their order, with the way between."""
    points = tool_positions(plan)
    if len(points) == 0:
        return None
    figure, axes = views(points, np.arange(1.0, len(points) + 1.0), "configuration")
    for view, side in zip(axes, SIDES, strict=True):
        view.plot(*points[:, side].T, color=MUTED, linewidth=0.7, alpha=0.5, zorder=0.9)
        view.plot(*points[:1, side].T, **marks(BEFORE, "s", 6.5), zorder=4.0)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return Drawn(
        "planned-positions",
        "Planned positions of the tool",
        f"The {len(points)} configurations from three sides; the color is their place "
        f"in the plan, the square is the first. Straight lines, {length:.2f} m in all, "
        "join one with the next; the robot itself moves on curves.",
        figure,
    )


def tool_positions(plan: Plan) -> Floats:
    """Tool points of the nominal robot in the base link, shape (K, 3) [m]."""
    points = np.zeros((len(plan.q), 3))
    keys = [aim.key for aim in plan.aims]
    for key in dict.fromkeys(keys):
        own, part = np.array([k == key for k in keys], bool), plan.problem.parts[key]
        error = part.error
        T = error.poses(plan.q[own][:, part.columns], np.zeros(len(error.screws)))
        points[own] = (error.base.inverse().homogeneous @ T)[:, :3, 3]
    return points
