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
from calib_pin.io.columns import (
    ANGLE,
    LENGTH,
    PIXEL,
    Column,
    Floats,
    Kind,
    closest,
    split_header,
    what_is_wrong,
)
from calib_pin.io.dialects import reading, side_by_side
from calib_pin.io.parquet import is_parquet, read_parquet
from calib_pin.io.text import Cells, read_cells
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
            value=self.columns[name].text(row),
            allowed=allowed,
        )

    def cells(self, names: Collection[str]) -> dict[str, Labels]:
        """Trimmed text of whole columns, by name, N strings each."""
        return {name: self.columns[name].texts() for name in names}

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
                what_is_wrong(self.columns[name].text(row), float(values[row])),
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
        return self.cells(there)

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
            return self.cell_error(
                f"stands in {len(same)} rows and looks like a sign that there is no "
                f"reading; leave them out by 'reading: {{without: [{lines}]}}'",
                name,
                int(same[0]),
            )
        column = self.columns[name]
        smaller = kind.smaller.get(column.unit or kind.si)
        reason = f"{value:.6g} {kind.si} looks like the wrong unit"
        reason += f", {why}" if why else ""
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
            be one; see `read_cells`.
        progress: Told the part of the lines that is read, 0 to 1.
        columns: What columns with foreign names are, ours to theirs; theirs may state
            a unit in square brackets.

    Raises:
        InputError: If the file is no such text with a header and rows of the same
            length, a column name occurs twice, or decimal marks are of both kinds; if
            it is a damaged Parquet file.
        OptionError: If it is a Parquet file, and the extra that reads it is missing.
    """
    cells = read_parquet(path) if is_parquet(path) else read_cells(path, "", progress)
    if not cells.lines:
        raise InputError("the file has a header but no rows", file=cells.file)
    _check_marks(cells)
    number = np.frombuffer(cells.lines, np.int64)
    given = [c.grown(name) for name, c in zip(cells.header, cells.columns, strict=True)]
    remarks = cells.remarks
    if cells.foreign:
        named, row = side_by_side(cells.foreign, given)
        named, number = cells.foreign.read(named), number[row]
    else:
        named = _named(cells, given)
    named, missing = _renamed(named, columns, cells)
    if not cells.foreign and (found := reading(named, Path(path))):
        # The setup names columns as the file does, or as they are called then.
        named, missing = _renamed(found.columns, missing, cells)
        remarks += (f"read as {found.remark}",)
    line = cells.header_line or None
    return Table(cells.file, line, named, number, missing, remarks)


def _check_marks(cells: Cells) -> None:
    """Refuse commas and points as decimal marks: some separate thousands."""
    commas = any("," in column.marks for column in cells.columns)
    for name, column in zip(cells.header, cells.columns, strict=True):
        points = [row for mark, row in column.marks.items() if mark != ","]
        thousands = commas and "." not in column.marks
        if points and ("," in column.marks or thousands):
            raise InputError(
                "a number has a decimal point here, and others a comma",
                file=cells.file,
                line=cells.lines[min(points)],
                column=split_header(name)[0],
                allowed="one decimal mark",
            )


def _named(cells: Cells, given: Sequence[Column]) -> dict[str, Column]:
    """Columns by their names; those without are named by their number.

    Raises:
        InputError: If two have the same.
    """
    result: dict[str, Column] = {}
    for place, column in enumerate(given, 1):
        name = column.theirs or f"column {place}"
        if name in result:
            raise InputError(
                f"two columns are '{name}': '{result[name].header}', '{column.header}'",
                file=cells.file,
                line=cells.header_line or None,
                column=name,
            )
        header = column.header or name
        result[name] = replace(column, header=header)
    return result


def _renamed(
    named: Mapping[str, Column], columns: Mapping[str, str], cells: Cells
) -> tuple[dict[str, Column], dict[str, str]]:
    """Columns by what the setup says they are, and those that are not there.

    Raises:
        InputError: If two are one column, or units contradict.
    """
    taken, missing = dict[str, tuple[str, Column]](), dict[str, str]()
    for ours, stated in columns.items():
        name, unit = split_header(stated)
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
            line = cells.header_line or None
            raise InputError(reason, file=cells.file, line=line, column=name)
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
