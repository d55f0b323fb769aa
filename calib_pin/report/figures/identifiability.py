"""Singular values, and the correlations between the estimates of the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    AFTER,
    INK,
    MUTED,
    WIDTH,
    Drawn,
    inches,
    key,
    marks,
    note,
    panel,
    panels,
)
from calib_pin.report.figures.estimates import Estimate, beside, correlation, of_robot
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


MOST = 40
"""Estimates that are shown at most."""

TOGETHER = 0.5
"""Absolute correlation from which an estimate is worth a line among very many."""

LINE = 0.155
"""Height of a line of the matrix [inch]."""

WIDEST = 0.4
"""Largest width of a column [inch]."""

LEFT = 2.75
"""Width of the names [inch]."""

STEPS = 10
"""Shades of each sign."""

NEGATIVE, POSITIVE = "#8073ac", "#e08214"
"""Ends of the purple-orange scale of ColorBrewer that show on white and on black."""


def correlations(result: CalibrationResult) -> Drawn | None:
    """Correlations of the robot's estimates, the lower half of the matrix."""
    if not np.isfinite(result.covariance).all():
        return None
    estimates = of_robot(result.parameters, result.groups, result.model.given)
    places = {p.name: k for k, p in enumerate(result.parameters)}
    R = correlation(estimates, places, result.covariance)
    usable = np.isfinite(np.diag(R))
    estimates = [e for e, kept in zip(estimates, usable, strict=True) if kept]
    R = R[np.ix_(usable, usable)]
    kept = shown(R)
    if len(kept) < 2:
        return None
    height = max(LINE * len(kept), 0.8)
    figure = Figure(figsize=(WIDTH, height + 0.4))
    width = min(WIDTH - LEFT - 0.15, WIDEST * len(kept))
    axes = panel(figure, LEFT, 0.1, width, height)
    _matrix(axes, R[np.ix_(kept, kept)], [estimates[k] for k in kept])
    _shades(figure)
    remark = ""
    if len(kept) < len(estimates):
        remark = (
            f" {len(kept)} of {len(estimates)} are shown: those with the largest "
            f"correlations, above {TOGETHER}."
        )
    apart = np.abs(R - np.diag(np.diag(R)))
    i, j = (int(k) for k in np.unravel_index(apart.argmax(), R.shape))
    return Drawn(
        "correlations",
        "Correlation of the estimates",
        f"Strong color off the diagonal: the measurements determine only a mix of the "
        f"two well. The largest correlation is {number(float(R[i, j]))}, between "
        f"{estimates[j].label} and {estimates[i].label}.{remark}",
        figure,
    )


def shown(R: Floats) -> NDArray[np.intp]:
    """Positions that are shown, ascending: all, or the most correlated ones."""
    if len(R) <= MOST:
        return np.arange(len(R))
    strongest = np.abs(R - np.diag(np.diag(R))).max(axis=1)
    order = np.argsort(-strongest, kind="stable")[:MOST]
    return np.sort(order[strongest[order] > TOGETHER])


def _matrix(axes: Axes, R: Floats, estimates: list[Estimate]) -> None:
    """Squares of the lower half, in shades through which the paper can be seen."""
    count = len(R)
    rows, columns = np.tril_indices(count)
    levels = np.rint(R[rows, columns] * STEPS).astype(int)
    for level in np.unique(levels[levels != 0]):
        chosen = levels == level
        axes.add_artist(_squares(columns[chosen], rows[chosen], int(level)))
    axes.set(xlim=(-0.5, count - 0.5), ylim=(count - 0.5, -0.5))
    axes.set_axis_off()
    every = 1 if count <= 26 else 2
    for k, estimate in enumerate(estimates):
        beside(axes, k, estimate.label, size=8.0, gap=20.0)
        beside(axes, k, str(k + 1), size=8.0, color=MUTED)
        if k % every == 0:
            place = (k, count - 0.4, str(k + 1))
            axes.text(*place, ha="center", va="top", fontsize=8.0, color=MUTED)


def _squares(columns: Floats, rows: Floats, level: int) -> PathPatch:
    """Unit squares of one shade as one path."""
    half = 0.47
    corners = [(-half, -half), (half, -half), (half, half), (-half, half), (0, 0)]
    at = np.column_stack([columns, rows])[:, None] + np.array(corners)
    codes = [Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY]
    return PathPatch(
        Path(at.reshape(-1, 2), np.tile(codes, len(rows))),
        facecolor=NEGATIVE if level < 0 else POSITIVE,
        alpha=abs(level) / STEPS,
        linewidth=0.0,
        label=f"{level / STEPS:+.1f}",
    )


def _shades(figure: Figure) -> None:
    """The color scale, at the right, where the matrix is empty."""
    place = Affine2D().scale(0.085, 0.13)
    place.translate(WIDTH - 1.2, figure.get_figheight() - 0.2)
    for level in (*range(-STEPS, 0), *range(1, STEPS + 1)):
        square = _squares(np.array([level]), np.zeros(1), level)
        square.set_transform(place + inches(figure))
        figure.add_artist(square)
    for level, told in ((-STEPS, "\N{MINUS SIGN}1"), (0, "0"), (STEPS, "+1")):
        left = WIDTH - 1.2 + 0.085 * level
        note(figure, left, 0.3, told, ha="center", va="top", fontsize=8.0)
