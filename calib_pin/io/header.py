"""Headers of CSV files: separators, names, and the setup's names for columns."""

from __future__ import annotations

import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import replace

from calib_pin.errors import InputError
from calib_pin.io.columns import (
    ANGLE,
    LENGTH,
    PIXEL,
    Column,
    GrowingColumn,
    split_header,
)
from calib_pin.io.csv_text import Stretch

UNITS = {*ANGLE.units, *LENGTH.units, *PIXEL.units}
"""Units as calib-pin writes them."""


def separator_of(first: Stretch) -> str:
    """The separator of the columns: a comma, a semicolon or a tab."""
    header = first.lines[0]
    found = max(",;\t", key=header.count)
    names = re.sub(r"\[[^\[\]]*\]", "", header).split()
    # A single column may have a space in its name, but not in its numbers.
    alone = found not in header and len(names) > 1
    if alone and len(first.lines[-1].split()) == len(names):
        raise InputError(
            "the columns are separated by spaces, the separator must be a comma, a "
            "semicolon or a tab",
            file=first.file,
            line=first.numbers[0],
        )
    return found


def check_marks(
    header: Sequence[str], grown: Sequence[GrowingColumn], lines: array[int], file: str
) -> None:
    """Refuse a column with decimal commas and points: some separate thousands."""
    for cell, column in zip(header, grown, strict=True):
        if len(column.marks) > 1:
            comma, point = (lines[column.marks[mark]] for mark in ",.")
            raise InputError(
                f"a number has a decimal point here, and a comma in line {comma}",
                file=file,
                line=point,
                column=split_header(cell)[0],
                allowed="one decimal mark",
            )


def renamed(
    named: dict[str, Column], columns: Mapping[str, str], file: str, line: int | None
) -> tuple[dict[str, Column], dict[str, str]]:
    """Columns by what the setup says they are, and those that are not there.

    Raises:
        InputError: If two are one column, or units contradict.
    """
    by_header = {column.header: name for name, column in named.items()}
    taken, missing = dict[str, tuple[str, Column]](), dict[str, str]()
    for ours, stated in columns.items():
        name, unit = split_header(stated)
        name, unit = (by_header[stated], None) if stated in by_header else (name, unit)
        column = named.get(name)
        if column is None:
            if ours not in named:
                missing[ours] = stated
            continue
        if name in taken:
            raise InputError(
                f"'columns' in the setup takes '{taken[name][0]}' and '{ours}' from it",
                file=file,
                line=line,
                column=name,
            )
        # A unit that the file writes in its own way may be stated in ours.
        own = column.unit if column.unit in UNITS else None
        if None not in (unit, own) and unit != own:
            raise InputError(
                f"the header says [{column.unit}], 'columns' in the setup [{unit}]",
                file=file,
                line=line,
                column=name,
            )
        taken[name] = ours, replace(column, unit=own or unit or column.unit)
    meanings = {ours for ours, _ in taken.values()}
    result = dict[str, Column]()
    for name, column in named.items():
        ours, read = taken.get(name, (name, column))
        # A column that has the name of another's meaning keeps its place without it.
        if name in meanings and name not in taken:
            ours = f"{name} (of the file)"
        result[ours] = read
    return result, missing


def named_columns(
    header: Sequence[str], columns: Sequence[GrowingColumn], file: str, line: int | None
) -> dict[str, Column]:
    """Columns by their names; those without a name are left out.

    Raises:
        InputError: If two have the same.
    """
    result: dict[str, Column] = {}
    for place, (cell, column) in enumerate(zip(header, columns, strict=True)):
        name, unit = split_header(cell)
        if not name:
            continue
        if name in result:
            raise InputError(
                f"two columns are '{name}': '{result[name].header}', '{cell.strip()}'",
                file=file,
                line=line,
                column=name,
            )
        result[name] = column.grown(cell.strip(), unit, place)
    return result
