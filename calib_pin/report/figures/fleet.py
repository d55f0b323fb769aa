"""Figures of many robots: their errors before and after, and what to expect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib_pin.kinematics.spatial import Floats
from calib_pin.monte_carlo import Outlook
from calib_pin.monte_carlo.summary import LEVELS
from calib_pin.report.figures.acceptance import LIMIT
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    WIDTH,
    Drawn,
    key,
    panel,
    panels,
)
from calib_pin.report.figures.labels import log_axis, log_limits, unit_of
from calib_pin.report.tables import amount
from calib_pin.setup import LimitSetup
from calib_pin.validation.fleet import FleetRow

HEIGHT = 2.4
"""Height of the panels [inch]."""

FEWEST = 3
"""Robots from which on a distribution is drawn."""


def errors_in_fleet(rows: Sequence[FleetRow]) -> Drawn | None:
    """Cumulative distribution of the errors before and after over a fleet."""
    trusted = [row for row in rows if row.trusted and row.unit]
    names = [row.quantity for row in trusted]
    name = max(dict.fromkeys(names), key=names.count, default="")
    own = [row for row in trusted if row.quantity == name]
    if len(own) < FEWEST:
        return None
    unit, factor = unit_of(own[0].unit)
    before = factor * np.array([row.nominal for row in own])
    after = factor * np.array([row.calibrated for row in own])
    figure = Figure(figsize=(WIDTH, HEIGHT + 0.95))
    axes = panel(figure, 0.75, 0.4, WIDTH - 0.95, HEIGHT)
    for sizes, color in ((before, BEFORE), (after, AFTER)):
        axes.step(*_cumulated(sizes), where="post", color=color, linewidth=1.8)
    log_axis(axes, "x", log_limits(before, after) or (0.1, 1.0))
    axes.set_xlabel(f"{name} error of a robot, rms over its measurements [{unit}]")
    axes.set_ylabel("robots [%]")
    axes.set_ylim(0.0, 101.0)
    key(
        figure,
        {
            "before (nominal)": {"color": BEFORE, "linewidth": 1.8},
            "after (calibrated)": {"color": AFTER, "linewidth": 1.8},
        },
        0.75,
    )
    medians = (
        amount(float(np.median(s)) / factor, own[0].unit) for s in (before, after)
    )
    return Drawn(
        "errors-in-fleet",
        "Errors before and after",
        f"Part of the {len(own)} trusted robots whose {name} error is smaller; medians "
        f"{' and '.join(medians)}.",
        figure,
    )


def _cumulated(sizes: Floats) -> tuple[Floats, Floats]:
    """Sorted sizes, and the percentage up to each."""
    found = np.sort(sizes)
    return found, 100.0 * np.arange(1, len(found) + 1) / len(found)


@dataclass(frozen=True)
class Foreseen:
    """The subject of the figure of a Monte Carlo study."""

    outlooks: Sequence[Outlook]
    limit: LimitSetup


def accuracy_by_configurations(found: Foreseen) -> Drawn | None:
    """Position error, and part of the robots within the limit, by configurations."""
    done = [one for one in found.outlooks if one.failed < one.robots]
    if not done:
        return None
    limit = found.limit.position
    limited = np.isfinite(done[0].met[0])
    figure = Figure(figsize=(WIDTH, HEIGHT + 0.95))
    if limited:
        axes, chances = panels(figure, 2, 0.45, HEIGHT, left=0.75, right=0.1, gap=0.8)
    else:
        axes = panel(figure, 0.75, 0.45, WIDTH - 0.95, HEIGHT)
    unit, factor = unit_of("m")
    counts = np.array([one.configurations for one in done])
    low, middle, high = factor * np.array([one.position for one in done]).T
    share = factor * np.array([one.position_share[1] for one in done])
    band: dict[str, Any] = {"color": AFTER, "alpha": 0.25, "linewidth": 0.0}
    line: dict[str, Any] = {"color": AFTER, "linewidth": 1.8, "marker": "o"}
    wide: dict[str, Any] = {"color": INK, "linewidth": 1.2, "marker": "s"}
    line["markersize"], wide["markersize"] = 4.0, 3.5
    axes.fill_between(counts, low, high, **band)
    axes.plot(counts, middle, **line)
    axes.plot(counts, share, **wide)
    shown = [low, high, share]
    entries = {
        "rms, median": line,
        "5 to 95 % of robots": {**band, "linewidth": 6.0},
        "95 % of the workspace": wide,
    }
    if limit is not None:
        axes.axhline(factor * limit, **LIMIT)
        shown.append(np.array([factor * limit]))
        entries["limit"] = LIMIT
    log_axis(axes, "y", log_limits(*shown) or (0.1, 1.0))
    axes.set_ylabel(f"position error [{unit}]")
    axes.set_xlabel("configurations")
    text = (
        "Position error of a robot after a calibration: rms over the workspace, and "
        "what the median robot keeps within in 95 % of it."
    )
    if limited:
        met = 100.0 * np.array([one.met for one in done])
        below, above = met[:, 0] - met[:, 1], met[:, 2] - met[:, 0]
        chances.errorbar(
            counts, met[:, 0], [below, above], **line, capsize=2.5, elinewidth=1.2
        )
        chances.axhline(100.0 * LEVELS[-1], color=INK, linewidth=0.8, linestyle=":")
        chances.set_ylim(-3.0, 104.0)
        chances.set_ylabel("robots within the limit [%]")
        chances.set_xlabel("configurations")
        text += (
            " Right: robots that are within the limit in 95 % of their workspace, with "
            "95 % intervals; dotted: 95 % of the robots."
        )
    key(figure, entries, 0.75)
    return Drawn(
        "accuracy-by-configurations",
        "Accuracy against number of configurations",
        text,
        figure,
    )
