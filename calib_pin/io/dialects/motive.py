"""CSV exports of OptiTrack Motive: bodies and markers side by side, a row each frame.

Source: https://docs.optitrack.com/motive/data-export/data-export-csv: the first line
has the settings in pairs (`Format Version`, ..., `Rotation Type`, `Length Units`); rows
with the type, name, ID (and parent) of what each column is of, `Rotation` or
`Position`, and X, Y, Z, W follow; a marker out of sight leaves blank cells. Markers of
a rigid body are where its pose has them, and no measurements of their own. Euler angles
are about turned axes ("X(Pitch), Y(Yaw), Z(Roll), Relative, RHS" in the NatNet SDK).
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise, zip_longest

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Column

KINDS = ("Rigid Body", "Rigid Body Bone", "Bone", "Marker", "Rigid Body Marker")
"""Types of columns, of which the first that is there is read."""

UNITS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm", "Inches": "in"}


class Motive(base.Dialect):
    """An export of a take."""

    def heading(self, lines: base.Lines) -> base.Heading | None:
        """The settings, and the lines down to that of the axes."""
        if not (lines := base.starting(lines, "Format Version")):
            return None
        rows, mark = base.cut(lines)
        at = next((k for k, row in enumerate(rows) if row[:1] == ["Frame"]), 0)
        kind = next((kind for kind in KINDS if kind in rows[1]), "")
        if at < 4 or not kind:
            return None
        settings = dict(pairwise(rows[0]))
        unit = UNITS.get(settings.get("Length Units", ""))
        order = settings.get("Rotation Type", "Quaternion").lower()
        turned = "q{}" if order == "quaternion" else "turn {} [deg]"
        above = zip_longest(rows[1], rows[2], rows[at - 1], rows[at], fillvalue="")
        columns = [*above][: len(rows[at])]
        labels = {name for of, name, *_ in columns if of == kind}
        labels = {n for n in labels if not n.startswith("Unlabeled")} or labels
        names, objects = list[str](), ["", "", *(name for _, name, *_ in columns[2:])]
        for k, (of, name, group, axis) in enumerate(columns):
            if k < 2 or not of:
                names.append("time [s]" if axis.startswith("Time (") else axis)
                continue
            read = name in labels and of == kind and axis in ("X", "Y", "Z", "W")
            place = base.header("{}", unit) if group == "Position" else turned
            names.append(place.format(axis.lower()) * read)
        remark = f"an export of OptiTrack Motive (lengths in {unit or 'no unit'})"
        last, ours = lines[at][0], "target" if kind.endswith("Marker") else "tool"
        convert = partial(_converted, order)
        return base.Heading(mark, names, last, remark, objects, ours, convert)


def _converted(order: str, columns: dict[str, Column]) -> dict[str, Column]:
    """Euler angles as quaternions."""
    from scipy.spatial.transform import Rotation

    if "turn x" in columns and sorted(order) == [*"xyz"]:
        angles = np.column_stack([columns.pop(f"turn {a}").numbers for a in order])
        # Capitals stand for turned axes.
        columns |= base.oriented(
            angles, lambda q: Rotation.from_euler(order.upper(), q, True).as_quat()
        )
    return columns
