"""Logs that are joined by time or by names: CSV files in, a measurement file out."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, enumerated
from calib_pin.io.columns import ANGLE, LENGTH, PURE, Floats, Kind, closest
from calib_pin.io.foreign_headers import OTHER, Foreign, foreign, understood, vectors
from calib_pin.io.measured_columns import (
    NAMES,
    ORIENTED,
    measured,
    orientation_columns,
    read_quaternions,
    reserved,
)
from calib_pin.io.measurements import encode_table
from calib_pin.io.table import Table, require_columns, with_readings
from calib_pin.kinematics.spatial import from_quaternion, so3_log
from calib_pin.measurement_models.declaration import ROTATION_VECTOR
from calib_pin.observations.joining import Joined, Log, Standstill, scatter
from calib_pin.setup import STATED

TIME = Kind("s", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}, {}, np.inf)

TIMES = ("time", "timestamp", "stamp", "zeit", "t")
"""Names of a column of times, in any case, where none is called `time`."""

SECONDS = 1e8
"""Times from here on are counted from 1970, and their digits tell the unit."""

ALIKE = 0.1
"""Difference in thousands of the spans of two logs, as a power, that is theirs."""

UNITS = ("s", "ms", "us", "ns")
"""Units of times, each a thousandth of the one before."""

STAMPS = re.compile(
    r"(?:^|[ _.\-/])(?:seq|frame|count|counter|index|sec|secs|nsec|nsecs|nanosec|"
    r"stamp|time|timestamp)(?:$|[ _.\-#])"
)
"""Words of counters and of times."""

COUNTED = 10
"""Numbers that grow by equal steps from which a column is a counter."""

LEAST = 1e-11
"""Standard deviation of a mean that is rounding, not scatter [m, rad, px]."""

QUATERNION = ("qx", "qy", "qz", "qw")

POSE = "pose"
"""Column of the names by which two files are joined, in the result."""


@dataclass(frozen=True)
class JointLog:
    """Joint positions by time.

    Attributes:
        log: Time and positions [s; rad, m].
        headers: Headers of the columns, with their units.
        factors: Factors that bring their numbers to SI units, shape (n,).
        poses: Names of the rows, of logs without times.
        loose: Whether nothing says in which unit the times are.
    """

    log: Log
    headers: tuple[str, ...]
    factors: Floats
    poses: Sequence[str] = ()
    loose: bool = False


@dataclass(frozen=True)
class ReadingLog:
    """Measured values by time.

    Attributes:
        log: Time and values in SI units; an orientation as a quaternion.
        columns: Their names.
        texts: Further columns by name, N strings each; `POSE` of logs without times.
        loose: Whether nothing says in which unit the times are.
    """

    log: Log
    columns: tuple[str, ...]
    texts: Mapping[str, Sequence[str]]
    loose: bool = False


def named_alike(joints: Table, readings: Table) -> tuple[Table, Table] | None:
    """Two files without times, their columns of the same names called `POSE`.

    Args:
        joints: The file of the joints; each name stands there once.
        readings: The file of the readings.

    Returns:
        Both; None if both have times.

    Raises:
        InputError: If one has none, and there are no such columns.
    """
    if all(map(_times_of, (joints, readings))):
        return None
    theirs = {name: _alike(readings, name) for name in readings.columns}
    most, found = 1, None
    for ours in joints.columns:
        names = _alike(joints, ours)
        for name, others in theirs.items() if len({*names}) == len(names) else ():
            both = len({*names} & {*others} - {""})
            if both > most:
                most, found = both, (ours, name)
    if found is None:
        without = readings if _times_of(joints) else joints
        raise without.error(
            f"there is no column 'time', and no column of names that {joints.file} and "
            f"{readings.file} share",
            allowed=f"one of {', '.join(TIMES)}, 'columns: {{time: NAME}}' in the "
            "setup, or the names of points in both",
        )
    pairs = zip((joints, readings), found, strict=True)
    first, second = (table.renamed({POSE: name}) for table, name in pairs)
    return first, second


def _alike(table: Table, name: str) -> list[str]:
    """Trimmed cells of a column in lower case; none of one of numbers with decimals."""
    numbers = table.columns[name].numbers
    decimals = np.any(numbers[np.isfinite(numbers)] % 1.0)
    return [] if decimals else [cell.lower() for cell in _cells(table, name)]


def _cells(table: Table, name: str) -> list[str]:
    return [cell.strip() for cell in table.cells([name])[name]]


def read_joint_log(
    table: Table,
    columns: Mapping[str, str] = {},
    notice: Callable[[str], None] | None = None,
) -> JointLog:
    """The joints of a log: those that the setup names, or its columns of positions.

    Args:
        table: The file, read with `columns`.
        columns: Columns with foreign names, ours to theirs.
        notice: Called with sentences about the file and what was left out.

    Raises:
        InputError: If it has no time or nothing else, or the time goes back.
    """
    stamp = POSE if POSE in table else _time_column(table)
    given = [name for name in columns if name in table and name not in reserved()]
    columns_of = foreign(table.columns)
    # The pose that a controller computes, or an instrument's in the same log.
    points = {
        one.name for pair in vectors(columns_of) for way in pair for one in way.values()
    }
    names = [name for name in given if name != stamp] or [
        one.name
        for one in columns_of
        if one.name not in {stamp, *NAMES}
        and one.name not in points
        and _is_position(one)
    ]
    if not names:
        raise table.error("there are no columns of joints beside the time")
    timed = [] if stamp == POSE else [stamp]
    table = _whole(table, [*timed, *names], notice)
    kinds = [_kind(table.columns[name].unit) for name in names]
    factors = [
        kind.units.get(table.columns[name].unit or "", 1.0)
        for name, kind in zip(names, kinds, strict=True)
    ]
    values = [table.numbers(n, kind) for n, kind in zip(names, kinds, strict=True)]
    headers = (
        f"{n} [{table.columns[n].unit}]" if table.columns[n].unit else n for n in names
    )
    time = _times(table, stamp) if timed else np.arange(float(len(table.lines)))
    return JointLog(
        Log(time, np.column_stack(values)),
        tuple(headers),
        np.array(factors),
        () if timed else _cells(table, POSE),
        _is_loose(table, stamp),
    )


def read_reading_log(
    table: Table,
    notice: Callable[[str], None] | None = None,
) -> ReadingLog:
    """The measured values of a log.

    Readings of several targets, tools or stations may alternate, or share a time.

    Args:
        table: The file, read with the columns that a setup names.
        notice: Called with sentences about the file and what was left out.

    Raises:
        InputError: If it has no time or no measured values, or the time of a target
            goes back.
    """
    # Other columns that the setup names may be those of the joints.
    lacking = {ours: table.missing[ours] for ours in table.missing.keys() & measured()}
    require_columns([replace(table, missing=lacking)])
    table = understood(table)
    stamp = POSE if POSE in table else _time_column(table)
    timed = [] if stamp == POSE else [stamp]
    own = [n for n in table.columns if n in measured() and n not in ORIENTED]
    way = ""
    if any(name in table for name in ORIENTED):
        way = orientation_columns(table)
    if not own and not way:
        raise table.error(
            "there are no measured columns"
            + closest("x", [name for name in table.columns if name != stamp]),
            allowed="x, y, z, distance, u, v or an orientation; 'columns' in the setup "
            "says which they are",
        )
    table = _whole(table, [*timed, *own, *(STATED[way] if way else ())], notice)
    texts = table.texts([name for name in NAMES if name in table])
    kind = np.zeros(len(table.lines), np.int64)
    for labels in texts.values():
        kind = kind * len(labels.names) + labels.codes
    time = _times(table, stamp, kind) if timed else np.arange(float(len(kind)))
    values = [table.numbers(name, _measured_kind(table, name)) for name in own]
    if way:
        values += [*read_quaternions(table, way).T]
        own += QUATERNION
    used = {stamp, *own, *NAMES, *ORIENTED, "temperature"}
    ignored = table.ignored([name for name in table.columns if name not in used])
    if ignored and notice is not None:
        notice(ignored)
    order = np.argsort(time, kind="stable")
    log = Log(time[order], np.column_stack(values)[order], kind[order])
    cells = {name: [*labels[order]] for name, labels in texts.items()}
    if not timed:
        cells[POSE] = _cells(table, POSE)
    log = continuous(log) if way else log
    return ReadingLog(log, tuple(own), cells, _is_loose(table, stamp))


def _is_loose(table: Table, stamp: str) -> bool:
    """Whether times state no unit, and are so small that their digits tell none."""
    column = table.columns[stamp]
    return column.unit is None and bool(np.all(column.numbers < SECONDS))


def in_one_unit(
    joints: JointLog, readings: ReadingLog, notice: Callable[[str], None] | None
) -> tuple[JointLog, ReadingLog]:
    """Logs of the same recording, of which one may count milliseconds or less.

    Args:
        joints: The joints.
        readings: The readings.
        notice: Called with a sentence about times that are in another unit.
    """
    spans = [float(np.ptp(log.log.time)) for log in (joints, readings)]
    far = np.log10(spans[0] / spans[1]) / 3.0 if min(spans) > 0.0 else 0.0
    steps = round(far)
    loose = joints.loose and readings.loose and abs(far - steps) < ALIKE
    if not (loose and 0 < abs(steps) < len(UNITS)):
        return joints, readings
    longer, unit = "joints" if steps > 0 else "readings", UNITS[abs(steps)]
    if notice is not None:
        notice(f"the times of the {longer} are read as {unit}: so both last as long")
    factor = TIME.units[unit]
    if steps > 0:
        log = replace(joints.log, time=joints.log.time * factor)
        return replace(joints, log=log), readings
    log = replace(readings.log, time=readings.log.time * factor)
    return joints, replace(readings, log=log)


def joined_by_name(
    joints: JointLog, readings: ReadingLog, notice: Callable[[str], None] | None
) -> Joined:
    """Readings with the joints of the row of the same name.

    Args:
        joints: The joints.
        readings: The readings.
        notice: Called with a sentence about names that only one of them has.
    """
    ours, theirs = (
        np.array([name.lower() for name in names])
        for names in (joints.poses, readings.texts[POSE])
    )
    found = [
        Standstill(float(k), float(k), joints.log.values[k], rows)
        for k, name in enumerate(ours)
        for kind in readings.log.kinds
        if len(rows := kind[theirs[kind] == name])
    ]
    alone = sorted({*ours} ^ {*theirs})
    if alone and notice is not None:
        notice(f"in one of both files only, and left out: {enumerated(alone)}")
    return Joined(None, tuple(found), 0, 0, 0)


def continuous(log: Log) -> Log:
    """A log whose last four values are quaternions, of which no sign jumps.

    Both signs are the same orientation, and at half turns either comes out.
    """
    values = log.values.copy()
    for rows in log.kinds:
        q = values[rows, -4:]
        jumps = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)
        values[rows[1:], -4:] *= np.cumprod(jumps)[:, None]
    return replace(log, values=values)


def _whole(
    table: Table, names: Sequence[str], notice: Callable[[str], None] | None
) -> Table:
    """The rows that miss none of some columns.

    Raises:
        InputError: If there are none.
    """
    if notice is not None:
        for remark in table.remarks:
            notice(f"{table.file}: {remark}")
    missing = np.any([table.columns[name].missing() for name in names], axis=0)
    for name in (name for name in names if name not in _times_of(table)):
        sign = table.columns[name].sentinel
        if sign is not None:
            rows = table.columns[name].numbers == sign
            missing |= rows
            if notice is not None:
                told = f"{sign:g} in {np.count_nonzero(rows)} rows of '{name}'"
                notice(f"{table.file}: {told} is taken for a reading that is missing")
    if missing.all():
        raise table.error(f"no row has all of {enumerated(names)}")
    return with_readings(table, ~missing, "rows", notice)


def _is_position(one: Foreign) -> bool:
    """Whether a column of a log may be one of joint positions: no counter, no stamp."""
    numbers = one.column.numbers[np.isfinite(one.column.numbers)]
    if not one.column.numeric or OTHER.search(one.words) or STAMPS.search(one.words):
        return False
    if one.column.unit not in (None, *ANGLE.units, *LENGTH.units):
        return False
    steps = np.unique(np.diff(numbers))
    return not (len(steps) == 1 and steps[0] > 0.0 and len(numbers) > COUNTED)


def encode_joined(
    joined: Joined, joints: JointLog, readings: ReadingLog, *, keep: bool
) -> bytes:
    """A measurement file of two logs.

    Args:
        joined: The standstills and their readings.
        joints: The log of the joints.
        readings: The log of the readings.
        keep: Whether every reading is a row, or the mean of a standstill with the
            scatter of all as its standard deviation.
    """
    rows = [*_rows(joined.standstills, keep)]
    standstills = [joined.standstills[k] for k, _ in rows]
    q = np.array([standstill.q for standstill in standstills]) / joints.factors
    table: dict[str, Sequence[object] | NDArray[np.float64]] = {
        header: q[:, k] for k, header in enumerate(joints.headers)
    }
    picked = [used for _, used in rows]
    table |= _values(readings, picked)
    if not keep:
        table |= _sigmas(joined.standstills, readings)
    for name, cells in readings.texts.items():
        table[name] = [cells[used[0]] for used in picked]
    if POSE not in readings.texts:
        time = np.array([readings.log.time[used].mean() for used in picked])
        table["time"] = time - (joined.clock.ahead if joined.clock else 0.0)
    return encode_table(table, _comments(joined))


def _comments(joined: Joined) -> list[str]:
    count, way = len(joined.standstills), "time" if joined.clock else "name"
    return [f"joined by {way}: {count} standstills, {joined.used} readings"]


def _rows(
    standstills: Sequence[Standstill], keep: bool
) -> list[tuple[int, NDArray[np.int64]]]:
    """The standstill and the readings of each row."""
    if not keep:
        return [(k, standstill.readings) for k, standstill in enumerate(standstills)]
    return [
        (k, standstill.readings[i : i + 1])
        for k, standstill in enumerate(standstills)
        for i in range(len(standstill.readings))
    ]


def _values(
    readings: ReadingLog, picked: Sequence[NDArray[np.int64]]
) -> dict[str, NDArray[np.float64]]:
    """Means of the values, of a quaternion that of its rotations."""
    means = np.array([_mean(readings, used) for used in picked])
    return {name: means[:, k] for k, name in enumerate(readings.columns)}


def _mean(readings: ReadingLog, used: NDArray[np.int64]) -> Floats:
    values = readings.log.values[used].copy()
    if QUATERNION[0] in readings.columns:
        k = readings.columns.index(QUATERNION[0])
        mean = values.mean(axis=0)
        mean[k : k + 4] /= np.linalg.norm(mean[k : k + 4])
        return np.asarray(mean)
    return np.asarray(values.mean(axis=0))


def _sigmas(
    standstills: Sequence[Standstill], readings: ReadingLog
) -> dict[str, NDArray[np.float64]]:
    """Standard deviations of the residual components; none where nothing scatters."""
    values, names = readings.log.values, [*readings.columns]
    found = dict(zip(names, scatter(standstills, values), strict=True))
    if QUATERNION[0] in names:
        k = names.index(QUATERNION[0])
        turned = np.zeros((len(values), 3))
        for standstill in standstills:
            mean = _mean(readings, standstill.readings)[k : k + 4]
            R = from_quaternion(values[standstill.readings][:, k : k + 4])
            turned[standstill.readings] = so3_log(from_quaternion(mean).T @ R)
        away = scatter(standstills, turned)
        found = {n: s for n, s in found.items() if n not in QUATERNION}
        found |= dict(zip(ROTATION_VECTOR, away, strict=True))
    if not all(size > LEAST for size in found.values()):
        return {}
    return {f"sigma_{n}": np.full(len(standstills), size) for n, size in found.items()}


def _times_of(table: Table) -> list[str]:
    """Columns that may be that of the times, the likeliest first."""
    known = {name.lower(): name for name in reversed([*table.columns])}
    known |= {"time": "time"} if "time" in table else {}
    found = [known[name] for name in ("time", *TIMES) if name in known]
    last = {name: re.findall(r"[a-z]+", name.lower())[-1:] for name in table.columns}
    # Loggers put words of their own before all names.
    return found or [name for name, word in last.items() if {*word} & {*TIMES[:3]}]


def _time_column(table: Table) -> str:
    for name in _times_of(table):
        return name
    raise table.error(
        "there is no column 'time'",
        allowed=f"one of {', '.join(TIMES)}, or 'columns: {{time: NAME}}' in the setup",
    )


def _times(table: Table, name: str, kind: NDArray[np.int64] | None = None) -> Floats:
    """Times [s], of dates since the first one's midnight.

    Args:
        table: The log.
        name: Column of its times.
        kind: What each row is of, shape (N,); the time of each of these goes on.
    """
    column = table.columns[name]
    if column.words and not np.isfinite(column.numbers).any():
        time = _dates(table, name)
    else:
        time = table.numbers(name, TIME)
        if column.unit is None:
            # Seconds since 1970 have ten digits, others are of smaller units.
            steps = int(np.log10(max(time[0], 1.0))) // 3 - 3
            time = time * 1e-3 ** max(steps, 0)
    for rows in Log(time, time, kind).kinds:
        back = np.diff(time[rows]) <= 0.0
        if back.any():
            row = int(rows[int(np.argmax(back)) + 1])
            raise table.cell_error("the time does not go on here", name, row)
    if len(time) < 3:
        raise InputError("is too short to be joined by time", file=table.file)
    return time


def _dates(table: Table, name: str) -> Floats:
    cells = table.texts([name])[name]
    stamps = []
    for row, text in enumerate(cells):
        try:
            stamps.append(datetime.fromisoformat(text.replace(",", ".")).timestamp())
        except ValueError:
            reason = "not a time"
            raise table.cell_error(
                reason, name, row, "seconds, or a date such as 2026-01-31T12:00:00.5"
            ) from None
    return np.array(stamps)


def _kind(unit: str | None) -> Kind:
    """The kind of a column of joints, by its unit."""
    return next((k for k in (ANGLE, LENGTH) if unit in k.units), PURE)


def _measured_kind(table: Table, name: str) -> Kind:
    unit = table.columns[name].unit
    if name in ("u", "v"):
        return Kind("px", {"px": 1.0}, {}, np.inf)
    return ANGLE if unit in ANGLE.units else LENGTH
