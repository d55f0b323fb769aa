"""Singular values of the identification matrix."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    AFTER,
    INK,
    MUTED,
    WIDTH,
    Drawn,
    key,
    marks,
    panels,
)
from calib_pin.report.figures.labels import log_axis, log_limits, plain
from calib_pin.report.tables import number
from calib_pin.validation.result import CalibrationResult, Identifiability


def singular_values(result: CalibrationResult) -> Drawn | None:
    """Structural singular values with their gap beside those of the measurements."""
    ranks = result.identifiability
    structural, practical = (
        any(value > 0.0 for value in values)
        for values in (ranks.structural_values, ranks.singular_values)
    )
    if not structural and not practical:
        return None
    head = 0.62 if structural else 0.35
    figure = Figure(figsize=(WIDTH, head + 2.65))
    row = panels(figure, structural + practical, head, 2.1, gap=0.8)
    said = []
    if structural:
        key(figure, _structural(row[0], ranks), 0.75)
        dropped = len(ranks.structural_values) - ranks.structural_rank
        said.append(
            f"Structure: {ranks.structural_rank} directions are identifiable and "
            f"{max(dropped, 0)} numerically zero; a wide gap makes that certain."
        )
    if practical:
        axes, values = row[-1], np.array(ranks.singular_values)
        _values(axes, values, slice(None), marks(AFTER, "o", 5.0))
        axes.set_title(f"measurements: condition {number(ranks.condition)}")
        axes.set_xlabel("direction of the robot")
        axes.set_ylabel("singular value, normalized")
        said.append(
            "Measurements: the condition number of the robot's identifiable directions "
            f"is {number(ranks.condition)}."
        )
    return Drawn("singular-values", "Singular values", " ".join(said), figure)


def _structural(axes: Axes, ranks: Identifiability) -> dict[str, dict[str, Any]]:
    """Draw the values of the structure; returns their signs by what they stand for."""
    values, kept = np.array(ranks.structural_values), ranks.structural_rank
    signs = {f"{kept} identifiable": marks(AFTER, "o", 5.0)}
    low = _values(axes, values, slice(kept), *signs.values())
    title = "structure"
    if kept < len(values):
        zero = marks(MUTED, "x", 4.5, hollow=True)
        signs[f"{len(values) - kept} numerically zero"] = zero
        _values(axes, values, slice(kept, None), zero)
    if 0 < kept < len(values):
        _gap(axes, kept + 0.5, max(values[kept], low), max(values[kept - 1], low))
        known = math.isfinite(ranks.gap)
        title += f": gap {plain(ranks.gap)}" if known else ": the rest is zero"
    axes.set_title(title)
    axes.set_xlabel("direction")
    axes.set_ylabel("singular value, scaled")
    return signs


def _values(
    axes: Axes, values: Floats, chosen: slice, style: Mapping[str, Any]
) -> float:
    """Draw some of the values by rank; returns the lower end of the log axis."""
    limits = log_limits(values)
    assert limits is not None, "only drawn where something is positive"
    rank, shown = np.arange(1, len(values) + 1), np.maximum(values, limits[0])
    axes.plot(rank[chosen], shown[chosen], **style)
    log_axis(axes, "y", limits)
    return limits[0]


def _gap(axes: Axes, at: float, low: float, high: float) -> None:
    """A double arrow between the last value kept and the first that is zero."""
    axes.annotate(
        "",
        xy=(at, high),
        xytext=(at, low),
        arrowprops={"arrowstyle": "<->", "color": INK, "shrinkA": 0, "shrinkB": 0},
    )
