"""Predictions over the workspace, and plans: by count, and from three sides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib_pin.estimation.statistics.distributions import chi2_interval
from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    MUTED,
    SCALE,
    VECTORS,
    Drawn,
    key,
    log_axis,
    marks,
    panels,
    top_of,
)
from calib_pin.report.tables import number, unit_of
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import TipDrift

if TYPE_CHECKING:  # It brings all searches of a plan, and most figures are of none.
    from calib_pin.planning.plan import Plan

SIDES = ((0, 1), (0, 2), (1, 2))
"""Axes of the base link to the right and upwards, of every view."""


def views(points: Floats, values: Floats, label: str) -> tuple[Figure, Any]:
    """Points (N, 3) [m] of the base link from three sides, colored by values (N,)."""
    figure, (axes,) = panels(1, 3, 1.9, top=0.15, foot=1.2, gap=0.7)
    high = top_of(values)
    order = np.argsort(values)  # The largest come last and hide the others.
    size = float(np.clip(60.0 / np.sqrt(len(points)), 2.5, 5.0)) ** 2
    for view, (right, up) in zip(axes, SIDES, strict=True):
        drawn = view.scatter(
            *(points[order, right], points[order, up], size, values[order]),
            cmap=SCALE,
            vmin=float(values.min()),
            vmax=high,
            linewidths=0.0,
            rasterized=len(points) > VECTORS,
        )
        view.set_aspect("equal", "datalim")
        view.set_xlabel(f"{'xyz'[right]} [m]")
        view.set_ylabel(f"{'xyz'[up]} [m]", labelpad=1.0)
        view.locator_params(nbins=5)
    place = (0.35, 0.5 / figure.get_figheight(), 0.5, 0.04)
    scale = figure.colorbar(drawn, figure.add_axes(place), orientation="horizontal")
    scale.ax.locator_params(nbins=5)
    scale.outline.set_visible(False)
    scale.set_label(f"{label}{', more at the end' if values.max() > high else ''}")
    return figure, axes


def tip_by_count(result: CalibrationResult) -> Drawn | None:
    """The predicted tool-point uncertainty against the number of measurements."""
    tip = result.accuracy.tip
    if tip is None:
        return None
    unit, factor = unit_of("m")
    counts, errors = tip.by_count.measurements, tip.by_count.position
    usable = np.isfinite(errors) & (errors > 0.0)
    counts, errors = counts[usable], factor * errors[usable]
    if len(counts) < 2:
        return None
    figure, ((axes,),) = panels(1, 1, 2.15)
    falling = errors[-1] * np.sqrt(counts[-1] / counts)
    last = f"{counts[-1]:.0f} measured: {number(errors[-1])} {unit}"
    signs: dict[str, dict[str, Any]] = {
        "∝ 1/√n": {"color": MUTED, "linestyle": "--", "linewidth": 1.0},
        "part of the measurements": {**marks(AFTER, "o", 5.0), "linestyle": "-"},
        last: marks(INK, "o", 10.0, hollow=True),
    }
    curves = (counts, falling), (counts, errors), (counts[-1:], errors[-1:])
    for curve, style in zip(curves, signs.values(), strict=True):
        axes.plot(*curve, **style)
    log_axis(axes, "x", counts)
    log_axis(axes, "y", errors)
    axes.set_xlabel("number of measurements")
    axes.set_ylabel(f"tool-point uncertainty [{unit}]")
    key(figure, signs)
    return Drawn(
        "Accuracy against number of measurements",
        f"Predicted tool-point uncertainty (1 sigma, rms over the workspace): "
        f"{number(errors[-1])} {unit} with all {counts[-1]:.0f} measurements. Far "
        "above the dashed line the measurements are too few to determine all "
        "parameters; along it, four times as many halve the uncertainty. "
        "It is that of noise alone, in the frame of the instrument.",
        figure,
    )


def tip_in_workspace(result: CalibrationResult) -> Drawn | None:
    """The predicted tool-point uncertainty over the workspace, from three sides."""
    tip = result.accuracy.tip
    if tip is None or len(tip.points) == 0 or not np.isfinite(tip.position).all():
        return None
    said = "Of unmodeled errors it has what they do to the fit, not what they add"
    if weak := result.identifiability.weak:
        said += f"; it excludes the {weak} directions held at nominal"
    found = result.statistics
    if found.stated_sigma and found.chi2 > chi2_interval(found.dof)[1]:
        said += (
            "; it holds for the stated sigma, while the measurements scatter "
            f"{number(found.sigma0)} times as much"
        )
    unit, factor = unit_of("m")
    label = f"uncertainty [{unit}], rms"
    figure, _ = views(tip.points, factor * tip.position, label)
    return Drawn(
        "Tool-point accuracy over the workspace",
        f"Predicted tool-point uncertainty (1 sigma) "
        f"{_spread(tip.points, tip.position)}, in the frame of the instrument. {said}.",
        figure,
    )


def drift_in_workspace(drift: TipDrift) -> Drawn:
    """The distance of the tool points of two calibrations, from three sides."""
    unit, factor = unit_of("m")
    figure, _ = views(drift.points, factor * drift.drift, f"distance [{unit}]")
    return Drawn(
        "Distance of the tool points over the workspace",
        f"Distance of the tool points of both calibrations "
        f"{_spread(drift.points, drift.drift)}. Displacements of estimated frames are "
        "removed by a fit.",
        figure,
    )


def _spread(points: Floats, sizes: Floats) -> str:
    """Lengths (N,) [m] at tool points (N, 3) [m] in words."""
    unit, factor = unit_of("m")
    values = factor * sizes
    place = ", ".join(f"{value:.2f}" for value in points[int(values.argmax())])
    rms = float(np.sqrt(np.mean(values**2)))
    return (
        f"at {len(values)} random configurations: rms {number(rms)} {unit}, from "
        f"{number(values.min())} to {number(values.max())} {unit}, the largest at "
        f"({place}) m"
    )


SMALL = ("condition", "prediction")
"""Criteria that are to be small."""


def criterion_by_count(plan: Plan) -> Drawn | None:
    """The criterion and the tool-point uncertainty by number of configurations."""
    unit, factor = unit_of("m")
    tip, name, of_unit, scale = "tool-point uncertainty", plan.criterion, "", 1.0
    values, position = np.array([(s.value, factor * s.position) for s in plan.steps]).T
    curves = [(f"{tip} [{unit}]", position, np.nan)]
    if name == "prediction":
        name, of_unit, scale = tip, f" {unit}", factor
        curves = [(f"{tip} [{unit}]", position, factor * plan.random)]
    else:
        curves.insert(0, (name, values, plan.random))
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
    for block in dict.fromkeys(keys):
        own = np.array([other == block for other in keys], bool)
        term = plan.problem.terms[block]
        error = term.error
        T = error.poses(plan.q[own][:, term.columns], np.zeros(len(error.screws)))
        points[own] = (error.base.inverse().homogeneous @ T)[:, :3, 3]
    return points
