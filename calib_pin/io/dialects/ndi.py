"""Logs of NDI Polaris trackers: lengths in mm, tools below each other or side by side.

Sources: the header that NDI_DataLogger writes (`Tool ID, Timestamp, Frame #`, then Tx
Ty Tz and a rotation as a matrix R00 to R22 or a quaternion Q0 Qx Qy Qz, `Tracking
Quality`), of which lost tools are rows with `MISSING`; and the exports of NDI's own
tool tracker (`Tools,Port 1,Frame,Face,State,Q0,...,Error,Port 2,...`; in newer ones
`Time [sec]`, and the positions of the markers behind), of which lost tools have numbers
beyond 1e28, as public readers of such files (`vicra_plot`) quote them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Column, split_header

AXES = {"Tx": "x", "Ty": "y", "Tz": "z"}
NAMES = {"Tool ID": "tool", "Timestamp": "time", "Time": "time"}
QUATERNION = {"Q0": "qw", "Qx": "qx", "Qy": "qy", "Qz": "qz"}
MATRIX = [f"R{row}{column}" for row in range(3) for column in range(3)]

REMARK = "a log of an NDI tracker"

LOST = 1e20
"""Numbers from here on say that there is no reading."""


class Ndi(base.Dialect):
    """A tracker's log of tools."""

    def heading(self, lines: base.Lines) -> base.Heading | None:
        """One line of names, which are the same for each tool."""
        if not (lines := base.starting(lines, "Tools")):
            return None
        (cells, *_), mark = base.cut(lines[:1])
        tools, there, names = list[str](), set[str](), list[str]()
        for cell in cells:
            name = split_header(cell)[0]
            if cell.startswith("Port"):
                there = {name}
            known = not there or name in there or "Markers" in there
            names.append("" if known else cell.replace("[sec]", "[s]"))
            tools.append(cell if cell.startswith("Port") else ["", *tools][-1])
            there.add(name)
        found = base.Heading(mark, names, lines[0][0], REMARK, tools, "tool", _ours)
        return found if any(tools) else None

    def read(self, columns: Mapping[str, Column], file: Path) -> base.Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        turned = any({*names} <= columns.keys() for names in (MATRIX, QUATERNION))
        fits = {*AXES} <= columns.keys() and turned
        return base.Reading(_ours(columns), REMARK) if fits else None


def _ours(columns: Mapping[str, Column]) -> dict[str, Column]:
    names, read = {**NAMES, **AXES, **QUATERNION}, dict[str, Column]()
    for theirs, column in columns.items():
        name, unit = names.get(theirs, theirs), "mm" if theirs in AXES else None
        read[name] = base.named(column, name, unit)
        lost = np.abs(column.numbers) > LOST
        if lost.any():
            numbers = np.where(lost, np.nan, column.numbers)
            read[name] = base.computed(name, numbers, unit)
    if {*MATRIX} <= read.keys():
        R = np.column_stack([read.pop(name).numbers for name in MATRIX])
        read |= base.oriented(R, base.from_rows)
    return read
