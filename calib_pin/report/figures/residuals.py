"""Whether the residuals are normal, as least squares takes them to be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import NormalDist

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    GROUPS,
    INK,
    MUTED,
    OF_STATIONS,
    WIDTH,
    Drawn,
    marks,
    panels,
)
from calib_pin.report.figures.labels import shortened, stations_of
from calib_pin.report.figures.strokes import Marks
from calib_pin.validation.result import CalibrationResult

FEWEST = 8
"""Residuals from which a distribution can be seen."""

FAR = 3.0
"""Standard deviations beyond which one in 370 normal values lies."""

EDGE = 6.0
"""Standard deviations that the histogram shows; what lies beyond is put at its ends."""

TAIL = 60
"""Smallest and largest values that are all drawn in the normal plot."""

MIDDLE = 120
"""Values between them that are drawn."""

MARKS = ("o", "s", "^", "D", "v")


def residuals(result: CalibrationResult) -> Drawn | None:
    """Histogram and normal plot of the normalized residuals of the fit."""
    values = whitened(result)
    if sum(map(len, values.values())) < FEWEST:
        return None
    every = np.concatenate(list(values.values()))
    figure = Figure(figsize=(WIDTH, 3.3))
    left, right = panels(figure, 2, 0.4, 2.35, left=0.7, gap=0.85)
    several = len(stations_of(result.fitted.rows)[0]) > 1
    colors = (*OF_STATIONS, GROUPS[1]) if several else GROUPS
    _histogram(left, values, colors)
    _normal_plot(right, values, colors)
    outside = float(np.mean(np.abs(every) > FAR))
    left.set_title(f"{100.0 * outside:.2f} % outside ±3")
    return Drawn(
        "residuals",
        "Distribution of the residuals",
        "Residuals of the fitted measurements divided by their estimated standard "
        f"deviations: {100.0 * outside:.2f} % lie outside ±3; of normal ones 0.27 % "
        "would. Points that leave the line at its ends are heavy tails or outliers.",
        figure,
    )


def whitened(result: CalibrationResult) -> Mapping[str, Floats]:
    """Residuals in their standard deviations by quantity, ascending, (N,) each.

    A few stations are told apart. Empty where standard deviations are not known.
    """
    rows = result.fitted
    if not result.statistics.noise:
        return {}
    stations, of_row = stations_of(rows.rows)
    if len(stations) * len(rows.quantities) > len(OF_STATIONS):
        stations, of_row = [""], np.zeros_like(of_row)
    found = {}
    for quantity in rows.quantities:
        for k, station in enumerate(stations):
            parts = (rows.after, rows.sigma)
            own = of_row == k
            after, sigma = (part[own, quantity.columns].ravel() for part in parts)
            usable = np.isfinite(after) & np.isfinite(sigma)
            values = np.sort(after[usable] / sigma[usable])
            if len(values):
                name = f"{quantity.name}, {station}" if station else quantity.name
                found[name] = values
    return found


def _histogram(axes: Axes, values: Mapping[str, Floats], colors: Sequence[str]) -> None:
    count = sum(map(len, values.values()))
    bins = int(np.clip(np.sqrt(4 * count), 24, 60))
    edges = np.linspace(-EDGE, EDGE, bins + 1)
    highest = 0.4
    for (name, sizes), color in zip(values.items(), colors, strict=False):
        counts, _ = np.histogram(np.clip(sizes, -EDGE, EDGE), edges)
        density = counts / (len(sizes) * (edges[1] - edges[0]))
        highest = max(highest, float(density.max()))
        axes.stairs(density, edges, fill=True, color=color, alpha=0.3, linewidth=0.0)
        axes.stairs(density, edges, color=color, linewidth=1.2, label=shortened(name))
    at = np.linspace(-EDGE, EDGE, 121)
    normal = np.exp(-(at**2) / 2.0) / np.sqrt(2.0 * np.pi)
    axes.plot(at, normal, color=INK, linewidth=1.2, label="normal")
    for end in (-FAR, FAR):
        axes.axvline(end, color=MUTED, linewidth=0.9, linestyle=":")
    axes.set_xlim(-EDGE, EDGE)
    axes.set_ylim(0.0, 1.1 * highest)
    axes.set_xlabel("residual / sigma")
    axes.set_ylabel("density")


def _normal_plot(
    axes: Axes, values: Mapping[str, Floats], colors: Sequence[str]
) -> None:
    """Order statistics against what they would be if they were normal."""
    ends = [-4.0, 4.0]
    for (name, sizes), color, mark in zip(values.items(), colors, MARKS, strict=False):
        ranks = _shown_ranks(len(sizes))
        normal = [NormalDist().inv_cdf((k + 0.5) / len(sizes)) for k in ranks]
        style = marks(color, mark, 3.5, hollow=True)
        axes.add_line(Marks(normal, sizes[ranks], **style, label=shortened(name)))
        ends += [normal[0], normal[-1]]
    line = [min(ends), max(ends)]
    axes.plot(line, line, color=INK, linewidth=1.0, label="normal", zorder=1.5)
    axes.set_xlabel("normal value of the same rank")
    axes.set_ylabel("residual / sigma", labelpad=2.0)
    axes.legend(loc="best")


def _shown_ranks(count: int) -> NDArray[np.intp]:
    """Ranks of N values that are drawn: the ends all, the middle evenly in between."""
    if count <= 2 * TAIL + MIDDLE:
        return np.arange(count)
    middle = np.linspace(TAIL, count - 1 - TAIL, MIDDLE).round().astype(np.intp)
    tails = np.arange(TAIL)
    return np.unique(np.concatenate([tails, middle, count - 1 - tails]))
