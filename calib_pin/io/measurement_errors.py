"""`measurements.csv`: a result measurement by measurement, in SI units.

One line for every fitted measurement (`train`) and one for every held-out prediction
(`validate`): where it stands, where the robot was, what was measured, and how far the
nominal and the calibrated robot are off. Numbers come back exactly.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib_pin.estimation.layout import side_by_side
from calib_pin.io.measurements import LINES
from calib_pin.io.table import read_cells
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Quantity, declared
from calib_pin.observations import (
    BlockKey,
    Conditions,
    Labels,
    Measurements,
    Observations,
)
from calib_pin.parameterizations import needed_conditions
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.measurement_errors import AXES, MeasurementErrors
from calib_pin.validation.result import CalibrationResult

MEASUREMENTS = "measurements.csv"
"""Name of the file."""

SETS = ("train", "validate")
WORDS = ("set", "file", "line", "target", "payload", *BlockKey._fields)
"""The first columns; all others hold numbers."""

STATED = ("temperature", "time")
"""Columns of conditions, where they are known."""

LEGEND = """\
calib-pin measurements of a calibration, run {run}; lengths in m, angles in rad, images
in px. set: train is fitted, validate is predicted by a fit without it. <joint>: the
commanded position, start.<joint> that of the first configuration of a relative
measurement, direction.<joint> the sign of its last motion, 0 where it is not known.
measured.<k>: the values in the layout of the model. weight: 0 is rejected.
leverage: of the fit. tool.<axis>: the calibrated tool point in the base link.
<component>.before, .after: predicted minus measured by the nominal robot (registered)
and by the calibrated one. .sigma: its standard deviation as it is used, .stated: as it
was stated. An empty cell is a number that a measurement does not have. model, chain,
station, tool: the block; each model has its own values and components."""


def encode_errors(result: CalibrationResult, run: str) -> bytes:
    """The file of a result.

    Args:
        result: The result.
        run: Id of the run that it is of.
    """
    from pydantic_core import to_json

    parts = zip(SETS, (result.fitted, result.held_out), strict=True)
    directed = "direction" in needed_conditions(result.model.setup.parameters)
    tables = [p.table(name, directed) for name, p in parts if p is not None]
    columns: dict[str, list[Any]] = {n: [] for table in tables for n in table}
    for table in tables:
        unknown = [math.nan] * len(table["set"])
        for name, column in columns.items():
            column += table.get(name, unknown)
    numbers = [column for name, column in columns.items() if name not in WORDS]
    found, count = list[bytes](), len(columns["set"])
    for start in range(0, count, LINES):
        part = slice(start, start + LINES)
        text = io.StringIO(newline="")
        words = zip(*(columns[name][part] for name in WORDS), strict=True)
        csv.writer(text, lineterminator="\0").writerows(words)
        # Files may have names that are not UTF-8.
        heads = text.getvalue().encode("utf-8", "backslashreplace").split(b"\0")
        cells = [*zip(*(column[part] for column in numbers), strict=True)]
        # A JSON writer is four times faster than `repr`, and as exact.
        lines = to_json(cells, inf_nan_mode="constants")
        lines = lines.replace(b"NaN", b"").replace(b"Infinity", b"inf")
        tails = lines[2:-2].split(b"],[")
        found += (b"%b,%b\n" % line for line in zip(heads, tails, strict=False))
    text = io.StringIO(newline="")
    text.writelines(f"# {line}\n" for line in LEGEND.format(run=run).splitlines())
    csv.writer(text, lineterminator="\n").writerow(columns)
    return b"".join([text.getvalue().encode("utf-8", "backslashreplace"), *found])


def decode_errors(
    data: bytes, model: CalibratedModel, to_base: Mapping[str, Floats]
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements.

    Args:
        data: Bytes of the file.
        model: The calibrated robot.
        to_base: By set, rotations from the measurement frame of each block to its base
            link, shape (B, 3, 3).

    Raises:
        KeyError: If a column is missing.
        ValueError: If there is no measurement, or a cell is no number.
        InputError: If it is no CSV file.
    """
    cells = read_cells(data, MEASUREMENTS).columns()
    whole = {column.header: column for column in cells}
    words = {name: [*whole[name].texts()] for name in WORDS}
    columns = {name: column.numbers for name, column in whole.items()}
    sets: dict[str, dict[BlockKey, list[int]]] = {name: {} for name in SETS}
    for row, (name, _, _, _, _, *key) in enumerate(zip(*words.values(), strict=True)):
        sets[name].setdefault(BlockKey(*key), []).append(row)
    fitted, held_out = (
        _part(words, columns, blocks, model, to_base[name]) if blocks else None
        for name, blocks in sets.items()
    )
    if fitted is None:
        raise ValueError("there are no measurements")
    return fitted, held_out


def _part(
    words: Mapping[str, Sequence[str]],
    columns: Mapping[str, Floats],
    blocks: Mapping[BlockKey, Sequence[int]],
    model: CalibratedModel,
    to_base: Floats,
) -> MeasurementErrors:
    """The errors of one set, by the rows of its blocks."""
    unknown, joints = unknown_errors(model, 0), model.chains.joints
    _, first = side_by_side(_quantities(model))

    def numbers(rows: Sequence[int], form: str, names: Sequence[object]) -> Floats:
        """Cells of columns that are called by a form."""
        found = [columns[form.format(name)][rows] for name in names]
        return np.column_stack([np.zeros((len(rows), 0)), *found])

    def block(key: BlockKey, rows: Sequence[int]) -> Measurements:
        about, start = declared(key.model), first[key.model]
        own = unknown.components[start : start + len(about.components)]
        stated = f"{own[0]}.stated" in columns
        sigma = numbers(rows, "{}.stated", own) if stated else np.array(np.nan)
        file, line, target, payload = (
            [words[column][row] for row in rows] for column in WORDS[1:5]
        )
        held: Any = {n: columns[n][rows] for n in STATED if n in columns}
        if f"direction.{joints[0]}" in columns:
            directions = numbers(rows, "direction.{}", joints)
            held |= {"direction": directions.astype(np.int8), "source": "columns"}
        return Measurements(
            joints=joints,
            q=numbers(rows, "joint.{}", joints),
            values=numbers(rows, "measured.{}", range(1, len(about.values) + 1)),
            sigma=None if np.isnan(sigma).all() else sigma,
            target=Labels.of(target),
            conditions=Conditions(Labels.of(payload), **held),
            start=numbers(rows, "start.{}", joints if about.relative else ()),
            lines=np.array(line, np.int64),
            files=Labels.of(file),
            weight=columns["weight"][rows],
            **key._asdict(),
        )

    rows = [row for chosen in blocks.values() for row in chosen]
    stages = ("before", "after", "sigma")
    errors: Any = {
        stage: numbers(rows, f"{{}}.{stage}", unknown.components) for stage in stages
    }
    return replace(
        unknown,
        rows=Observations(tuple(block(*found) for found in blocks.items())),
        points=numbers(rows, "tool.{}", AXES),
        to_base=np.broadcast_to(to_base, (len(blocks), 3, 3)),
        leverage=columns["leverage"][rows],
        **errors,
    )


def _quantities(model: CalibratedModel) -> Mapping[str, Sequence[Quantity]]:
    """The quantities of each model that measurements were fitted with."""
    return {key.model: term.measurement.quantities for key, term in model.terms.items()}


def unknown_errors(model: CalibratedModel, count: int) -> MeasurementErrors:
    """The errors of measurements that a file says nothing of.

    Args:
        model: The calibrated robot.
        count: Number of measurements.
    """
    joints, (quantities, _) = model.chains.joints, side_by_side(_quantities(model))
    unknown = np.full((count, quantities[-1].columns.stop), np.nan)
    rows = Measurements(
        joints=joints,
        q=np.zeros((count, len(joints))),
        values=np.zeros((count, model.only.measurement.width)),
        **model.only.key._asdict(),
    )
    return MeasurementErrors(
        rows=Observations.of(rows),
        quantities=quantities,
        before=unknown,
        after=unknown,
        sigma=unknown,
        points=np.full((count, 3), np.nan),
        to_base=np.full((1, 3, 3), np.nan),
        leverage=np.full(count, np.nan),
    )
