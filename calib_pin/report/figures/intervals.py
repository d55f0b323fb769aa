"""The estimates of the robot with their uncertainty."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calib_pin.report.figures.canvas import AFTER, INK, MUTED, Drawn, key, marks
from calib_pin.report.figures.estimated import Estimate, of_robot
from calib_pin.report.figures.lists import LEFT, Listed, lists
from calib_pin.validation.result import CalibrationResult

SURE = 2.0
"""Standard deviations from zero beyond which a parameter is not zero."""

SIGNS: dict[str, dict[str, Any]] = {
    "differs from zero": marks(AFTER, "o", 5.0),
    "may be zero": marks(MUTED, "s", 4.5, hollow=True),
}


def parameter_intervals(result: CalibrationResult) -> Drawn | None:
    """Estimates of the robot with two standard deviations, one panel per unit."""
    estimates = of_robot(result.parameters, result.groups, result.model.error)
    if not estimates:
        return None
    figure, panels, remark = lists(estimates, _significance)
    for listed in panels:
        _intervals(listed)
    key(figure, SIGNS, LEFT)
    sure = sum(_significance(estimate) > SURE for estimate in estimates)
    return Drawn(
        "parameter-intervals",
        "Estimated errors of the robot",
        f"Values with two standard deviations to either side, from base to tip; {sure} "
        f"of {len(estimates)} differ from zero. Intervals shorter than the mark do "
        f"not show. The table of linear combinations has their formulae.{remark}",
        figure,
    )


def _significance(estimate: Estimate) -> float:
    """Distance from zero in standard deviations."""
    if estimate.sigma == 0.0:
        return math.inf if estimate.value else 0.0
    return abs(estimate.value) / estimate.sigma


def _intervals(listed: Listed) -> None:
    axes, lines = listed.axes, np.arange(len(listed.values))
    sure = np.array([_significance(e) > SURE for e in listed.estimates])
    axes.axvline(0.0, color=INK, linewidth=0.8)
    reach = SURE * listed.sigmas
    low, high = listed.values - reach, listed.values + reach
    for chosen, (label, sign) in zip((sure, ~sure), SIGNS.items(), strict=True):
        if not chosen.any():
            continue
        axes.hlines(lines[chosen], low[chosen], high[chosen], color=sign["color"])
        axes.plot(
            *(listed.values[chosen], lines[chosen]),
            **sign,
            label=label,
        )
    ends = min(float(low.min()), 0.0), max(float(high.max()), 0.0)
    room = 0.04 * (ends[1] - ends[0]) or 1.0
    axes.set_xlim(ends[0] - room, ends[1] + room)
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel(f"estimate [{listed.unit}]")
