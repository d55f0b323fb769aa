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
        plain = [one for one in lines if not one[1].lstrip().startswith("//")]
        for mark in "\t;, " if plain else "":
            first = base.cells_of(plain[0][1], mark)
            width = len(first)
            lead = min(width - 3, len(NAMES))
            if lead <= 0 or not _is_point(first, lead, width):
                continue
            rows = [base.cells_of(line, mark) for _, line in plain]
            fits = all(_is_point(row, lead, width) for row in rows)
            if not (fits and any(map(FRACTION.fullmatch, chain(*rows)))):
                continue
            text = " ".join(line for _, line in lines if line.startswith("//"))
            units = (u for u, word in UNITS.items() if re.search(word, text, re.I))
            unit = next(units, "")
            axes = [base.header(axis, unit) for axis in "xyz"]
            names = [*NAMES[-lead:], *axes, *[""] * (width - lead - 3)]
            remark = f"points with their names ({unit or 'no unit is stated'})"
            return base.Heading(mark, names, 0, remark)
        return None


def _is_point(row: Sequence[str], lead: int, width: int) -> bool:
    """Whether a row begins with names, the first with a letter, and then numbers."""
    return (
        len(row) == width
        and re.match(r"[^\W\d]", row[0]) is not None
        and not any(map(FRACTION.fullmatch, row[:lead]))
        and all(map(NUMBER.fullmatch, row[lead : lead + 3]))
    )
