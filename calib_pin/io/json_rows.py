"""Rows in JSON, as logs and data frames are written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any


def rows_of_json(text: bytes) -> list[dict[str, str]]:
    """The texts of the cells of each row, by the names of the columns.

    Args:
        text: A list of rows, maybe beside facts about them, a row in each line, or the
            columns. What has two names in a row is called by both, such as `pose_x`.

    Raises:
        ValueError: If there are no rows with names.
    """
    try:
        rows = [dict(_flat("", row)) for row in _rows(text)]
    except (TypeError, AttributeError, LookupError) as error:
        raise ValueError(str(error)) from None
    if not rows or "" in rows[0]:
        raise ValueError("there are no rows with names")
    return rows


def _rows(text: bytes) -> list[Any]:
    try:
        found: Any = json.loads(text)
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


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """The texts below a value, each with the names that lead there."""
    if isinstance(value, dict):
        for key, own in value.items():
            yield from _flat(f"{name}_{key}".lstrip("_"), own)
    else:
        yield name, value if isinstance(value, str) else json.dumps(value)
