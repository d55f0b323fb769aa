"""Measurement files: CSV in, `Measurements` in SI units out, and back.

Everything that may be written in several ways (units, orientations, joint columns) is
settled here, once. A file that cannot be right stops the run with its line.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.io.columns import Floats
from calib_pin.io.files import write_atomically
from calib_pin.io.joint_columns import (
    column_values,
    joint_sources,
    read_positions,
)
from calib_pin.io.measurement_parts import check_model, check_places, read_parts
from calib_pin.io.table import read_table
from calib_pin.io.written_columns import (
    column_name,
    measurement_columns,
    writable,
)
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models.side_by_side import concatenate
from calib_pin.observations import PLUS, Measurements
from calib_pin.progress import Progress, portion
from calib_pin.setup import JointMap

CUT = 0.9
"""Part of the time after which lines are cut into cells."""

LINES = 5000
"""Lines that are written between two reports of the progress."""


def read_measurements(
    paths: str | Path | Sequence[str | Path],
    chain: Chain,
    *,
    model: str | None = None,
    joints: Mapping[str, JointMap] = {},
    sockets: Collection[str] = (),
    notice: Callable[[str], None] | None = None,
    progress: Progress | None = None,
) -> Measurements:
    r"""Read measurement files and join them in the given order.

    A column `model` names the measurement model row by row; in a file of several a row
    leaves blank what only the others read. Of relative distances the first row of each
    target is where the others of that target start.

    Args:
        paths: One CSV file, or several.
        chain: Chain whose joints the files hold.
        model: Measurement model of the files that have no column `model`; of several
            names with a plus between them each file is read as the only one that its
            columns allow. None infers it from the columns.
        joints: How file columns become joints; others are taken by their own name.
        sockets: Sockets that are known, for which one configuration is enough.
        notice: Called once per file that has columns without a meaning, with one
            sentence that lists them.
        progress: Told the part that is done, 0 to 1.

    Returns:
        All rows, in SI units; `files` holds the paths as they were given. Of several
        models the rows of each stand together, first those of the first in `model`, or
        in the files.

    Raises:
        InputError: If a file does not hold measurements of this chain; names the file
            and, where it can, the line, the column and the value.
        OptionError: If there is no measurement model of that name.

    Example:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> text = ",".join([*chain.joints, "x [mm]", "y [mm]", "z [mm]"])
        >>> text += "\n0.1,0.2,0.3,0.4,0.5,0.6,1500,0,250\n"
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "tracker.csv"
        ...     _ = file.write_text(text)
        ...     data = read_measurements(file, chain)
        >>> data.model, data.values.tolist()
        ('position', [[1.5, 0.0, 0.25]])
    """
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    if not files:
        raise InputError("no measurement file is given")
    if model is not None:
        check_model(model)
    sources = joint_sources(chain, joints)
    parts: list[Measurements] = []
    for k, file in enumerate(files):
        tell = portion(progress, k / len(files), 1.0 / len(files))
        parts += read_parts(
            read_table(file, portion(tell, 0.0, CUT)),
            *(chain, sources, joints, model, notice, tell),
        )
    asked = [] if model is None else model.split(PLUS)
    result = []
    for name in dict.fromkeys([*asked, *(part.model for part in parts)]):
        own = [part for part in parts if part.model == name]
        if own:
            result.append(concatenate(own))
            check_places(result[-1], sockets)
    return concatenate(result)


def read_configurations(
    path: str | Path, chain: Chain, joints: Mapping[str, JointMap] = {}
) -> Floats:
    r"""Read only the joint positions of a CSV file; other columns are ignored.

    Args:
        path: CSV file.
        chain: Chain whose joints the file holds.
        joints: How file columns become joints; others are taken by their own name.

    Returns:
        Joint positions, shape (N, n) [rad, m].

    Raises:
        InputError: As `read_measurements` does.

    Example:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "configurations.csv"
        ...     _ = file.write_text(",".join(chain.joints) + "\n0,0,0,0.5,0,0\n")
        ...     read_configurations(file, chain).tolist()
        [[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]]
    """
    return read_positions(read_table(path), chain, joint_sources(chain, joints))


def read_names(path: str | Path, column: str) -> tuple[str, ...]:
    """Read only a column of names of a CSV file; empty where it has none.

    Args:
        path: CSV file.
        column: `target` or `payload`.

    Raises:
        InputError: If it is not such a file.
    """
    table = read_table(path)
    return table.texts(column) if column in table else ()


def encode_configurations(
    chain: Chain,
    q: Floats,
    target: Sequence[str] = (),
    *,
    joints: Mapping[str, JointMap] = {},
    comments: Sequence[str] = (),
) -> bytes:
    r"""Configurations to be measured as a CSV file.

    Args:
        chain: The chain.
        q: Joint positions, shape (N, n) [rad, m].
        target: Target of each; no column where none is named.
        joints: How file columns become joints; the file holds what a controller
            needs.
        comments: Lines for the head of the file.

    Raises:
        InputError: If the joint map cannot be undone.
        OutputError: If a name would not read back.

    Example:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> encode_configurations(chain, np.array([[0, 0, 0, 0.5, 0, 0.0]])).split()[1]
        b'0.0,0.0,0.0,0.5,0.0,0.0'
        >>> encode_configurations(chain, np.zeros((1, 6)), ["wall\n"])
        Traceback (most recent call last):
        calib_pin.errors.OutputError: target 'wall\n' would not read back
    """
    columns: dict[str, Floats | Sequence[str]] = {}
    for name, values in column_values(q, joint_sources(chain, joints)).items():
        columns[column_name(name)] = values
    if any(target):
        columns["target"] = writable("target", target)
    return encode_table(columns, comments)


def write_measurements(
    path: str | Path,
    measurements: Measurements,
    comments: Sequence[str] = (),
    force: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write measurements as a CSV file that reads back bit by bit.

    Args:
        path: File to write.
        measurements: Measurements to write; quaternions of unit length with qw >= 0, as
            `read_measurements` gives them, come back unchanged. So do rows of several
            models where those of each stand together, and the targets of relative
            distances where every start has one of its own.
        comments: Lines for the head of the file.
        force: Whether an existing file is replaced.
        progress: Told the part that is done, 0 to 1.

    Raises:
        OptionError: If the file exists and `force` is false, or there is no such
            measurement model.
        OutputError: If a name or a relative distance would not read back, or the file
            cannot be written.

    Example:
        >>> import tempfile
        >>> data = Measurements(
        ...     ("lift",), np.array([[0.25]]), "plane-distance", np.array([[1.5]])
        ... )
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "sensor.csv"
        ...     write_measurements(file, data, ["a sensor on a lift"])
        ...     file.read_text().split()[-2:]
        ['lift,distance', '0.25,1.5']
    """
    data = encode_measurements(measurements, comments, progress)
    write_atomically(Path(path), data, force=force)


def encode_measurements(
    measurements: Measurements,
    comments: Sequence[str] = (),
    progress: Progress | None = None,
) -> bytes:
    """The file that `write_measurements` writes.

    Raises:
        OptionError: If there is no such measurement model.
        OutputError: If a name or a relative distance would not read back.
    """
    check_model(measurements.model)
    columns = dict(measurement_columns(measurements))
    return encode_table(columns, comments, progress)


def encode_table(
    columns: Mapping[str, Sequence[object] | NDArray[Any]],
    comments: Sequence[str],
    progress: Progress | None = None,
) -> bytes:
    """A CSV file.

    Args:
        columns: Cells of every column by its header.
        comments: Lines for the head of the file.
        progress: Told the part that is done, 0 to 1.
    """
    data, text = io.BytesIO(), io.StringIO(newline="")
    for comment in comments:
        for line in comment.splitlines() or [""]:
            text.write(f"# {line}".rstrip() + "\n")
    # The csv module writes floats by repr, which loses nothing.
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    count = max(map(len, columns.values()), default=0)
    for start in range(0, count, LINES):
        parts = [column[start : start + LINES] for column in columns.values()]
        # numpy's own numbers would be written slowly.
        cells = [p.tolist() if isinstance(p, np.ndarray) else p for p in parts]
        writer.writerows(zip(*cells, strict=True))
        data.write(text.getvalue().encode())
        text.seek(0)
        text.truncate()
        if progress is not None:
            progress(start / count)
    data.write(text.getvalue().encode())
    return data.getvalue()
