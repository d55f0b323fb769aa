"""Parquet files, read by pyarrow, as columns of numbers and texts."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from calib_pin.errors import InputError, OptionError
from calib_pin.io.columns import GrowingColumn
from calib_pin.progress import Progress

SUFFIXES = (".parquet", ".parq", ".pq")
MAGIC = b"PAR1"
"""First bytes of a Parquet file."""

CELLS = 1 << 27
"""Most cells of a file, twice those of the largest CSV file."""


@dataclass(frozen=True)
class Parquet:
    """A table of pyarrow with the attributes of `Text`; its rows are counted from 1.

    Attributes:
        file: Path as the caller gave it.
        table: The columns.
    """

    file: str
    table: Any
    separator: ClassVar[str] = ","
    header_line: ClassVar[None] = None
    remarks: ClassVar[tuple[str, ...]] = ()
    foreign: ClassVar[None] = None

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(name.strip() for name in self.table.column_names)

    def columns(
        self, progress: Progress | None = None
    ) -> tuple[array[int], list[GrowingColumn]]:
        """Numbers of the rows, and the columns."""
        import pyarrow as pa

        grown = [GrowingColumn() for _ in self.header]
        for column, cells in zip(grown, self.table.columns, strict=True):
            if pa.types.is_floating(cells.type) or pa.types.is_integer(cells.type):
                numbers = cells.cast(pa.float64(), safe=False).to_numpy()
                odd = np.flatnonzero(~np.isfinite(numbers))
                column.add(numbers, _texts(cells.take(pa.array(odd))))
            else:
                column.extend(_texts(cells))
        if progress is not None:
            progress(1.0)
        return array("q", range(1, self.table.num_rows + 1)), grown

    def rows(self) -> Iterator[tuple[Sequence[int], list[list[str]]]]:
        """Numbers of all rows and their cells by column, at once."""
        numbers = range(1, self.table.num_rows + 1)
        yield numbers, [_texts(column) for column in self.table.columns]

    def cells(self, row: int) -> tuple[str, ...]:
        """Cells of the row of a number."""
        return tuple(_texts(c.slice(row - 1, 1))[0] for c in self.table.columns)


def is_parquet(path: str | Path) -> bool:
    """Whether a file is to be read as Parquet: by its suffix or its first bytes."""
    path = Path(path)
    if path.suffix.lower() in SUFFIXES or not path.is_file():
        return path.suffix.lower() in SUFFIXES
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def read_parquet(path: str | Path) -> Parquet:
    """Read a Parquet file.

    Raises:
        InputError: If it cannot be read, or says that it is too large.
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
            about = found.metadata
            if about.num_rows * about.num_columns > CELLS:
                raise InputError(f"has more than {CELLS} cells", file=path)
            return Parquet(str(path), found.read(use_threads=False))
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"cannot be read as Parquet: {what}", file=path) from None


def _texts(cells: Any) -> list[str]:
    """The cells of a column as texts; empty where there is none."""
    import pyarrow as pa

    kind = cells.type
    if pa.types.is_dictionary(kind):
        cells = cells.cast(kind.value_type)
    try:
        if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
            return ["" if x is None else repr(x) for x in cells.to_pylist()]
        if pa.types.is_floating(kind):
            return ["" if x is None else repr(x) for x in cells.to_pylist()]
        return ["" if x is None else x for x in cells.cast(pa.string()).to_pylist()]
    except pa.ArrowException:
        # Lists, bytes and the like: whoever reads the column is told what is there.
        return [f"({kind})"] * len(cells)
