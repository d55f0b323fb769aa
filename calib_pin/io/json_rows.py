"""Rows in JSON or YAML, as logs, data frames and samples of poses are written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import permutations
from typing import Any

YAML = (".yaml", ".yml", ".samples")
"""Ends of the names of files that are YAML; easy_handeye2 has the last."""


def rows_of_json(text: bytes, file: str) -> list[dict[str, str]]:
    """The texts of the cells of each row, by the names of the columns.

    Args:
        text: A list of rows, maybe beside facts about them, a row in each line, the
            columns, or their names beside the numbers of each row. What has two names
            in a row is called by both, such as `pose_x`.
        file: Where it is from; its ending tells YAML.

    Raises:
        ValueError: If there are no rows with names.
    """
    try:
        rows = [dict(_flat("", row)) for row in _rows(text, file)]
    except (TypeError, AttributeError, LookupError) as error:
        raise ValueError(str(error)) from None
    if not rows or "" in rows[0]:
        raise ValueError("there are no rows with names")
    return rows


def _rows(text: bytes, file: str) -> list[Any]:
    found: Any
    if file.lower().endswith(YAML):
        from calib_pin.io.yaml_tree import parse_tree

        found = parse_tree(text, file).data
    else:
        try:
            found = json.loads(text)
        except ValueError:
            return [json.loads(line) for line in text.splitlines() if line.strip()]
    if isinstance(found, list):
        return found
    for own in found.values():
        if isinstance(own, list) and isinstance(own[0], dict):
            return own
    lists = [own for own in found.values() if isinstance(own, list)]
    for names, rows in permutations(lists, 2):
        if all(isinstance(name, str) for name in names) and isinstance(rows[0], list):
            return [dict(zip(names, row, strict=True)) for row in rows]
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
