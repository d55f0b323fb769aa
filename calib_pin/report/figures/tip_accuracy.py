"""How well the tip is known, by number of measurements and over the workspace."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

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
from calib_pin.result import CalibrationResult

__all__ = ["tip_by_count", "tip_in_workspace"]


def tip_by_count(result: CalibrationResult) -> Drawn | None:
    """Predicted error of the tip against the number of measurements."""
    tip = result.tip
    if tip is None:
        return None
    unit, factor = unit_of("m")
    usable = np.isfinite(tip.by_count) & (tip.by_count > 0.0)
    counts, errors = tip.counts[usable], factor * tip.by_count[usable]
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
        "times the rows halve the error.",
        figure,
    )


def tip_in_workspace(result: CalibrationResult) -> Drawn | None:
    """Predicted error of the tip at random configurations, from three sides."""
    tip = result.tip
    if tip is None or len(tip.points) == 0 or not np.isfinite(tip.position).all():
        return None
    unit, factor = unit_of("m")
    views = Sides.of(tip.points)
    figure = Figure(figsize=(WIDTH, 0.1 + views.height + FOOT + SCALE))
    values = factor * tip.position
    colored(figure, 0.1, views, tip.points, values, f"tip error [{unit}], rms")
    worst = tip.points[int(values.argmax())]
    place = ", ".join(f"{value:.2f}" for value in worst)
    return Drawn(
        "tip-accuracy-in-workspace",
        "Tip accuracy over the workspace",
        f"Error of the tip that noise leaves at {len(values)} random configurations: "
        f"rms {number(factor * tip.rms[0])} {unit}, from {number(values.min())} to "
        f"{number(values.max())} {unit}, the largest at ({place}) m. What no parameter "
        "of the model describes is not in it.",
        figure,
    )
