"""Measurement files: CSV in, `Measurements` in SI units out, and back.

Everything that may be written in several ways (units, orientations, joint columns) is
settled here, once. A file that cannot be right stops the run with its line.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import chain as one_after_another
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.io.columns import Floats
from calib_pin.io.condition_columns import DIRECTION
from calib_pin.io.files import write_atomically
from calib_pin.io.inferred_model import asked_models
from calib_pin.io.joint_columns import (
    own_columns,
    read_positions,
    shown_columns,
)
from calib_pin.io.measurement_blocks import check_names, check_places, read_blocks
from calib_pin.io.table import Table, read_table, require_columns
from calib_pin.io.written_columns import (
    measurement_columns,
    writable,
)
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import (
    Labels,
    Measurements,
    Observations,
    with_directions,
)
from calib_pin.progress import Progress, portion
from calib_pin.setup import JointMap, ReadingSetup

CUT = 0.9
"""Part of the time after which lines are cut into cells."""

LINES = 5000
"""Lines that are written between two reports of the progress."""


def read_measurements(
    paths: str | Path | Sequence[str | Path],
    chain: Chain | Chains,
    *,
    model: str | None = None,
    station_per_file: bool = False,
    unnamed: str | None = None,
    columns: Mapping[str, str] = {},
    joints: Mapping[str, JointMap] = {},
    reading: ReadingSetup | None = None,
    sockets: Collection[str] = (),
    notice: Callable[[str], None] | None = None,
    progress: Progress | None = None,
) -> Observations:
    r"""Read measurement files and join them in the given order.

    Columns `model`, `chain`, `station` and `tool` name the block of each measurement;
    in a file of several models a measurement leaves blank what only the others read. Of
    relative distances the first row of each target is where the others start.

    Args:
        paths: One CSV file, or several.
        chain: Chain whose joints the files hold; where they name others, those of the
            same robot.
        model: Measurement model of the files that have no column `model`; of several
            names with a plus between them each file is read as the only one that its
            columns allow. None infers it from the columns.
        station_per_file: Whether each file is a station, called as the file is.
        unnamed: Chain of measurements that name none; default the only one of `chain`.
        columns: What columns with foreign names are, ours to theirs.
        joints: How file columns become joints; others are taken by their own name.
        reading: How files are to be read where they are not as their columns say.
        sockets: Sockets that are known, for which one configuration is enough.
        notice: Called once per file that has columns without a meaning, with one
            sentence that lists them.
        progress: Told the part that is done, 0 to 1.

    Returns:
        All measurements, in SI units; `files` holds the paths as they were given.
        Joints are those of all chains that files name, and of `chain` where it holds
        named ones; those that a measurement does not state are zero. Blocks are in the
        order in which they begin, first those of the first in `model`.

    Raises:
        InputError: If a file does not hold measurements of this chain; names the file
            and, where it can, the line, the column and the value.
        OptionError: If there is no measurement model of that name.

    Examples:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> text = ",".join([*chain.joints, "x [mm]", "y [mm]", "z [mm]"])
        >>> text += "\n0.1,0.2,0.3,0.4,0.5,0.6,1500,0,250\n"
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "tracker.csv"
        ...     _ = file.write_text(text)
        ...     data = read_measurements(file, chain)
        >>> data.models, data.only.values.tolist()
        (('position',), [[1.5, 0.0, 0.25]])
    """
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    if not files:
        raise InputError("no measurement file is given")
    asked, chains = asked_models(model), Chains.of(chain)
    if unnamed is None:
        unnamed = chains.names[0] if len(chains.names) == 1 else ""
    stations = _stations(files) if station_per_file else [None] * len(files)
    parts, tables = list[Measurements](), list[Table]()
    for k, (file, station) in enumerate(zip(files, stations, strict=True)):
        tell = portion(progress, k / len(files), 1.0 / len(files))
        table = read_table(file, portion(tell, 0.0, CUT), columns=columns)
        if notice is not None:
            for remark in table.remarks:
                notice(f"{file}: {remark}")
        if reading is not None:
            table, reading = _without(table, reading, alone=len(files) == 1)
        tables.append(table.rows(slice(0), table.columns))
        if k + 1 == len(files):
            require_columns(tables)
        parts += read_blocks(
            table,
            chains,
            joints,
            reading.orientation if reading else None,
            asked,
            station,
            unnamed,
            notice,
            tell,
        )
    parts.sort(key=lambda part: [*asked, part.model].index(part.model))
    given = () if chains.names == ("",) else chains.names
    names = dict.fromkeys([*given, *(part.chain for part in parts)])
    data = Observations.of(*_with_joints(parts, chains.named(tuple(names))))
    if reading is not None:
        data = read_otherwise(data, reading)
    data = with_directions(data)
    check_names(data)
    check_places(data, sockets)
    return data


def _without(
    table: Table, reading: ReadingSetup, *, alone: bool
) -> tuple[Table, ReadingSetup]:
    """A file without the lines that are left out, whatever stands there.

    Those of files in another order are left out once they are in order.

    Args:
        table: The file.
        reading: How the files are to be read.
        alone: Whether there is no other file.

    Returns:
        The rows that remain, and what remains to be done.
    """
    late = reading.shift or reading.reversed or reading.lag
    if late or not reading.without:
        return table, reading
    own = {
        place: int(line)
        for place in reading.without
        for file, _, line in [place.rpartition(":")]
        if (alone and not file) or f"/{table.file}".endswith(f"/{file}")
        if int(line) in table.lines
    }
    kept = np.flatnonzero(~np.isin(table.lines, [*own.values()]))
    if not len(kept):
        raise InputError("'reading' leaves out all measurements", file=table.file)
    others = tuple(place for place in reading.without if place not in own)
    return table.rows(kept, table.columns), replace(reading, without=others)


def _stations(files: Sequence[str | Path]) -> list[str | None]:
    """A name for each file: that of the file, made unique."""
    names: list[str | None] = []
    for file in files:
        stem = Path(file).stem
        others = (f"{stem}-{k}" for k in count(2))
        names.append(
            next(
                name for name in one_after_another([stem], others) if name not in names
            )
        )
    return names


def _with_joints(parts: Sequence[Measurements], chains: Chains) -> list[Measurements]:
    """The same with the joints of all chains; those that were not stated are zero."""

    def spread(q: Floats, joints: Sequence[str]) -> Floats:
        result = np.zeros((len(q), len(chains.joints)))
        result[:, [chains.joints.index(joint) for joint in joints]] = q
        return chains.follow(result)

    return [
        part
        if part.joints == chains.joints
        else replace(
            part,
            joints=chains.joints,
            q=spread(part.q, part.joints),
            start=spread(part.start, part.joints) if part.start.size else part.start,
            conditions=part.conditions.among(
                [chains.joints.index(joint) for joint in part.joints],
                len(chains.joints),
            ),
        )
        for part in parts
    ]


def read_configurations(
    path: str | Path,
    chain: Chain | Chains,
    joints: Mapping[str, JointMap] = {},
    columns: Mapping[str, str] = {},
) -> Floats:
    r"""Read only the joint positions of a CSV file; other columns are ignored.

    Args:
        path: CSV file.
        chain: Chain whose joints the file holds, or several.
        joints: How file columns become joints; others are taken by their own name.
        columns: What columns with foreign names are, ours to theirs.

    Returns:
        Joint positions, shape (N, n) [rad, m].

    Raises:
        InputError: As `read_measurements` does.

    Examples:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "configurations.csv"
        ...     _ = file.write_text(",".join(chain.joints) + "\n0,0,0,0.5,0,0\n")
        ...     read_configurations(file, chain).tolist()
        [[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]]
    """
    table = read_table(path, columns=columns)
    table, own = own_columns(table, chain, joints)
    return read_positions(table, chain, own)


def read_names(
    path: str | Path, column: str, columns: Mapping[str, str] = {}
) -> Labels:
    """Read only a column of names of a CSV file; empty where it has none.

    Args:
        path: CSV file.
        column: Name of the column, such as `target`.
        columns: What columns with foreign names are, ours to theirs.

    Raises:
        InputError: If it is not such a file.
    """
    table = read_table(path, columns=columns)
    return table.texts([column]).get(column, Labels.none())


def encode_configurations(
    chain: Chain | Chains,
    q: Floats,
    target: Sequence[str] = (),
    *,
    places: Mapping[str, Sequence[str]] = {},
    sides: Mapping[str, Sequence[int]] = {},
    joints: Mapping[str, JointMap] = {},
    degrees: bool = False,
    comments: Sequence[str] = (),
) -> bytes:
    r"""Configurations to be measured as a CSV file.

    Args:
        chain: The chain, or several.
        q: Joint positions, shape (N, n) [rad, m].
        target: Target of each; no column where none is named.
        places: Columns `chain`, `station` and `tool`, as far as these have names.
        sides: Side from which to come to each, by joint, as far as it matters.
        joints: How file columns become joints; the file holds what a controller
            needs.
        degrees: Whether angles are in degrees.
        comments: Lines for the head of the file.

    Raises:
        InputError: If the joint map cannot be undone.
        OutputError: If a name would not read back.

    Examples:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> encode_configurations(chain, np.array([[0, 0, 0, 0.5, 0, 0.0]])).split()[1]
        b'0.0,0.0,0.0,0.5,0.0,0.0'
        >>> encode_configurations(chain, np.zeros((1, 6)), ["wall\n"])
        Traceback (most recent call last):
        calib_pin.errors.OutputError: target 'wall\n' would not read back
    """
    columns: dict[str, Floats | Sequence[str] | Sequence[int]] = {
        **shown_columns(q, JointColumns.of(chain, joints), degrees)
    }
    columns |= {joint + DIRECTION: column for joint, column in sides.items()}
    named = {**places, "target": target}
    columns |= {k: writable(k, column) for k, column in named.items() if any(column)}
    return encode_table(columns, comments)


def write_measurements(
    path: str | Path,
    measurements: Measurements | Observations,
    comments: Sequence[str] = (),
    force: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write measurements as a CSV file that reads back bit by bit.

    Args:
        path: File to write.
        measurements: Measurements to write; quaternions of unit length with qw >= 0, as
            `read_measurements` gives them, come back unchanged. So do the targets of
            relative distances where every start has one of its own. Those of files
            stand in the order of their lines, others block after block.
        comments: Lines for the head of the file.
        force: Whether an existing file is replaced.
        progress: Told the part that is done, 0 to 1.

    Raises:
        OptionError: If the file exists and `force` is false, or there is no such
            measurement model.
        OutputError: If a name or a relative distance would not read back, or the file
            cannot be written.

    Examples:
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
    measurements: Measurements | Observations,
    comments: Sequence[str] = (),
    progress: Progress | None = None,
) -> bytes:
    """The file that `write_measurements` writes.

    Raises:
        OptionError: If there is no such measurement model.
        OutputError: If a name or a relative distance would not read back.
    """
    return encode_table(dict(measurement_columns(measurements)), comments, progress)


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
