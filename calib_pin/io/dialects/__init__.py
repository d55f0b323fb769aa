"""Foreign layouts that are recognized by their first lines, a file for each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from calib_pin.io.columns import Column
from calib_pin.io.dialects.base import Dialect, Heading, Lines, Reading, side_by_side
from calib_pin.io.dialects.franka import Franka
from calib_pin.io.dialects.joined import Joined
from calib_pin.io.dialects.lerobot import LeRobot
from calib_pin.io.dialects.matrices import Matrices
from calib_pin.io.dialects.motive import Motive
from calib_pin.io.dialects.ndi import Ndi
from calib_pin.io.dialects.pandas import Pandas
from calib_pin.io.dialects.plotjuggler import PlotJuggler
from calib_pin.io.dialects.points import Points
from calib_pin.io.dialects.rostopic import Rostopic
from calib_pin.io.dialects.rtde import Rtde
from calib_pin.io.dialects.stamps import Stamps
from calib_pin.io.dialects.tum import Tum
from calib_pin.io.dialects.vicon import Vicon
from calib_pin.plugins import Members

__all__ = ["DIALECTS", "Dialect", "Heading", "Reading", "side_by_side"]

MEMBERS = (
    *(Motive, Vicon, Ndi, Points, Tum),  # Their headers are no line of names.
    *(Rostopic, PlotJuggler, Rtde, Franka, LeRobot, Pandas, Matrices, Stamps, Joined),
)


def _fault(name: str, dialect: object) -> str:
    """Why an object of another package cannot be a member; empty where it can."""
    fits = isinstance(dialect, type) and issubclass(dialect, Dialect)
    return "" if fits else "it is no Dialect"


DIALECTS: Mapping[str, type[Dialect]] = Members(
    "calib_pin.dialects", {kind.__name__.lower(): kind for kind in MEMBERS}, _fault
)
"""Tried in this order: those that come with calib-pin, then others."""


def heading(lines: Lines) -> Heading | None:
    """The header of a file in a dialect in which it is not one line of names.

    Args:
        lines: The first lines that are not blank, with their numbers.
    """
    headings = (kind().heading(lines) for kind in DIALECTS.values() if lines)
    return next(filter(None, headings), None)


def reading(columns: Mapping[str, Column], file: Path) -> Reading | None:
    """The columns of a file in its dialects, one after the other; None if in none."""
    remarks = list[str]()
    for kind in DIALECTS.values():
        if layout := kind().read(columns, file):
            columns = layout.columns
            remarks.append(layout.remark)
    return Reading(columns, "; ".join(remarks)) if remarks else None
