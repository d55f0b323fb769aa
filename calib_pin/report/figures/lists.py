"""Panels with a line for every estimate, one panel per unit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import GRID, INK, WIDTH, panel
from calib_pin.report.figures.estimated import Estimate
from calib_pin.report.figures.labels import unit_of

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


@dataclass(frozen=True)
class Listed:
    """A panel with the estimates of one unit.

    Attributes:
        axes: The panel; a line is one high, the first one at zero.
        unit: What people read.
        estimates: The estimates of its lines.
        values: Estimates in that unit, shape (n,).
        sigmas: Standard deviations in that unit, shape (n,).
    """

    axes: Axes
    unit: str
    estimates: list[Estimate]
    values: Floats
    sigmas: Floats


def lists(
    estimates: Sequence[Estimate], weight: Callable[[Estimate], float]
) -> tuple[Figure, list[Listed], str]:
    """A figure with empty panels, and a remark if something is left out.

    Args:
        estimates: The estimates, in order.
        weight: Where there are too many, those where this is largest are kept.
    """
    units: dict[str, list[Estimate]] = {}
    for estimate in estimates:
        units.setdefault(estimate.unit, []).append(estimate)
    kept = {unit: _heaviest(own, weight) for unit, own in units.items()}
    lines = sum(map(len, kept.values()))
    figure = Figure(
        figsize=(WIDTH, HEAD + LINE * (lines + len(kept)) + FOOT * len(kept))
    )
    found, top = [], HEAD
    for unit, own in kept.items():
        height = LINE * (len(own) + 1)
        axes = panel(figure, LEFT, top, WIDTH - LEFT - 0.2, height)
        axes.set_ylim(len(own) - 0.2, -0.8)
        axes.set_yticks([])
        for k, estimate in enumerate(own):
            beside(axes, k, estimate.label)
        axes.hlines(
            range(len(own)), 0.0, 1.0, **RULE, transform=axes.get_yaxis_transform()
        )
        shown, factor = unit_of(unit)
        values, sigmas = (
            factor * np.array([getattr(estimate, name) for estimate in own])
            for name in ("value", "sigma")
        )
        found.append(Listed(axes, shown, own, values, sigmas))
        top += height + FOOT
    dropped = len(estimates) - lines
    return figure, found, f" {dropped} smaller ones are left out." if dropped else ""


def _heaviest(
    estimates: list[Estimate], weight: Callable[[Estimate], float]
) -> list[Estimate]:
    """The heaviest ones, in their own order."""
    order = sorted(range(len(estimates)), key=lambda k: -weight(estimates[k]))
    return [estimates[k] for k in sorted(order[:MOST])]


def beside(
    axes: Axes,
    line: float,
    label: str,
    size: float = 8.5,
    gap: float = 4.0,
    color: str = INK,
) -> None:
    """A label at the left of a line; much faster than a tick.

    Args:
        axes: The axes.
        line: Height of the line in the axes' own numbers.
        label: The label.
        size: Size of the font [pt].
        gap: Distance from the axes [pt].
        color: Its color.
    """
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
