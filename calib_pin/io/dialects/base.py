"""A foreign layout: its columns with our names, units and meaning."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.io.columns import Column, Floats
from calib_pin.measurement_models.declaration import QUATERNION

Columns = Mapping[str, Column]
"""Columns of a file by name."""

Lines = Sequence[tuple[int, str]]
"""Lines of a file with their numbers, counted from 1."""


@dataclass(frozen=True)
class Heading:
    """A header that is more than a line of names, or none.

    Attributes:
        separator: Separator of two cells; a space stands for any blanks.
        names: The name of each column, with its unit in square brackets; empty for one
            without a name, which a dialect leaves out.
        line: Last line above the rows, counted from 1; 0 if there is none.
        remark: What was recognized; empty for one line of names.
        objects: The object that each column is of, where several are side by side;
            empty for one that is of all.
        kind: What the objects are, `tool` or `target`.
        read: The columns as ours, of those of all objects one below the other.
    """

    separator: str
    names: Sequence[str]
    line: int
    remark: str
    objects: Sequence[str] = ()
    kind: str = ""
    read: Callable[[dict[str, Column]], dict[str, Column]] = dict


@dataclass(frozen=True)
class Reading:
    """The columns of a foreign layout as ours.

    Attributes:
        columns: All columns that may mean something, by name.
        remark: What was recognized.
    """

    columns: Columns
    remark: str


class Dialect:
    """A foreign layout: which columns it has, and what they become.

    One that is more than other names has methods of its own.

    Attributes:
        signs: Patterns; for each of them a file of this layout has a column.
        ours: Patterns of columns, our names for them, and the units of those that
            state none. Of several columns the first pattern decides, then the order.
        other: Columns that are neither joints nor measured, as a pattern.
        remark: What was recognized.
    """

    signs: ClassVar[Sequence[str]] = ()
    ours: ClassVar[Sequence[tuple[str, str, str | None]]] = ()
    other: ClassVar[str] = ""
    remark: ClassVar[str] = ""

    def heading(self, lines: Lines) -> Heading | None:
        """The header of a file; None where it is one line of names, or another layout.

        Args:
            lines: The first lines that are not blank, with their numbers; at least one.
        """
        return None

    def read(self, columns: Columns, file: Path) -> Reading | None:
        """The columns of a file as ours; None for a file of another layout.

        Args:
            columns: Columns by name, those first renamed that the setup file names.
            file: The file, for others beside it.
        """
        matches = [any(re.fullmatch(sign, n) for n in columns) for sign in self.signs]
        fits = matches and all(matches)
        return Reading(self.converted(columns), self.remark) if fits else None

    def converted(self, columns: Columns) -> dict[str, Column]:
        """The columns as ours."""
        sources = dict[str, tuple[str, str | None]]()
        for pattern, ours, unit in self.ours:
            for match in filter(None, (re.fullmatch(pattern, n) for n in columns)):
                # A joint of the same name in a second topic keeps theirs.
                sources.setdefault(match.expand(ours), (match[0], unit))
        read, names = dict[str, Column](), {n: ours for ours, (n, _) in sources.items()}
        for theirs, column in columns.items():
            if theirs in names:
                name = names[theirs]
                read[name] = named(column, name, sources[name][1])
            elif not (theirs in sources or re.fullmatch(self.other, theirs)):
                read[theirs] = named(column, theirs)
        return read


def cells_of(line: str, separator: str) -> list[str]:
    """Trimmed cells of a line; a space stands for any blanks, of which a unit has some.

    Examples:
        >>> cells_of("x [mm]  y", " "), cells_of('a, "b,c"', ",")
        (['x [mm]', 'y'], ['a', 'b,c'])
    """
    if separator == " ":
        return re.split(r"\s+(?!\[)", line.strip())
    try:
        row = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error:
        row = line.split(separator)
    return [cell.strip() for cell in row]


def starting(lines: Lines, word: str) -> list[tuple[int, str]]:
    """The lines from that on which begins with a word, maybe behind a sign."""
    for k, (number, line) in enumerate(lines):
        bare = line.lstrip("#%/ \t")
        if bare.lstrip('"').startswith(word):
            return [(number, bare), *lines[k + 1 :]]
    return []


def cut(lines: Lines) -> tuple[list[list[str]], str]:
    """Cells of some lines, and the separator that is in the first of them."""
    separator = max(",;\t", key=lines[0][1].count)
    return [cells_of(line, separator) for _, line in lines], separator


def header(name: str, unit: str | None) -> str:
    """The header of a column with a unit, if it has any."""
    return f"{name} [{unit}]" if unit else name


def named(column: Column, name: str, unit: str | None = None) -> Column:
    """A column with another name, and a unit where it states none."""
    unit = column.unit or unit
    return replace(column, header=header(name, unit), unit=unit)


def computed(name: str, numbers: Floats, unit: str | None = None) -> Column:
    """A column of numbers that the file does not hold; one that is nan is blank."""
    return Column(header(name, unit), unit, numbers)


def oriented(numbers: Floats, read: Callable[[Floats], Floats]) -> dict[str, Column]:
    """The columns of quaternions, blank where a number is missing.

    Args:
        numbers: Numbers of orientations, shape (N, ...).
        read: The quaternions that they mean, (M, ...) -> (M, 4).
    """
    seen = np.flatnonzero(np.isfinite(numbers.reshape(len(numbers), -1)).all(axis=1))
    quaternions = np.full((len(numbers), 4), np.nan)
    quaternions[seen] = read(numbers[seen])
    return {n: computed(n, c) for n, c in zip(QUATERNION, quaternions.T, strict=True)}


def side_by_side(
    heading: Heading, columns: Sequence[Column]
) -> tuple[dict[str, Column], NDArray[np.int64]]:
    """Objects that are side by side in a file one below the other, row by row.

    Args:
        heading: The header of the file.
        columns: Its columns.

    Returns:
        The columns of no object, those that all objects have, and one with the name of
        the object; and the row of the file of each row.
    """
    count, objects = len(columns[0].numbers), heading.objects or [""] * len(columns)
    tables = dict[str, dict[str, Column]]()
    for column, name, owner in zip(columns, heading.names, objects, strict=True):
        if name or not heading.remark:
            tables.setdefault(owner, {})[column.theirs] = column
    result = tables.pop("", {})
    if not tables:
        return result, np.arange(count)
    rows = np.repeat(np.arange(count), len(tables))
    result = {name: column.rows(rows) for name, column in result.items()}
    first, *others = tables.values()
    for name in (name for name in first if all(name in other for other in others)):
        numbers = [table[name].numbers for table in tables.values()]
        result[name] = computed(name, np.ravel(numbers, "F"), first[name].unit)
    codes = np.tile(np.arange(len(tables)), count)
    nothing = np.full(len(rows), np.nan)
    result[heading.kind] = Column(heading.kind, None, nothing, (*tables,), codes)
    return result, rows
