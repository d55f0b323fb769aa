"""Tables: files with named columns of numbers or text, and errors that cite them.

A column holds the number of every cell that is one, and the text of the others, so
columns that mean nothing may hold anything, and a bad number is blamed on its own line.
Where a column has few different cells, as one of names has, it holds the text of its
numbers as well.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, enumerated
from calib_pin.io.cells import read_cells
from calib_pin.io.columns import (
    ANGLE,
    UNITS,
    Column,
    Floats,
    GrowingColumn,
    Kind,
    closest,
    counted,
    split_header,
    what_is_wrong,
)
from calib_pin.io.dialects import reading, side_by_side
from calib_pin.observations import Labels
from calib_pin.progress import Progress
from calib_pin.units import steps_of


@dataclass(frozen=True)
class Table:
    """A CSV or Parquet file by columns.

    Attributes:
        file: Path as the caller gave it.
        header_line: Line of the header, counted from 1; None in a file without lines.
        columns: The named columns in the order of the file.
        lines: Line of each row, or its number, shape (N,).
        missing: Columns that it should have by the setup, ours to theirs.
        remarks: Sentences about how the file was read.
    """

    file: str
    header_line: int | None
    columns: Mapping[str, Column]
    lines: NDArray[np.int64]
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
        columns = {n: c.rows(index) for n, c in self.columns.items() if n in names}
        return replace(self, columns=columns, lines=self.lines[index])

    def error(
        self, reason: str, column: str | None = None, allowed: str | None = None
    ) -> InputError:
        """An error about the header."""
        line, own = self.header_line, column and self._told(column)
        return InputError(
            reason, file=self.file, line=line, column=own, allowed=allowed
        )

    def cell_error(
        self, reason: str, name: str, row: int, allowed: str | None = None
    ) -> InputError:
        """An error about one cell."""
        line, own = int(self.lines[row]), self._told(name)
        cell = self.columns[name].text(row)
        return InputError(
            reason, file=self.file, line=line, column=own, value=cell, allowed=allowed
        )

    def cells(self, names: Collection[str]) -> dict[str, Labels]:
        """Text of whole columns, by name, N strings each."""
        return {name: self.columns[name].texts() for name in names}

    def texts(self, names: Collection[str]) -> dict[str, Labels]:
        """Trimmed text of those columns that there are, by name, N strings each.

        Raises:
            InputError: If a header states a unit.
        """
        there = [name for name in names if name in self]
        for name in there:
            if self.columns[name].unit is not None:
                raise self.error(f"'{name}' is text and takes no unit", name)
        return {name: self.columns[name].texts().map(str.strip) for name in there}

    def renamed(self, names: Mapping[str, str]) -> Table:
        """The table with other names of some columns, ours to theirs."""
        ours = {theirs: name for name, theirs in names.items()}
        columns = {ours.get(name, name): c for name, c in self.columns.items()}
        return replace(self, columns=columns)

    def whole(self, names: Collection[str]) -> Table:
        """The table in which names among these that end in brackets are not split."""
        ends = {name for name in names if split_header(name) != (name, None)}
        columns = {
            one.header if one.header in ends else name: (
                replace(one, unit=None, theirs=one.header)
                if one.header in ends
                else one
            )
            for name, one in self.columns.items()
        }
        return replace(self, columns=columns)

    def called(self, columns: Mapping[str, str]) -> Table:
        """The table with the names and units that the setup states.

        Args:
            columns: What columns with foreign names are, ours to theirs; theirs may
                state a unit in square brackets.

        Raises:
            InputError: If two are one column, or units contradict.
        """
        taken, missing = dict[str, str](), dict[str, str]()
        stated = dict(self.columns)
        for ours, theirs in columns.items():
            name, unit = split_header(theirs)
            if name not in self:
                missing |= {} if ours in self else {ours: theirs}
                continue
            own = self.columns[name].unit
            if name in taken:
                both = f"'{taken[name]}' and '{ours}'"
                raise self.error(f"'columns' in the setup takes {both} from it", name)
            # A unit that the file writes in its own way may be stated in ours.
            known = own in UNITS or own in ANGLE.units
            if known and unit not in (None, own):
                reason = f"the header says [{own}], 'columns' in the setup [{unit}]"
                raise self.error(reason, name)
            taken[name] = ours
            stated[name] = replace(stated[name], unit=unit or own)
        # A column that has the name of another's meaning keeps its place without it.
        names = {ours: f"{ours} (of the file)" for ours in taken.values()} | taken
        read = {names.get(name, name): column for name, column in stated.items()}
        return replace(self, columns=read, missing=missing)

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
        column = self.columns[name]
        if column.unit is not None and column.unit not in kind.units:
            allowed = ", ".join(kind.units) or "no unit"
            raise self.error(f"unit '{column.unit}' does not fit here", name, allowed)
        turn, zero = steps_of(column.unit or "") or (0.0, 0.0)
        good = np.isfinite(column.numbers)
        if positive:
            good &= column.numbers > 0.0
        if zero is None:
            good &= (column.numbers >= 0.0) & (column.numbers <= turn)
        if not good.all():
            row = int(np.argmin(good))
            reason = what_is_wrong(column.text(row), float(column.numbers[row]))
            allowed = "a positive number" if positive else "a finite number"
            if zero is None and np.isfinite(column.numbers[row]):
                reason = "no position of a servo within a turn"
                allowed = (
                    f"0 to {turn:g}, or zero in the unit, such as steps/{turn:g}@0"
                )
            raise self.cell_error(reason, name, row, allowed)
        factor = 1.0 if column.unit is None else kind.units[column.unit]
        if turn:
            return (column.numbers - (turn / 2.0 if zero is None else zero)) * factor
        return column.numbers if factor == 1.0 else column.numbers * factor

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
        same = self.columns[name].outlying
        if row in same:
            lines = ", ".join(map(str, self.lines[same]))
            reason = f"stands in {len(same)} rows and looks like a sign that there is "
            reason += f"no reading; leave them out by 'reading: {{without: [{lines}]}}'"
            return self.cell_error(reason, name, int(same[0]))
        column = self.columns[name]
        unit = column.unit or kind.si
        smaller, number = kind.smaller.get(unit, ""), abs(value) / kind.units[unit]
        while smaller in kind.smaller and kind.units[smaller] * number > kind.largest:
            smaller = kind.smaller[smaller]
        reason = f"{value:.6g} {kind.si} looks like the wrong unit"
        reason += f", {why}" if why else ""
        if kind is ANGLE and column.unit is None and counted(column.numbers):
            plain = [c.numbers for c in self.columns.values() if c.unit is None]
            smaller = counted(np.concatenate([n for n in plain if counted(n)]))
            reason += "; whole numbers of all joints are steps, zero in the middle"
        if kind is ANGLE and np.nanmax(np.abs(column.numbers)) == 100.0:
            reason += "; -100 to 100 of a range: [steps/N@0], N = 819200 / range"
        if smaller and column.theirs in ("", name):
            reason += f"; write the header as '{name} [{smaller}]'"
        elif smaller:
            stated = f"{{{name}: {column.theirs} [{smaller}]}}"
            reason += f"; state in the setup 'columns: {stated}'"
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
        if abs(values[row]) > largest:
            raise self.implausible(name, row, float(values[row]), kind, why)

    def _told(self, name: str) -> str:
        """A column with its name in the file, which the setup may say means ours."""
        theirs = (name in self and self.columns[name].theirs) or name
        return name if theirs == name else f"{theirs} ({name})"


def read_table(
    path: str | Path | bytes,
    progress: Progress | None = None,
    *,
    columns: Mapping[str, str] = {},
) -> Table:
    """Read a file of columns: Parquet, or else CSV.

    Args:
        path: Parquet file, by its first bytes; or CSV with a header: commas,
            semicolons, tabs or blanks separate, and where it is no comma, the decimal
            mark may be one; see `read_cells`. Bytes are those of a file.
        progress: Told the part of the lines that is read, 0 to 1.
        columns: What columns with foreign names are, ours to theirs; theirs may state
            a unit in square brackets.

    Raises:
        InputError: If the file is no such text with a header and rows of the same
            length, a column name occurs twice, or decimal marks are of both kinds; if
            it is a damaged Parquet file.
        OptionError: If it is a Parquet file, and the extra that reads it is missing.
    """
    cells = read_cells(path, "", progress)
    line, number = cells.header_line or None, np.frombuffer(cells.lines, np.int64)
    table = Table(cells.file, line, {}, number, remarks=cells.remarks)
    if not cells.lines:
        raise InputError("the file has a header but no rows", file=cells.file)
    headers = [name or f"column {k}" for k, name in enumerate(cells.header, 1)]
    given = [c.grown(name) for c, name in zip(cells.columns, headers, strict=True)]
    if cells.foreign:
        found, row = side_by_side(cells.foreign, given)
        ours = cells.foreign.read(found)
        return replace(table, columns=ours, lines=number[row]).called(columns)
    names = [column.theirs for column in given]
    for place, name in enumerate(names):
        if (first := names.index(name)) < place:
            both = f"'{given[first].header}', '{given[place].header}'"
            raise table.error(f"two columns are '{name}': {both}", name)
    table = replace(table, columns=dict(zip(names, given, strict=True)))
    _check_marks(table, cells.columns)
    table = table.called(columns)
    if read := reading(table.columns, Path(cells.file)):
        remarks = (*table.remarks, f"read as {read.remark}")
        # The setup names columns as the file does, or as they are called then.
        table = replace(table, columns=read.columns, remarks=remarks)
        table = table.called(table.missing)
    return table


def _check_marks(table: Table, columns: Sequence[GrowingColumn]) -> None:
    """Refuse commas and points as decimal marks: some separate thousands."""
    commas = [column.marks[","] for column in columns if "," in column.marks]
    for name, column in zip(table.columns, columns, strict=True):
        points = [row for mark, row in column.marks.items() if mark != ","]
        thousands = commas and "." not in column.marks
        if points and ("," in column.marks or thousands):
            line = table.lines[column.marks.get(",", min(commas))]
            reason = f"a number has a decimal point here, others a comma (line {line})"
            raise table.cell_error(reason, name, min(points), "one decimal mark")


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
