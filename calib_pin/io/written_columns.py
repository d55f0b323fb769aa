"""Columns that measurements and configurations are written in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OutputError
from calib_pin.io.columns import Floats, split_header
from calib_pin.io.joint_columns import column_values, joint_sources
from calib_pin.io.measured_columns import reserved
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import declared
from calib_pin.observations import AT, PART, Measurements
from calib_pin.setup import JointMap


def measurement_columns(
    measurements: Measurements,
) -> Iterator[tuple[str, Sequence[object] | NDArray[Any]]]:
    """Names and cells of the columns that hold measurements."""
    rows = _with_starts(measurements)
    for name, column in zip(rows.joints, rows.q.T, strict=True):
        yield column_name(name), column
    models, target = _models(rows), rows.target
    if len(rows.parts) > 1:
        yield "model", models
        target = tuple(name.partition(PART)[2] for name in target)
    yield from _measured(rows, models).items()
    if any(target):
        yield "target", _writable("target", target)
    if any(rows.payload):
        yield "payload", _writable("payload", rows.payload)
    if rows.validate.any():
        yield "set", ["validate" if late else "train" for late in rows.validate]


def _models(rows: Measurements) -> tuple[str, ...]:
    """The model of each row."""
    if len(rows.parts) == 1:
        return (rows.model,) * len(rows)
    models = tuple(name.partition(PART)[0] for name in rows.target)
    for model, target in zip(models, rows.target, strict=True):
        if model not in rows.parts:
            raise OutputError(f"target {target!r} is of none of {rows.model}")
    return models


def _measured(rows: Measurements, models: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Cells of the columns of all models, blank where a row's own has none."""
    values: dict[str, NDArray[Any]] = {}
    sigmas: dict[str, NDArray[Any]] = {}
    a = b = 0
    for model in rows.parts:
        stated, own = declared(model), _rows_of(models, model)
        c, d = a + len(stated.values), b + len(stated.components)
        _fill(values, stated.values, rows.values[:, a:c], own)
        told = None if rows.sigma is None else rows.sigma[:, b:d]
        a, b = c, d
        if told is None or np.isnan(told[own]).all():
            continue
        if not np.isfinite(told[own]).all():
            raise OutputError(f"only some rows of '{model}' have standard deviations")
        _fill(sigmas, [f"sigma_{name}" for name in stated.components], told, own)
    return values | sigmas


def _rows_of(models: Sequence[str], model: str) -> NDArray[np.bool_]:
    """Whether each row is of a model, shape (N,)."""
    return np.fromiter((name == model for name in models), bool, len(models))


def _fill(
    columns: dict[str, NDArray[Any]],
    names: Sequence[str],
    table: Floats,
    own: NDArray[np.bool_],
) -> None:
    """Put the rows of one model into columns that others may share."""
    if own.all():
        columns.update(zip(names, table.T, strict=True))
    elif own.any():
        for name, column in zip(names, table.T, strict=True):
            cells = columns.setdefault(name, np.full(len(own), "", object))
            cells[own] = column[own]


def _with_starts(data: Measurements) -> Measurements:
    """With a row for every start, before the first that is measured from it.

    Raises:
        OutputError: If a relative distance would not read back.
    """
    model = next((name for name in data.parts if declared(name).relative), None)
    if model is None:
        return data
    relative = _rows_of(_models(data), model)
    before = data.parts[: data.parts.index(model)]
    distance = data.values[:, sum(len(declared(name).values) for name in before)]
    start = data.start if data.start.size else np.full(data.q.shape, np.nan)
    for wrong, reason in (
        (~np.isfinite(start).all(axis=1), "has no start"),
        ((data.q == start).all(axis=1), "is taken at its start"),
        (distance <= 0.0, "is not more than 0"),
    ):
        if (relative & wrong).any():
            place = data.source(int(np.argmax(relative & wrong)))
            raise OutputError(
                f"{place}: the relative distance {reason} and would not read back"
            )
    target, first = _start_names(data, relative)
    index = np.repeat(np.arange(len(data)), 1 + first)
    begins = np.append(index[1:] == index[:-1], False)
    rows = replace(data, target=target).rows(index)
    q, values = rows.q.copy(), rows.values.copy()
    q[begins], values[begins] = start[index[begins]], 0.0
    return replace(rows, q=q, values=values)


def _start_names(
    data: Measurements, relative: NDArray[np.bool_]
) -> tuple[tuple[str, ...], NDArray[np.bool_]]:
    """Targets that tell starts apart; of several with one name the first keeps it.

    Args:
        data: The rows.
        relative: Those that have a start, shape (N,).

    Returns:
        The target of each row, and whether it is the first of its start, shape (N,).
    """
    target, first = list(data.target), np.zeros(len(data), bool)
    taken, kept, numbers = set(target), set[str](), count(2)
    names: dict[tuple[str, bytes, str], str] = {}
    for row in np.flatnonzero(relative).tolist():
        name = target[row]
        key = name, data.start[row].tobytes(), data.payload[row]
        if key not in names:
            first[row] = True
            names[key] = name
            stem = name if name and name[-1] not in AT + PART else f"{name}start"
            while name in kept and names[key] in taken:
                names[key] = f"{stem}/{next(numbers)}"
            kept.add(name)
            taken.add(names[key])
        target[row] = names[key]
    return tuple(target), first


def configuration_columns(
    chain: Chain, q: Floats, target: Sequence[str], joints: Mapping[str, JointMap]
) -> dict[str, Floats | Sequence[str]]:
    """Names and cells of the columns that hold configurations."""
    columns: dict[str, Floats | Sequence[str]] = {}
    for name, values in column_values(q, joint_sources(chain, joints)).items():
        columns[column_name(name)] = values
    if any(target):
        columns["target"] = _writable("target", target)
    return columns


def column_name(joint: str) -> str:
    """The name of a column of joint positions.

    Raises:
        OutputError: If it would not read back.
    """
    if split_header(joint) != (joint, None) or joint in reserved():
        raise OutputError(f"joint '{joint}' cannot be the name of a column")
    return joint


def _writable(column: str, names: Sequence[str]) -> Sequence[str]:
    """The cells of a column of names."""
    for name in dict.fromkeys(names):
        if name != name.strip() or set(name) & set("\r\n\0"):
            raise OutputError(f"{column} {name!r} would not read back")
    return names
