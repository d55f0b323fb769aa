"""Convergence of a search, and model selection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib_pin.report.figures.canvas import (
    AFTER,
    MUTED,
    WIDTH,
    Drawn,
    marks,
    panel,
    panels,
)
from calib_pin.report.figures.estimates import beside
from calib_pin.report.figures.labels import log_axis, log_limits, shortened, unit_of
from calib_pin.report.tables import number
from calib_pin.validation.result import (
    CalibrationResult,
    Candidate,
    HeldOutErrors,
    ModelSelection,
)


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


LINE = 0.3
"""Height of a candidate [inch]."""

LEFT = 2.45
"""Width of the names [inch]."""

RIGHT = 1.95
"""Width of the errors [inch]."""

DWARFS = 8.0
"""Ratio of the largest to the smallest error from which the axis is logarithmic."""


WHERE = {
    "near": "The model is for use near the fitted configurations.",
    "away": "The model is for use away from the fitted configurations.",
    "both": "The model is for use everywhere.",
}
"""Meaning of each use of a model, see `ModelSelection.use`."""


def model_ladder(result: CalibrationResult) -> Drawn | None:
    """Mean error on validation measurements by candidate, with its standard error."""
    ladder = result.model_selection
    if ladder is None or not np.isfinite([r.score for r in ladder.candidates]).any():
        return None
    count = len(ladder.candidates)
    height = LINE * (count + 0.4)
    figure = Figure(figsize=(WIDTH, height + 0.65))
    axes = panel(figure, LEFT, 0.1, WIDTH - LEFT - RIGHT, height)
    _rungs(axes, ladder)
    _scale(axes, [r for r in ladder.candidates if np.isfinite(r.score)])
    kept = ladder.candidates[ladder.chosen]
    return Drawn(
        "model-ladder",
        "Model selection",
        "Mean error on held-out measurements, in standard deviations, with its "
        "standard error: near the fitted configurations (filled, at the right in "
        "units of each quantity) and in regions of joint space that were held out "
        f"whole (open). {WHERE[ladder.use]} The simplest model that is not "
        f"significantly worse than the best is selected: {kept.name}.",
        figure,
    )


def _rungs(axes: Axes, ladder: ModelSelection) -> None:
    """A point with its standard error for every candidate, the simplest at the top."""
    for k, rung in enumerate(ladder.candidates):
        if not np.isfinite(rung.score):
            continue
        kept = k == ladder.chosen
        color, sign = (AFTER, "D") if kept else (MUTED, "o")
        axes.errorbar(
            *([rung.score], [k]),
            xerr=[rung.deviation],
            **marks(color, sign, 6.0),
            capsize=3.0,
            label=rung.name,
        )
        if rung.away is not None:
            axes.errorbar(
                *([rung.away.score], [k]),
                xerr=[rung.away.deviation],
                **marks(color, sign, 6.0, hollow=True),
                capsize=3.0,
            )
    axes.set_ylim(len(ladder.candidates) - 0.3, -0.7)
    axes.set_yticks([])
    for k, rung in enumerate(ladder.candidates):
        remark = " (selected)" if k == ladder.chosen else ""
        beside(axes, k, f"{shortened(rung.name, 30)}{remark}", size=9.0)
        place = axes.get_yaxis_transform()
        axes.text(1.03, k, _errors(rung), va="center", transform=place)
    axes.set_xlabel("mean error on held-out measurements [std. dev.]")


def _scale(axes: Axes, rungs: Sequence[Candidate]) -> None:
    """The axis of the errors, logarithmic where one candidate dwarfs another."""
    best = min(rungs, key=lambda rung: rung.score)
    axes.axvline(best.score + best.deviation, color=MUTED, linestyle=":")
    away = [rung.away for rung in rungs if rung.away is not None]
    shown: list[Candidate | HeldOutErrors] = [*rungs, *away]
    lows, highs = (
        np.array([one.score + sign * one.deviation for one in shown])
        for sign in (-1.0, 1.0)
    )
    limits = log_limits(lows, highs)
    if limits is not None and lows.min() > 0.0 and highs.max() > DWARFS * lows.min():
        log_axis(axes, "x", limits)
    else:
        axes.set_xlim(0.0, 1.08 * float(highs.max()) or 1.0)


def _errors(rung: Candidate) -> str:
    """Mean errors in their own units, or why there are none."""
    if rung.reason:
        return "not tried"
    parts = []
    for _, unit, mean, _ in rung.errors:
        shown, factor = unit_of(unit)
        parts.append(f"{number(factor * mean)} {shown}")
    return ", ".join(parts)
