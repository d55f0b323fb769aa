"""Parquet files, read by pyarrow, as columns of numbers and texts."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any

from calib_pin.errors import InputError, OptionError
from calib_pin.io.columns import GrowingColumn
from calib_pin.io.files import read_blocks
from calib_pin.io.text import Cells

MAGIC = b"PAR1"
"""First bytes of a Parquet file."""


def is_parquet(path: str | Path) -> bool:
    """Whether a file is to be read as Parquet: by its first bytes."""
    return next(read_blocks(path, len(MAGIC)), b"") == MAGIC


def read_parquet(path: str | Path) -> Cells:
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

    column, kind = GrowingColumn(), cells.type
    if pa.types.is_floating(kind) or pa.types.is_integer(kind):
        column.add(cells.cast(pa.float64(), safe=False).to_numpy())
        return column
    try:
        column.extend([x or "" for x in cells.cast(pa.string()).to_pylist()])
    except pa.ArrowException:
        # Lists, bytes and the like: whoever reads the column is told what is there.
        column.extend([f"({kind})"] * len(cells))
    return column
