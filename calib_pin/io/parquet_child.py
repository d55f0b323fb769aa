"""Reads Parquet files in a process that may crash; `parquet_files` runs it as a script.

The library believes what a file says of itself, and a few bytes may say that there are
thousands of millions of numbers. A request of JSON comes in. Lines of JSON go out, each
with a reason why the file cannot be read, or with the names of the columns and the
number of rows, or with some rows and then the bytes of their columns.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

import numpy as np

from calib_pin.io.limits import limit

ROWS = 1 << 15
"""Rows that are read at a time, as far as their columns are few."""

CELLS = 1 << 19
"""Cells that are read at a time."""

BUFFER = 1 << 18
"""Bytes of a column that are read at a time."""


def texts(array: Any) -> tuple[dict[str, object], bytes]:
    """A column as texts: each once, and the place of each cell's among them."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = array.type
    if pa.types.is_dictionary(kind):
        array, kind = array.dictionary_decode(), kind.value_type
    if pa.types.is_floating(kind):
        # As Python writes them, which reads back bit by bit.
        cells = ["" if x is None else repr(float(x)) for x in array.to_pylist()]
        array = pa.array(cells, pa.string())
    try:
        array = pc.fill_null(pc.cast(array, pa.string()), "")
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        # Lists, bytes and the like: whoever reads the column is told what is there.
        array = pa.array([f"({kind})"] * len(array), pa.string())
    coded = array.dictionary_encode()
    codes = coded.indices.to_numpy(zero_copy_only=False).astype("<i4")
    return {"numbers": False, "words": coded.dictionary.to_pylist()}, codes.tobytes()


def column(array: Any) -> tuple[dict[str, object], bytes]:
    """A column of numbers as such, with the texts of those that are not finite."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = array.type
    number = pa.types.is_floating(kind) or pa.types.is_integer(kind)
    if not (number or pa.types.is_decimal(kind)):
        return texts(array)
    empty = pc.is_null(array).to_numpy(zero_copy_only=False)
    # Integers above 2^53 are rounded, as they are in a text.
    found = pc.cast(array, pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    rows = np.flatnonzero(empty | ~np.isfinite(found))
    odd = ["" if empty[k] else str(found[k]) for k in rows]
    return {"numbers": True, "words": odd}, found.astype("<f8").tobytes()


def answers(request: dict[str, Any]) -> Any:
    """The answers to a request, one after another, each a head and its bytes."""
    import pyarrow.parquet as parquet

    with parquet.ParquetFile(
        request["path"], buffer_size=BUFFER, page_checksum_verification=True
    ) as file:
        names = file.schema_arrow.names
        yield {"header": names, "rows": file.metadata.num_rows}, b""
        places = request["places"]
        chosen = range(len(names)) if places is None else places
        rows = max(min(ROWS, CELLS // max(len(names), 1)), 1)
        # All columns: the library would choose some by names, which may occur twice.
        for batch in file.iter_batches(batch_size=rows, use_threads=False):
            read = texts if request["texts"] else column
            parts = [read(batch.column(place)) for place in chosen]
            head = {"count": batch.num_rows, "columns": [about for about, _ in parts]}
            yield head, b"".join(data for _, data in parts)
    yield {}, b""


def main() -> None:
    """Answer one request."""
    request = json.loads(sys.stdin.buffer.readline())
    # Memory that is given back at once, and no threads, which would each take some.
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"
    os.environ["OMP_NUM_THREADS"] = "1"
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    limit()
    try:
        for head, data in answers(request):
            output.write(json.dumps(head).encode() + b"\n" + data)
    except BrokenPipeError:  # Nobody wants to know more.
        os._exit(0)
    except Exception as failure:
        lines = str(failure).strip().splitlines() or [type(failure).__name__]
        output.write(json.dumps({"reason": lines[0]}).encode() + b"\n")
    output.flush()


if __name__ == "__main__":
    main()
