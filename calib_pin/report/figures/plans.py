"""Figures of a plan: its accuracy by count, and its positions."""

from __future__ import annotations

from dataclasses import dataclass

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
    PAPER,
    WIDTH,
    Drawn,
    marks,
    panels,
)
from calib_pin.report.figures.labels import log_axis, log_limits, unit_of
from calib_pin.report.figures.views import FOOT, SIDES, Sides
from calib_pin.report.tables import number

SMALL = ("condition", "prediction")
"""Criteria that are to be small."""


@dataclass(frozen=True)
class _Curve:
    """A measure of accuracy against the number of configurations.

    Attributes:
        label: Its name, with its unit.
        values: Its value for every number, shape (K,).
        random: Its value for configurations at random, if that is known.
    """

    label: str
    values: Floats
    random: float | None


def criterion_by_count(plan: Plan) -> Drawn | None:
    """The criterion and the tool-point uncertainty by number of configurations."""
    counts = np.array([step.count for step in plan.steps], float)
    curves = [curve for curve in _curves(plan) if log_limits(curve.values)]
    if len(counts) < 2 or not curves:
        return None
    figure = Figure(figsize=(WIDTH, 2.8))
    row = panels(figure, len(curves), 0.15, 2.1, gap=0.85)
    for axes, curve in zip(row, curves, strict=True):
        _draw(axes, counts, curve, len(plan.q))
    size = "smaller" if plan.criterion in SMALL else "larger"
    name, unit, factor = plan.criterion, "", 1.0
    if plan.criterion == "prediction":
        unit, factor = f" {unit_of('m')[0]}", unit_of("m")[1]
        name = "tool-point uncertainty"
    own, random = (number(factor * value) for value in (plan.value, plan.random))
    return Drawn(
        "criterion-by-count",
        "Accuracy against number of configurations",
        f"Below {len(plan.q)} configurations the best part of the plan, above it the "
        f"plan with more candidates. Planned: {name} {own}{unit}; random baseline: "
        f"{random}{unit}; {size} is better. Where a curve is flat, further "
        "measurements gain little.",
        figure,
    )


def _curves(plan: Plan) -> list[_Curve]:
    unit, factor = unit_of("m")
    position = factor * np.array([step.position for step in plan.steps])
    tip = f"tool-point uncertainty [{unit}]"
    if plan.criterion == "prediction":
        return [_Curve(tip, position, factor * plan.random)]
    values = np.array([step.value for step in plan.steps])
    return [_Curve(plan.criterion, values, plan.random), _Curve(tip, position, None)]


def _draw(axes: Axes, counts: Floats, curve: _Curve, planned: int) -> None:
    axes.plot(counts, curve.values, color=AFTER, marker="o", markersize=3.0)
    own = curve.values[counts == planned]
    shown = [curve.values, own]
    axes.plot(
        [planned] * len(own),
        own,
        **marks(INK, "o", 9.0, hollow=True),
        label=f"planned, {planned}",
    )
    if curve.random is not None and np.isfinite(curve.random):
        shown.append(np.array([curve.random]))
        axes.plot(
            planned,
            curve.random,
            **marks(BEFORE, "X", 8.0),
            label=f"random baseline, {planned}",
        )
    limits = log_limits(*shown)
    assert limits is not None, "only drawn where something is positive"
    log_axis(axes, "y", limits)
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel("configurations")
    axes.set_ylabel(curve.label)
    rising = curve.values[-1] > curve.values[0]
    axes.legend(loc="lower right" if rising else "upper right")


AWAY = np.array([(1.0, 0.6), (-1.0, 0.6), (1.0, -0.6), (-1.0, -0.6)])
"""Sides of a stop on which its number can stand; it is left out if none is free."""

AROUND = 0.06
"""Distance of a number from the middle of a stop [inch]."""


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
    points = np.zeros((len(plan.q), 3))
    keys = [aim.key for aim in plan.aims]
    for key in dict.fromkeys(keys):
        own, term = np.array([k == key for k in keys], bool), plan.problem.terms[key]
        error = term.error
        T = error.poses(plan.q[own][:, term.columns], np.zeros(len(error.screws)))
        points[own] = (error.base.inverse().homogeneous @ T)[:, :3, 3]
    return points


def _way(axes: Axes, spots: Floats, scale: float) -> None:
    """The path (K, 2) [m], its stops, and the numbers that have room.

    The scale is in inches per meter.
    """
    axes.plot(*spots.T, color=MUTED, linewidth=0.7, alpha=0.5)
    axes.plot(*spots.T, **marks(AFTER, "o", 4.5), zorder=4.0)
    axes.plot(*spots[:1].T, **marks(BEFORE, "s", 6.5), zorder=4.0)
    stops, told = spots * scale, np.empty((0, 2, 2))
    for k, stop in enumerate(stops):
        half = np.array([0.036 * len(str(k + 1)) + 0.01, 0.065])
        for away in AWAY:
            middle = stop + away * (half + AROUND)
            box = np.array([middle - half, middle + half])
            near = np.abs(stops - middle) < half + 0.5 * AROUND
            crossed = (box[0] < told[:, 1]) & (told[:, 0] < box[1])
            if near.all(axis=1).any() or crossed.all(axis=1).any():
                continue
            told = np.concatenate([told, box[None]])
            x, y = middle / scale
            axes.text(
                x,
                y,
                str(k + 1),
                ha="center",
                va="center",
                fontsize=7.5,
                # The way passes below the number.
                bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 0.5},
            )
            break
