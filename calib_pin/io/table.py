"""Tables: files with named columns of numbers or text, and errors that cite them.

A column holds the number of every cell that is one, and the text of the others, so
columns that mean nothing may hold anything, and a bad number is blamed on its own line.
The text of a number is in the file, and is read from there where it is asked for.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, enumerated
from calib_pin.io.columns import (
    ANGLE,
    LENGTH,
    PIXEL,
    Column,
    Floats,
    GrowingColumn,
    Kind,
    Numbering,
    closest,
    read_lines,
    split_header,
    what_is_wrong,
    with_points,
)
from calib_pin.io.dialects import reading, side_by_side
from calib_pin.io.parquet import Parquet, is_parquet, read_parquet
from calib_pin.io.text import Text, read_text
from calib_pin.observations import Labels
from calib_pin.progress import Progress

UNITS = {*ANGLE.units, *LENGTH.units, *PIXEL.units}
"""Units as calib-pin writes them."""


@dataclass(frozen=True)
class Table:
    """A CSV or Parquet file by columns.

    Attributes:
        file: Path as the caller gave it.
        header_line: Line of the header, counted from 1; None in a file without lines.
        columns: The named columns in the order of the file.
        lines: Line of each row, or its number, shape (N,).
        text: The file's text.
        missing: Columns that it should have by the setup, ours to theirs.
        remarks: Sentences about how the file was read.
    """

    file: str
    header_line: int | None
    columns: Mapping[str, Column]
    lines: NDArray[np.int64]
    text: Text | Parquet
    missing: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

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

    def head(self) -> Table:
        """The same without rows, which takes little memory."""
        columns = {name: c.rows(slice(0)) for name, c in self.columns.items()}
        text, none = Text(self.file, b"", ",", (), 0), np.zeros(0, np.int64)
        return replace(self, columns=columns, lines=none, text=text)

    def error(
        self, reason: str, column: str | None = None, allowed: str | None = None
    ) -> InputError:
        """An error about the header."""
        return InputError(
            reason,
            file=self.file,
            line=self.header_line,
            column=column and self._told(column),
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
            column=self._told(name),
            value=self.cell(name, row),
            allowed=allowed,
        )

    def cell(self, name: str, row: int) -> str:
        """Trimmed text of one cell."""
        column = self.columns[name]
        if column.words and column.codes[row] >= 0:
            return column.words[int(column.codes[row])].strip()
        if column.place < 0:
            return repr(float(column.numbers[row]))
        return self.text.cells(int(self.lines[row]))[column.place].strip()

    def cells(self, names: Collection[str]) -> dict[str, Labels]:
        """Text of whole columns, by name, N strings each."""
        found: dict[str, Labels] = {}
        for name in names:
            column = self.columns[name]
            if column.words and (column.codes >= 0).all():
                found[name] = Labels(column.words, column.codes)
            elif column.place < 0:
                cells = [self.cell(name, row) for row in range(len(self.lines))]
                known = Numbering()
                codes = known.of(cells)
                found[name] = Labels(tuple(known.known), codes)
        again = [name for name in names if name not in found]
        return found | self._cells_of_text(again) if again else found

    def with_points(self, names: Collection[str]) -> dict[str, Labels]:
        """As `cells`, decimal commas as points where a comma separates no cells."""
        if self.text.separator == ",":
            return self.cells(names)
        cells = self.cells(names).items()
        return {n: c.map(lambda text: with_points([text])[0]) for n, c in cells}

    def renamed(self, names: Mapping[str, str]) -> Table:
        """The table with other names of some columns, ours to theirs."""
        ours = {theirs: name for name, theirs in names.items()}
        columns = {ours.get(name, name): c for name, c in self.columns.items()}
        return replace(self, columns=columns)

    def ignored(self, names: Collection[str]) -> str:
        """A sentence about columns without a meaning; empty if there are none."""
        headers = [self.columns[name].header for name in names]
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
        numbers = self.columns[name].numbers
        same = np.flatnonzero(numbers == numbers[row])
        others = np.abs(np.delete(numbers, same)).max(initial=0.0)
        if len(same) > 1 and 2.0 * others < abs(numbers[row]):
            lines = ", ".join(map(str, self.lines[same]))
            return self.cell_error(
                f"stands in {len(same)} rows and looks like a sign that there is no "
                f"reading; leave them out by 'reading: {{without: [{lines}]}}'",
                name,
                int(same[0]),
            )
        unit = self.columns[name].unit or kind.si
        reason = f"{value:.6g} {kind.si} looks like the wrong unit"
        reason += f", {why}" if why else ""
        if unit in kind.smaller:
            theirs, smaller = self._theirs(name), kind.smaller[unit]
            number = abs(value) / kind.units[unit]
            while kind.units[smaller] * number > kind.largest and (
                smaller in kind.smaller
            ):
                smaller = kind.smaller[smaller]
            reason += (
                f"; write the header as '{name} [{smaller}]'"
                if theirs == name
                else f"; state in the setup 'columns: {{{name}: {theirs} [{smaller}]}}'"
            )
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

    def _cells_of_text(self, names: Sequence[str]) -> dict[str, Labels]:
        """Text of whole columns, cut once more out of that of the file."""
        lines = array("q")
        known = {name: Numbering() for name in names}
        found: dict[str, list[NDArray[np.int64]]] = {name: [] for name in names}
        for numbers, columns in self.text.rows():
            lines.extend(numbers)
            for name in names:
                cells = columns[self.columns[name].place]
                found[name].append(known[name].of(cells))
        rows = np.searchsorted(lines, self.lines)
        if rows.max() >= len(lines) or (np.array(lines)[rows] != self.lines).any():
            reason = "the file has changed while it was read"
            raise InputError(reason, file=self.file)
        return {
            name: Labels(tuple(known[name].known), np.concatenate(codes)[rows])
            for name, codes in found.items()
        }

    def _theirs(self, name: str) -> str:
        """The name of a column in the file, which the setup may say means ours."""
        column = self.columns.get(name)
        if column is None:
            return name
        there = 0 <= column.place < len(self.text.header)
        header = self.text.header[column.place] if there else ""
        return split_header(header or column.header)[0]

    def _told(self, name: str) -> str:
        theirs = self._theirs(name)
        return name if theirs == name else f"{theirs} ({name})"

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
    path: str | Path,
    progress: Progress | None = None,
    *,
    columns: Mapping[str, str] = {},
) -> Table:
    """Read a file of columns: Parquet, or else CSV.

    Args:
        path: Parquet file, by its suffix or its content; or CSV with a header: commas,
            semicolons or tabs separate, and where it is no comma, the decimal mark may
            be one; see `read_text`.
        progress: Told the part of the lines that is read, 0 to 1.
        columns: What columns with foreign names are, ours to theirs; theirs may state
            a unit in square brackets.

    Raises:
        InputError: If the file is no such text with a header and rows of the same
            length, a column name occurs twice, or decimal marks are of both kinds; if
            it is a damaged Parquet file.
        OptionError: If it is a Parquet file, and the extra that reads it is missing.
    """
    text: Text | Parquet
    if is_parquet(path):
        text = read_parquet(path)
        lines, grown = text.columns(progress)
    else:
        text = read_text(path)
        lines, grown = array("q"), [GrowingColumn() for _ in text.header]
        commas = text.separator != ","
        for numbers, rows in text.blocks(progress):
            lines.extend(numbers)
            plain = None if commas else read_lines(rows, len(grown))
            if plain is not None:
                for column, read in zip(grown, plain, strict=True):
                    column.add(read, ())
                continue
            for column, cells in zip(grown, text.cut(numbers, rows), strict=True):
                column.extend(cells, commas=commas)
    if not lines:
        raise InputError("the file has a header but no rows", file=text.file)
    _check_marks(text, grown, lines)
    named, number = _named(text, grown), np.frombuffer(lines, np.int64)
    if text.foreign:
        named, row = side_by_side(named)
        named, number = text.foreign.read(named), number[row]
    named, missing = _renamed(named, columns, text)
    remarks = text.remarks
    if not text.foreign and (found := reading(named, Path(text.file))):
        # The setup names columns as the file does, or as they are called then.
        named, missing = _renamed(found.columns, missing, text)
        remarks += (f"read as {found.remark}",)
    line = text.header_line or None
    return Table(text.file, line, named, number, text, missing, remarks)


def _check_marks(
    text: Text | Parquet, grown: Sequence[GrowingColumn], lines: Sequence[int]
) -> None:
    """Refuse commas and points as decimal marks: some separate thousands."""
    commas = [column.marks[","] for column in grown if "," in column.marks]
    for name, column in zip(text.header, grown, strict=True):
        mixed = "," in column.marks or (commas and column.thousands)
        if "." in column.marks and mixed:
            comma = lines[column.marks.get(",", min(commas))]
            raise InputError(
                f"a number has a decimal point here, and a comma in line {comma}",
                file=text.file,
                line=lines[column.marks["."]],
                column=split_header(name)[0],
                allowed="one decimal mark",
            )


def _named(text: Text | Parquet, grown: Sequence[GrowingColumn]) -> dict[str, Column]:
    """Columns by their names; those without are named by their number.

    Raises:
        InputError: If two have the same.
    """
    result: dict[str, Column] = {}
    for place, (cell, column) in enumerate(zip(text.header, grown, strict=True)):
        name, unit = split_header(cell)
        name = name or f"column {place + 1}"
        if name in result:
            raise InputError(
                f"two columns are '{name}': '{result[name].header}', '{cell}'",
                file=text.file,
                line=text.header_line,
                column=name,
            )
        result[name] = column.grown(cell or name, unit, place)
    return result


def _renamed(
    named: Mapping[str, Column], columns: Mapping[str, str], text: Text | Parquet
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
        reason = ""
        if name in taken:
            first = taken[name][0]
            reason = f"'columns' in the setup takes '{first}' and '{ours}' from it"
        # A unit that the file writes in its own way may be stated in ours.
        own = column.unit if column.unit in UNITS else None
        if None not in (unit, own) and unit != own:
            reason = f"the header says [{own}], 'columns' in the setup [{unit}]"
        if reason:
            line = text.header_line
            raise InputError(reason, file=text.file, line=line, column=name)
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


def with_readings(
    table: Table,
    kept: NDArray[np.bool_],
    what: str,
    notice: Callable[[str], None] | None,
) -> Table:
    """The rows that have a reading, and a word on those that have none.

    Args:
        table: The file.
        kept: Whether each row has one, shape (N,).
        what: The name of its rows.
        notice: Called with a sentence that counts those without.
    """
    if kept.all():
        return table
    if notice is not None:
        first = table.lines[int(np.argmin(kept))]
        count = f"{np.count_nonzero(~kept)} of {len(kept)} {what}"
        notice(f"{table.file}: {count} have no reading (the first in line {first})")
    return table.rows(np.flatnonzero(kept), table.columns)


def require_columns(tables: Sequence[Table]) -> None:
    """Refuse files of which none has a column that the setup names.

    Raises:
        InputError: If so.
    """
    missing = [table.missing for table in tables]
    for ours, theirs in missing[0].items() if missing else ():
        if all(ours in others for others in missing):
            table = tables[0]
            raise table.error(
                f"'columns' in the setup takes '{ours}' from '{theirs}', and there is "
                f"no such column{closest(theirs, list(table.columns))}"
            )
