"""The tool-point uncertainty, by number of measurements and over the workspace."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    AFTER,
    INK,
    MUTED,
    WIDTH,
    Drawn,
    marks,
    panels,
)
from calib_pin.report.figures.labels import log_axis, log_limits, unit_of
from calib_pin.report.figures.views import FOOT, SCALE, Sides, colored
from calib_pin.report.tables import number
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import TipDrift


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
    figure = Figure(figsize=(WIDTH, 2.8))
    (axes,) = panels(figure, 1, 0.15, 2.15, left=0.75)
    last = f"{counts[-1]:.0f} measured: {number(errors[-1])} {unit}"
    axes.plot(
        counts,
        errors[-1] * np.sqrt(counts[-1] / counts),
        color=MUTED,
        linestyle="--",
        linewidth=1.0,
        label="∝ 1/√n",
    )
    style = {**marks(AFTER, "o", 5.0), "linestyle": "-"}
    axes.plot(counts, errors, **style, label="part of the measurements")
    axes.plot(
        *(counts[-1:], errors[-1:]),
        **marks(INK, "o", 10.0, hollow=True),
        label=last,
    )
    log_axis(axes, "x", ends)
    log_axis(axes, "y", limits)
    axes.set_xlabel("number of measurements")
    axes.set_ylabel(f"tool-point uncertainty [{unit}]")
    axes.legend(loc="upper right")
    return Drawn(
        "tip-error-by-count",
        "Accuracy against number of measurements",
        f"Predicted tool-point uncertainty (1 sigma, rms over the workspace): "
        f"{number(errors[-1])} {unit} with all {counts[-1]:.0f} measurements. Far "
        "above the dashed line the measurements are too few to determine all "
        "parameters; along it, four times as many halve the uncertainty. "
        f"{_left_out(result)}",
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
        f"Predicted tool-point uncertainty (1 sigma) {words}. {_left_out(result)}",
        figure,
    )


def _left_out(result: CalibrationResult) -> str:
    """What the prediction does not contain, as a sentence."""
    said = "It excludes unmodeled errors"
    if weak := result.identifiability.weak:
        said += f" and the {weak} directions held at nominal"
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
