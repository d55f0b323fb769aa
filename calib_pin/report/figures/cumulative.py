"""Shares of measurements with an error below a size, before and after."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    MUTED,
    STAGES,
    Drawn,
    key,
    marks,
    panels,
)
from calib_pin.report.tables import significant, unit_of
from calib_pin.validation.accuracy import Accuracy
from calib_pin.validation.result import CalibrationResult

SHARE = 0.95
"""The share that is marked."""

STEPS = 300
"""Steps of a curve at most."""

COLUMNS = 2
"""Panels side by side at most."""


def cumulative_errors(result: CalibrationResult) -> Drawn | None:
    """Cumulative errors of the held-out measurements, of all where there are none."""
    rows = result.fitted if result.held_out is None else result.held_out
    counted = rows.rows.weight > 0.0
    found = []
    for quantity in rows.quantities:
        unit, factor = unit_of(quantity.unit)
        own = [size[counted & ~np.isnan(size)] for size in rows.sizes(quantity)]
        if all(np.isfinite(size).any() for size in own):
            found.append((quantity.name, unit, [np.sort(factor * s) for s in own]))
    if not found:
        return None
    lines, columns = math.ceil(len(found) / COLUMNS), min(len(found), COLUMNS)
    figure, places = panels(lines, columns, 2.2, right=0.35, top=0.68, apart=0.95)
    for axes in places.flat[len(found) :]:
        axes.remove()
    said = []
    for axes, (name, unit, sizes) in zip(places.flat, found, strict=False):
        below = " → ".join(significant(Accuracy.of(size).p95) for size in sizes)
        axes.set_title(f"95 % below {below} {unit}")
        axes.set_xlabel(f"{name} error [{unit}]")
        _curves(axes, sizes)
        said.append(f"{name} {below} {unit}")
    for axes in places[:, 0]:
        axes.set_ylabel("share of measurements [%]")
    key(figure, {name: {"color": c} for name, c in STAGES.items()})
    which = "fitted" if result.held_out is None else "held-out"
    return Drawn(
        "cumulative-errors",
        "Share of measurements below an error",
        f"Each curve shows which part of the {len(rows)} {which} measurements has an "
        "error of at most the size on the axis: the further to the left, the more "
        f"accurate. 95 % lie below the dots: {', '.join(said)}.",
        figure,
    )


def _curves(axes: Axes, stages: list[Floats]) -> None:
    """Both curves on a linear axis, which leaves out the few that are far off."""
    finite = [sizes[np.isfinite(sizes)] for sizes in stages]
    spread = max(float(np.quantile(sizes, SHARE)) for sizes in finite)
    high = min(1.05 * float(max(s[-1] for s in finite)), 1.6 * spread) or 1.0
    for sizes, known, color in zip(stages, finite, STAGES.values(), strict=True):
        kept = np.unique(np.linspace(0, len(known) - 1, STEPS).round().astype(int))
        across = np.concatenate([[0.0], known[kept], [max(high, known[-1])]])
        up = np.concatenate([[0], kept + 1, [len(known)]]) * 100.0 / len(sizes)
        axes.plot(across, up, color=color, drawstyle="steps-post", linewidth=1.6)
        p95 = Accuracy.of(sizes).p95
        if math.isfinite(p95):
            axes.plot([p95], [100.0 * SHARE], **marks(color, "o", 6.0))
            axes.vlines(p95, 0.0, 100.0 * SHARE, color=color, linestyle=":")
    axes.axhline(100.0 * SHARE, color=MUTED, linestyle="--", linewidth=0.9)
    axes.set(xlim=(0.0, high), ylim=(0.0, 102.0))
    axes.set_yticks([0, 25, 50, 75, 95], ["0", "25", "50", "75", "95"])
    axes.locator_params(axis="x", nbins=6)
