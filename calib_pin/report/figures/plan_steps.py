"""The accuracy of a plan against its number of configurations."""

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
    WIDTH,
    Drawn,
    marks,
    panels,
)
from calib_pin.report.figures.labels import log_axis, log_limits, unit_of
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
