"""Columns of the conditions of a measurement: approach, temperature and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib_pin.io.columns import Floats, Kind
from calib_pin.io.table import Table
from calib_pin.observations import Conditions, Signs

DIRECTION = ".direction"
"""End of the name of a column with the direction in which a joint was approached."""

TIME = Kind("s", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}, {}, 1e12)
TEMPERATURE = Kind("degC", {"degC": 1.0}, {}, 1e3)


def read_conditions(
    table: Table, joints: Sequence[str]
) -> tuple[Conditions, frozenset[str]]:
    """The conditions that a file states, but for the payload.

    A temperature or a time that is not a number in each row, such as a date, is none.

    Args:
        table: The file.
        joints: Names of the joints.

    Returns:
        The conditions, and the columns that hold them.

    Raises:
        InputError: If a direction is none.
    """
    direction, used = read_directions(table, joints)
    stated: dict[str, Any] = {
        name: numbers
        for name, kind in (("temperature", TEMPERATURE), ("time", TIME))
        if (numbers := _numbers(table, name, kind)) is not None
    }
    found = Conditions(direction=direction, **stated)
    if direction.size:
        found = replace(found, source="columns")
    return found, used | frozenset(stated)


def read_directions(
    table: Table, joints: Sequence[str]
) -> tuple[Signs, frozenset[str]]:
    """Directions of approach, shape (N, n) or (0, 0), and the columns that hold them.

    Args:
        table: The file.
        joints: Names of the joints.

    Raises:
        InputError: If a cell is none of -1, 0 and 1, or blank.
    """
    columns = {joint + DIRECTION: k for k, joint in enumerate(joints)}
    used = frozenset(columns).intersection(table.columns)
    if not used:
        return np.zeros((0, 0), np.int8), used
    direction = np.zeros((len(table.lines), len(joints)), np.int8)
    for name in used:
        column = table.columns[name]
        blank = column.blank()
        values = np.where(blank, 0.0, column.numbers)
        wrong = ~np.isin(values, (-1.0, 0.0, 1.0))
        if wrong.any():
            raise table.cell_error(
                "not the sign of a joint's last motion",
                name,
                int(np.argmax(wrong)),
                "1, -1, or 0 where it is not known",
            )
        direction[:, columns[name]] = values
    return direction, used


def _numbers(table: Table, name: str, kind: Kind) -> Floats | None:
    """A column that is a number throughout; None if it is not."""
    if name not in table:
        return None
    column = table.columns[name]
    fits = column.unit is None or column.unit in kind.units
    if not fits or not np.isfinite(column.numbers).all():
        return None
    return table.numbers(name, kind)
