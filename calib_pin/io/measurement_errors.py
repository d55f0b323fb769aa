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

import numpy as np

from calib_pin.io.columns import GrowingColumn
from calib_pin.io.csv_text import CsvText
from calib_pin.io.measurements import LINES
from calib_pin.io.result_folder import MEASUREMENTS
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.measurement_errors import AXES, MeasurementErrors
from calib_pin.validation.result import CalibrationResult

SETS = ("train", "validate")
WORDS = ("set", "file", "line", "target", "payload")
"""The first columns; all others hold numbers."""

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
    from pydantic_core import to_json

    parts = [result.fitted, *([] if result.held_out is None else [result.held_out])]
    tables = [p.table(name) for p, name in zip(parts, SETS, strict=False)]
    names = dict.fromkeys(name for table in tables for name in table)
    numbers = [name for name in names if name not in WORDS]
    text, found = io.StringIO(newline=""), list[bytes]()
    text.write("".join(f"# {line}\n" for line in LEGEND.format(run=run).splitlines()))
    csv.writer(text, lineterminator="\n").writerow([*WORDS, *numbers])
    # Files may have names that are not UTF-8.
    found.append(text.getvalue().encode("utf-8", "backslashreplace"))
    for table in tables:
        unknown = [math.nan] * len(table["set"])
        for start in range(0, len(unknown), LINES):
            part = slice(start, start + LINES)
            words = io.StringIO(newline="")
            csv.writer(words, lineterminator="\0").writerows(
                zip(*(table[name][part] for name in WORDS), strict=True)
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
    data: bytes, model: CalibratedModel, to_base: Floats
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements.

    Args:
        data: Bytes of the file.
        model: The calibrated robot.
        to_base: Rotation from the measurement frame to the base link, shape (3, 3).

    Raises:
        ValueError: If a column is missing, or there is no measurement.
        InputError: If it is no CSV file.
    """
    first, stretches = CsvText(MEASUREMENTS, len(data), data).split()
    header = first.cells(0)
    if missing := set(WORDS) - set(header):
        raise ValueError(f"columns are missing: {', '.join(sorted(missing))}")
    words: dict[str, list[str]] = {name: [] for name in WORDS}
    numbers = {name: GrowingColumn() for name in header if name not in words}
    for stretch in stretches:
        for name, cells in zip(header, stretch.columns(header), strict=True):
            (words[name] if name in words else numbers[name]).extend(cells)
    columns = {name: np.frombuffer(found.numbers) for name, found in numbers.items()}
    fitted, held_out = (_part(words, columns, model, to_base, name) for name in SETS)
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
    chosen = np.flatnonzero(np.array(words["set"]) == name)
    if not len(chosen):
        return None
    file, line, target, payload = (
        tuple(words[column][row] for row in chosen.tolist()) for column in WORDS[1:]
    )

    def numbers(*names: str) -> Floats:
        for column in names:
            if column not in columns:
                raise ValueError(f"the column '{column}' is missing")
        return np.stack([columns[column][chosen] for column in names], axis=1)

    components = unknown_errors(model, 0).components
    stated = [f"{component}.stated" for component in components]
    joints = model.chain.joints
    starts = [f"start.{joint}" for joint in joints]
    rows = Measurements(
        joints=joints,
        q=numbers(*(f"joint.{joint}" for joint in joints)),
        model=model.measurement.name,
        values=numbers(*(f"measured.{k + 1}" for k in range(model.measurement.width))),
        sigma=numbers(*stated) if stated[0] in columns else None,
        target=target,
        payload=payload,
        start=numbers(*starts) if starts[0] in columns else np.zeros((0, 0)),
        lines=np.array(line, np.int64),
        files=file,
        weight=numbers("weight")[:, 0],
    )
    before, after, sigma = (
        numbers(*(f"{component}.{stage}" for component in components))
        for stage in ("before", "after", "sigma")
    )
    return MeasurementErrors(
        rows=rows,
        quantities=tuple(model.measurement.quantities),
        before=before,
        after=after,
        sigma=sigma,
        points=numbers(*(f"tool.{axis}" for axis in AXES)),
        to_base=to_base,
        leverage=numbers("leverage")[:, 0],
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
