"""CSV files with named columns and units: the table under every measurement file.

Cells stay text until a column is asked for, so columns that mean nothing may hold
anything, and a bad number is blamed on its own line.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, nearest
from calib_pin.io.files import read_bytes
from calib_pin.progress import Progress

__all__ = [
    "ANGLE",
    "LENGTH",
    "LINES",
    "PIXEL",
    "PURE",
    "Column",
    "Kind",
    "Table",
    "closest",
    "read_table",
    "split_header",
]

Floats = NDArray[np.float64]

LINES = 5000
"""Lines that are read between two reports of the progress."""


@dataclass(frozen=True)
class Kind:
    """A physical kind of number and the units it may be written in.

    Attributes:
        si: Unit inside calib-pin and where a header states none; empty if pure.
        units: Factor to `si` of each unit.
        smaller: The unit that is likely meant when a value is far too large in another.
        largest: Largest absolute value that can be meant, in `si`.
    """

    si: str
    units: Mapping[str, float]
    smaller: Mapping[str, str]
    largest: float


LENGTH = Kind(
    "m",
    {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    {"m": "mm", "in": "mm", "mm": "um"},
    # No instrument here measures farther.
    100.0,
)
ANGLE = Kind(
    "rad",
    {"rad": 1.0, "deg": np.pi / 180.0, "mrad": 1e-3},
    {"rad": "deg", "deg": "mrad"},
    # Two turns either way, as far as joint counters commonly go.
    4.0 * np.pi,
)
PIXEL = Kind("px", {"px": 1.0}, {}, 1e5)
PURE = Kind("", {}, {}, np.inf)


@dataclass(frozen=True)
class Column:
    """One column as it was written.

    Attributes:
        header: Header cell, with its unit.
        unit: Unit in square brackets, or None.
        cells: Text of each row, untrimmed.
    """

    header: str
    unit: str | None
    cells: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A CSV file by columns.

    Attributes:
        file: Path as the caller gave it.
        header_line: Line of the header, counted from 1.
        columns: The named columns in the order of the file.
        unnamed: Number of columns with an empty header.
        lines: Line of each row, shape (N,).
    """

    file: str
    header_line: int
    columns: Mapping[str, Column]
    unnamed: int
    lines: NDArray[np.int64]

    def __contains__(self, name: object) -> bool:
        """Whether there is a column of exactly this name."""
        return name in self.columns

    def rows(self, index: NDArray[np.int64], names: Collection[str]) -> Table:
        """Some of the rows and columns.

        Args:
            index: The rows, in this order.
            names: The columns; those that do not exist are left out.
        """
        order = index.tolist()
        columns = {
            name: replace(column, cells=tuple(map(column.cells.__getitem__, order)))
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
            value=self.columns[name].cells[row].strip(),
            allowed=allowed,
        )

    def numbers(self, name: str, kind: Kind, *, positive: bool = False) -> Floats:
        """A column of numbers in SI units, shape (N,).

        Args:
            name: Name of the column, which must exist.
            kind: What it holds; decides about the units.
            positive: Whether every number must be greater than zero.

        Raises:
            InputError: If the unit does not fit, or a cell is not a finite number.
        """
        cells = self.columns[name].cells
        factor = self._factor(name, kind)
        values = _numbers(cells)
        bad = ~np.isfinite(values)
        if positive:
            bad |= ~(values > 0.0)
        if bad.any():
            row = int(np.argmax(bad))
            raise self.cell_error(
                _what_is_wrong(cells[row].strip(), float(values[row])),
                name,
                row,
                "a positive number" if positive else "a finite number",
            )
        return values if factor == 1.0 else values * factor

    def texts(self, name: str) -> tuple[str, ...]:
        """A column of trimmed text, N strings.

        Raises:
            InputError: If the header states a unit.
        """
        if self.columns[name].unit is not None:
            raise self.error(f"'{name}' is text and takes no unit", name)
        return tuple(cell.strip() for cell in self.columns[name].cells)

    def implausible(
        self, name: str, row: int, value: float, kind: Kind, why: str = ""
    ) -> InputError:
        """An error about a value so large that its unit must be another one.

        Args:
            name: Name of the column.
            row: Row of the value.
            value: The value in SI units.
            kind: What the column holds.
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
            values: What it holds in SI units, shape (N,).
            kind: What the column holds.
            largest: Largest absolute value that is plausible.
            why: What else the reader should know, for the message.

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


def closest(name: str, candidates: Collection[str]) -> str:
    """Hint at the one column that may have been meant by a missing name.

    A column that continues the name with something other than a letter or digit
    (`x (mm)`, `elbow_joint_deg`) is near, whatever its length. With several near
    columns a guess would mislead.

    Args:
        name: The missing name.
        candidates: Columns without another meaning.

    Returns:
        A hint with a leading space, or an empty string.
    """
    near = [
        other
        for other in candidates
        if other.lower().startswith(name.lower())
        and not other[len(name) : len(name) + 1].isalnum()
    ]
    near = near or [other for other in candidates if nearest(name, [other])]
    return f" (did you mean '{near[0]}'?)" if len(near) == 1 else ""


def split_header(cell: str) -> tuple[str, str | None]:
    """Split a header cell into name and unit; None where no unit is stated."""
    match = re.fullmatch(r"(.*?)\s*\[\s*([^\[\]]*?)\s*\]", cell.strip())
    return (match[1], match[2]) if match else (cell.strip(), None)


def read_table(path: str | Path, progress: Progress | None = None) -> Table:
    """Read a CSV file with a header; comments and blank lines are skipped.

    Args:
        path: UTF-8 file, with or without byte order mark, any line ends.
        progress: Told the part of the lines that is read, 0 to 1.

    Raises:
        InputError: If the file is not comma-separated text with a header and rows of
            the same length, or a column name occurs twice.
    """
    file = str(path)
    text = _decode(read_bytes(Path(path)), file)
    numbered = [
        (number, line)
        for number, line in enumerate(text.split("\n"), start=1)
        if (words := line.lstrip()) and not words.startswith("#")
    ]
    if not numbered:
        raise InputError("the file is empty, it needs a header and rows", file=file)
    _check_separator(numbered, file)
    rows: list[list[str]] = []
    for start in range(0, len(numbered), LINES):
        some = numbered[start : start + LINES]
        rows += [_cells(number, line, file) for number, line in some]
        if progress is not None:
            progress(len(rows) / len(numbered))
    header, header_line = rows.pop(0), numbered.pop(0)[0]
    # Columns may be named 1, 2, 3 (and mapped to joints), but not 0.25.
    if np.isfinite(_numbers(header)).all() and any("." in cell for cell in header):
        raise InputError(
            "the first row holds numbers, a header with the names of the columns is "
            "missing",
            file=file,
            line=header_line,
        )
    if not rows:
        raise InputError("the file has a header but no rows", file=file)
    for (number, _), row in zip(numbered, rows, strict=True):
        if len(row) != len(header):
            raise _ragged(file, number, row, header)
    return Table(
        file,
        header_line,
        _named(header, list(zip(*rows, strict=True)), file, header_line),
        sum(not split_header(cell)[0] for cell in header),
        np.array([number for number, _ in numbered], np.int64),
    )


def _decode(data: bytes, file: str) -> str:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            "not UTF-8 text", file=file, line=data[: error.start].count(b"\n") + 1
        ) from None
    if "\0" in text:
        raise InputError("not a text file (it contains NUL bytes)", file=file)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _check_separator(numbered: Sequence[tuple[int, str]], file: str) -> None:
    """Name the separator of a file that is not comma-separated."""
    number, header = numbered[0]
    found = [
        name
        for mark, name in ((";", "semicolons"), ("\t", "tabs"))
        if header.count(mark) > header.count(",")
    ]
    names = re.sub(r"\[[^\]]*\]", "", header).split()
    if not found and "," not in header and len(names) > 1:
        # A single column may have a space in its name, but not in its numbers.
        found = ["spaces"] * (len(numbered[-1][1].split()) == len(names))
    if found:
        raise InputError(
            f"the columns are separated by {found[0]}, the separator must be a comma "
            "(and the decimal mark a point)",
            file=file,
            line=number,
        )


def _cells(number: int, line: str, file: str) -> list[str]:
    # Plain split is several times faster, and right where nothing is quoted. Lines
    # are parsed one by one so that an open quote is blamed where it stands.
    if '"' not in line:
        return line.split(",")
    try:
        return next(csv.reader([line], strict=True, skipinitialspace=True))
    except csv.Error as error:
        raise InputError(
            f"the quotes are not as CSV has them: {error}", file=file, line=number
        ) from None


def _ragged(file: str, number: int, row: list[str], header: list[str]) -> InputError:
    """An error about a row that is too short or too long."""
    short = len(row) < len(header)
    reason = f"the row has {len(row)} cells, the header {len(header)} columns"
    if not short and len(row) > 1.5 * len(header):
        reason += " (the decimal mark must be a point)"
    return InputError(
        reason,
        file=file,
        line=number,
        # The first column without a cell, or the first cell without a column.
        column=header[len(row)].strip() if short else None,
        value=None if short else row[len(header)].strip(),
    )


def _named(
    header: list[str], columns: list[tuple[str, ...]], file: str, line: int
) -> dict[str, Column]:
    result: dict[str, Column] = {}
    for cell, cells in zip(header, columns, strict=True):
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
        result[name] = Column(cell.strip(), unit, cells)
    return result


def _numbers(cells: Sequence[str]) -> Floats:
    """The numbers in a column; not-a-number where there is none."""
    try:
        if not any("_" in cell for cell in cells):
            return np.fromiter(map(float, cells), np.float64)
    except ValueError:
        pass
    return np.array([_number(cell) for cell in cells])


def _number(cell: str) -> float:
    # Python reads 1_000 as a number; in a CSV file it is a slip.
    try:
        return float("nan") if "_" in cell else float(cell)
    except ValueError:
        return float("nan")


def _what_is_wrong(cell: str, value: float) -> str:
    if not cell:
        return "the cell is empty"
    if np.isfinite(value):
        return "not positive"
    if np.isinf(value) or cell.lower().lstrip("+-") == "nan":
        return "not a finite number"
    if re.fullmatch(r"[+-]?\d+,\d+", cell):
        return "not a number (the decimal mark must be a point)"
    return "not a number"
