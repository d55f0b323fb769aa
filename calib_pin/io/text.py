"""Files of cells as text: their encoding, separator and header, and cells by column."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import BinaryIO, TextIO

from calib_pin.errors import InputError
from calib_pin.io.dialects import Heading, heading
from calib_pin.io.dialects.base import cells_of
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

BLOCK = 1 << 20
"""Bytes that are read at a time."""

USUAL: Mapping[int, list[str]] = {
    1: ["distance"],
    3: ["x", "y", "z"],
    6: ["x", "y", "z", "rx", "ry", "rz"],
    7: ["x", "y", "z", "qx", "qy", "qz", "qw"],
}
"""Measured columns, by their number, for a header to paste."""

BINARY: Sequence[tuple[bytes, str]] = (
    (b"\xd0\xcf\x11\xe0", "an Excel workbook (xls): save the sheet as CSV"),
    (b"MATLAB 5.0", "a MATLAB file: write it with writetable"),
    (b"\x89HDF", "an HDF5 file (or MATLAB 7.3): write it as CSV"),
    (b"\x93NUMPY", "a NumPy array: write it with numpy.savetxt, and a header"),
    (b"\x1f\x8b", "compressed (gzip): unpack it"),
    (b"BZh", "compressed (bzip2): unpack it"),
    (b"\xfd7zXZ", "compressed (xz): unpack it"),
    (b"\x28\xb5\x2f\xfd", "compressed (zstd): unpack it"),
    (b"7z\xbc\xaf", "an archive (7z): unpack it"),
    (b"SQLite format 3", "an SQLite database or a bag of ROS 2: see 'join'"),
    (b"\x89MCAP", "a bag of ROS 2 (mcap): see 'join'"),
    (b"#ROSBAG", "a bag of ROS 1: convert it with rosbags-convert"),
    (b"%PDF", "a PDF: export the table as CSV"),
)
"""The first bytes of files that hold no lines, and their kinds."""

ZIPPED: Sequence[tuple[bytes, str]] = (
    (b"xl/", "an Excel workbook: save the sheet as CSV"),
    (b"[Content_Types].xml", "an Excel workbook: save the sheet as CSV"),
    (b"opendocument", "an OpenDocument spreadsheet: save the sheet as CSV"),
    (b".npy", "NumPy arrays (npz): write them with numpy.savetxt, and a header"),
    (b"", "an archive (zip): unpack it"),
)
"""The kind of a ZIP archive, by a name in it."""


@dataclass(frozen=True)
class Text:
    """A file with one row per line, below a header.

    Attributes:
        file: Path as the caller gave it.
        data: Its bytes, in UTF-8; None where the file can be read again.
        separator: Separator of two cells; a space stands for any blanks.
        header: Trimmed cells of the header.
        header_line: Its line, counted from 1; 0 where there is none.
        remarks: Sentences about how the file had to be read.
        foreign: The header of a foreign layout, where it is no line of names.
    """

    file: str
    data: bytes | None
    separator: str
    header: tuple[str, ...]
    header_line: int
    remarks: tuple[str, ...] = ()
    foreign: Heading | None = None

    def rows(self) -> Iterator[tuple[list[int], list[tuple[str, ...]]]]:
        """Lines of some rows and their cells by column, and so on.

        Raises:
            InputError: As `cut`.
        """
        for numbers, lines in self.blocks():
            yield numbers, self.cut(numbers, lines)

    def blocks(
        self, progress: Progress | None = None
    ) -> Iterator[tuple[list[int], list[str]]]:
        """Some lines that are rows, their numbers first, and so on.

        Args:
            progress: Told the part of the file that is read, 0 to 1.
        """
        raw, last = self._open(), 0
        size = raw.seek(0, io.SEEK_END)
        raw.seek(0)
        with io.TextIOWrapper(raw, "utf-8-sig") as stream:
            while lines := self._next(stream):
                numbers = [
                    number
                    for number, line in enumerate(lines, last + 1)
                    if line[0] not in OTHER or not (line.isspace() or _comment(line))
                    if number > self.header_line
                ]
                kept = lines
                if len(numbers) < len(lines):
                    kept = [lines[number - last - 1] for number in numbers]
                last += len(lines)
                if progress is not None:
                    progress(raw.tell() / size)
                if numbers:
                    yield numbers, kept

    def cut(
        self, numbers: Sequence[int], lines: Sequence[str]
    ) -> list[tuple[str, ...]]:
        """Cells of some lines, by column.

        Raises:
            InputError: If a row has more or fewer cells than the header, or its quotes
                are not as CSV has them; names the line.
        """
        if any('"' in line for line in lines):
            rows = self._quoted(numbers, lines)
        else:
            mark = None if self.separator == " " else self.separator
            rows = [line.rstrip("\n").split(mark) for line in lines]
        if {*map(len, rows)} != {len(self.header)}:
            rows = list(map(self._whole, numbers, rows))
        return [*zip(*rows, strict=True)]

    def cells(self, line: int) -> tuple[str, ...]:
        """Cells of the row in a line."""
        for numbers, columns in self.rows():
            if line in numbers:
                row = numbers.index(line)
                return tuple(column[row] for column in columns)
        raise self._changed()

    def _changed(self) -> InputError:
        return InputError("the file has changed while it was read", file=self.file)

    def _open(self) -> BinaryIO:
        if self.data is not None:
            return io.BytesIO(self.data)
        try:
            return Path(self.file).open("rb")
        except OSError:
            raise self._changed() from None

    def _next(self, stream: TextIO) -> list[str]:
        """Some more lines."""
        try:
            return stream.readlines(LINES)
        except UnicodeDecodeError:
            raise self._changed() from None

    def _quoted(self, numbers: Sequence[int], lines: Sequence[str]) -> list[list[str]]:
        """Cells of lines by row; lines without quotes are cut much faster."""
        reader = csv.reader(
            lines, delimiter=self.separator, strict=True, skipinitialspace=True
        )
        rows: list[list[str]] = []
        try:
            rows.extend(reader)
        except csv.Error as error:
            # An open quote is blamed where it stands.
            raise self._quotes(numbers[len(rows)], str(error)) from None
        if len(rows) < len(lines):
            broken = (k for k, row in enumerate(rows) if "\n" in "".join(row))
            raise self._quotes(numbers[next(broken)], "they are not closed")
        return rows

    def _whole(self, line: int, row: list[str]) -> list[str]:
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
            line=line,
            # The first column without a cell, or the first cell without a column.
            column=self.header[count] if count < width else None,
            value=row[width].strip() if count > width else None,
        )

    def _quotes(self, line: int, why: str) -> InputError:
        reason = f"the quotes are not as CSV has them: {why}"
        return InputError(reason, file=self.file, line=line)


def read_text(path: str | Path) -> Text:
    """Read a file of cells: UTF-8, UTF-16 with a byte order mark, or else Latin-1.

    Comments and blank lines are skipped. The header is the first line with as many
    cells as the rows below have; it may stand behind the sign of a comment.

    Raises:
        InputError: If there is no such file, it is of another kind, or has no header.
    """
    file, again, head = str(path), Path(path).is_file(), b""
    decoder = codecs.getincrementaldecoder("utf-8")()
    blocks = read_blocks(path, BLOCK, pipe=not again)
    for block in blocks if again else ():
        head = head or block
        try:
            again = "\0" not in decoder.decode(block, final=len(block) < BLOCK)
        except UnicodeDecodeError:
            again = False
        if not again:
            blocks = read_blocks(path, BLOCK)
            break
    # Plain text is read from the file again where it is needed, and not kept.
    return _laid_out(head, None, file) if again else parsed(b"".join(blocks), file)


def parsed(data: bytes, file: str) -> Text:
    """The same of the content of a file; `file` is its path, for messages."""
    _check_kind(data, file)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        try:
            data = data.decode("utf-16").encode()
        except UnicodeError:
            reason = "not UTF-16 text, as its byte order mark says"
            raise InputError(reason, file=file) from None
    if b"\0" in data:
        raise InputError("not a text file (it contains NUL bytes)", file=file)
    try:
        data.decode()
    except UnicodeDecodeError:
        found = _laid_out(data := data.decode("latin-1").encode(), data, file)
        return replace(found, remarks=(*found.remarks, "not UTF-8, read as Latin-1"))
    return _laid_out(data, data, file)


def _check_kind(head: bytes, file: str) -> None:
    """Refuse files that are known to be something else."""
    if head.startswith(b"PK\x03\x04"):
        kind = next(kind for name, kind in ZIPPED if name in head[:4096])
    else:
        kind = next((kind for mark, kind in BINARY if head.startswith(mark)), "")
    if re.match(rb"\s*(\{|\[\s*[\[{\"\d-])", head[:100]):
        kind = "JSON: write it as CSV"
    if kind:
        raise InputError(f"is {kind}", file=file)


def _laid_out(head: bytes, data: bytes | None, file: str) -> Text:
    """Text with the separator and the header that its first lines show."""
    _check_kind(head, file)
    stream = io.TextIOWrapper(io.BytesIO(head), "utf-8-sig", errors="ignore")
    first = islice(enumerate(stream, 1), HEAD)
    lines = [(n, line.strip("\n")) for n, line in first if line.strip()]
    # Excel writes blank lines as separators.
    if found := heading([one for one in lines if one[1].strip(" ,;\t")]):
        remark = f"read as {found.remark}"
        names = tuple(found.names)
        return Text(file, data, found.separator, names, found.line, (remark,), found)
    separator, remarks = "", tuple[str, ...]()
    # Excel writes it, and takes it for no row either.
    if lines and (stated := re.fullmatch(r'"?sep=(.)"?', lines[0][1].strip())):
        separator, lines = stated[1], lines[1:]
    plain = [(n, line) for n, line in lines if not _comment(line)]
    if not plain:
        reason = "the file is empty, it needs a header and rows"
        raise InputError(reason, file=file)
    separator = separator or _separator(plain)
    line, header = _header(lines, plain, separator, file)
    if above := sum(n < line for n, _ in plain):
        remarks = (f"{above} lines above the header in line {line} are left out",)
    return Text(file, data, separator, tuple(map(str.strip, header)), line, remarks)


def _comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def _separator(plain: Sequence[tuple[int, str]]) -> str:
    """The separator that stands as often in most lines."""
    for mark in SEPARATORS:
        counts = Counter(line.count(mark) for _, line in plain)
        ((count, lines),) = counts.most_common(1)
        if count and 2 * lines >= len(plain):
            return mark
    header = plain[0][1]
    found = max(SEPARATORS, key=header.count)
    names = re.sub(r"\[[^\[\]]*\]", "", header).split()
    # A single column may have a space in its name, but not in its numbers.
    alone = found not in header and len(names) > 1
    return " " if alone and len(plain[-1][1].split()) == len(names) else found


def _header(
    lines: Sequence[tuple[int, str]],
    plain: Sequence[tuple[int, str]],
    separator: str,
    file: str,
) -> tuple[int, list[str]]:
    """Line and cells of the header.

    Args:
        lines: The first lines with their numbers.
        plain: Those that are no comments.
        separator: Separator of two cells.
        file: The file, for messages.
    """
    cut = [(number, cells_of(line, separator)) for number, line in plain]
    rows = [(number, cells) for number, cells in cut if _is_row(cells, separator)]
    if not rows:
        return cut[0]
    ((width, _),) = Counter(len(cells) for _, cells in rows).most_common(1)
    first = next(number for number, cells in rows if len(cells) == width)
    above = [(number, cells) for number, cells in cut if number < first]
    commented = [
        (number, cells_of(line.lstrip(" \t#%/"), separator))
        for number, line in lines
        if number < first
    ]
    for number, cells in [*above, *commented]:
        if len(cells) == width and not _is_row(cells, separator):
            return number, cells
    number, cells = max(above, key=lambda each: len(each[1]), default=(0, []))
    if 2 * len(cells) >= width:
        return number, cells
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
        if (values := count - joints) in USUAL:
            return [f"j{k}" for k in range(1, joints + 1)] + USUAL[values]
    return [f"column_{k}" for k in range(1, count + 1)]
