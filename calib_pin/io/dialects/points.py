"""Points of SpatialAnalyzer and other metrology software: names, then x, y, z.

Source: the SpatialAnalyzer user's manual, "Exporting ASCII Formatted Points"
(kinematics.com): `Collection Group Target x y z`, `Group Target x y z` or `Target x y
z` and more numbers behind, separated by spaces or commas, with comments behind `//` in
which the unit may stand, and no header.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import chain

import calib_pin.io.dialects.base as base

FRACTION = re.compile(r"[+-]?\d*[.,]\d+(?:[eE][+-]?\d+)?")
NUMBER = re.compile(rf"[+-]?\d+|{FRACTION.pattern}")

UNITS = {
    "mm": r"\bmm\b|millimet",
    "in": r"\binch|units?\W+in\b",
    "m": r"\bmet(?:er|re)s?\b|units?\W+m\b",
}

NAMES = ("collection", "group", "point")
"""Columns before the coordinates, of which the last are there."""


class Points(base.Dialect):
    """Points with their names."""

    def heading(self, lines: base.Lines) -> base.Heading | None:
        """No header: every line begins with names, and three numbers follow."""
        plain = [line for _, line in lines if not line.lstrip().startswith("//")]
        marks = (m for m in "\t;, " if plain and _is_point(base.cells_of(plain[0], m)))
        if not (mark := next(marks, "")):
            return None
        rows = [base.cells_of(line, mark) for line in plain]
        width = len(rows[0])
        if {*map(len, rows)} != {width} or not all(map(_is_point, rows)):
            return None
        if not any(map(FRACTION.fullmatch, chain(*rows))):
            return None
        text = " ".join(line for _, line in lines if line.startswith("//"))
        units = (u for u, word in UNITS.items() if re.search(word, text, re.I))
        unit, lead = next(units, ""), min(width - 3, len(NAMES))
        axes = [base.header(axis, unit) for axis in "xyz"]
        names = [*NAMES[-lead:], *axes, *[""] * (width - lead - 3)]
        remark = f"points with their names ({unit or 'no unit is stated'})"
        return base.Heading(mark, names, 0, remark)


def _is_point(row: Sequence[str]) -> bool:
    """Whether a row begins with names, the first with a letter, and then numbers."""
    lead = min(len(row) - 3, len(NAMES))
    return (
        lead > 0
        and re.match(r"[^\W\d]", row[0]) is not None
        and not any(map(FRACTION.fullmatch, row[:lead]))
        and all(map(NUMBER.fullmatch, row[lead : lead + 3]))
    )
