"""Tables: bytes of a file to named columns of numbers or text, and errors citing them.

A column holds the number of every cell that is one, and the text of the others, so
columns that mean nothing may hold anything, and a bad number is blamed on its own line.
One of names holds the text of its numbers as well.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, compress, count, islice, pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, enumerated, require_package
from calib_pin.io.columns import (
    ANGLE,
    COMMA,
    GRAD,
    NAMES,
    NO_READING,
    OURS,
    THOUSANDS,
    Column,
    Floats,
    Kind,
    closest,
    counted,
    kind_of_unit,
    split_header,
    unit_called,
)
from calib_pin.io.dialects import Heading, heading, reading, side_by_side
from calib_pin.io.dialects.base import cells_of
from calib_pin.io.files import read_bytes
from calib_pin.io.not_measured import first_statistic, out_of_sight
from calib_pin.observations import Booleans, Indices, Labels
from calib_pin.progress import Progress
from calib_pin.units import MINUS, as_number, steps_of

Notice = Callable[[str], None]
"""Called with sentences about a file."""

LINES = 1 << 18
"""Letters of the lines that are cut into cells at a time."""

HEAD = 200
"""Lines among which the header stands."""

COMMENTS = ("#", "%", "//")
"""Signs with which comments begin; a header may stand behind one, above the rows."""

OTHER = frozenset(" \t\r\n\v\f#%/")
"""First letters of all lines that are blank or comments."""

SEPARATORS = "\t;,| "
"""In this order: where others separate, a comma is a decimal mark, and names may have a
bar."""

START = 1 << 12
"""Bytes that tell what a file is."""

PARQUET = b"PAR1"
"""First bytes of a Parquet file."""

OTHERS: Mapping[bytes, str] = {
    rb"PK.*\[Content_Types\]\.xml": "an Excel workbook: save the sheet as CSV",
    rb"PK.*opendocument": "an OpenDocument spreadsheet: save the sheet as CSV",
    rb"PK.*\.npy": "NumPy arrays: write them with numpy.savetxt, and a header",
    rb"PK\x03\x04": "an archive (zip): unpack it",
    rb"\xd0\xcf\x11\xe0": "an Excel workbook (xls): save the sheet as CSV",
    rb"MATLAB 5\.0": "a MATLAB file: write it with writetable",
    rb"\x89HDF": "an HDF5 file (or MATLAB 7.3): write it as CSV",
    rb"\x93NUMPY": "a NumPy array: write it with numpy.savetxt, and a header",
    rb"\x1f\x8b": "compressed (gzip): unpack it",
    rb"SQLite format 3": "an SQLite database or a bag of ROS 2: see 'join'",
    rb"\x89MCAP": "a bag of ROS 2 (mcap): see 'join'",
    rb"\s*(?:\{|\[\s*[\[{\"\d-])": "JSON or YAML: write its rows as CSV",
    # Of KUKA, ABB (`%%%` before it) and FANUC.
    rb"\s*(?:&ACCESS|DEFDAT\s|%%%\s|MODULE\s|/PROG\s)": "a program of a controller: "
    "write the joints of its points as CSV",
}
"""Patterns for the start of files that hold no table, and what they are."""

DOCUMENTS = (".yaml", ".yml", ".samples")
"""Endings of files of YAML."""


BROKEN = re.compile(r'(?<![^\n\t;,])"[^"\n]*\n[^"]{,200}"(?=[\n\t;,])')
"""A cell in quotes that has line ends in it, as those of a header in a sheet."""


LIST = re.compile(r"\w*\W*[\[({].*\d[\s,;].*\d.*[\])}]", re.DOTALL)
"""Cells that hold several numbers."""


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

    def rows(self, index: Indices | slice) -> Table:
        """Some of the rows, in this order."""
        columns = {name: column.rows(index) for name, column in self.columns.items()}
        return replace(self, columns=columns, lines=self.lines[index])

    def error(
        self, reason: str, column: str = "", allowed: str = "", row: int | None = None
    ) -> InputError:
        """An error about the header, or about a cell of a row."""
        source = self.columns.get(column)
        line = self.header_line if row is None else int(self.lines[row])
        value = source.text(row) if source and row is not None else None
        if source and source.theirs not in ("", column):
            # The setup says which column of the file means ours.
            column = f"{source.theirs} ({column})"
        about: dict[str, Any] = {"column": column or None, "allowed": allowed or None}
        return InputError(reason, file=self.file, line=line, value=value, **about)

    def refuse(self, rows: Booleans, reason: str, name: str, allowed: str = "") -> None:
        """Refuse rows, shape (N,), if there are any; blames the cell of the first."""
        if rows.any():
            raise self.error(reason, name, allowed, int(np.argmax(rows)))

    def require(
        self,
        names: Collection[str],
        reason: str,
        among: Collection[str] = (),
        advice: str = "",
    ) -> None:
        """Refuse a file that lacks columns.

        Args:
            names: The columns that it must have.
            reason: What is wrong, before the names of those that are missing.
            among: Columns that may be meant by these.
            advice: What to do where none of them may be.
        """
        if missing := [name for name in names if name not in self]:
            hints = (closest(name, among) for name in missing)
            hint = next(filter(None, hints), advice)
            raise self.error(f"{reason} {', '.join(missing)}{hint}", missing[0])

    def labels(self, name: str, absent: str = "") -> Labels:
        """Trimmed text of a column, N strings; that of one that there is not is equal.

        Raises:
            InputError: If its header states a unit.
        """
        if name not in self:
            return Labels.all(absent, len(self.lines))
        if self.columns[name].unit is not None:
            raise self.error(f"'{name}' is text and takes no unit", name)
        return self.columns[name].texts().map(str.strip)

    def texts(self, names: Collection[str]) -> dict[str, Labels]:
        """Those of the columns that there are, by name, see `labels`."""
        return {name: self.labels(name) for name in names if name in self}

    def renamed(self, names: Mapping[str, str]) -> Table:
        """The table with other names of some columns, ours to theirs."""
        ours = {theirs: name for name, theirs in names.items()}
        columns = {ours.get(name, name): c for name, c in self.columns.items()}
        return replace(self, columns=columns)

    def whole(self, names: Collection[str]) -> Table:
        """The table in which names among these that end in brackets are not split."""
        columns = dict[str, Column]()
        for name, column in self.columns.items():
            if column.header.endswith("]") and column.header in names:
                name = column.header
                column = replace(column, unit=None, theirs=name)
            columns[name] = column
        return replace(self, columns=columns)

    def called(self, columns: Mapping[str, str]) -> Table:
        """The table with the names and units that the setup states.

        Args:
            columns: What columns with foreign names are, ours to theirs; theirs may
                state a unit in square brackets.

        Raises:
            InputError: If two are one column, or units contradict.
        """
        meanings, missing = dict[str, str](), dict[str, str]()
        by_name = dict(self.columns)
        for ours, theirs in columns.items():
            name, unit = split_header(theirs)
            if name not in self:
                missing |= {} if ours in self else {ours: theirs}
                continue
            if name in meanings:
                both = f"'{meanings[name]}' and '{ours}'"
                raise self.error(f"'columns' in the setup takes {both} from it", name)
            native = self.columns[name].unit
            # A unit that the file writes in its own way may be stated in ours.
            if kind_of_unit(native).si and unit not in (None, native):
                reason = f"the header says [{native}], 'columns' in the setup [{unit}]"
                raise self.error(reason, name)
            meanings[name] = ours
            by_name[name] = replace(self.columns[name], unit=unit or native)
        # A column that has the name of another's meaning keeps its place without it.
        names = {ours: f"{ours} (of the file)" for ours in meanings.values()} | meanings
        read = {names.get(name, name): column for name, column in by_name.items()}
        return replace(self, columns=read, missing=missing)

    def ignored(self, names: Collection[str]) -> str:
        """A sentence about columns without a meaning; empty if there are none."""
        headers = [self.columns[name].header for name in names]
        return f"{self.file}: columns ignored: {enumerated(headers)}" * bool(headers)

    def numbers(self, name: str, kind: Kind) -> Floats:
        """A column of numbers in SI units, shape (N,).

        Args:
            name: Name of the column, which must exist.
            kind: Quantity in the column; determines the allowed units.

        Raises:
            InputError: If the unit does not fit, or a cell is not a finite number.
        """
        column = self.columns[name]
        unit, numbers = column.unit, column.numbers
        if unit is not None and unit not in kind.units:
            allowed = ", ".join(kind.units) or "no unit"
            raise self.error(f"unit '{unit}' does not fit here", name, allowed)
        bad = ~np.isfinite(numbers)
        if bad.any():
            self.refuse(bad, column.fault(int(np.argmax(bad))), name, "a finite number")
        turn, zero = steps_of(unit or "") or (0.0, 0.0)
        if turn and zero is None:
            allowed = f"0 to {turn:g}, or zero in the unit, such as steps/{turn:g}@0"
            outside = (numbers < 0.0) | (numbers > turn)
            self.refuse(outside, "no position of a servo within a turn", name, allowed)
            zero = turn / 2.0
        factor = 1.0 if unit is None else kind.units[unit]
        numbers = numbers - zero if zero else numbers
        return numbers if factor == 1.0 else numbers * factor

    def check(self, name: str, values: Floats, kind: Kind) -> Floats:
        """The values, of which none may be so that another unit must be meant.

        Args:
            name: Name of the column.
            values: Its values in SI units, shape (N,).
            kind: Quantity in the column, and its bounds.

        Raises:
            InputError: If a value is too large or too small; blames the largest, and
                names the unit that must be meant.
        """
        allowed = f"{kind.least:g} {kind.si} or more"
        self.refuse(values < kind.least, "the value is too small", name, allowed)
        sizes, column = np.abs(values), self.columns[name]
        row, unit = int(np.argmax(sizes)), column.unit or kind.si
        if sizes[row] <= kind.largest:
            return values
        number, units = sizes[row] / kind.units[unit], kind.smaller(unit)
        fits = (u for u in units if number * kind.units[u] <= kind.largest)
        meant = next(fits, "")
        if kind.si == ANGLE.si and column.unit is None:
            # All joints of a robot are counted by servos of one kind.
            plain = [c.numbers for c in self.columns.values() if counted(c.numbers)]
            meant = counted(np.concatenate([[], *plain])) or meant
        reason = f"{values[row]:.6g} {kind.si} looks like the wrong unit"
        if meant:
            reason += f"; write the header as '{column.theirs or name} [{meant}]'"
        # Percent of a range look like degrees, and come no farther than 100.
        if meant == "deg" and np.nanmax(np.abs(column.numbers)) <= 100.0:
            reason += ", of percent of its range [steps/N@0], N = 72000 / range in deg"
        raise self.error(reason, name, ", ".join(kind.units), row)

    def values(self, kinds: Iterable[tuple[str, Kind]]) -> Floats:
        """Columns side by side, shape (N, k), of values that can be meant [SI]."""
        columns = [self.check(n, self.numbers(n, kind), kind) for n, kind in kinds]
        return np.column_stack([np.zeros((len(self.lines), 0)), *columns])

    def numbers_if_any(self, name: str, kind: Kind) -> Floats | None:
        """As `numbers`; None where there is no such column, or one of other cells."""
        with suppress(InputError):
            return self.numbers(name, kind) if name in self else None
        return None


def read_table(
    path: str | Path | bytes,
    progress: Progress | None = None,
    *,
    columns: Mapping[str, str] = {},
    names: Collection[str] | None = (*NAMES, *OURS),
) -> Table:
    """Read a file of columns: Parquet, or else CSV.

    Args:
        path: Parquet file, by its first bytes; or CSV with a header: commas,
            semicolons, tabs or blanks separate, and where it is no comma, the decimal
            mark may be one; see `read_cells`. Bytes are those of a file.
        progress: Told the part of the lines that is read, 0 to 1.
        columns: What columns with foreign names are, ours to theirs; theirs may state
            a unit in square brackets.
        names: Our columns of names, see `read_cells`.

    Raises:
        InputError: If the file is no such text with a header and rows of the same
            length, a column name occurs twice, or decimal marks are of both kinds; if
            it is a damaged Parquet file.
        OptionError: If it is a Parquet file, and the extra that reads it is missing.
    """
    if names is not None:
        theirs = (columns[name] for name in names if name in columns)
        names = {*names, *(split_header(header)[0] for header in theirs)}
    cells = read_cells(path, "", progress, names=names)
    heading, given = cells.heading, cells.columns()
    if not cells.lines:
        raise InputError("the file has a header but no rows", file=cells.file)
    ours, row = side_by_side(heading, given)
    lines = np.frombuffer(cells.lines, np.int64)[row]
    table = Table(cells.file, heading.line or None, ours, lines)
    for column in given if not heading.remark else ():
        other = ours[column.theirs]  # The last one of this name.
        same = column is other or column.texts() == other.texts()
        if not same or column.header != other.header:
            both = f"two columns are '{other.theirs}': '{column.header}'"
            raise table.error(f"{both}, '{other.header}'", other.theirs)
    table = replace(table, columns=heading.read(ours)).called(columns)
    layout = heading.remark
    if not layout and (read := reading(table.columns, Path(cells.file))):
        # The setup names columns as the file does, or as they are called then.
        table = replace(table, columns=read.columns).called(table.missing)
        layout = read.remark
    remarks = cells.remarks + (f"read as {layout}",) * bool(layout)
    return _measured_rows(replace(table, remarks=remarks))


def _measured_rows(table: Table) -> Table:
    """The rows that are measurements as the file itself says, a remark on others."""
    remarks = [*table.remarks]
    if (first := first_statistic(table.columns, table.lines)) is not None:
        line = table.lines[first]
        remarks.append(f"statistics are left out, from line {line} on")
        table = table.rows(slice(first))
    if (flag := out_of_sight(table.columns)) is not None:
        name, seen = flag
        lost = len(table.lines) - len(seen)
        remarks.append(f"{lost} rows are left out as lost ('{name}')")
        others = {n: c for n, c in table.columns.items() if n != name}
        table = replace(table, columns=others).rows(seen)
    if lists := [name for name, column in table.columns.items() if _is_list(column)]:
        remedy = "write a column for each number"
        remarks.append(f"lists in {enumerated(lists)} are not read: {remedy}")
    return replace(table, remarks=tuple(remarks))


def _is_list(column: Column) -> bool:
    """Whether the cells of a column are lists, such as `[0.1, 0.2]`."""
    words = [word.strip() for word in column.words if word.strip()]
    return bool(words) and all(map(LIST.fullmatch, words))


def with_readings(
    table: Table, missing: Mapping[str, Booleans], what: str, notice: Notice
) -> Table:
    """The rows that have all their readings, and a word on those that have not.

    Args:
        table: The file.
        missing: Columns, and whether each row lacks a number of it, shape (N,).
        what: The name of its rows.
        notice: Called with a sentence that counts those without.

    Raises:
        InputError: If there are none.
    """
    lost = np.any([np.zeros(len(table.lines), bool), *missing.values()], axis=0)
    if not lost.any():
        return table
    first = int(np.argmax(lost))
    name = next(name for name in missing if missing[name][first])
    if lost.all():
        raise table.error(NO_READING, name, row=first)
    cell = table.columns[name].text(first)
    shown = f": '{cell}' in '{name}'" * bool(cell)
    count = f"{np.count_nonzero(lost)} of {len(lost)} {what}"
    place = f"the first in line {table.lines[first]}{shown}"
    notice(f"{table.file}: {count} have no reading ({place})")
    return table.rows(np.flatnonzero(~lost))


def require_columns(tables: Sequence[Table]) -> None:
    """Refuse files of which none has a column that the setup names.

    Raises:
        InputError: If so.
    """
    first, *others = tables
    for ours, theirs in first.missing.items():
        if all(ours in other.missing for other in others):
            hint = closest(theirs, first.columns.keys())
            raise first.error(f"there is no column '{theirs}' for '{ours}'{hint}")


class Growing:
    """A column while its file is read.

    It grows where it is, which takes half the memory of joining parts.

    Attributes:
        named: Whether it holds names, and keeps the texts of numbers, as 01 and 1.10.
    """

    def __init__(self, *, named: bool) -> None:
        """A column without rows."""
        self.named, self.numbers, self.codes = named, array("d"), array("i")
        self.words = defaultdict[str, int](count().__next__)

    def add(self, cells: Sequence[str] | Floats) -> None:
        """Add rows by their untrimmed texts, or by their numbers alone."""
        codes = np.full(len(cells), -1, np.intc)
        if isinstance(cells, np.ndarray):
            numbers = cells
        else:
            numbers = read_numbers(cells)
            kept = ~np.isfinite(numbers) | self.named
            codes[kept] = [self.words[cell] for cell in compress(cells, kept)]
        self.numbers.frombytes(numbers.tobytes())
        self.codes.frombytes(codes.tobytes())

    def column(self, header: str) -> Column:
        """The column under its header."""
        (name, unit), words = split_header(header), tuple(self.words)
        numbers = np.frombuffer(self.numbers)
        numbers.setflags(write=False)
        codes = np.array(self.codes if words else (), np.int64)
        return Column(header, unit, numbers, words, codes, name)


@dataclass
class Cells:
    """The cells of a file by columns, while it is read.

    Attributes:
        file: Path as the caller gave it.
        heading: The header: trimmed names, line (0: none), separator (a space stands
            for any blanks), and what was recognized, if it is that of a dialect.
        remarks: Sentences about how the file had to be read.
        lines: Line of each row, or its number.
        names: Columns of names; None for all.
    """

    file: str
    heading: Heading
    names: Collection[str] | None
    remarks: tuple[str, ...] = ()
    lines: array[int] = field(default_factory=lambda: array("q"))

    def __post_init__(self) -> None:
        """Columns without rows."""
        known = [split_header(header)[0] for header in self.heading.names]
        names = known if self.names is None else self.names
        self.grown = [Growing(named=name in names) for name in known]
        self.comma = 0  # The first line with a decimal comma.
        self.head = set[str]()  # The header and the lines above it, with their ends.

    def columns(self) -> list[Column]:
        """The columns, whose names are those of the file."""
        headers = (h or f"column {k}" for k, h in enumerate(self.heading.names, 1))
        return [column.column(h) for column, h in zip(self.grown, headers, strict=True)]

    def extend(self, lines: Sequence[str], first: int) -> None:
        """Add the rows among some lines.

        Args:
            lines: The lines.
            first: Number of the first one.

        Raises:
            InputError: If a row has more or fewer cells than the header, or its quotes
                are not as CSV has them; names the line.
        """
        above = lines[: max(self.heading.line + 1 - first, 0)]
        bare = {line.lstrip("\ufeff") for line in above}
        self.head |= bare | {f"\ufeff{line}" for line in bare}
        numbers = [
            number
            for number, line in enumerate(lines, first)
            if line[0] not in OTHER or not (line.isspace() or _is_comment(line))
            if line not in self.head  # Of files behind each other.
        ]
        lines = [lines[number - first] for number in numbers]
        self.lines.extend(numbers)
        comma = self.heading.separator == ","
        fast = comma and not any(column.named for column in self.grown)
        read = read_lines(lines, len(self.grown)) if fast else None
        if read is not None:
            for column, values in zip(self.grown, read, strict=True):
                column.add(values)
            return
        rows = self._rows(numbers, lines)
        if not self.comma and (not comma or any('"' in line for line in lines)):
            self.comma = self._first_comma(numbers, rows)
        for k, cells in enumerate(zip(*rows, strict=True)):
            name = self.heading.names[k]
            self.grown[k].add(self._with_points(name, cells) if self.comma else cells)

    def _first_comma(self, numbers: Sequence[int], rows: Sequence[list[str]]) -> int:
        """The first line with a decimal comma; 0 for none.

        Between commas it is in quotes, as names and thousands may be that are none.
        """
        marked = [[c for c in row if "," in c and COMMA.fullmatch(c)] for row in rows]
        if self.heading.separator == ",":
            cells, commas = {*chain(*rows)}, {*chain(*marked)}
            points = any("." in c and as_number(c.strip()) is not None for c in cells)
            if points or all(THOUSANDS.fullmatch(c.strip()) for c in commas):
                return 0
        return next(compress(numbers, marked), 0)

    def _with_points(self, name: str, written: Sequence[str]) -> list[str]:
        """The last cells of a column with decimal points in the place of commas."""
        cells = {*written}
        commas = {cell for cell in cells if COMMA.fullmatch(cell)}
        points = {c for c in cells if "." in c and as_number(c.strip()) is not None}
        thousands = all(THOUSANDS.fullmatch(cell.strip()) for cell in points)
        # Beside decimal commas, in this column or others, these are no fractions.
        if points and (commas or thousands):
            row = next(k for k, cell in enumerate(written) if cell in points)
            reason = f"a decimal point, where others are a comma (line {self.comma})"
            line, cell = self.lines[row - len(written)], written[row].strip()
            raise InputError(reason, file=self.file, line=line, column=name, value=cell)
        return [c.replace(",", ".") if c in commas else c for c in written]

    def _rows(self, numbers: Sequence[int], lines: Sequence[str]) -> list[list[str]]:
        """Cells of some lines, as many of each as the header has."""
        rows, width = list[list[str]](), len(self.grown)
        mark = self.heading.separator
        if mark == " ":
            mark, lines = "\t", ["\t".join(line.split()) for line in lines]
        reader = csv.reader(lines, delimiter=mark, strict=True, skipinitialspace=True)
        try:
            for row in reader:
                if reader.line_num > len(rows) + 1:
                    raise csv.Error("a quote is not closed")
                # Blank cells behind the last column are none.
                if len(row) < width or any(map(str.strip, row[width:])):
                    commas = mark == "," and len(row) > width
                    hint = " (are there decimal commas?)" * commas
                    raise csv.Error(f"{len(row)} cells for {width} columns{hint}")
                rows.append(row[:width])
        except csv.Error as error:
            reason, line = f"the line is no row: {error}", numbers[len(rows)]
            raise InputError(reason, file=self.file, line=line) from None
        return rows


def read_cells(
    source: str | Path | bytes,
    file: str = "",
    progress: Progress | None = None,
    *,
    names: Collection[str] | None = NAMES,
) -> Cells:
    """Read a file of cells: Parquet by its first bytes, or else text.

    Text is UTF-8, UTF-16 with a byte order mark, or else Latin-1. Comments and blank
    lines are skipped. The header is the first line with as many cells as the rows below
    have; it may stand behind the sign of a comment.

    Args:
        source: The file, or its bytes.
        file: Its path, for messages, where there are bytes.
        progress: Told the part of the file that is read, 0 to 1.
        names: Columns whose cells are names, also where they look like numbers; None
            for all.

    Raises:
        InputError: If there is no such file, it is of another kind, has no header, or
            rows of another length.
        OptionError: If it is a Parquet file, and the extra that reads it is missing.
    """
    if isinstance(source, bytes):
        start = source[:START]
    else:
        file, start = str(source), read_bytes(source, first=START)
        if start.startswith(PARQUET):
            return _read_parquet(file)
    kinds = (k for sign, k in OTHERS.items() if re.match(sign, start, re.DOTALL))
    document = file.lower().endswith(DOCUMENTS)
    if kind := next(kinds, "YAML: write its rows as CSV" * document):
        raise InputError(f"is {kind}", file=file)
    wide = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "latin-1"):
        remarks = ("not UTF-8, read as Latin-1",) * (encoding == "latin-1")
        with (
            suppress(UnicodeError),
            _opened(source) as raw,
            io.TextIOWrapper(raw, encoding) as stream,
        ):
            head = _heading([*islice(stream, HEAD)], file)
            cells = Cells(file, head, names, remarks)
            size, first = raw.seek(0, io.SEEK_END), 1
            stream.seek(0)
            while lines := stream.readlines(LINES):
                cells.extend(lines, first)
                first += len(lines)
                if progress is not None:
                    progress(raw.tell() / size)
            return cells
    raise InputError("not UTF-16 text, as its byte order mark says", file=file)


def _opened(source: str | Path | bytes) -> BinaryIO:
    return io.BytesIO(source) if isinstance(source, bytes) else Path(source).open("rb")


def _read_parquet(file: str) -> Cells:
    """The cells of a Parquet file; its rows are counted from 1.

    Raises:
        InputError: If it cannot be read.
        OptionError: If the extra is missing.
    """
    require_package("pyarrow", "Parquet files need pyarrow", "parquet", file)
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(file) as opened:
            names = opened.schema_arrow.names
            lines = array("q", range(1, opened.metadata.num_rows + 1))
            heading = Heading(",", [name.strip() for name in names], 0, "")
            result = Cells(file, heading, None, lines=lines)
            # One after the other, for memory.
            for name, column in zip(names, result.grown, strict=True):
                cells = opened.read([name], use_threads=False).column(0)
                if pa.types.is_floating(cells.type) or pa.types.is_integer(cells.type):
                    column.add(cells.cast(pa.float64(), safe=False).to_numpy())
                else:
                    column.add(["" if c is None else str(c) for c in cells.to_pylist()])
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"cannot be read as Parquet: {what}", file=file) from None
    return result


def _heading(first: Sequence[str], file: str) -> Heading:
    """The header that the first lines of a file show."""
    if "\0" in "".join(first):
        raise InputError("not a text file (it contains NUL bytes)", file=file)
    lines = [
        (number, line)
        for number, line in _numbered("".join(first))
        # Excel writes the separator in a line of its own, and blank lines as others.
        if line.strip(" ,;\t\r\n") and not re.fullmatch(r'"?sep=."?', line.strip())
    ]
    if foreign := heading(lines):
        return foreign
    plain = [one for one in lines if not _is_comment(one[1])]
    if not plain:
        raise InputError("the file is empty, it needs a header and rows", file=file)
    mark = _separator([line for _, line in plain])
    # Behind the sign of a comment it may stand, too: the nearest to the rows.
    bare = [(n, line.lstrip(" \t#%/")) for n, line in lines if _is_comment(line)]
    cut = [(n, cells_of(line, mark)) for n, line in plain + bare[::-1]]
    rows = [one for one in cut[: len(plain)] if _is_row(one[1], mark)]
    if not rows:
        return Heading(mark, cut[0][1], cut[0][0], "")
    ((width, _),) = Counter(len(cells) for _, cells in rows).most_common(1)
    whole = [(number, cells) for number, cells in rows if len(cells) == width]
    # Sheets fill up the lines of a title with blank cells.
    top = next((n for n, cells in whole if 2 * cells.count("") < width), whole[0][0])
    lead = [(0, [""] * width), *(one for one in cut if len(one[1]) == width)]
    candidates = (
        (number, names)
        for (_, groups), (number, cells) in pairwise(lead)
        if number < top and not (_is_row(cells, mark) or _units(cells))
        if _is_header(names := _grouped(groups, cells))
    )
    above = [one for one in cut[: len(plain)] if one[0] < top]
    longest = max(above, key=lambda one: len(one[1]), default=(0, []))
    number, names = next(candidates, longest)
    if 2 * len(names) >= width:
        below = next((one for one in above if one[0] > number), (number, []))
        if units := _units(below[1]):
            number, names = below[0], [*map(_with_unit, names, units)]
        return Heading(mark, names, number, "")
    reason = "the first row holds numbers, and there is no header"
    allowed = f"{width} names above it, such as {mark.join(_names(width))}"
    raise InputError(reason, file=file, line=top, allowed=allowed)


def _numbered(text: str) -> Iterator[tuple[int, str]]:
    """Lines with their numbers; one with line ends in quotes has that of the last."""
    number = 0
    for line in BROKEN.sub(lambda cell: cell[0].replace("\n", "\v"), text).split("\n"):
        number += 1 + line.count("\v")
        yield number, line.replace("\v", " ")


def _is_header(cells: Sequence[str]) -> bool:
    """Whether most cells of a line have a name, and none the name of another."""
    names = [cell for cell in cells if cell]
    return 2 * len(names) > len(cells) and len({*names}) == len(names)


def _grouped(groups: Sequence[str], names: Sequence[str]) -> list[str]:
    """Names that stand several times, behind that of the group above them.

    A sheet states a group above the first of its columns.
    """
    above = [""]
    for group in groups:
        above.append(group or above[-1])
    return [
        f"{group} {name}".strip() if name and names.count(name) > 1 else name
        for group, name in zip(above[1:], names, strict=True)
    ]


def _units(cells: Sequence[str]) -> list[str]:
    """The units in a line of units, as some write below the header; empty for others.

    Most are ours. A sign says that there is none.
    """
    units = [cell.strip(" []()-") for cell in cells]
    known = [unit for unit in units if unit_called(unit) or unit.lower() == GRAD]
    others = [unit for unit in units if unit and unit not in known]
    return units if len(known) > len(others) else []


def _with_unit(name: str, unit: str) -> str:
    complete = not unit or split_header(name)[1]
    return name if complete else f"{name} [{unit_called(unit) or unit}]"


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def _separator(lines: Sequence[str]) -> str:
    """The separator that cuts the most lines, and half of them, into as many cells."""

    def score(mark: str) -> int:
        counts = Counter(len(cells_of(line, mark)) for line in lines)
        ((width, often),) = counts.most_common(1)
        # A single column may have a space in its name, but not in its numbers.
        rows = mark != " " or len(cells_of(lines[-1], mark)) == width
        cuts = width > 1 and 2 * often >= len(lines) and rows
        return often if cuts else (mark == ",") - 1

    return max(SEPARATORS, key=score)


def _is_row(cells: Sequence[str], separator: str) -> bool:
    """Whether a line is one of numbers; columns may be called 1, 2, 3 but not 0.25."""
    mark = r"\." if separator == "," else "[.,]"
    number = re.compile(rf"[-+{MINUS}]?\d*{mark}\d+([eE][+-]?\d+)?", re.ASCII)
    return any(number.fullmatch(cell.strip()) for cell in cells)


def _names(width: int) -> list[str]:
    """Names for a header: of an arm with six or seven joints, where they can be."""
    values = ["x", "y", "z", "rx", "ry", "rz"][: 3 if width < 12 else 6]
    if width - len(values) in (6, 7):
        return [f"j{k}" for k in range(1, width - len(values) + 1)] + values
    return [f"column_{k}" for k in range(1, width + 1)]


def read_numbers(cells: Sequence[str]) -> Floats:
    """The numbers in some cells, to the last bit as Python's `float` has them.

    Args:
        cells: Untrimmed text, N strings.

    Returns:
        The numbers, shape (N,); infinite or not-a-number where a cell says so or holds
        none.
    """
    if (numbers := _decimals(cells, len(cells))) is not None:
        return numbers
    known = {cell: as_number(cell.strip()) for cell in set(cells)}
    return np.array([known[cell] for cell in cells], np.float64)


def read_lines(lines: Sequence[str], width: int) -> Floats | None:
    """The numbers in lines of cells between commas, as `read_numbers` has them.

    Args:
        lines: Lines, N strings.
        width: Cells in each.

    Returns:
        The numbers by column, shape (width, N); None unless all cells are decimal
        fractions, which are read three times as fast at once.
    """
    numbers = _decimals(lines, len(lines) * width)
    if numbers is None or {line.count(",") for line in lines} != {width - 1}:
        return None
    return numbers.reshape(-1, width).T


def _decimals(cells: Sequence[str], count: int) -> Floats | None:
    """The numbers of so many cells, shape (count,), where all are decimal fractions."""
    # Importing it takes time, and most of the commands have done so before.
    from pydantic_core import from_json

    # A JSON reader is four times faster than `float` with all digits of a number, and
    # rounds to the nearest number as well. What it reads as anything but a decimal
    # fraction is not left to it (JSON's integers have no -0).
    with suppress(ValueError):
        numbers = from_json(f"[{','.join(cells)}]", allow_inf_nan=False)
        if len(numbers) == count and set(map(type, numbers)) == {float}:
            return np.fromiter(numbers, np.float64, count)
    return None
