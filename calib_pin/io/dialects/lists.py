"""Lists in cells, as pandas, exporters of bags and controllers write vectors.

`[0.1, 0.2]`, `array('d', [0.1, 0.2])`, `{A1 10.5, A2 -3}` (KUKA's E6AXIS) and
`{'x': 0.1, 'y': 0.2}` become a column for each number, called by the name that stands
before it, or else by its place, counted from 0.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from calib_pin.io.columns import Column
from calib_pin.io.dialects.base import Columns, Dialect, Reading, computed

LIST = re.compile(r"(?:\w*\W*)?[\[({].*[\])}]", re.DOTALL)

NUMBER = re.compile(
    r"(?:\b([A-Za-z]\w*)\W*[:=\s]\s*)?(?<![\w.])([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)(?![\w.])"
)
"""A number, and the name before it."""


class Lists(Dialect):
    """Columns of lists that are all of the same length."""

    def read(self, columns: Columns, file: Path) -> Reading | None:
        """The columns with one for each number in the place of one of lists."""
        read, found = dict[str, Column](), list[str]()
        for name, column in columns.items():
            if numbers := _numbers(name, column):
                found.append(name)
            read |= numbers or {name: column}
        return Reading(read, f"lists in {', '.join(found)}") if found else None


def _numbers(name: str, column: Column) -> dict[str, Column]:
    """The columns of a column of lists; none of another."""
    if not column.words or np.isfinite(column.numbers).any():
        return {}
    cells = column.texts().map(str.strip)
    lists = [NUMBER.findall(c) if LIST.fullmatch(c) else [] for c in cells.names]
    width = max(map(len, lists))
    if width < 2 or {len(one) for one in lists} - {0, width}:
        return {}
    named = [word for word, _ in next(filter(None, lists))]
    ends = named if all(named) and len({*named}) == width else range(width)
    blank = [("", "nan")] * width
    values = np.array([[float(n) for _, n in one or blank] for one in lists])
    headers = [f"{name}_{end}" for end in ends]
    return {
        header: computed(header, numbers, column.unit)
        for header, numbers in zip(headers, values[cells.codes].T, strict=True)
    }
