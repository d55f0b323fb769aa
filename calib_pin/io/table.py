"""Tables: CSV files with named columns of numbers or text, and errors that cite them.

A column holds the number of every cell that is one, and the text of the others, so
columns that mean nothing may hold anything, and a bad number is blamed on its own line.
The text of a number is in the file, and is read from there where it is asked for.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, enumerated
from calib_pin.io.columns import (
    Column,
    Floats,
    GrowingColumn,
    Kind,
    Numbering,
    read_numbers,
    split_header,
    what_is_wrong,
)
from calib_pin.io.csv_text import CsvText, Stretch, open_csv
from calib_pin.observations import Labels
from calib_pin.progress import Progress


@dataclass(frozen=True)
class Table:
    """A CSV file by columns.

    Attributes:
        file: Path as the caller gave it.
        header_line: Line of the header, counted from 1.
        columns: The named columns in the order of the file.
        unnamed: Number of columns with an empty header.
        lines: Line of each row, shape (N,).
        text: The file's text.
    """

    file: str
    header_line: int
    columns: Mapping[str, Column]
    unnamed: int
    lines: NDArray[np.int64]
    text: CsvText

    def __contains__(self, name: object) -> bool:
        """Whether there is a column of exactly this name."""
        return name in self.columns

    def rows(self, index: NDArray[np.int64] | slice, names: Collection[str]) -> Table:
        """Some of the rows and columns.

        Args:
            index: The rows, in this order.
            names: The columns; those that do not exist are left out.
        """
        columns = {
            name: column.rows(index)
            for name, column in self.columns.items()
            if name in names
        }
        return replace(self, columns=columns, lines=self.lines[index])

    def error(
        self, reason: str, column: str | None = None, allowed: str | None = None
    ) -> InputError:
        """An error about the header."""
        return InputError(
            reason,
            file=self.file,
            line=self.header_line,
            column=column,
            allowed=allowed,
        )

    def cell_error(
        self, reason: str, name: str, row: int, allowed: str | None = None
    ) -> InputError:
        """An error about one cell."""
        return InputError(
            reason,
            file=self.file,
            line=int(self.lines[row]),
            column=name,
            value=self.cell(name, row),
            allowed=allowed,
        )

    def cell(self, name: str, row: int) -> str:
        """Trimmed text of one cell."""
        column = self.columns[name]
        if column.words and column.codes[row] >= 0:
            return column.words[int(column.codes[row])].strip()
        return self.text.cells(int(self.lines[row]))[column.place].strip()

    def cells(self, names: Collection[str]) -> dict[str, Labels]:
        """Untrimmed text of whole columns, by name, N strings each.

        Raises:
            InputError: If it must be read again, and the file has changed.
        """
        found: dict[str, Labels] = {}
        for name in names:
            column = self.columns[name]
            if column.words and (column.codes >= 0).all():
                found[name] = Labels(column.words, column.codes)
        again = [name for name in names if name not in found]
        return found | self._cells_of_file(again) if again else found

    def ignored(self, names: Collection[str]) -> str:
        """A sentence about columns without a meaning; empty if there are none."""
        headers = [self.columns[name].header for name in names]
        headers += ["(unnamed)"] * self.unnamed
        return f"{self.file}: columns ignored: {enumerated(headers)}" * bool(headers)

    def numbers(self, name: str, kind: Kind, *, positive: bool = False) -> Floats:
        """A column of numbers in SI units, shape (N,).

        Args:
            name: Name of the column, which must exist.
            kind: Quantity in the column; determines the allowed units.
            positive: Whether every number must be greater than zero.

        Raises:
            InputError: If the unit does not fit, or a cell is not a finite number.
        """
        factor = self._factor(name, kind)
        values = self.columns[name].numbers
        bad = ~np.isfinite(values)
        if positive:
            bad |= ~(values > 0.0)
        if bad.any():
            row = int(np.argmax(bad))
            raise self.cell_error(
                what_is_wrong(self.cell(name, row), float(values[row])),
                name,
                row,
                "a positive number" if positive else "a finite number",
            )
        return values if factor == 1.0 else values * factor

    def texts(self, names: Collection[str]) -> dict[str, Labels]:
        """Trimmed text of those columns that there are, by name, N strings each.

        Raises:
            InputError: If a header states a unit.
        """
        there = [name for name in names if name in self]
        for name in there:
            if self.columns[name].unit is not None:
                raise self.error(f"'{name}' is text and takes no unit", name)
        return {name: cells.map(str.strip) for name, cells in self.cells(there).items()}

    def implausible(
        self, name: str, row: int, value: float, kind: Kind, why: str = ""
    ) -> InputError:
        """An error about a value so large that its unit must be another one.

        Args:
            name: Name of the column.
            row: Row of the value.
            value: The value in SI units.
            kind: Quantity in the column.
            why: How it shows, where that is not the value alone.
        """
        unit = self.columns[name].unit or kind.si
        reason = f"{value:.6g} {kind.si} looks like the wrong unit"
        reason += f", {why}" if why else ""
        if unit in kind.smaller:
            reason += f"; write the header as '{name} [{kind.smaller[unit]}]'"
        return self.cell_error(reason, name, row, ", ".join(kind.units))

    def check_size(
        self, name: str, values: Floats, kind: Kind, largest: float, why: str = ""
    ) -> None:
        """Refuse values that are too large to be in the stated unit.

        Args:
            name: Name of the column.
            values: Its values in SI units, shape (N,).
            kind: Quantity in the column.
            largest: Largest absolute value that is plausible.
            why: Further explanation for the message.

        Raises:
            InputError: If a value is larger; blames the largest.
        """
        row = int(np.argmax(np.abs(values)))
        if abs(values[row]) <= largest:
            return
        if len(kind.units) == 1:
            reason = f"{values[row]:.6g} {kind.si} is too large"
            raise self.cell_error(reason, name, row, f"{largest:g} {kind.si} or less")
        raise self.implausible(name, row, float(values[row]), kind, why)

    def _cells_of_file(self, names: Sequence[str]) -> dict[str, Labels]:
        """Untrimmed text of whole columns, read from the file once more."""
        places = [self.columns[name].place for name in names]
        first, stretches = self.text.split()
        header = first.cells(0)
        if len(header) <= max(places):
            raise self.text.changed()
        lines = array("q")
        known = [Numbering() for _ in places]
        found: list[list[NDArray[np.int64]]] = [[] for _ in places]
        for stretch in stretches:
            lines.extend(stretch.numbers)
            columns = stretch.columns(header)
            for codes, place, number in zip(found, places, known, strict=True):
                codes.append(number.of(columns[place]))
        rows = np.searchsorted(lines, self.lines)
        if not np.array_equal(np.take(lines, rows, mode="clip"), self.lines):
            raise self.text.changed()
        return {
            name: Labels(tuple(number.known), np.concatenate(codes)[rows])
            for name, codes, number in zip(names, found, known, strict=True)
        }

    def _factor(self, name: str, kind: Kind) -> float:
        unit = self.columns[name].unit
        if unit is None:
            return 1.0
        if unit not in kind.units:
            raise self.error(
                f"unit '{unit}' does not fit here",
                name,
                ", ".join(kind.units) or "no unit",
            )
        return kind.units[unit]


def read_table(
    path: str | Path, progress: Progress | None = None, *, head: bool = False
) -> Table:
    """Read a CSV file with a header; comments and blank lines are skipped.

    Args:
        path: UTF-8 file, with or without byte order mark, any line ends.
        progress: Told the part of the lines that is read, 0 to 1.
        head: Whether the first lines are enough, some hundreds.

    Raises:
        InputError: If the file is not comma-separated text with a header and rows of
            the same length, or a column name occurs twice.
    """
    text = open_csv(path)
    file = text.file
    first, stretches = text.split(progress)
    _check_separator(first)
    header, header_line = first.cells(0), first.numbers[0]
    # Columns may be named 1, 2, 3 (and mapped to joints), but not 0.25.
    if np.isfinite(read_numbers(header)).all() and any("." in cell for cell in header):
        raise InputError(
            "the first row holds numbers, a header with the names of the columns is "
            "missing",
            file=file,
            line=header_line,
        )
    lines, columns = array("q"), [GrowingColumn() for _ in header]
    for stretch in islice(stretches, 1) if head else stretches:
        lines.extend(stretch.numbers)
        for column, cells in zip(columns, stretch.columns(header), strict=True):
            column.extend(cells)
    if not lines:
        raise InputError("the file has a header but no rows", file=file)
    return Table(
        file,
        header_line,
        _named(header, columns, file, header_line),
        sum(not split_header(cell)[0] for cell in header),
        np.frombuffer(lines, np.int64),
        text,
    )


def _check_separator(first: Stretch) -> None:
    """Name the separator of a file that is not comma-separated."""
    header = first.lines[0]
    found = [
        name
        for mark, name in ((";", "semicolons"), ("\t", "tabs"))
        if header.count(mark) > header.count(",")
    ]
    names = re.sub(r"\[[^\[\]]*\]", "", header).split()
    if not found and "," not in header and len(names) > 1:
        # A single column may have a space in its name, but not in its numbers.
        found = ["spaces"] * (len(first.lines[-1].split()) == len(names))
    if found:
        raise InputError(
            f"the columns are separated by {found[0]}, the separator must be a comma "
            "(and the decimal mark a point)",
            file=first.file,
            line=first.numbers[0],
        )


def _named(
    header: Sequence[str], columns: Sequence[GrowingColumn], file: str, line: int
) -> dict[str, Column]:
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
