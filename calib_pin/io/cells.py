"""Files of cells, text or Parquet: what they are, their header, and cells by column."""

from __future__ import annotations

import codecs
import csv
import io
import re
from array import array
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

from calib_pin.errors import InputError, OptionError
from calib_pin.io.columns import GrowingColumn, read_lines
from calib_pin.io.dialects import Heading, heading
from calib_pin.io.dialects.base import Lines, cells_of
from calib_pin.io.files import read_blocks
from calib_pin.progress import Progress

LINES = 1 << 18
"""Letters of the lines that are cut into cells at a time."""

HEAD = 200
"""Lines among which the header stands."""

COMMENTS = ("#", "%", "//")
"""Signs with which comments begin; a header may stand behind one, above the rows."""

OTHER = frozenset(" \t\r\n\v\f#%/")
"""First letters of all lines that are blank or comments."""

SEPARATORS = "\t;,"
"""In this order: where others separate, a comma is a decimal mark."""

START = 1 << 12
"""Bytes that tell what a file is."""

PARQUET = b"PAR1"
"""First bytes of a Parquet file."""

BINARY: Sequence[tuple[bytes, bytes, str]] = (
    (b"PK", b"[Content_Types].xml", "an Excel workbook: save the sheet as CSV"),
    (b"PK", b"opendocument", "an OpenDocument spreadsheet: save the sheet as CSV"),
    (b"PK", b".npy", "NumPy arrays: write them with numpy.savetxt, and a header"),
    (b"PK\x03\x04", b"", "an archive (zip): unpack it"),
    (b"\xd0\xcf\x11\xe0", b"", "an Excel workbook (xls): save the sheet as CSV"),
    (b"MATLAB 5.0", b"", "a MATLAB file: write it with writetable"),
    (b"\x89HDF", b"", "an HDF5 file (or MATLAB 7.3): write it as CSV"),
    (b"\x93NUMPY", b"", "a NumPy array: write it with numpy.savetxt, and a header"),
    (b"\x1f\x8b", b"", "compressed (gzip): unpack it"),
    (b"SQLite format 3", b"", "an SQLite database or a bag of ROS 2: see 'join'"),
    (b"\x89MCAP", b"", "a bag of ROS 2 (mcap): see 'join'"),
)
"""First bytes of files that hold no lines, others in them, and what they are."""


@dataclass(frozen=True)
class Cells:
    """The cells of a file with one row per line, by columns.

    Attributes:
        file: Path as the caller gave it.
        header: Trimmed cells of the header.
        header_line: Its line, counted from 1; 0 where there is none.
        separator: Separator of two cells; a space stands for any blanks.
        remarks: Sentences about how the file had to be read.
        foreign: The header of a foreign layout, where it is no line of names.
        lines: Line of each row, or its number.
        columns: The columns.
    """

    file: str
    header: tuple[str, ...]
    header_line: int = 0
    separator: str = ","
    remarks: tuple[str, ...] = ()
    foreign: Heading | None = None
    lines: array[int] = field(default_factory=lambda: array("q"))
    columns: list[GrowingColumn] = field(default_factory=list)

    def extend(self, lines: Sequence[str], first: int) -> None:
        """Add the rows among some lines.

        Args:
            lines: The lines.
            first: Number of the first one.

        Raises:
            InputError: If a row has more or fewer cells than the header, or its quotes
                are not as CSV has them; names the line.
        """
        numbers = [
            number
            for number, line in enumerate(lines, first)
            if line[0] not in OTHER or not (line.isspace() or _is_comment(line))
            if number > self.header_line
        ]
        if len(numbers) < len(lines):
            lines = [lines[number - first] for number in numbers]
        commas, later = self.separator != ",", bool(self.lines)
        self.lines.extend(numbers)
        # The texts of numbers are for messages and names, and so for small files.
        if later and not commas:
            read = read_lines(lines, len(self.columns))
            if read is not None:
                for column, values in zip(self.columns, read, strict=True):
                    column.add(values)
                return
        rows = self._cut(numbers, lines)
        for column, cells in zip(self.columns, zip(*rows, strict=True), strict=False):
            column.extend(cells, commas=commas)

    def _cut(self, numbers: Sequence[int], lines: Sequence[str]) -> list[list[str]]:
        """Cells of some lines; those without quotes are cut much faster."""
        if any('"' in line for line in lines):
            rows = list(map(self._quoted, numbers, lines))
        else:
            mark = None if self.separator == " " else self.separator
            rows = [line.rstrip("\n").split(mark) for line in lines]
        if {*map(len, rows)} != {len(self.header)}:
            rows = list(map(self._whole, numbers, rows))
        return rows

    def _quoted(self, number: int, line: str) -> list[str]:
        mark = self.separator
        try:
            reader = csv.reader(
                [line], delimiter=mark, strict=True, skipinitialspace=True
            )
            return next(reader)
        except csv.Error as error:
            reason = f"the quotes are not as CSV has them: {error}"
            raise InputError(reason, file=self.file, line=number) from None

    def _whole(self, number: int, row: list[str]) -> list[str]:
        """A row as long as the header; blank cells behind that are none."""
        count, width = len(row), len(self.header)
        if count >= width and not any(map(str.strip, row[width:])):
            return row[:width]
        reason = f"the row has {count} cells, the header {width} columns"
        if count > 1.5 * width and self.separator == ",":
            reason += " (between commas the decimal mark must be a point)"
        raise InputError(
            reason,
            file=self.file,
            line=number,
            # The first column without a cell, or the first cell without a column.
            column=self.header[count] if count < width else None,
            value=row[width].strip() if count > width else None,
        )


def read_cells(
    source: str | Path | bytes, file: str = "", progress: Progress | None = None
) -> Cells:
    """Read a file of cells: Parquet by its first bytes, or else text.

    Text is UTF-8, UTF-16 with a byte order mark, or else Latin-1. Comments and blank
    lines are skipped. The header is the first line with as many cells as the rows below
    have; it may stand behind the sign of a comment.

    Args:
        source: The file, or its bytes.
        file: Its path, for messages, where there are bytes.
        progress: Told the part of the file that is read, 0 to 1.

    Raises:
        InputError: If there is no such file, it is of another kind, has no header, or
            rows of another length.
        OptionError: If it is a Parquet file, and the extra that reads it is missing.
    """
    if isinstance(source, bytes):
        start = source[:START]
    else:
        file, start = str(source), next(read_blocks(source, START), b"")
        if start.startswith(PARQUET):
            return _read_parquet(source)
    kinds = (k for a, b, k in BINARY if start.startswith(a) and b in start)
    json = re.match(rb"\s*(\{|\[\s*[\[{\"\d-])", start)
    if kind := "JSON: write it as CSV" if json else next(kinds, ""):
        raise InputError(f"is {kind}", file=file)
    wide = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "latin-1"):
        with suppress(UnicodeError):
            return _read(source, encoding, file, progress)
    raise InputError("not UTF-16 text, as its byte order mark says", file=file)


def _opened(source: str | Path | bytes) -> BinaryIO:
    return io.BytesIO(source) if isinstance(source, bytes) else Path(source).open("rb")


def _read(
    source: str | Path | bytes, encoding: str, file: str, progress: Progress | None
) -> Cells:
    with _opened(source) as raw, io.TextIOWrapper(raw, encoding) as stream:
        found = _laid_out([*islice(stream, HEAD)], encoding, file)
        size, count = raw.seek(0, io.SEEK_END), 0
        stream.seek(0)
        while lines := stream.readlines(LINES):
            found.extend(lines, count + 1)
            count += len(lines)
            if progress is not None:
                progress(raw.tell() / size)
    return found


def _laid_out(first: Sequence[str], encoding: str, file: str) -> Cells:
    """Columns without rows, below the header that the first lines of a file show."""
    if "\0" in "".join(first):
        raise InputError("not a text file (it contains NUL bytes)", file=file)
    lines = [
        (number, line.strip("\n"))
        for number, line in enumerate(first, 1)
        # Excel writes the separator in a line of its own.
        if line.strip() and not re.fullmatch(r'"?sep=."?', line.strip())
    ]
    # It also writes blank lines as separators.
    found = heading([one for one in lines if one[1].strip(" ,;\t")])
    remarks = ["not UTF-8, read as Latin-1"] * (encoding == "latin-1")
    if found is not None:
        names, line, separator = found.names, found.line, found.separator
        remarks.append(f"read as {found.remark}")
    else:
        plain = [one for one in lines if not _is_comment(one[1])]
        if not plain:
            reason = "the file is empty, it needs a header and rows"
            raise InputError(reason, file=file)
        separator = _separator([text for _, text in plain])
        line, names = _header(lines, plain, separator, file)
    columns, told = [GrowingColumn() for _ in names], tuple(remarks)
    return Cells(file, tuple(names), line, separator, told, found, columns=columns)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def _separator(lines: Sequence[str]) -> str:
    """The separator that stands as often in most lines."""
    for mark in SEPARATORS:
        counts = Counter(line.count(mark) for line in lines)
        ((count, most),) = counts.most_common(1)
        if count and 2 * most >= len(lines):
            return mark
    found = max(SEPARATORS, key=lines[0].count)
    names = cells_of(lines[0], " ")
    # A single column may have a space in its name, but not in its numbers.
    alone = found not in lines[0] and len(names) > 1
    return " " if alone and len(lines[-1].split()) == len(names) else found


def _header(
    lines: Lines, plain: Lines, separator: str, file: str
) -> tuple[int, list[str]]:
    """Line and cells of the header.

    Args:
        lines: The first lines with their numbers.
        plain: Those that are no comments.
        separator: Separator of two cells.
        file: The file, for messages.
    """
    cut = [(number, cells_of(line, separator)) for number, line in plain]
    rows = [one for one in cut if _is_row(one[1], separator)]
    if not rows:
        return cut[0]
    ((width, _),) = Counter(len(cells) for _, cells in rows).most_common(1)
    first = next(number for number, cells in rows if len(cells) == width)
    above = [one for one in cut if one[0] < first]
    bare = [(n, cells_of(line.lstrip(" \t#%/"), separator)) for n, line in lines]
    for number, cells in above + [one for one in bare if one[0] < first]:
        if len(cells) == width and not _is_row(cells, separator):
            return number, cells
    longest = max(above, key=lambda one: len(one[1]), default=(0, []))
    if 2 * len(longest[1]) >= width:
        return longest
    raise InputError(
        "the first row holds numbers, a header with the names of the columns is "
        "missing",
        file=file,
        line=first,
        allowed=f"{width} names above it, such as {separator.join(_names(width))}",
    )


def _is_row(cells: Sequence[str], separator: str) -> bool:
    """Whether a line is one of numbers; columns may be called 1, 2, 3 but not 0.25."""
    mark = r"\." if separator == "," else "[.,]"
    number = re.compile(rf"[+-]?\d*{mark}\d+([eE][+-]?\d+)?", re.ASCII)
    return any(number.fullmatch(cell.strip()) for cell in cells)


def _names(count: int) -> list[str]:
    """Names for a header: of an arm with six or seven joints, where they can be."""
    for joints in (6, 7):
        if count - joints in (3, 6):
            values = ["x", "y", "z", "rx", "ry", "rz"][: count - joints]
            return [f"j{k}" for k in range(1, joints + 1)] + values
    return [f"column_{k}" for k in range(1, count + 1)]


def _read_parquet(path: str | Path) -> Cells:
    """The cells of a Parquet file; its rows are counted from 1.

    Raises:
        InputError: If it cannot be read.
        OptionError: If the extra is missing.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise OptionError(
            "Parquet files need pyarrow, which is missing: pip install "
            "'calib-pin[parquet]'",
            file=path,
        ) from None
    try:
        with parquet.ParquetFile(path) as found:
            table = found.read(use_threads=False)
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"cannot be read as Parquet: {what}", file=path) from None
    header = tuple(name.strip() for name in table.column_names)
    return Cells(
        str(path),
        header,
        lines=array("q", range(1, table.num_rows + 1)),
        columns=[*map(_column, table.columns)],
    )


def _column(cells: Any) -> GrowingColumn:
    """A column of pyarrow; a cell that is null or nan is blank."""
    import pyarrow as pa

    column = GrowingColumn()
    if pa.types.is_floating(cells.type) or pa.types.is_integer(cells.type):
        column.add(cells.cast(pa.float64(), safe=False).to_numpy())
        return column
    texts = ["" if cell is None else str(cell) for cell in cells.to_pylist()]
    column.extend(texts)
    return column
