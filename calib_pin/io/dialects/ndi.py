"""Logs of NDI Polaris trackers: a row for each tool and frame, lengths in mm.

Source: the header of NDI_DataLogger (`Tool ID, Timestamp, Frame #`, then Tx Ty Tz and
a rotation as a matrix R00 to R22 or a quaternion Q0 Qx Qy Qz, `Tracking Quality`). Lost
tools are rows with `MISSING`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib_pin.io.columns import Column
from calib_pin.io.dialects.base import Reading
from calib_pin.kinematics.spatial import nearest_rotation, to_quaternion

AXES = {"Tx": "x", "Ty": "y", "Tz": "z"}
NAMES = {"Tool ID": "tool", "Timestamp": "time"}
QUATERNION = {"Q0": "qw", "Qx": "qx", "Qy": "qy", "Qz": "qz"}
MATRIX = [f"R{row}{column}" for row in range(3) for column in range(3)]


class Ndi:
    """A tracker's log of tools."""

    def read(self, columns: Mapping[str, Column]) -> Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        turned = {*MATRIX} <= columns.keys()
        if not (
            {*AXES} <= columns.keys() and (turned or {*QUATERNION} <= columns.keys())
        ):
            return None
        ours = {**NAMES, **AXES, **QUATERNION}
        read = {
            ours.get(name, name): replace(column, unit=column.unit or "mm")
            if name in AXES
            else column
            for name, column in columns.items()
        }
        if turned:
            R = np.stack([columns[name].numbers for name in MATRIX], axis=1)
            numbers = np.full((len(R), 4), np.nan)
            seen = np.isfinite(R).all(axis=1)
            numbers[seen] = to_quaternion(nearest_rotation(R[seen].reshape(-1, 3, 3)))
            for k, name in enumerate(("qx", "qy", "qz", "qw")):
                read[name] = replace(columns["R00"], numbers=numbers[:, k])
        return Reading(read, "a log of an NDI tracker, a row for each tool")
