"""Figures of a test and of a study: poses beside their limits, and what to expect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    Drawn,
    key,
    log_axis,
    marks,
    panels,
)
from calib_pin.report.tables import unit_of
from calib_pin.setup import LimitSetup

if TYPE_CHECKING:
    from calib_pin.monte_carlo import Outlook
    from calib_pin.validation.acceptance import Acceptance

FEW = 12
"""Poses up to which each is named: names of more lie over each other."""

LIMIT: dict[str, Any] = {"color": INK, "linestyle": "--", "linewidth": 1.2}

ROBOTS = {
    "nominal": ("before (nominal robot)", marks(BEFORE, "o", 4.5, hollow=True)),
    "calibrated": ("after (calibrated)", marks(AFTER, "s", 4.5)),
    "robot": ("robot", marks(AFTER, "s", 4.5)),
}
"""Name and sign of each robot of a test."""


def poses_tested(tests: Mapping[str, Acceptance], limit: LimitSetup) -> Drawn | None:
    """AP and RP by pose with their intervals, of each robot, and the limits.

    Args:
        tests: The test by the robot that the commanded poses are of.
        limit: What must be reached.
    """
    figure, (row,) = panels(1, 2, 2.5, gap=0.8)
    unit = unit_of("m")[0]
    limits = {"accuracy": limit.position, "repeatability": limit.repeatability}
    for axes, name, of in zip(row, ("AP", "RP"), limits, strict=True):
        _poses(axes, tests, of, limits[of])
        axes.set(xlabel="pose", ylabel=f"{name} [{unit}]")
    entries = dict(ROBOTS[name] for name in tests)
    if limit.position is not None or limit.repeatability is not None:
        entries["limit"] = LIMIT
    key(figure, entries)
    caption = "AP and RP of every pose with 95 % intervals."
    if "limit" in entries:
        caption += " A limit is met where all of an interval lies below it."
    return Drawn("Accuracy and repeatability by pose", caption, figure)


def _poses(
    axes: Axes, tests: Mapping[str, Acceptance], of: str, limit: float | None
) -> None:
    _, factor = unit_of("m")
    shown = []
    for k, (name, test) in enumerate(tests.items()):
        numbers = [pose.pose for pose in test.poses]
        # Robots stand beside each other, or their intervals would hide each other.
        places = np.array(numbers) + 0.24 * (k - 0.5 * (len(tests) - 1))
        value, low, high = (
            factor * np.array([getattr(pose, of) for pose in test.poses]).T
        )
        bars = [np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)]
        axes.errorbar(places, value, bars, **ROBOTS[name][1], capsize=2.5)
        shown += [value, low, high]
    if np.isnan(value).any():
        axes.text(0.5, 0.5, "not testable", ha="center", transform=axes.transAxes)
    if limit is not None:
        shown.append(np.array([factor * limit]))
        axes.axhline(factor * limit, **LIMIT)
    axes.set_xlim(numbers[0] - 0.6, numbers[-1] + 0.6)
    if len(numbers) <= FEW:
        axes.set_xticks(numbers, [f"P{number}" for number in numbers], fontsize=8)
    axes.grid(visible=False, axis="x")
    values = np.concatenate(shown)
    positive = values[np.isfinite(values) & (values > 0.0)]
    if len(positive) and positive.max() > 20.0 * positive.min():
        log_axis(axes, "y", positive)
    else:
        axes.locator_params(axis="y", nbins=6)
        axes.set_ylim(0.0, 1.12 * float(positive.max(initial=0.0)) or 1.0)


def accuracy_by_configurations(
    outlooks: Sequence[Outlook], limit: LimitSetup
) -> Drawn | None:
    """Position error, and part of the robots within the limit, by configurations."""
    from calib_pin.monte_carlo.summary import LEVELS

    done = [o for o in outlooks if o.failed < o.robots]
    if not done:
        return None
    limited = bool(np.isfinite(done[0].met[0]))
    figure, (row,) = panels(1, 1 + limited, 2.4, gap=0.8)
    axes, (unit, factor) = row[0], unit_of("m")
    counts = np.array([o.configurations for o in done])
    low, middle, high = factor * np.array([o.position for o in done]).T
    share = factor * np.array([o.position_share[1] for o in done])
    band: dict[str, Any] = {"color": AFTER, "alpha": 0.25, "linewidth": 0.0}
    line: dict[str, Any] = {"color": AFTER, "marker": "o", "markersize": 4.0}
    wide: dict[str, Any] = {"color": INK, "marker": "s", "markersize": 3.5}
    axes.fill_between(counts, low, high, **band)
    axes.plot(counts, middle, **line)
    axes.plot(counts, share, **wide)
    entries = {
        "rms, median": line,
        "5 to 95 % of robots": {**band, "linewidth": 6.0},
        "95 % of the workspace": wide,
    }
    largest = np.nan
    if limit.position is not None:
        largest = factor * limit.position
        axes.axhline(largest, **LIMIT)
        entries["limit"] = LIMIT
    log_axis(axes, "y", low, high, share, np.array([largest]))
    axes.set_ylabel(f"position error [{unit}]")
    axes.set_xlabel("configurations")
    text = (
        "Position error of a robot after a calibration: rms over the workspace, and "
        "what the median robot keeps within in 95 % of it."
    )
    if limited:
        chances = row[1]
        share, least, most = 100.0 * np.array([o.met for o in done]).T
        chances.errorbar(counts, share, [share - least, most - share], **line)
        chances.axhline(100.0 * LEVELS[-1], color=INK, linewidth=0.8, linestyle=":")
        chances.set_ylim(-3.0, 104.0)
        chances.set_ylabel("robots within the limit [%]")
        chances.set_xlabel("configurations")
        text += (
            " Right: robots that are within the limit in 95 % of their workspace, with "
            "95 % intervals; dotted: 95 % of the robots."
        )
    key(figure, entries)
    return Drawn("Accuracy against number of configurations", text, figure)
