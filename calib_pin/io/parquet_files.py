"""Parquet files as tables: columns of numbers and texts, some thousand rows at a time.

A process of its own reads them, see `parquet_child`, with limits of memory and time: a
damaged file costs a line. Rows are counted from 1, and stand in messages as lines do.
"""

from __future__ import annotations

import json
import subprocess
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.io.children import started
from calib_pin.io.columns import GrowingColumn
from calib_pin.io.files import read_blocks
from calib_pin.progress import Progress

SUFFIXES = (".parquet", ".parq", ".pq")

MAGIC = b"PAR1"
"""First and last bytes of a Parquet file."""

CELLS = 1 << 27
"""Most cells of a file, twice those of the largest CSV file; 3 GB while it is read."""

SECONDS = 30.0
"""Time for some thousand rows, and for what is before the first ones [s]."""

TEXT = 1 << 28
"""Bytes of all texts of a file, each counted once in some thousand rows."""

LINE = 2 * TEXT
"""Bytes of the longest head of an answer, which holds the texts of its rows."""


def is_parquet(path: str | Path) -> bool:
    """Whether a file is to be read as Parquet: by its suffix, or by both its ends."""
    path = Path(path)
    if path.suffix.lower() in SUFFIXES:
        return True
    try:
        if not path.is_file() or path.stat().st_size < 3 * len(MAGIC):
            return False
        with path.open("rb") as stream:
            first = stream.read(len(MAGIC))
            stream.seek(-len(MAGIC), 2)
            return first == MAGIC == stream.read(len(MAGIC))
    except (OSError, ValueError):
        return False


@dataclass(frozen=True)
class ParquetFile:
    """A Parquet file whose cells can be read as text as often as that is needed.

    Attributes:
        file: Path as the caller gave it.
        separator: Separator of two cells; as with commas, decimal marks are points.
    """

    file: str
    separator: ClassVar[str] = ","

    def columns(
        self, progress: Progress | None = None, *, head: bool = False
    ) -> tuple[list[str], list[GrowingColumn], array[int]]:
        """Names of the columns, their cells, and the numbers of the rows.

        Args:
            progress: Told the part of the rows that is read, 0 to 1.
            head: Whether the first rows are enough.

        Raises:
            InputError: If it is no such file, or has too many cells.
            OptionError: If the extra is missing.
        """
        done = 0
        with self._answers(None, texts=False) as (header, rows, batches):
            grown = [GrowingColumn() for _ in header]
            for count, parts in batches:
                for column, part in zip(grown, parts, strict=True):
                    if isinstance(part, _Numbers):
                        column.add(part.numbers, part.words)
                    else:
                        column.extend(part.cells())
                done += count
                if progress is not None:
                    progress(done / max(rows, done))
                if head:
                    break
            else:
                if done != rows:
                    reason = f"it has {done} rows and says {rows}"
                    raise InputError(f"cannot be read: {reason}", file=self.file)
        return header, grown, array("q", range(1, done + 1))

    def texts(
        self, places: Sequence[int]
    ) -> Iterator[tuple[Sequence[int], list[list[str]]]]:
        """Numbers of some rows, and the texts of some columns, and so on.

        Raises:
            InputError: If it can no longer be read.
        """
        first = 1
        with self._answers(places, texts=True) as (_, _, batches):
            for count, parts in batches:
                yield range(first, first + count), [part.cells() for part in parts]
                first += count

    def cells(self, number: int) -> list[str]:
        """Texts of the row of a number.

        Raises:
            InputError: If there is no such row any more.
        """
        with self._answers(None, texts=True) as (_, _, batches):
            for count, parts in batches:
                if number <= count:
                    return [part.words[part.codes[number - 1]] for part in parts]
                number -= count
        raise self.changed()

    def changed(self) -> InputError:
        """An error about a file that is no longer what it was."""
        return InputError("the file has changed while it was read", file=self.file)

    @contextmanager
    def _answers(
        self, places: Sequence[int] | None, *, texts: bool
    ) -> Iterator[tuple[list[str], int, Iterator[tuple[int, list[Any]]]]]:
        """Names of the columns, number of rows, and the rows, some at a time."""
        start = next(read_blocks(self.file, len(MAGIC)), b"")
        if start != MAGIC:
            reason = "is no Parquet file: it does not begin with PAR1"
            raise InputError(reason, file=self.file)
        if find_spec("pyarrow") is None:
            raise OptionError(
                "Parquet files need pyarrow, which is missing: pip install "
                "'calib-pin[parquet]'",
                file=self.file,
            )
        request = {"path": self.file, "places": places, "texts": texts}
        child = started("parquet_child.py")
        try:
            assert child.stdin is not None
            child.stdin.write(json.dumps(request).encode() + b"\n")
            child.stdin.flush()
            head, _ = self._answer(child, 0)
            header, rows = [str(name) for name in head["header"]], int(head["rows"])
            if rows * len(header) > CELLS:
                raise InputError(
                    f"has {rows} rows of {len(header)} columns, more than {CELLS} "
                    "numbers",
                    file=self.file,
                )
            width = len(header) if places is None else len(places)
            yield header, rows, self._batches(child, width, rows)
        except (OSError, LookupError, TypeError, ValueError):
            raise self._lost() from None
        finally:
            child.kill()
            child.communicate()

    def _batches(
        self, child: subprocess.Popen[bytes], width: int, rows: int
    ) -> Iterator[tuple[int, list[Any]]]:
        left, room = rows, TEXT
        while True:
            head, parts = self._answer(child, width)
            if not head:
                return
            left -= head["count"]
            room -= sum(len(word) for part in parts for word in part.words)
            if room < 0:
                reason = f"has more than {TEXT >> 20} MB of different texts"
                raise InputError(reason, file=self.file)
            if left < 0:
                raise self._lost()
            yield head["count"], parts

    def _answer(
        self, child: subprocess.Popen[bytes], width: int
    ) -> tuple[dict[str, Any], list[Any]]:
        """The next answer of the process, with its columns."""
        assert child.stdout is not None
        timer = Timer(SECONDS, child.kill)
        timer.start()
        try:
            head = json.loads(child.stdout.readline(LINE))
            if "reason" in head:
                reason = f"cannot be read as Parquet: {head['reason']}"
                raise InputError(reason, file=self.file)
            about = head.get("columns", [])
            if about and len(about) != width:
                raise self._lost()
            count = head.get("count", 0)
            return head, [_read(child, each, count) for each in about]
        finally:
            timer.cancel()

    def _lost(self) -> InputError:
        return InputError(
            "cannot be read as Parquet: what reads it crashes, or needs too much "
            "memory or time",
            file=self.file,
        )


@dataclass(frozen=True)
class _Numbers:
    """Numbers, and the texts of those that are not finite."""

    numbers: NDArray[np.float64]
    words: list[str]


@dataclass(frozen=True)
class _Texts:
    """Some texts, and the place of each cell's among them."""

    words: list[str]
    codes: NDArray[np.int32]

    def cells(self) -> list[str]:
        return [self.words[code] for code in self.codes.tolist()]


def _read(
    child: subprocess.Popen[bytes], about: dict[str, Any], count: int
) -> _Numbers | _Texts:
    """A column of an answer.

    Raises:
        ValueError: If the answer is not whole.
    """
    assert child.stdout is not None
    words = about["words"]
    if about["numbers"]:
        numbers = np.frombuffer(child.stdout.read(8 * count), "<f8")
        if len(numbers) != count or (~np.isfinite(numbers)).sum() != len(words):
            raise ValueError("it ends too early")
        return _Numbers(numbers, words)
    codes = np.frombuffer(child.stdout.read(4 * count), "<i4")
    if len(codes) != count:
        raise ValueError("it ends too early")
    return _Texts(words, codes)
