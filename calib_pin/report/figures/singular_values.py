"""Singular values, structural and of the measurements."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
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
from calib_pin.report.figures.labels import log_axis, log_limits, plain
from calib_pin.report.tables import number
from calib_pin.validation.result import CalibrationResult, Identifiability


def singular_values(result: CalibrationResult) -> Drawn | None:
    """Structural singular values with their gap beside those of the measurements."""
    ranks = result.identifiability
    kinds = []
    if any(value > 0.0 for value in ranks.structural_values):
        kinds.append(_structural)
    if any(value > 0.0 for value in ranks.singular_values):
        kinds.append(_practical)
    if not kinds:
        return None
    figure = Figure(figsize=(WIDTH, 3.0))
    row = panels(figure, len(kinds), 0.35, 2.1, gap=0.8)
    for axes, draw in zip(row, kinds, strict=True):
        draw(axes, ranks)
    dropped = len(ranks.structural_values) - ranks.structural_rank
    words = {
        _structural: f"Structure: {ranks.structural_rank} directions are identifiable "
        f"and {max(dropped, 0)} numerically zero; a wide gap makes that certain.",
        _practical: "Measurements: the condition number of the robot's identifiable "
        f"directions is {number(ranks.condition)}.",
    }
    reading = " ".join(words[kind] for kind in kinds)
    return Drawn("singular-values", "Singular values", reading, figure)


def _structural(axes: Axes, ranks: Identifiability) -> None:
    values = np.array(ranks.structural_values)
    limits = log_limits(values)
    assert limits is not None, "only drawn where something is positive"
    kept, rank = ranks.structural_rank, np.arange(1, len(values) + 1)
    shown = np.maximum(values, limits[0])
    axes.plot(
        *(rank[:kept], shown[:kept]),
        **marks(AFTER, "o", 5.0),
        label=f"{kept} identifiable",
    )
    if kept < len(values):
        axes.plot(
            *(rank[kept:], shown[kept:]),
            **marks(MUTED, "x", 4.5, hollow=True),
            label=f"{len(values) - kept} numerically zero",
        )
    log_axis(axes, "y", limits)
    if 0 < kept < len(values):
        _gap(axes, kept + 0.5, shown[kept], shown[kept - 1], ranks.gap)
    axes.set_title("structure")
    axes.set_xlabel("direction")
    axes.set_ylabel("singular value, scaled")
    axes.legend(loc="lower left")


def _gap(axes: Axes, at: float, low: float, high: float, gap: float) -> None:
    """A double arrow between the last value kept and the first that is zero."""
    axes.annotate(
        "",
        xy=(at, high),
        xytext=(at, low),
        arrowprops={"arrowstyle": "<->", "color": INK, "shrinkA": 0, "shrinkB": 0},
    )
    told = f"gap {plain(gap)}" if math.isfinite(gap) else "the rest is zero"
    axes.text(at, math.sqrt(low * high), f"{told}  ", ha="right", va="center")


def _practical(axes: Axes, ranks: Identifiability) -> None:
    values = np.array(ranks.singular_values)
    limits = log_limits(values)
    assert limits is not None, "only drawn where something is positive"
    axes.plot(
        *(np.arange(1, len(values) + 1), np.maximum(values, limits[0])),
        **marks(AFTER, "o", 5.0),
    )
    log_axis(axes, "y", limits)
    axes.set_title(f"measurements: condition {number(ranks.condition)}")
    axes.set_xlabel("direction of the robot")
    axes.set_ylabel("singular value, normalized")
