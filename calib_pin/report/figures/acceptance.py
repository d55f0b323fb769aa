"""Accuracy and repeatability of every pose of an acceptance test, beside the limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    WIDTH,
    Drawn,
    key,
    marks,
    panels,
)
from calib_pin.report.figures.labels import log_axis, log_limits, unit_of
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import Acceptance, Interval, PoseTest

HEIGHT = 2.5
"""Height of the panels [inch]."""

FEW = 12
"""Poses up to which each is named: names of more lie over each other."""

LIMIT: dict[str, Any] = {"color": INK, "linestyle": "--", "linewidth": 1.2}


@dataclass(frozen=True)
class Judged:
    """The subject of the figure.

    Attributes:
        tests: The test by the robot that the commanded poses are of.
        limit: What must be reached.
        path: Whether the poses are points of a path.
    """

    tests: Mapping[str, Acceptance]
    limit: LimitSetup
    path: bool = False


def poses_tested(found: Judged) -> Drawn | None:
    """AP and RP by pose with their intervals, of each robot, and the limits."""
    figure = Figure(figsize=(WIDTH, HEIGHT + 1.0))
    left, right = panels(figure, 2, 0.5, HEIGHT, left=0.75, right=0.1, gap=0.8)
    limit = found.limit
    _panel(left, found.tests, lambda pose: pose.accuracy, limit.position)
    _panel(right, found.tests, lambda pose: pose.repeatability, limit.repeatability)
    unit, _ = unit_of("m")
    place = "point of the path" if found.path else "pose"
    for axes, name in ((left, "AP"), (right, "RP")):
        axes.set_ylabel(f"{name} [{unit}]")
        axes.set_xlabel(place)
    entries = {_name(name): _sign(name) for name in found.tests}
    if limit.position is not None or limit.repeatability is not None:
        entries["limit"] = LIMIT
    key(figure, entries, 0.75)
    worst = "; the worst are AT and RT" if found.path else ""
    return Drawn(
        "poses-tested",
        f"Accuracy and repeatability by {place}",
        f"AP and RP of every {place} with 95 % intervals{worst}."
        + " A limit is met where all of an interval lies below it."
        * ("limit" in entries),
        figure,
    )


def _panel(
    axes: Axes,
    tests: Mapping[str, Acceptance],
    of: Callable[[PoseTest], Interval],
    limit: float | None,
) -> None:
    _, factor = unit_of("m")
    shown = []
    for k, (name, test) in enumerate(tests.items()):
        places = np.array([p.pose for p in test.poses], float)
        # Robots stand beside each other, or their intervals would hide each other.
        places += 0.24 * (k - 0.5 * (len(tests) - 1))
        found = [of(pose) for pose in test.poses]
        values = factor * np.array([[i.value, i.low, i.high] for i in found])
        value, low, high = values.T
        shown += [value, low, high]
        sign = _sign(name)
        bars = [np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)]
        axes.errorbar(
            places, value, bars, **sign, elinewidth=1.4, capsize=2.5, capthick=1.4
        )
    if limit is not None:
        shown.append(np.array([factor * limit]))
        axes.axhline(factor * limit, **LIMIT)
    last = [*tests.values()][-1].poses
    numbers = [pose.pose for pose in last]
    axes.set_xlim(numbers[0] - 0.6, numbers[-1] + 0.6)
    if len(numbers) <= FEW:
        axes.set_xticks(numbers, [f"P{number}" for number in numbers], fontsize=8)
    axes.grid(visible=False, axis="x")
    everything = np.concatenate(shown)
    everything = everything[np.isfinite(everything)]
    if np.isnan(value).any():
        axes.text(0.5, 0.5, "not testable", ha="center", transform=axes.transAxes)
    positive = everything[everything > 0.0]
    if len(positive) and positive.max() > 20.0 * positive.min():
        log_axis(axes, "y", log_limits(positive) or (0.1, 1.0))
    else:
        axes.locator_params(axis="y", nbins=6)
        axes.set_ylim(0.0, 1.12 * float(everything.max()) or 1.0)


def _name(robot: str) -> str:
    return {
        "nominal": "before (nominal robot)",
        "calibrated": "after (calibrated)",
        "robot": "robot",
    }[robot]


def _sign(robot: str) -> dict[str, Any]:
    if robot == "nominal":
        return marks(BEFORE, "o", 4.5, hollow=True)
    return marks(AFTER, "s", 4.5)
