"""Columns that measurements and configurations are written in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OutputError
from calib_pin.io.columns import Floats
from calib_pin.io.measured_columns import DIRECTION, reserved
from calib_pin.measurement_models import declared
from calib_pin.observations import (
    AT,
    BlockKey,
    Booleans,
    Indices,
    Labels,
    Measurements,
    Observations,
)


def measurement_columns(
    measurements: Measurements | Observations,
) -> Iterator[tuple[str, Sequence[object] | NDArray[Any]]]:
    """Names and cells of the columns that hold measurements.

    Raises:
        OptionError: If there is no measurement model of a name.
        OutputError: If a name or a relative distance would not read back.
    """
    data = _with_starts(Observations.of(measurements))
    order = data.in_order
    for name, column in zip(data.joints, data.q[order].T, strict=True):
        yield column_name(name), column
    for field in BlockKey._fields:
        of_block = Labels.of([getattr(block, field) for block in data.blocks])
        if len(of_block.distinct) > 1 or (field != "model" and any(of_block)):
            yield field, writable(field, of_block[data.block_of[order]])
    for name, column in _measured(data).items():
        yield name, column[order]
    for field in ("target", "payload"):
        names = getattr(data, field)
        if any(names.distinct):
            yield field, writable(field, names[order])
    yield from stated_conditions(data, order)
    if data.validate.any():
        yield "set", Labels(("train", "validate"), data.validate[order].astype(int))


def stated_conditions(
    data: Observations, order: Indices
) -> Iterator[tuple[str, NDArray[Any]]]:
    """Columns of the conditions that are stated, but for the payload.

    Directions that follow from the order of rows, or from their time, do so again.
    """
    held = data.conditions
    if held.source == "columns":
        for name, column in zip(data.joints, held.direction[order].T, strict=True):
            yield name + DIRECTION, column
    for name in ("temperature", "time"):
        if len(column := getattr(held, name)):
            yield name, column[order]


def _measured(data: Observations) -> dict[str, NDArray[Any]]:
    """Cells of the columns of all blocks, blank where a block has no such column."""
    found: dict[str, list[tuple[slice, Floats]]] = {}
    # All values stand before all standard deviations.
    for sigmas in (False, True):
        for block, rows in zip(data.blocks, data.slices, strict=True):
            stated = declared(block.model)
            names, table = stated.values, block.values
            if table.shape[1]:
                names = names or tuple(deviation for deviation, _ in stated.readings)
            if sigmas:
                if block.sigma is None:
                    continue
                names = tuple(f"sigma_{name}" for name in stated.components)
                table = block.sigma
            for name, column in zip(names, table.T, strict=True):
                found.setdefault(name, []).append((rows, column))
    result = {}
    for name, parts in found.items():
        whole = sum(len(column) for _, column in parts) == len(data)
        cells = np.full(len(data), 0.0 if whole else "", float if whole else object)
        for rows, column in parts:
            cells[rows] = column
        result[name] = cells
    return result


def _with_starts(data: Observations) -> Observations:
    """With a row for every start, before the first that is measured from it.

    Raises:
        OutputError: If a relative distance would not read back.
    """
    if not any(declared(model).relative for model in data.models):
        return data
    rank = np.argsort(data.in_order)
    return Observations(
        tuple(
            # The first that is measured from a start is the first in the file.
            _started(block.rows(np.argsort(rank[rows])))
            if declared(block.model).relative
            else block
            for block, rows in zip(data.blocks, data.slices, strict=True)
        )
    )


def _started(data: Measurements) -> Measurements:
    """Relative measurements with a row for every start."""
    if not data.start.size:
        raise _unreadable(data, 0, "has no start")
    for wrong, reason in (
        ((data.q == data.start).all(axis=1), "is taken at its start"),
        (data.values[:, 0] <= 0.0, "is not more than 0"),
    ):
        if wrong.any():
            raise _unreadable(data, int(np.argmax(wrong)), reason)
    target, first = _start_names(data)
    index = np.repeat(np.arange(len(data)), 1 + first)
    begins = np.append(index[1:] == index[:-1], False)
    rows = replace(data, target=target).rows(index)
    q, values = rows.q.copy(), rows.values.copy()
    q[begins], values[begins] = rows.start[begins], 0.0
    return replace(rows, q=q, values=values)


def _unreadable(data: Measurements, row: int, reason: str) -> OutputError:
    return OutputError(
        f"{data.source(row)}: the relative distance {reason} and would not read back"
    )


def _start_names(data: Measurements) -> tuple[Labels, Booleans]:
    """Targets that tell starts apart; of several with one name the first keeps it.

    Returns:
        The target of each row, and whether it is the first of its start, shape (N,).
    """
    # Bit by bit, for starts have to read back.
    bits = np.ascontiguousarray(data.start).view(np.int64)
    _, found, start = np.unique(
        np.column_stack([data.target.codes, data.payload.codes, bits]),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    taken, kept, numbers = set(data.target.names), set[str](), count(2)
    names = [""] * len(found)
    for k in np.argsort(found).tolist():
        name = names[k] = data.target[found[k]]
        stem = f"{name}start" if not name or name.endswith(AT) else name
        while name in kept and names[k] in taken:
            names[k] = f"{stem}/{next(numbers)}"
        kept.add(name)
        taken.add(names[k])
    first = np.zeros(len(data), bool)
    first[found] = True
    return Labels(tuple(names), start.reshape(-1)), first


def column_name(joint: str) -> str:
    """The name of a column of joint positions.

    Raises:
        OutputError: If it would not read back.
    """
    if joint != joint.strip() or joint in reserved():
        raise OutputError(f"joint '{joint}' cannot be the name of a column")
    return joint


def writable(column: str, names: Sequence[str]) -> Labels:
    """The cells of a column of names."""
    labels = Labels.of(names)
    for name in labels.distinct:
        if name != name.strip() or set(name) & set("\r\n\0"):
            raise OutputError(f"{column} {name!r} would not read back")
    return labels
