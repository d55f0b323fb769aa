"""Measurement files: CSV in, `Measurements` in SI units out, and back.

Everything that may be written in several ways (units, orientations, joint columns) is
settled here, once. A file that cannot be right stops the run with its line.
"""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib_pin.io.measured_columns as measured_columns
from calib_pin.errors import InputError, OutputError, RobotError, nearest
from calib_pin.io.columns import NAMES, OURS, Column, Floats, closest
from calib_pin.io.files import write_atomically
from calib_pin.io.foreign_headers import check_gauges
from calib_pin.io.measured_columns import DIRECTION, POSITION, place_of
from calib_pin.io.table import Notice, Table, read_table, require_columns, with_readings
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import JointColumns, drives_of
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.measurement_models.declaration import QUATERNION
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import (
    BlockKey,
    Booleans,
    Conditions,
    Indices,
    Labels,
    Measurements,
    Observations,
    approached,
    with_directions,
)
from calib_pin.observations.measurements import SourcedRows, with_joints
from calib_pin.progress import Progress, portion
from calib_pin.setup import STATED, WORLD, JointMap, OrientationSetup, ReadingSetup
from calib_pin.units import steps_of

LINES = 5000
"""Lines that are written between two reports of the progress."""

Keys = dict[BlockKey, Indices | slice]
"""The rows of each block."""


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
    notice: Notice | None = None,
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
    asked, chains = measured_columns.asked_models(model), Chains.of(chain)
    if unnamed is None:
        unnamed = chains.names[0] if len(chains.names) == 1 else ""
    notice, reading = notice or (lambda remark: None), reading or ReadingSetup()
    reader = _Reader(chains, asked, joints, reading.orientation, unnamed, notice)
    parts, tables, stations = list[Measurements](), list[Table](), [""]
    for k, file in enumerate(files):
        tell = portion(progress, k / len(files), 1.0 / len(files))
        table = read_table(file, tell, columns=columns)
        for remark in table.remarks:
            notice(f"{file}: {remark}")
        if reading.without:
            table, reading = _without_lines(table, reading, alone=len(files) == 1)
        tables.append(table.rows(slice(0)))
        if k + 1 == len(files):
            require_columns(tables)
        if station_per_file:
            stem = Path(file).stem
            called = (f"{stem}-{n}" if n > 1 else stem for n in count(1))
            stations.append(next(name for name in called if name not in stations))
            if "station" in table:
                reason = "the file names stations, leave out --station-per-file"
                raise table.error(reason, "station")
        parts += reader.blocks(table, stations[-1])
    parts.sort(key=lambda part: [*asked, part.model].index(part.model))
    names = () if chains.names == ("",) else chains.names
    chains = chains.named((*names, *(part.chain for part in parts)))
    data = Observations.of(*(_with_joints(part, chains) for part in parts))
    data = with_directions(read_otherwise(data, reading))
    _check_names(data, sockets)
    return data


def _without_lines(
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
    lines = dict[str, int]()
    late = reading.shift or reading.reversed or reading.lag
    for place in () if late else reading.without:
        file, _, line = place.rpartition(":")
        mine = f"/{table.file}".endswith(f"/{file}") if file else alone
        if mine and int(line) in table.lines:
            lines[place] = int(line)
    table = table.rows(np.flatnonzero(~np.isin(table.lines, [*lines.values()])))
    if not len(table.lines):
        raise InputError("'reading' leaves out all measurements", file=table.file)
    others = tuple(place for place in reading.without if place not in lines)
    return table, replace(reading, without=others)


def _with_joints(part: Measurements, chains: Chains) -> Measurements:
    """The same with the joints of all chains; those that were not stated are zero."""
    if part.joints == chains.joints:
        return part
    part = with_joints(part, chains.joints)
    start = chains.follow(part.start) if part.start.size else part.start
    return replace(part, q=chains.follow(part.q), start=start)


@dataclass(frozen=True)
class _Reader:
    """How measurements of a file are read.

    Attributes:
        chains: The chains that it may name.
        asked: Measurement models of a file without a column `model`.
        joints: How file columns become joints; others are taken by their own name.
        orientation: How columns of an orientation are to be read.
        unnamed: Chain of measurements that name none.
        notice: Called with sentences about the file.
    """

    chains: Chains
    asked: Sequence[str]
    joints: Mapping[str, JointMap]
    orientation: OrientationSetup | None
    unnamed: str
    notice: Notice

    def blocks(self, table: Table, station: str) -> list[Measurements]:
        """Measurements of the file, in the order in which blocks begin.

        A measurement leaves blank what only the models of others read: a number there
        was meant to be read, and would be lost. Columns that none of them reads may
        hold anything.

        Args:
            table: The file.
            station: Station of all, where the file names none.

        Raises:
            InputError: If a measurement names a model or a chain that there is not, or
                has a value of another model, or the file does not hold such.
        """
        chain_of = table.labels("chain").map(lambda name: name or self.unnamed)
        for name in chain_of.distinct if "chain" in table else ():
            try:
                self.chains.named((name,))
            except RobotError as error:
                wrong = chain_of.where(name)
                table.refuse(wrong, error.reason, "chain", error.allowed or "")
        chains = self.chains.named(chain_of.distinct)
        table, columns = measured_columns.joints_in(table, chains, self.joints)
        table = self._of_sheet(table)
        keys = self._keys(table, chain_of, station)
        missing = _missing(table, chains, columns, keys)
        complete = with_readings(table, missing, "measurements", self.notice)
        if complete is not table:
            return self.blocks(complete, station)
        q = measured_columns.read_positions(table, chains, columns, chain_of)
        spare = measured_columns.spare_columns(table, chains, self.joints)
        further = measured_columns.spare_positions(table, chains, columns, q, spare)
        held, used = measured_columns.read_conditions(table, chains.joints)
        steps = {
            joint: turn[0]
            for joint, (name, _) in columns.maps.items()
            if name in table and (turn := steps_of(table.columns[name].unit or ""))
        }
        payload = table.labels("payload")
        held = replace(held, payload=payload, spare=further, steps=steps)
        parts, unread = list[Measurements](), {*spare} - used - {*NAMES} - OURS
        read = {key: measured_columns.read_by(key.model) for key in keys}
        anybody = frozenset[str]().union(*read.values())
        for key, rows in keys.items():
            block = table.rows(rows)
            for name in (n for n in block.columns if n in anybody - read[key]):
                filled = ~block.columns[name].missing()
                reason = f"the row measures '{key.model}', which has no {name}"
                block.refuse(filled, reason, name, "a blank cell")
            part, names = self._block(block, chains, key, q[rows], held.rows(rows))
            parts.append(part)
            unread -= names
        ignored = [name for name in table.columns if name in unread]
        if any(declared(part.model).contact for part in parts):
            check_gauges(table, ignored)
        if ignored:
            self.notice(table.ignored(ignored))
        return parts

    def _of_sheet(self, table: Table) -> Table:
        """The file with z = 0 where it states x and y alone: points of a sheet."""
        names = table.columns.keys()
        others = measured_columns.ORIENTED & names or {*self.asked} - {"position"}
        hidden = "z" in {*names, *table.missing} or closest("z", names)
        if hidden or others or not {"x", "y"} <= names:
            return table
        self.notice(f"{table.file}: no z: a sheet, z = 0, on which the robot stands")
        z = Column("z", None, np.zeros(len(table.lines)))
        return replace(table, columns={**table.columns, "z": z})

    def _keys(self, table: Table, chain_of: Labels, station: str) -> Keys:
        """The rows of each block, in the order in which these begin."""
        models = table.labels("model")
        if "model" not in table:
            model = measured_columns.infer_model(table, self.asked)
            models = Labels.all(model, len(table.lines))
        for name in (n for n in models.distinct if n not in MEASUREMENT_MODELS):
            reason = f"unknown measurement model{nearest(name, MEASUREMENT_MODELS)}"
            allowed = ", ".join(MEASUREMENT_MODELS)
            table.refuse(models.where(name), reason, "model", allowed)
        stations, tools = table.labels("station", station), table.labels("tool")
        columns = models, chain_of, stations, tools
        code = np.zeros(len(table.lines), np.int64)
        for column in columns:
            code = code * len(column.names) + column.codes
        first = np.sort(np.unique(code, return_index=True)[1]).tolist()
        rows = [np.flatnonzero(code == code[row]) for row in first]
        keys = [BlockKey(*(column[row] for column in columns)) for row in first]
        return dict(zip(keys, rows if len(keys) > 1 else [slice(None)], strict=True))

    def _block(
        self, table: Table, chains: Chains, key: BlockKey, q: Floats, held: Conditions
    ) -> tuple[Measurements, set[str]]:
        """Measurements of one block, and the columns that hold them."""
        needed = {*NAMES, *measured_columns.needed(key.model)}
        items = table.columns.items()
        columns = {n: c for n, c in items if n in needed or not c.missing().all()}
        table = replace(table, columns=columns)
        orientation = self.orientation
        read, values = measured_columns.read_values(table, key.model, orientation)
        # How far apart points stand that stand still has nothing to do with the robot.
        if "x" in read and key.chain != WORLD:
            measured_columns.check_spread(table, chains[key.chain], values[:, :3])
        start = np.zeros((0, 0))
        if declared(key.model).relative:
            row_of = measured_columns.find_starts(table, values[:, 0], q)
            rows = np.flatnonzero(row_of != np.arange(len(row_of)))
            table, start = table.rows(rows), q[row_of[rows]]
            q, values, held = q[rows], values[rows], held.rows(rows)
        of_sigma, sigma = measured_columns.read_sigma(table, key.model)
        sets = table.labels("set", "train")
        validate = sets.where("validate")
        wrong = ~validate & ~sets.where("train")
        table.refuse(wrong, "unknown set", "set", "train, validate")
        ways = (way for way, columns in STATED.items() if {*columns} <= {*read})
        part = Measurements(
            joints=chains.joints,
            q=q,
            values=values,
            sigma=sigma,
            target=table.labels("target"),
            conditions=held,
            start=start,
            validate=validate,
            lines=table.lines,
            files=Labels.all(table.file, len(q)),
            orientation=next(ways, ""),
            **key._asdict(),
        )
        return part, {*read, *of_sigma.values()}


def _missing(
    table: Table, chains: Chains, columns: JointColumns, keys: Keys
) -> dict[str, Booleans]:
    """Whether each row lacks what its model and its joints read, shape (N,) each."""
    result = defaultdict[str, Booleans](lambda: np.zeros(len(table.lines), bool))
    for key, rows in keys.items():
        block, optional = table.rows(rows), measured_columns.optional(key.model)
        joints = drives_of(chains[key.chain])
        drives = {n for j in joints for n in measured_columns.kinds_of(columns, j)}
        read = drives | measured_columns.measured(key.model).keys()
        for name in (name for name in table.columns if name in read):
            missing = table.columns[name].missing()[rows]
            if missing.any() and not (missing.all() and name in optional):
                result[name][rows] = missing
        if {*POSITION} <= read & block.columns.keys():
            result["x"][rows] |= _lost_targets(block, drives & block.columns.keys())
    return result


def _lost_targets(table: Table, drives: Collection[str]) -> Booleans:
    """Which positions or orientations are signs of a lost target, shape (N,).

    Trackers write 0, -1 or -999 three times, which no instrument measures at several
    configurations, and a quaternion of zeros.
    """
    x, y, z = (table.columns[axis].numbers for axis in POSITION)
    lost: Booleans = (x == y) & (y == z) & (table.columns["z"].theirs != "")
    for number in np.unique(x[lost]):
        rows = lost & (x == number)
        joints = [table.columns[name].numbers[rows] for name in drives]
        lost[rows] = any(np.ptp(positions) != 0.0 for positions in joints)
    if {*QUATERNION} <= table.columns.keys():
        lost |= ~np.any([table.columns[name].numbers for name in QUATERNION], axis=0)
    return lost


def _check_names(data: Observations, sockets: Collection[str]) -> None:
    """Refuse names that some rows leave open, and sockets of one configuration.

    The places of one station are the same for all chains and tools.
    """
    for block in data.blocks:
        siblings = [key for key in data.keys if key[:2] == block.key[:2]]
        for k in ("station", "tool"):
            if not getattr(block, k) and any(getattr(key, k) for key in siblings):
                raise block.error(0, f"the row names no {k}, others do", column=k)
        still, naming = block.chain == WORLD, declared(block.model).naming
        if still or naming.required == "every":
            noun = f"point of chain '{WORLD}'" if still else naming.noun
            reason = f"the row names no {noun} in a column 'target'"
            _refuse_targets(block, block.target.map(place_of).where(""), reason)
    for model, station in dict.fromkeys((key.model, key.station) for key in data.keys):
        blocks = [b for b in data.blocks if (b.model, b.station) == (model, station)]
        rows, naming = Observations(tuple(blocks)), declared(model).naming
        places, noun = rows.target.map(place_of), naming.noun
        nameless = places.where("")
        if naming.required == "all or none" and not nameless.all():
            _refuse_targets(rows, nameless, f"the row names no {noun}, others do")
        if naming.configurations > 1:
            seen = np.unique(rows.groups() * len(places.names) + places.codes)
            seldom = np.bincount(seen % len(places.names)) == 1
            lonely = (seldom & ~np.isin(places.names, [*sockets]))[places.codes]
            first = f"the {noun} '{places[int(np.argmax(lonely))]}'"
            _refuse_targets(rows, lonely, f"{first} has one configuration only")


def _refuse_targets(rows: SourcedRows, wrong: Booleans, reason: str) -> None:
    if wrong.any():
        raise rows.error(int(np.argmax(wrong)), reason, column="target")


def read_held(table: Table, joints: Sequence[str], q: Floats) -> Conditions:
    """The conditions at the configurations of a file.

    Args:
        table: The file.
        joints: Names of the joints.
        q: The configurations, shape (N, n) [rad, m]; directions that the file does not
            state are those from one to the next.

    Raises:
        InputError: If a direction is none.
    """
    held, _ = measured_columns.read_conditions(table, joints)
    if not held.direction.size:
        held = replace(held, direction=approached(q), source="order")
    return replace(held, payload=table.labels("payload"))


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
    table, joint_columns = measured_columns.joints_in(table, chain, joints)
    return measured_columns.read_positions(table, chain, joint_columns)


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
    joint_columns = JointColumns.of(chain, joints)
    columns = dict[str, Any](measured_columns.shown_columns(q, joint_columns, degrees))
    columns |= {joint + DIRECTION: column for joint, column in sides.items()}
    named = {**places, "target": target}
    columns |= {k: _writable(k, column) for k, column in named.items() if any(column)}
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
            `read_measurements` gives them, come back unchanged. Of relative distances
            every start needs a target of its own. Measurements of files stand in the
            order of their lines, others block after block.
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
    data = encode_table(measurement_columns(measurements), comments, progress)
    write_atomically(Path(path), data, force=force)


def measurement_columns(
    measurements: Measurements | Observations, joint_columns: JointColumns | None = None
) -> dict[str, Labels | NDArray[Any]]:
    """Cells of the columns that hold measurements, by name.

    Args:
        measurements: The measurements.
        joint_columns: Columns of the joints; default one of its name for each.

    Raises:
        InputError: If the couplings of the joint map cannot be undone.
        OptionError: If there is no measurement model of a name.
        OutputError: If a name or a relative distance would not read back.
    """
    data = _with_starts(Observations.of(measurements))
    names, held = map(measured_columns.column_name, data.joints), data.conditions
    columns = dict[str, Any](zip(names, data.q.T, strict=True))
    if joint_columns is not None:
        columns = dict(measured_columns.shown_columns(data.q, joint_columns))
    for field in BlockKey._fields:
        of_block = Labels.of([getattr(block, field) for block in data.blocks])
        if len(of_block.distinct) > 1 or (field != "model" and any(of_block)):
            columns[field] = _writable(field, of_block[data.block_of])
    columns |= _value_columns(data)
    for field, labels in (("target", data.target), ("payload", data.payload)):
        if any(labels.distinct):
            columns[field] = _writable(field, labels)
    # Directions that follow from the order of rows, or from their time, do so again.
    if held.source == "columns":
        ends = (joint + DIRECTION for joint in data.joints)
        columns |= zip(ends, held.direction.T, strict=True)
    for name in ("temperature", "time"):
        if len(column := getattr(held, name)):
            columns[name] = column
    if data.validate.any():
        columns["set"] = Labels(("train", "validate"), data.validate.astype(int))
    return {name: column[data.in_order] for name, column in columns.items()}


def _value_columns(data: Observations) -> dict[str, Floats]:
    """The columns of all blocks, NaN where a block has no such column."""
    values, sigmas = (
        defaultdict[str, Floats](lambda: np.full(len(data), np.nan)) for _ in range(2)
    )
    for block, rows in zip(data.blocks, data.slices, strict=True):
        model = declared(block.model)
        names = model.values or tuple(name for name, _ in model.readings)
        for name, column in zip(names, block.values.T, strict=False):
            values[name][rows] = column
        if block.sigma is not None:
            for name, column in zip(model.components, block.sigma.T, strict=True):
                sigmas[f"sigma_{name}"][rows] = column
    return values | sigmas


def _with_starts(data: Observations) -> Observations:
    """With a row for every start, before the first that is measured from it.

    Raises:
        OutputError: If a relative distance would not read back.
    """
    blocks, rank = list[Measurements](), np.argsort(data.in_order)
    for block, rows in zip(data.blocks, data.slices, strict=True):
        if declared(block.model).relative:
            # The first that is measured from a start is the first in the file.
            block = _with_start_rows(block.rows(np.argsort(rank[rows])))
        blocks.append(block)
    return Observations(tuple(blocks))


def _with_start_rows(data: Measurements) -> Measurements:
    """Relative measurements with a row for every start, which targets tell apart."""
    start = data.start if data.start.size else data.q * np.nan
    _, firsts, which = np.unique(data.target.codes, True, True)
    load, first = data.payload.codes, firsts[which]
    # Without a start, at it, not away from it, or from another than their target's.
    wrong = np.isnan(start).any(axis=1) | (data.q == start).all(axis=1)
    wrong |= (data.values[:, 0] <= 0.0) | (load != load[first])
    wrong |= (start != start[first]).any(axis=1)
    if wrong.any():
        place = data.source(int(np.argmax(wrong)))
        raise OutputError(f"{place}: the relative distance would not read back")
    index = np.sort(np.append(np.arange(len(data)), firsts))
    begin = np.append(np.diff(index) == 0, False)
    rows = data.rows(index)
    q = np.where(begin[:, None], rows.start, rows.q)
    return replace(rows, q=q, values=np.where(begin[:, None], 0.0, rows.values))


def _writable(column: str, names: Sequence[str]) -> Labels:
    """The cells of a column of names."""
    labels = Labels.of(names)
    for name in labels.distinct:
        if name != name.strip() or set(name) & set("\r\n\0"):
            raise OutputError(f"{column} {name!r} would not read back")
    return labels


def encode_table(
    columns: Mapping[str, Sequence[object] | NDArray[Any]],
    comments: Sequence[str],
    progress: Progress | None = None,
) -> bytes:
    """A CSV file.

    Args:
        columns: Cells of every column by its header; NaN of an array is a blank.
        comments: Lines for the head of the file.
        progress: Told the part that is done, 0 to 1.
    """
    data = io.BytesIO()
    # Files may have names that are not UTF-8.
    text = io.TextIOWrapper(data, "utf-8", "backslashreplace", newline="")
    for comment in comments:
        for line in comment.splitlines() or [""]:
            text.write(f"# {line}".rstrip() + "\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    rows = max(map(len, columns.values()), default=0)
    for start in range(0, rows, LINES):
        parts = (column[start : start + LINES] for column in columns.values())
        writer.writerows(zip(*map(_texts, parts), strict=True))
        if progress is not None:
            progress(start / rows)
    text.flush()
    return data.getvalue()


def _texts(cells: Sequence[object] | NDArray[Any]) -> Sequence[object]:
    """Cells as the csv module writes them fast, and exactly."""
    from pydantic_core import to_json

    if not isinstance(cells, np.ndarray) or cells.dtype != float:
        return cells.tolist() if isinstance(cells, np.ndarray) else cells
    # A JSON writer is four times faster than `repr`, and as exact.
    text = to_json(cells.tolist(), inf_nan_mode="constants").decode()
    return text[1:-1].replace("NaN", "").replace("Infinity", "inf").split(",")
