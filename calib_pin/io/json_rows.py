"""Rows in JSON, as logs and data frames are written, as a header and lines of cells."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from typing import Any


def table_of_json(text: bytes) -> tuple[list[str], list[str]]:
    """The names of columns, and lines with commas between the cells.

    Args:
        text: A list of rows, maybe beside facts about them, a row in each line, or the
            columns. What is in a row by name is called by both names: `pose_x`.

    Raises:
        ValueError: If it is something else.
    """
    try:
        rows = [dict(_flat("", row)) for row in _rows(text)]
        names = [*rows[0]]
        if "" in names:
            raise LookupError("a row has no names")
    except (TypeError, AttributeError, LookupError) as error:
        raise ValueError(str(error)) from None
    stream = io.StringIO(newline="")
    writer = csv.writer(stream)
    for row in rows:
        cells = (row.get(name, "") for name in names)
        writer.writerow([c if isinstance(c, str) else json.dumps(c) for c in cells])
    return names, stream.getvalue().splitlines()


def _rows(text: bytes) -> list[dict[str, Any]]:
    try:
        found = json.loads(text)
    except ValueError:
        return [json.loads(line) for line in text.splitlines() if line.strip()]
    if isinstance(found, list):
        return found
    for own in found.values():
        if isinstance(own, list) and isinstance(own[0], dict):
            return own
    # A data frame of pandas has the index beside each number.
    columns = (c.values() if isinstance(c, dict) else c for c in found.values())
    return [dict(zip(found, row, strict=True)) for row in zip(*columns, strict=True)]


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """What is below a value, each with the names that lead there."""
    if not isinstance(value, dict):
        yield name, value
        return
    for key, own in value.items():
        yield from _flat(f"{name}_{key}".lstrip("_"), own)
