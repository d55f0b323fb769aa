"""Text of figures: names that may hold anything, and plain numbers on log axes."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, NullLocator
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.report.figures.canvas import OF_STATIONS
from calib_pin.units import DISPLAY

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

DECADES = 18
"""Decades below the largest value that a log axis shows at most."""


def shortened(name: str, length: int = 40) -> str:
    """A name of at most so many characters, shortened in the middle.

    A character that does not print, breaks the line or turns the text direction is
    replaced: not even all of it may stand in XML.

    Examples:
        >>> shortened("left_arm_shoulder_lift_joint.placement.rx", 20)
        'left_arm_…acement.rx'
    """
    name = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)
    if len(name) <= length:
        return name
    end = length // 2
    return f"{name[: length - end - 1]}…{name[-end:]}"


def stations_of(rows: Observations) -> tuple[list[str], NDArray[np.intp]]:
    """Names of the stations that colors tell apart, and that of each row, (N,).

    One without a name where there is one, or more than there are colors.
    """
    names = [key.station for key in rows.keys]
    distinct = list(dict.fromkeys(names))
    if not 1 < len(distinct) <= len(OF_STATIONS):
        return [""], np.zeros(len(rows), np.intp)
    places = np.array([distinct.index(name) for name in names], np.intp)
    return [name or "-" for name in distinct], places[rows.block_of]


def unit_of(unit: str) -> tuple[str, float]:
    """Unit that people read, and the factor to it; an unknown one is left alone."""
    return DISPLAY.get(unit, (unit, 1.0))


def plain(value: float) -> str:
    """A tick of an axis, as a power of ten where zeros would have to be counted.

    Examples:
        >>> plain(0.002), plain(500.0), plain(1e-16), plain(2e7)
        ('0.002', '500', '10⁻¹⁶', '2·10⁷')
    """
    if value < 0.0:
        return f"\N{MINUS SIGN}{plain(-value)}"
    if not math.isfinite(value) or value == 0.0 or 1e-4 < value < 99999.5:
        return f"{value:g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    factor = f"{value / 10.0**exponent:.2g}"
    power = f"10{str(exponent).translate(SUPERSCRIPT)}"
    return power if factor == "1" else f"{factor}·{power}"


def log_limits(*values: Floats) -> tuple[float, float] | None:
    """Limits of a log axis for the positive values; None where there is none."""
    found = np.concatenate([np.ravel(part) for part in values])
    found = found[np.isfinite(found) & (found > 0.0)]
    if found.size == 0:
        return None
    high = float(found.max())
    low = max(float(found.min()), high * 10.0**-DECADES)
    room = max((high / low) ** 0.06, 1.15)
    return low / room, high * room


def log_axis(axes: Axes, which: Literal["x", "y"], limits: tuple[float, float]) -> None:
    """Make an axis logarithmic between its limits, with numbers as people write."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    axes.set(**{f"{which}scale": "log", f"{which}lim": limits})
    ticks = log_ticks(*limits)
    axis.set_minor_locator(NullLocator())
    axis.set_ticks(ticks, [plain(tick) for tick in ticks])


def log_ticks(low: float, high: float) -> list[float]:
    """Three to eight round numbers between the ends of a log axis."""
    first, last = math.log10(low), math.log10(high)
    span = last - first
    if span < 0.7:
        ticks = [
            float(tick)
            for tick in MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(low, high)
        ]
    else:
        step = max(1, round(span / 6.0))
        digits = (1.0, 2.0, 5.0) if span < 1.7 else (1.0,)
        decades = range(math.floor(first), math.ceil(last) + 1)
        ticks = [d * 10.0**k for k in decades if k % step == 0 for d in digits]
    return [tick for tick in ticks if low <= tick <= high]
