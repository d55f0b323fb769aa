"""`measurements.csv`: a result measurement by measurement, in SI units.

One line for every fitted measurement (`train`) and one for every held-out prediction
(`validate`): where it stands, where the robot was, what was measured, and how far the
nominal and the calibrated robot are off. Numbers come back exactly.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib_pin.io.measurements import encode_table
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.measurement_errors import AXES, MeasurementErrors
from calib_pin.validation.result import CalibrationResult

FILE_NAME = "measurements.csv"
"""Name beside `calibration.json`."""

SETS = ("train", "validate")
WORDS = ("set", "file", "line", "target", "payload")
"""Columns that hold no numbers, but for the line."""

LEGEND = """\
calib-pin measurements of a calibration, run {run}; lengths in m, angles in rad, images
in px. set: train is fitted, validate is predicted by a fit without it. <joint>: the
commanded position, start.<joint> that of the first configuration of a relative
measurement. measured.<k>: the values in the layout of the model. weight: 0 is rejected.
leverage: of the fit. tool.<axis>: the calibrated tool point in the base link.
<component>.before, .after: predicted minus measured by the nominal robot (registered)
and by the calibrated one. .sigma: its standard deviation as it is used, .stated: as it
was stated. An empty cell is a number that a measurement does not have."""


def encode_errors(result: CalibrationResult, run: str) -> bytes:
    """The file of a result.

    Args:
        result: The result.
        run: Id of the run that it is of.
    """
    parts = [result.fitted, *([] if result.held_out is None else [result.held_out])]
    tables = [p.table(name) for p, name in zip(parts, SETS, strict=False)]
    cells: dict[str, list[object]] = {name: [] for t in tables for name in t}
    for table, part in zip(tables, parts, strict=True):
        for name, column in cells.items():
            column += map(_cell, table.get(name, [""] * len(part)))
    return encode_table(cells, LEGEND.format(run=run).splitlines())


def _cell(value: object) -> object:
    """A cell; empty for a number that there is not."""
    return "" if value != value else value


def decode_errors(
    data: bytes, model: CalibratedModel, to_base: Floats
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements.

    Args:
        data: Bytes of the file.
        model: The calibrated robot.
        to_base: Rotation from the measurement frame to the base link, shape (3, 3).

    Raises:
        ValueError: If a column or a number is missing, or is none.
    """
    text = data.decode("utf-8", "surrogateescape")
    lines = (line for line in text.splitlines() if not line.startswith("#"))
    header, *cells = csv.reader(lines)
    if any(len(row) != len(header) for row in cells):
        raise ValueError("a line has more or fewer cells than the header")
    columns = dict(zip(header, zip(*cells, strict=True), strict=False))
    for name in WORDS:
        if name not in header:
            raise ValueError(f"the column '{name}' is missing")
    found = [_part(columns, model, to_base, name) for name in SETS]
    fitted, held_out = found
    if fitted is None:
        raise ValueError("there are no measurements")
    return fitted, held_out


def _part(
    columns: dict[str, tuple[str, ...]],
    model: CalibratedModel,
    to_base: Floats,
    name: str,
) -> MeasurementErrors | None:
    chosen = [k for k, word in enumerate(columns.get("set", ())) if word == name]
    if not chosen:
        return None
    joints, quantities = model.chain.joints, tuple(model.measurement.quantities)

    def words(column: str) -> tuple[str, ...]:
        return tuple(map(columns[column].__getitem__, chosen))

    def numbers(names: Sequence[str]) -> Floats:
        for column in names:
            if column not in columns:
                raise ValueError(f"the column '{column}' is missing")
        table = [[float(cell or "nan") for cell in words(column)] for column in names]
        return np.array(table, float).reshape(len(names), len(chosen)).T.copy()

    components = unknown_errors(model, 0).components
    stated = [f"{component}.stated" for component in components]
    starts = [f"start.{joint}" for joint in joints]
    width = model.measurement.width
    lines: NDArray[np.int64] = np.array([int(word) for word in words("line")])
    rows = Measurements(
        joints=joints,
        q=numbers([f"joint.{joint}" for joint in joints]),
        model=model.measurement.name,
        values=numbers([f"measured.{k + 1}" for k in range(width)]),
        sigma=numbers(stated) if stated[0] in columns else None,
        target=words("target"),
        payload=words("payload"),
        start=numbers(starts) if starts[0] in columns else np.zeros((0, 0)),
        lines=lines,
        files=words("file"),
        weight=numbers(["weight"])[:, 0],
    )
    before, after, sigma = (
        numbers([f"{component}.{stage}" for component in components])
        for stage in ("before", "after", "sigma")
    )
    return MeasurementErrors(
        rows=rows,
        quantities=quantities,
        before=before,
        after=after,
        sigma=sigma,
        points=numbers([f"tool.{axis}" for axis in AXES]),
        to_base=to_base,
        leverage=numbers(["leverage"])[:, 0],
    )


def unknown_errors(model: CalibratedModel, count: int) -> MeasurementErrors:
    """The errors of measurements that a file says nothing of.

    Args:
        model: The calibrated robot.
        count: Number of measurements.
    """
    joints, quantities = model.chain.joints, tuple(model.measurement.quantities)
    unknown = np.full((count, quantities[-1].columns.stop), np.nan)
    width = model.measurement.width
    rows = Measurements(
        joints=joints,
        q=np.zeros((count, len(joints))),
        model=model.measurement.name,
        values=np.zeros((count, width)),
        target=("",) * count,
    )
    return MeasurementErrors(
        rows=rows,
        quantities=quantities,
        before=unknown,
        after=unknown,
        sigma=unknown,
        points=np.full((count, 3), np.nan),
        to_base=np.full((3, 3), np.nan),
        leverage=np.full(count, np.nan),
    )
