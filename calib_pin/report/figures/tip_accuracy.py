"""How well the tip is known, by number of measurements and over the workspace."""

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

__all__ = ["drift_in_workspace", "tip_by_count", "tip_in_workspace"]


def tip_by_count(result: CalibrationResult) -> Drawn | None:
    """Predicted error of the tip against the number of measurements."""
    tip = result.tip
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
    axes.plot(counts, errors, **style, label="some of these rows")
    axes.plot(
        *(counts[-1:], errors[-1:]),
        **marks(INK, "o", 10.0, hollow=True),
        label=last,
    )
    log_axis(axes, "x", ends)
    log_axis(axes, "y", limits)
    axes.set_xlabel("number of measurements")
    axes.set_ylabel(f"tip error [{unit}], rms")
    axes.legend(loc="upper right")
    return Drawn(
        "tip-error-by-count",
        "Tip error by number of measurements",
        f"Error of the tip that noise leaves, predicted over the workspace: "
        f"{number(errors[-1])} {unit} with all {counts[-1]:.0f} measurements. Far "
        "above the dashed line too few rows determine all parameters; along it, four "
        f"times the rows halve the error. {_left_out(result)}",
        figure,
    )


def tip_in_workspace(result: CalibrationResult) -> Drawn | None:
    """Predicted error of the tip at random configurations, from three sides."""
    tip = result.tip
    if tip is None or len(tip.points) == 0 or not np.isfinite(tip.position).all():
        return None
    figure, words = _over_workspace(tip.points, tip.position, "tip error", ", rms")
    return Drawn(
        "tip-accuracy-in-workspace",
        "Tip accuracy over the workspace",
        f"Error of the tip that noise leaves {words}. {_left_out(result)}",
        figure,
    )


def _left_out(result: CalibrationResult) -> str:
    """What the prediction does not know."""
    said = "Not in it is what no parameter of the model describes"
    if weak := result.identifiability.weak:
        said += f", nor the {weak} directions that are left at nominal"
    if result.stated_sigma and result.chi2 > chi2_interval(result.dof)[1]:
        said += (
            f"; it holds for the stated sigma, and the rows scatter "
            f"{number(result.sigma0)} times as much"
        )
    return f"{said}."


def drift_in_workspace(drift: TipDrift) -> Drawn:
    """How far the tips of two calibrations are apart, from three sides."""
    figure, words = _over_workspace(drift.points, drift.drift, "distance", "")
    return Drawn(
        "tip-drift",
        "Distance of the tips over the workspace",
        f"How far the tips of both calibrations are apart {words}. What a frame can "
        "absorb that one of them estimated is fitted away.",
        figure,
    )


def _over_workspace(
    points: Floats, sizes: Floats, name: str, kind: str
) -> tuple[Figure, str]:
    """Points colored by a size, and the sizes in words.

    Args:
        points: Where the tips are, shape (N, 3) [m].
        sizes: What is shown of each, shape (N,) [m].
        name: What that is.
        kind: What kind of mean, after the unit.
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
