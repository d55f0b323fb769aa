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
from calib_pin.io.cells import read_cells
from calib_pin.io.measurements import LINES
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
WORDS = ("set", "file", "line", "target", "payload")
"""The first columns; all others but `KEYS` hold numbers."""

STATED = ("temperature", "time")
"""Columns of conditions, where they are known."""

KEYS = BlockKey._fields
"""Columns that stand behind these where there are several blocks of measurements."""

LEGEND = """\
calib-pin measurements of a calibration, run {run}; lengths in m, angles in rad, images
in px. set: train is fitted, validate is predicted by a fit without it. <joint>: the
commanded position, start.<joint> that of the first configuration of a relative
measurement, direction.<joint> the sign of its last motion, 0 where it is not known.
measured.<k>: the values in the layout of the model. weight: 0 is rejected.
leverage: of the fit. tool.<axis>: the calibrated tool point in the base link.
<component>.before, .after: predicted minus measured by the nominal robot (registered)
and by the calibrated one. .sigma: its standard deviation as it is used, .stated: as it
was stated. An empty cell is a number that a measurement does not have."""

OF_BLOCKS = """
model, chain, station, tool: the block. A model has its own values and components."""
"""End of the legend where there are several blocks."""


def encode_errors(result: CalibrationResult, run: str) -> bytes:
    """The file of a result.

    Args:
        result: The result.
        run: Id of the run that it is of.
    """
    from pydantic_core import to_json

    parts = [result.fitted, *([] if result.held_out is None else [result.held_out])]
    directed = "direction" in needed_conditions(result.model.setup.parameters)
    tables = [p.table(name, directed) for p, name in zip(parts, SETS, strict=False)]
    names = dict.fromkeys(name for table in tables for name in table)
    told = [*WORDS, *(name for name in KEYS if name in names)]
    for errors, table in zip(parts, tables, strict=True):
        if told != [*WORDS] and "model" not in table:
            key = errors.rows.only.key._asdict()
            table |= {name: [value] * len(errors) for name, value in key.items()}
    numbers = [name for name in names if name not in told]
    text, found = io.StringIO(newline=""), list[bytes]()
    legend = LEGEND.format(run=run) + (OF_BLOCKS if "model" in told else "")
    text.write("".join(f"# {line}\n" for line in legend.splitlines()))
    csv.writer(text, lineterminator="\n").writerow([*told, *numbers])
    # Files may have names that are not UTF-8.
    found.append(text.getvalue().encode("utf-8", "backslashreplace"))
    for table in tables:
        unknown = [math.nan] * len(table["set"])
        for start in range(0, len(unknown), LINES):
            part = slice(start, start + LINES)
            words = io.StringIO(newline="")
            csv.writer(words, lineterminator="\0").writerows(
                zip(*(table[name][part] for name in told), strict=True)
            )
            heads = words.getvalue().encode("utf-8", "backslashreplace").split(b"\0")
            cells = zip(*(table.get(n, unknown)[part] for n in numbers), strict=True)
            # A JSON writer is four times faster than `repr`, and as exact.
            lines = to_json(list(cells), inf_nan_mode="constants")
            lines = lines.replace(b"NaN", b"").replace(b"Infinity", b"inf")
            tails = lines[2:-2].split(b"],[")
            found += (b"%b,%b\n" % line for line in zip(heads, tails, strict=False))
    return b"".join(found)


def decode_errors(
    data: bytes, model: CalibratedModel, to_base: Mapping[str, Floats]
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements.

    Args:
        data: Bytes of the file.
        model: The calibrated robot.
        to_base: By set, rotations from the measurement frame of each block to its base
            link, shape (B, 3, 3), or one for all, shape (3, 3).

    Raises:
        KeyError: If a column is missing.
        ValueError: If there is no measurement, or a cell is no number.
        InputError: If it is no CSV file.
    """
    cells = read_cells(data, MEASUREMENTS)
    whole = {n: c.grown(n) for n, c in zip(cells.header, cells.columns, strict=True)}
    words = {n: [*whole[n].texts()] for n in (*WORDS, *KEYS) if n in whole}
    columns = {name: column.numbers for name, column in whole.items()}
    count, only = len(words["set"]), model.only.key._asdict()
    words = {name: [value] * count for name, value in only.items()} | words
    fitted, held_out = (
        _part(words, columns, model, to_base[name], name) for name in SETS
    )
    if fitted is None:
        raise ValueError("there are no measurements")
    return fitted, held_out


def _part(
    words: Mapping[str, Sequence[str]],
    columns: Mapping[str, Floats],
    model: CalibratedModel,
    to_base: Floats,
    name: str,
) -> MeasurementErrors | None:
    """The errors of one set; None where it is empty."""
    of_block: dict[BlockKey, list[int]] = {}
    keys = map(BlockKey, *(words[column] for column in KEYS))
    for row, (found, key) in enumerate(zip(words["set"], keys, strict=True)):
        if found == name:
            of_block.setdefault(key, []).append(row)
    if not of_block:
        return None
    unknown, joints = unknown_errors(model, 0), model.chains.joints
    _, first = side_by_side(_quantities(model))

    def numbers(rows: Sequence[int], form: str, names: Sequence[object]) -> Floats:
        """Cells of columns that are called by a form."""
        found = [columns[form.format(name)][rows] for name in names]
        return np.column_stack([np.zeros((len(rows), 0)), *found])

    def block(key: BlockKey, rows: Sequence[int]) -> Measurements:
        about, at = declared(key.model), first[key.model]
        own = unknown.components[at : at + len(about.components)]
        sigma = None
        if f"{own[0]}.stated" in columns:
            sigma = numbers(rows, "{}.stated", own)
        file, line, target, payload = (
            [words[column][row] for row in rows] for column in WORDS[1:]
        )
        held: Any = {n: columns[n][rows] for n in STATED if n in columns}
        if f"direction.{joints[0]}" in columns:
            directions = numbers(rows, "direction.{}", joints)
            held |= {"direction": directions.astype(np.int8), "source": "columns"}
        return Measurements(
            joints=joints,
            q=numbers(rows, "joint.{}", joints),
            values=numbers(rows, "measured.{}", range(1, len(about.values) + 1)),
            sigma=None if sigma is None or np.isnan(sigma).all() else sigma,
            target=Labels.of(target),
            conditions=Conditions(Labels.of(payload), **held),
            start=numbers(rows, "start.{}", joints if about.relative else ()),
            lines=np.array(line, np.int64),
            files=Labels.of(file),
            weight=columns["weight"][rows],
            **key._asdict(),
        )

    rows = [row for chosen in of_block.values() for row in chosen]
    stages = ("before", "after", "sigma")
    errors: Any = {
        stage: numbers(rows, f"{{}}.{stage}", unknown.components) for stage in stages
    }
    return replace(
        unknown,
        rows=Observations(tuple(block(*found) for found in of_block.items())),
        points=numbers(rows, "tool.{}", AXES),
        to_base=np.broadcast_to(to_base, (len(of_block), 3, 3)),
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
