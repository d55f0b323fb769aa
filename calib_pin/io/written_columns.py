"""Columns that measurements and configurations are written in."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
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
    held = data.conditions
    # Directions that follow from the order of rows, or from their time, do so again.
    if held.source == "columns":
        for name, column in zip(data.joints, held.direction[order].T, strict=True):
            yield name + DIRECTION, column
    for name in ("temperature", "time"):
        if len(column := getattr(held, name)):
            yield name, column[order]
    if data.validate.any():
        yield "set", Labels(("train", "validate"), data.validate[order].astype(int))


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
    """Relative measurements with a row for every start.

    Targets tell starts apart; of several with one name the first keeps it.
    """
    if not data.start.size:
        raise _unreadable(data, 0, "has no start")
    for wrong, reason in (
        ((data.q == data.start).all(axis=1), "is taken at its start"),
        (data.values[:, 0] <= 0.0, "is not more than 0"),
    ):
        if wrong.any():
            raise _unreadable(data, int(np.argmax(wrong)), reason)
    names, taken = dict[tuple[str, ...], str](), set(data.target.names)
    index, begins, targets = list[int](), list[bool](), list[str]()
    for row, (target, payload) in enumerate(
        zip(data.target, data.payload, strict=True)
    ):
        # Bit by bit, for starts have to read back.
        start = target, payload, data.start[row].tobytes().hex()
        first = start not in names
        if first:
            kept = all(other != target for other, *_ in names)
            names[start] = target if kept else _free_name(target, taken)
            taken.add(names[start])
        index += [row] * (1 + first)
        begins += [True, False] if first else [False]
        targets += [names[start]] * (1 + first)
    rows, begin = data.rows(np.array(index)), np.array(begins)
    q, values = rows.q.copy(), rows.values.copy()
    q[begin], values[begin] = rows.start[begin], 0.0
    return replace(rows, q=q, values=values, target=Labels.of(targets))


def _free_name(target: str, taken: Collection[str]) -> str:
    """A name like that of a target that none has."""
    stem = f"{target}start" if not target or target.endswith(AT) else target
    return next(n for k in count(2) if (n := f"{stem}/{k}") not in taken)


def _unreadable(data: Measurements, row: int, reason: str) -> OutputError:
    return OutputError(
        f"{data.source(row)}: the relative distance {reason} and would not read back"
    )


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
