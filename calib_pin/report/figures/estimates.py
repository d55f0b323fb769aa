"""The estimates of the robot, parameters and linear combinations, in panels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib_pin.parameters import ParameterSet
from calib_pin.report.figures.canvas import (
    AFTER,
    GRID,
    INK,
    MUTED,
    WIDTH,
    Drawn,
    key,
    marks,
    panel,
)
from calib_pin.report.figures.labels import shortened, unit_of
from calib_pin.validation.result import (
    CalibrationResult,
    CoupledGroup,
    ParameterEstimate,
)

NAME = 32
"""Letters of a name that has room beside a panel."""


@dataclass(frozen=True)
class Estimate:
    """A parameter or a linear combination that is known.

    Attributes:
        label: Its name in figures.
        unit: Its unit.
        value: Estimate.
        sigma: Standard deviation.
    """

    label: str
    unit: str
    value: float
    sigma: float


def of_robot(
    parameters: Sequence[ParameterEstimate],
    groups: Sequence[CoupledGroup],
    given: ParameterSet,
) -> list[Estimate]:
    """Identifiable parameters and combinations of the robot, from base to tip.

    A combination that begins with a frame or the instrument is theirs.
    """
    own = {parameter.name for parameter in given if not parameter.nuisance}
    place = {parameter.name: k for k, parameter in enumerate(parameters)}
    known = [p for p in parameters if p.status == "identifiable"]
    found: list[tuple[str, str, ParameterEstimate | CoupledGroup]] = [
        *((p.name, shortened(p.name, NAME), p) for p in known),
        *((g.terms[0][0], f"combination {g.number}", g) for g in groups),
    ]
    return [
        Estimate(label, of.unit, of.value, of.sigma)
        for first, label, of in sorted(found, key=lambda entry: place[entry[0]])
        if first in own and of.sigma is not None and math.isfinite(of.sigma)
    ]


MOST = 48
"""Lines of a panel."""

LINE = 0.175
"""Height of a line [inch]."""

LEFT = 2.8
"""Width of the names [inch]."""

HEAD = 0.35
"""Height above the first panel [inch]."""

FOOT = 0.55
"""Height of the labels below a panel [inch]."""


RULE: dict[str, Any] = {"color": GRID, "linewidth": 0.6, "zorder": 0.5}


def beside(
    axes: Axes,
    line: float,
    label: str,
    size: float = 8.5,
    gap: float = 4.0,
    color: str = INK,
) -> None:
    """A label at the left of a line; sizes in points. Much faster than a tick."""
    axes.annotate(
        label,
        (0.0, line),
        xycoords=axes.get_yaxis_transform(),
        xytext=(-gap, 0.0),
        textcoords="offset points",
        ha="right",
        va="center_baseline",
        fontsize=size,
        color=color,
        annotation_clip=False,
    )


SURE = 2.0
"""Standard deviations from zero beyond which a parameter is not zero."""

SIGNS: dict[str, dict[str, Any]] = {
    "differs from zero": marks(AFTER, "o", 5.0),
    "may be zero": marks(MUTED, "s", 4.5, hollow=True),
}


def parameter_intervals(result: CalibrationResult) -> Drawn | None:
    """Estimates of the robot with two standard deviations, one panel per unit.

    Where there are too many of a unit, those farthest from zero are kept.
    """
    estimates = of_robot(result.parameters, result.groups, result.model.given)
    if not estimates:
        return None
    units: dict[str, list[Estimate]] = {}
    for estimate in estimates:
        units.setdefault(estimate.unit, []).append(estimate)
    for unit, own in units.items():
        order = sorted(range(len(own)), key=lambda k: -_significance(own[k]))
        units[unit] = [own[k] for k in sorted(order[:MOST])]
    lines = sum(map(len, units.values()))
    height = HEAD + LINE * (lines + len(units)) + FOOT * len(units)
    figure, top = Figure(figsize=(WIDTH, height)), HEAD
    for unit, own in units.items():
        height = LINE * (len(own) + 1)
        _intervals(panel(figure, LEFT, top, WIDTH - LEFT - 0.2, height), unit, own)
        top += height + FOOT
    key(figure, SIGNS, LEFT)
    sure = sum(_significance(estimate) > SURE for estimate in estimates)
    dropped = len(estimates) - lines
    remark = f" {dropped} smaller ones are left out." if dropped else ""
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


def _intervals(axes: Axes, unit: str, estimates: Sequence[Estimate]) -> None:
    """Draw estimates of one unit, a line each, the first one at zero."""
    lines = np.arange(len(estimates))
    axes.set_ylim(len(lines) - 0.2, -0.8)
    axes.set_yticks([])
    for k, estimate in enumerate(estimates):
        beside(axes, k, estimate.label)
    axes.hlines(lines, 0.0, 1.0, **RULE, transform=axes.get_yaxis_transform())
    shown, factor = unit_of(unit)
    values = factor * np.array([estimate.value for estimate in estimates])
    reach = factor * SURE * np.array([estimate.sigma for estimate in estimates])
    sure = np.array([_significance(estimate) > SURE for estimate in estimates])
    axes.axvline(0.0, color=INK, linewidth=0.8)
    low, high = values - reach, values + reach
    for chosen, (label, sign) in zip((sure, ~sure), SIGNS.items(), strict=True):
        if not chosen.any():
            continue
        axes.hlines(lines[chosen], low[chosen], high[chosen], color=sign["color"])
        axes.plot(values[chosen], lines[chosen], **sign, label=label)
    ends = min(float(low.min()), 0.0), max(float(high.max()), 0.0)
    room = 0.04 * (ends[1] - ends[0]) or 1.0
    axes.set_xlim(ends[0] - room, ends[1] + room)
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel(f"estimate [{shown}]")
