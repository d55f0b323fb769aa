"""The convergence of a search by differential evolution."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calib_pin.report.figures.canvas import AFTER, WIDTH, Drawn, panels
from calib_pin.report.figures.labels import log_axis, log_limits
from calib_pin.report.tables import number
from calib_pin.validation.result import CalibrationResult


def convergence(result: CalibrationResult) -> Drawn | None:
    """The best cost of every generation, where there were any."""
    cost = np.array(result.solver.history)
    limits = log_limits(cost)
    if len(cost) < 2 or limits is None:
        return None
    figure = Figure(figsize=(WIDTH, 2.5))
    (axes,) = panels(figure, 1, 0.15, 1.85, left=0.85)
    generation = np.arange(len(cost))
    shown = np.isfinite(cost) & (cost > 0.0)
    axes.plot(generation[shown], cost[shown], color=AFTER, drawstyle="steps-post")
    log_axis(axes, "y", limits)
    axes.set_xlim(0, len(cost) - 1)
    axes.set_xlabel("generation")
    axes.set_ylabel("best cost")
    return Drawn(
        "convergence",
        "Convergence of the search",
        f"Half the sum of squared normalized residuals of the best member fell from "
        f"{number(cost[0])} to {number(cost[-1])} in {len(cost) - 1} generations of "
        f"{result.solver.name}. Where the curve ends flat, more would not have helped.",
        figure,
    )
