"""`measurements.csv`: a result measurement by measurement, in SI units.

One line for every fitted measurement (`train`) and one for every held-out prediction
(`validate`): where it stands, where the robot was, what was measured, and how far the
nominal and the calibrated robot are off. Numbers come back exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from calib_pin.io.measurements import encode_table
from calib_pin.io.table import read_cells
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import BlockKey, Conditions, Measurements, Observations
from calib_pin.parameterizations import needed_conditions
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import (
    AXES,
    CalibrationResult,
    MeasurementErrors,
    columns_of,
)

MEASUREMENTS = "measurements.csv"
"""Name of the file."""

SETS = ("train", "validate")
WORDS = ("set", "file", "line", "target", "payload", *BlockKey._fields)
"""The first columns; all others hold numbers."""

STATED = ("temperature", "time")
"""Columns of conditions, where they are known."""


def encode_errors(result: CalibrationResult, run: str) -> bytes:
    """The file of a result.

    Args:
        result: The result.
        run: Id of the run that it is of.
    """
    parts = zip(SETS, (result.fitted, result.held_out), strict=True)
    directed = "direction" in needed_conditions(result.model.setup.parameters)
    tables = [p.table(name, directed) for name, p in parts if p is not None]
    columns = dict[str, Any]()
    blanks = [np.full(len(table["set"]), np.nan) for table in tables]
    for name in dict.fromkeys(name for table in tables for name in table):
        cells = [t.get(name, none) for t, none in zip(tables, blanks, strict=True)]
        words = name in WORDS
        columns[name] = [*chain(*cells)] if words else np.concatenate(cells)
    head = f"calib-pin measurements of a calibration, run {run}; in m, rad and px"
    return encode_table(columns, [head])


def decode_errors(
    data: bytes, model: CalibratedModel
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements.

    Args:
        data: Bytes of the file.
        model: The calibrated robot.

    Raises:
        KeyError: If a column is missing.
        ValueError: If there is no measurement, or a cell is no number.
        InputError: If it is no CSV file.
    """
    cells = {c.header: c for c in read_cells(data, MEASUREMENTS, names=WORDS).columns()}
    words = {name: cells[name].texts() for name in WORDS}
    unknown, joints = MeasurementErrors.unknown(model, 0), model.chains.joints
    _, first = columns_of(model)

    def numbers(form: str, names: Sequence[object], rows: Sequence[int]) -> Floats:
        """Cells of columns that are called by a form."""
        columns = [cells[form.format(name)].numbers[rows] for name in names]
        return np.column_stack([np.zeros((len(rows), 0)), *columns])

    def block(key: BlockKey, rows: Sequence[int]) -> Measurements:
        about, start, index = declared(key.model), first[key.model], np.array(rows)
        components = unknown.components[start : start + len(about.components)]
        given = components if f"{components[0]}.stated" in cells else ()
        sigma = numbers("{}.stated", given, rows)
        conditions: Any = {n: cells[n].numbers[rows] for n in STATED if n in cells}
        if f"direction.{joints[0]}" in cells:
            directions = numbers("direction.{}", joints, rows).astype(np.int8)
            conditions |= {"direction": directions, "source": "columns"}
        return Measurements(
            joints=joints,
            q=numbers("joint.{}", joints, rows),
            values=numbers("measured.{}", range(1, len(about.values) + 1), rows),
            sigma=None if np.isnan(sigma).all() else sigma,
            target=words["target"][index],
            conditions=Conditions(words["payload"][index], **conditions),
            start=numbers("start.{}", joints if about.relative else (), rows),
            lines=cells["line"].numbers[rows].astype(np.int64),
            files=words["file"][index],
            weight=cells["weight"].numbers[rows],
            **key._asdict(),
        )

    sets: dict[str, dict[BlockKey, list[int]]] = {name: {} for name in SETS}
    keys = map(BlockKey, *(words[field] for field in BlockKey._fields))
    for row, (name, key) in enumerate(zip(words["set"], keys, strict=True)):
        sets[name].setdefault(key, []).append(row)
    if not sets[SETS[0]]:
        raise ValueError("there are no measurements")
    parts, stages = list[MeasurementErrors](), ("before", "after", "sigma")
    for blocks in filter(None, sets.values()):
        rows = [row for chosen in blocks.values() for row in chosen]
        part: Any = {n: numbers(f"{{}}.{n}", unknown.components, rows) for n in stages}
        part |= {
            "rows": Observations(tuple(block(*item) for item in blocks.items())),
            "points": numbers("tool.{}", AXES, rows),
            "leverage": cells["leverage"].numbers[rows],
        }
        parts.append(replace(unknown, **part))
    return parts[0], parts[1] if len(parts) > 1 else None
