"""CSV files as text: a stretch of lines at a time, and the cells of their columns."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from calib_pin.errors import InputError
from calib_pin.io.files import read_blocks
from calib_pin.progress import Progress

_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)

BLOCK = 1 << 17
"""Bytes that are read at a time: their cells fit into the cache of a processor (1 MB
takes a third longer), and what a block costs by itself is below a hundredth."""


@dataclass(frozen=True)
class Stretch:
    """Successive lines of a file, without comments and blank lines.

    Attributes:
        file: Path of the file, for messages.
        separator: Separator of two cells.
        numbers: Number of each line, counted from 1.
        lines: Their text.
    """

    file: str
    separator: str
    numbers: Sequence[int]
    lines: Sequence[str]

    def cells(self, row: int) -> list[str]:
        """Untrimmed cells of one line.

        Raises:
            InputError: If the quotes are not as CSV has them.
        """
        # Lines are parsed one by one so that an open quote is blamed where it stands.
        line, mark = self.lines[row], self.separator
        if '"' not in line:
            return line.split(mark)
        try:
            return next(
                csv.reader([line], delimiter=mark, strict=True, skipinitialspace=True)
            )
        except csv.Error as error:
            raise InputError(
                f"the quotes are not as CSV has them: {error}",
                file=self.file,
                line=self.numbers[row],
            ) from None

    def columns(self, header: Sequence[str]) -> list[list[str]]:
        """Untrimmed cells by column.

        Args:
            header: Cells of the header, one for each column.

        Raises:
            InputError: If a line has more or fewer cells than the header, or its quotes
                are not as CSV has them.
        """
        text = self.separator.join(self.lines)
        marks = {line.count(self.separator) for line in self.lines}
        if '"' not in text and marks == {len(header) - 1}:
            cells = text.split(self.separator)
        else:
            rows = [self.cells(row) for row in range(len(self.lines))]
            for number, row in zip(self.numbers, rows, strict=True):
                if len(row) != len(header):
                    raise _ragged(self.file, number, row, header)
            cells = list(chain.from_iterable(rows))
        return [cells[k :: len(header)] for k in range(len(header))]


@dataclass(frozen=True)
class CsvText:
    """A CSV file that can be read as often as its text is needed.

    Attributes:
        file: Path as the caller gave it.
        size: Number of its bytes.
        data: These in UTF-8, where they cannot be read again or are not; else None.
        separator: Separator of two cells.
    """

    file: str
    size: int
    data: bytes | None = None
    separator: str = ","

    def stretches(self, progress: Progress | None = None) -> Iterator[Stretch]:
        """All lines; comments and blank lines are skipped, no stretch is empty.

        Args:
            progress: Told the part that is read and worked off, 0 to 1.

        Raises:
            InputError: If the file cannot be read, or is not UTF-8 text.
        """
        first, done = 1, 0
        for data in _whole_lines(self._blocks()):
            text = _decode(data, self.file, first)
            lines = text.split("\n")
            kept = [
                row
                for row, line in enumerate(lines)
                if (words := line.lstrip()) and words[0] != "#"
            ]
            if kept:
                numbers = [first + row for row in kept]
                texts = [lines[row] for row in kept]
                yield Stretch(self.file, self.separator, numbers, texts)
            first, done = first + len(lines) - 1, done + len(data)
            if progress is not None:
                progress(min(done / max(self.size, 1), 1.0))

    def split(
        self, progress: Progress | None = None
    ) -> tuple[Stretch, Iterator[Stretch]]:
        """A stretch that begins with the header, and all that follows the header.

        Args:
            progress: As `stretches` tells it.

        Raises:
            InputError: If the file is empty; also as `stretches` does, by and by.
        """
        stretches = self.stretches(progress)
        first = next(stretches, None)
        if first is None:
            reason = "the file is empty, it needs a header and rows"
            raise InputError(reason, file=self.file)
        rest = replace(first, numbers=first.numbers[1:], lines=first.lines[1:])
        return first, chain([rest], stretches)

    def cells(self, number: int) -> list[str]:
        """Untrimmed cells of the line of a number.

        Raises:
            InputError: If there is no such line any more.
        """
        for stretch in self.stretches():
            if number <= stretch.numbers[-1] and number in stretch.numbers:
                return stretch.cells(stretch.numbers.index(number))
        raise self.changed()

    def texts(
        self, places: Sequence[int]
    ) -> Iterator[tuple[Sequence[int], list[list[str]]]]:
        """Numbers of some lines, and the untrimmed cells of some columns, and so on.

        Raises:
            InputError: If the file is no longer what it was.
        """
        first, stretches = self.split()
        header = first.cells(0)
        if len(header) <= max(places):
            raise self.changed()
        for stretch in stretches:
            columns = stretch.columns(header)
            yield stretch.numbers, [columns[place] for place in places]

    def changed(self) -> InputError:
        """An error about a file that is no longer what it was."""
        return InputError("the file has changed while it was read", file=self.file)

    def _blocks(self) -> Iterator[bytes]:
        if self.data is None:
            return read_blocks(self.file, BLOCK)
        return (self.data[k : k + BLOCK] for k in range(0, len(self.data), BLOCK))


def open_csv(path: str | Path) -> CsvText:
    """A CSV file; a pipe, which cannot be read twice, and UTF-16 are read at once.

    Raises:
        InputError: If there is no such file, or its byte order mark is wrong.
    """
    if is_file := Path(path).is_file():
        start = next(read_blocks(path, BLOCK), b"")
        if not start.startswith(_UTF_16):
            return CsvText(str(path), Path(path).stat().st_size)
    data = b"".join(read_blocks(path, BLOCK, pipe=not is_file))
    if data.startswith(_UTF_16):
        try:
            data = data.decode("utf-16").encode()
        except UnicodeError:
            reason = "not UTF-16 text, as its byte order mark says"
            raise InputError(reason, file=path) from None
    return CsvText(str(path), len(data), data)


def _whole_lines(blocks: Iterator[bytes]) -> Iterator[bytes]:
    """The same bytes, cut at line ends."""
    pending: list[bytes] = []
    for block in blocks:
        # A carriage return at the very end may be the first half of a line end.
        cut = max(block.rfind(b"\n"), block.rfind(b"\r", 0, -1)) + 1
        if len(block) < BLOCK:  # The last one, however its last line ends.
            cut = len(block)
        if cut:
            yield b"".join([*pending, block[:cut]])
            pending.clear()
        pending.append(block[cut:])
    if rest := b"".join(pending):
        yield rest


def _decode(data: bytes, file: str, first: int) -> str:
    """Text of whole lines with plain line ends; `first` is the number of the first."""
    try:
        text = data.decode("utf-8-sig" if first == 1 else "utf-8")
    except UnicodeDecodeError as error:
        line = first + data[: error.start].count(b"\n")
        raise InputError("not UTF-8 text", file=file, line=line) from None
    if "\0" in text:
        raise InputError("not a text file (it contains NUL bytes)", file=file)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _ragged(
    file: str, number: int, row: Sequence[str], header: Sequence[str]
) -> InputError:
    """An error about a row that is too short or too long."""
    short = len(row) < len(header)
    reason = f"the row has {len(row)} cells, the header {len(header)} columns"
    if not short and len(row) > 1.5 * len(header):
        reason += " (between commas the decimal mark must be a point)"
    return InputError(
        reason,
        file=file,
        line=number,
        # The first column without a cell, or the first cell without a column.
        column=header[len(row)].strip() if short else None,
        value=None if short else row[len(header)].strip(),
    )
