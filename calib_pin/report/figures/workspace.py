"""Errors and their prediction over the workspace, as arrows or as colors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    MUTED,
    WIDTH,
    Drawn,
    inches,
    key,
    marks,
    note,
    panels,
)
from calib_pin.report.figures.labels import log_axis, log_limits, plain, unit_of
from calib_pin.report.figures.strokes import arrows, thinned, thinning
from calib_pin.report.figures.views import FOOT, LEFT, SCALE, SIDES, Sides, colored
from calib_pin.report.tables import number
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import TipDrift

ARROWS = 300
"""Arrows of one kind: more hide each other."""

POINTS = 5000
"""Points that are drawn at most."""

LENGTH = 0.3
"""Length of a long arrow [inch]."""

TITLE = 0.4
"""Height of a title above views [inch]."""

STAGES = {"before (nominal robot)": BEFORE, "after (calibrated)": AFTER}


def error_vectors(result: CalibrationResult) -> Drawn | None:
    """Errors of the fitted measurements at the tool positions, from three sides."""
    vectors = result.fitted.displacements
    if vectors is None:
        return _sizes(result.fitted)
    usable = np.isfinite(np.column_stack(vectors)).all(axis=1)
    usable &= result.fitted.rows.weight > 0.0
    if not usable.any():
        return None
    lengths = [np.linalg.norm(part[usable], axis=1) for part in vectors]
    drawn = np.flatnonzero(usable)[thinned(int(usable.sum()), ARROWS, lengths)]
    points = result.fitted.points[drawn]
    views = Sides.of(points)
    factor = magnification(np.concatenate(lengths), views.scale)

    block = TITLE + views.height + FOOT
    figure = Figure(figsize=(WIDTH, 2 * block + 0.05))
    for k, ((title, color), part) in enumerate(
        zip(STAGES.items(), vectors, strict=True)
    ):
        row = views.axes(figure, k * block + TITLE)
        ends = points + factor * part[drawn]
        for axes, side in zip(row, SIDES, strict=True):
            ways = points[:, side], ends[:, side]
            axes.add_artist(arrows(*ways, color, views.scale))
        note(figure, LEFT, k * block + 0.25, title)
    _scale_arrow(figure, views.scale, factor)
    means = " and ".join(number(1e3 * size.mean()) for size in lengths)
    return Drawn(
        "error-vectors",
        "Position errors in the workspace",
        f"Arrows lead from the tool point to where the error takes it, magnified "
        f"{factor:g} times; mean length {means} mm before and after. Arrows that "
        "agree with their neighbors show errors of the robot; random ones are noise."
        + thinning(len(drawn), len(lengths[0])),
        figure,
    )


def magnification(lengths: Floats, scale: float) -> float:
    """A round factor that makes most arrows short enough and the long ones seen.

    The lengths (N,) are in meters, the scale is in inches per meter.
    """
    longest = float(np.quantile(lengths, 0.95))
    return _round_down(LENGTH / (scale * longest)) if longest > 0.0 else 1.0


def _round_down(value: float) -> float:
    """The largest of 1, 2, 5, 10, ... that is not larger."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(max(k * power for k in (1.0, 2.0, 5.0) if k * power <= value))


def _scale_arrow(figure: Figure, scale: float, factor: float) -> None:
    """An arrow of known length at the upper right corner."""
    length = _round_down(0.6 / (scale * factor))
    shown = factor * length * scale
    start = np.array([[WIDTH - 0.2 - shown, figure.get_figheight() - 0.2]])
    arrow = arrows(start, start + np.array([shown, 0.0]), INK, 1.0)
    arrow.set_transform(inches(figure))
    figure.add_artist(arrow)
    told = f"error of {plain(1e3 * length)} mm, magnified {plain(factor)} times"
    note(figure, WIDTH - 0.28 - shown, 0.2, told, ha="right", va="center")


def _sizes(rows: MeasurementErrors) -> Drawn | None:
    """Where no position is measured: points colored by the remaining error."""
    rated = [(q, rows.sizes(q)[1]) for q in rows.quantities]
    rated = [(q, sizes) for q, sizes in rated if not np.isnan(sizes).all()]
    if not rated:
        return None
    views = Sides.of(rows.points)
    block = views.height + FOOT + SCALE
    figure = Figure(figsize=(WIDTH, 0.1 + block * len(rated)))
    note = ""
    for k, (quantity, sizes) in enumerate(rated):
        unit, factor = unit_of(quantity.unit)
        own = np.flatnonzero(~np.isnan(sizes))
        drawn = own[thinned(len(own), POINTS, [sizes[own]])]
        values, label = factor * sizes[drawn], f"{quantity.name} error [{unit}]"
        colored(figure, 0.1 + k * block, views, rows.points[drawn], values, label)
        note = note or thinning(len(drawn), len(own))
    return Drawn(
        "errors-in-workspace",
        "Errors in the workspace",
        "Tool positions from three sides; the color is the error that remains after "
        f"calibration. Regions of one color hint at unmodeled errors.{note}",
        figure,
    )


def tip_by_count(result: CalibrationResult) -> Drawn | None:
    """The predicted tool-point uncertainty against the number of measurements."""
    tip = result.accuracy.tip
    if tip is None:
        return None
    unit, factor = unit_of("m")
    counts, errors = tip.by_count.curve
    usable = np.isfinite(errors) & (errors > 0.0)
    counts, errors = counts[usable], factor * errors[usable]
    limits, ends = log_limits(errors), log_limits(counts)
    if len(counts) < 2 or limits is None or ends is None:
        return None
    figure = Figure(figsize=(WIDTH, 3.1))
    (axes,) = panels(figure, 1, 0.45, 2.15, left=0.75)
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
    log_axis(axes, "x", ends)
    log_axis(axes, "y", limits)
    axes.set_xlabel("number of measurements")
    axes.set_ylabel(f"tool-point uncertainty [{unit}]")
    key(figure, signs, 0.75)
    return Drawn(
        "tip-error-by-count",
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
    figure, words = _over_workspace(tip.points, tip.position, "uncertainty", ", rms")
    return Drawn(
        "tip-accuracy-in-workspace",
        "Tool-point accuracy over the workspace",
        f"Predicted tool-point uncertainty (1 sigma) {words}, in the frame of the "
        f"instrument. {_left_out(result)}",
        figure,
    )


def _left_out(result: CalibrationResult) -> str:
    """The limits of the prediction, as a sentence."""
    said = "Of unmodeled errors it has what they do to the fit, not what they add"
    if weak := result.identifiability.weak:
        said += f"; it excludes the {weak} directions held at nominal"
    if (
        result.statistics.stated_sigma
        and result.statistics.chi2 > chi2_interval(result.statistics.dof)[1]
    ):
        said += (
            f"; it holds for the stated sigma, while the measurements scatter "
            f"{number(result.statistics.sigma0)} times as much"
        )
    return f"{said}."


def drift_in_workspace(drift: TipDrift) -> Drawn:
    """The distance of the tool points of two calibrations, from three sides."""
    figure, words = _over_workspace(drift.points, drift.drift, "distance", "")
    return Drawn(
        "tip-drift",
        "Distance of the tool points over the workspace",
        f"Distance of the tool points of both calibrations {words}. Displacements of "
        "estimated frames are removed by a fit.",
        figure,
    )


def _over_workspace(
    points: Floats, sizes: Floats, name: str, kind: str
) -> tuple[Figure, str]:
    """Tool points (N, 3) [m] colored by a length (N,) [m], and that in words.

    The kind is that of the mean, after the unit.
    """
    unit, factor = unit_of("m")
    views = Sides.of(points)
    figure = Figure(figsize=(WIDTH, 0.1 + views.height + FOOT + SCALE))
    values = factor * sizes
    colored(figure, 0.1, views, points, values, f"{name} [{unit}]{kind}")
    place = ", ".join(f"{value:.2f}" for value in points[int(values.argmax())])
    rms = float(np.sqrt(np.mean(values**2)))
    return figure, (
        f"at {len(values)} random configurations: rms {number(rms)} {unit}, from "
        f"{number(values.min())} to {number(values.max())} {unit}, the largest at "
        f"({place}) m"
    )
