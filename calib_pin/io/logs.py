"""Logs that are joined by time or by names: CSV files in, a measurement file out."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

import calib_pin.observations.joining as joining
from calib_pin.errors import InputError, enumerated
from calib_pin.io.columns import ANGLE, LENGTH, PIXEL, PURE, Floats, Kind
from calib_pin.io.dialects.base import header
from calib_pin.io.foreign_headers import OTHER, Foreign, foreign, understood, vectors
from calib_pin.io.foreign_headers import measured as meanings
from calib_pin.io.measured_columns import (
    NAMES,
    ORIENTED,
    gauges,
    measured,
    orientation_columns,
    read_quaternions,
    reserved,
)
from calib_pin.io.measurements import encode_table
from calib_pin.io.table import Table, require_columns, with_readings
from calib_pin.measurement_models.declaration import QUATERNION, ROTATION_VECTOR
from calib_pin.setup import STATED
from calib_pin.units import steps_of

TIME = Kind("s", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}, {}, np.inf)

TIMES = ("time", "timestamp", "stamp", "zeit", "t")
"""Names of a column of times."""

SECONDS = 1e8
"""Times from here on are counted from 1970, and their digits tell the unit."""

STAMPS = re.compile(
    r"(?:^|[ _.\-/])(?:seq|frame|count|counter|index|sec|secs|nsec|nsecs|nanosec|"
    r"stamp|time|timestamp)(?:$|[ _.\-#])"
)
"""Words of counters and of times."""

DAY = 86400.0
"""Length of a day [s]."""

COUNTED = 10
"""Numbers that grow by equal steps from which a column is a counter."""

IMAGE = "image"
"""Column of the names of images, whose rows are all of one time."""

IMAGES = (IMAGE, "img", "filename")
"""Names of it elsewhere."""

LEAST = 1e-11
"""Standard deviation of a mean that is rounding, not scatter [m, rad, px]."""

POSE = "pose"
"""Column of the names by which two files are joined, in the result."""

Notice = Callable[[str], None]
"""Called with sentences about the file and what was left out."""


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

    log: joining.Log
    headers: tuple[str, ...]
    factors: Floats
    poses: Sequence[str] = ()
    loose: bool = False


@dataclass(frozen=True)
class ReadingLog:
    """Measured values by time.

    Attributes:
        log: Time and values in SI units; an orientation as a quaternion, the last.
        columns: Their names.
        texts: Further columns by name, N strings each; `POSE` of logs without times,
            `IMAGE` of images; standard deviations of those that are no series.
        loose: Whether nothing says in which unit the times are.
    """

    log: joining.Log
    columns: tuple[str, ...]
    texts: Mapping[str, Sequence[str]]
    loose: bool = False


def named_alike(joints: Table, readings: Table) -> tuple[Table, Table]:
    """Two files; where these have no times, columns of the same names called `POSE`.

    Args:
        joints: The file of the joints; each name stands there once.
        readings: The file of the readings.
    """
    if all(map(_time_column, (joints, readings))):
        return joints, readings
    found = joining.shared_names(_names_of(joints), _names_of(readings))
    if found is None:
        return joints, readings
    return joints.renamed({POSE: found[0]}), readings.renamed({POSE: found[1]})


def _names_of(table: Table) -> dict[str, list[str]]:
    """Cells in lower case of all columns but those of numbers with decimals."""
    return {
        name: [cell.strip().lower() for cell in column.texts()]
        for name, column in table.columns.items()
        if not np.any(column.numbers[np.isfinite(column.numbers)] % 1.0)
    }


def read_joint_log(
    table: Table, columns: Mapping[str, str], notice: Notice
) -> JointLog:
    """The joints of a log: those that the setup names, or its columns of positions.

    Args:
        table: The file, read with `columns`.
        columns: Columns with foreign names, ours to theirs.
        notice: Called with sentences about the file and what was left out.

    Raises:
        InputError: If it has no time or nothing else, or the time goes back.
    """
    stamp, found = _stamp(table), foreign(table.columns)
    # The pose that a controller computes, or an instrument's in the same log.
    points = {
        one.name for pair in vectors(found) for way in pair for one in way.values()
    }
    others = {stamp, *NAMES, *points}
    names = [
        name for name in columns if name in table and name not in {stamp, *reserved()}
    ] or [one.name for one in found if one.name not in others and _is_position(one)]
    if not names:
        raise table.error("there are no columns of joints beside the time")
    table = _whole(table, stamp, names, notice)
    units = [table.columns[name].unit for name in names]
    kinds = [*map(_kind, units)]
    # Steps of servos are told in radians.
    units = [None if steps_of(unit or "") else unit for unit in units]
    factors = [k.units.get(u or "", 1.0) for k, u in zip(kinds, units, strict=True)]
    time, poses, loose = _times(table, stamp)
    log = joining.Log(time, np.column_stack([*map(table.numbers, names, kinds)]))
    headers = tuple(map(header, names, units))
    return JointLog(log, headers, np.array(factors), poses, loose)


def read_reading_log(table: Table, notice: Notice) -> ReadingLog:
    """The measured values of a log, or none of a list of images.

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
    table = with_images(understood(table))
    stamp = _stamp(table)
    own = [n for n in table.columns if n in measured() and n not in ORIENTED]
    # Beside other values a deviation is one from some nominal value.
    own = [n for n in own if n not in gauges()] or own
    way = orientation_columns(table) if ORIENTED & table.columns.keys() else ""
    if not (own or way or IMAGE in table):
        raise table.error(
            "there are no measured columns; 'columns' in the setup says which they are",
            allowed="x, y, z, distance, u, v, an orientation, or a column 'image'",
        )
    table = _whole(table, stamp, [*own, *(STATED[way] if way else ())], notice)
    texts = table.texts([name for name in NAMES if name in table])
    kind = np.zeros(len(table.lines), np.int64)
    for labels in texts.values():
        kind = kind * len(labels.names) + labels.codes
    single = IMAGE in table or stamp == POSE
    passed = [n for n in table.columns if n == IMAGE or (single and _is_sigma(n))]
    headers = {n: IMAGE if n == IMAGE else table.columns[n].header for n in passed}
    texts |= {headers[n]: cells for n, cells in table.cells(passed).items()}
    # Images may stand in any order.
    ordered = np.arange(len(kind)) if IMAGE in table else kind
    time, poses, loose = _times(table, stamp, ordered)
    values = [np.empty((0, len(time)))]
    values += [table.numbers(name, _kind(table.columns[name].unit)) for name in own]
    if way:
        values += [*read_quaternions(table, way).T]
        own += QUATERNION
    used = {stamp, *own, *NAMES, *ORIENTED, *passed, "temperature"}
    ignored = table.ignored([name for name in table.columns if name not in used])
    if ignored:
        notice(ignored)
    order = np.argsort(time, kind="stable")
    log = joining.Log(time[order], np.vstack(values).T[order], kind[order])
    cells = {name: [*labels[order]] for name, labels in texts.items()}
    cells |= {POSE: [*poses]} if poses else {}
    return ReadingLog(joining.continuous(log) if way else log, tuple(own), cells, loose)


def encode_joined(
    joined: joining.Joined, joints: JointLog, readings: ReadingLog, *, keep: bool
) -> bytes:
    """A measurement file of two logs.

    Args:
        joined: The standstills and their readings.
        joints: The log of the joints.
        readings: The log of the readings.
        keep: Whether every reading is a row, as of images, or the mean of a standstill
            with its standard deviation.
    """
    rows = [*joined.standstills]
    if keep := keep or IMAGE in readings.texts:
        rows = [replace(one, readings=k) for one in rows for k in one.readings[:, None]]
        rows.sort(key=lambda one: int(one.readings[0]))
    q = np.array([one.q for one in rows]) / joints.factors
    table: dict[str, Sequence[object] | NDArray[np.float64]]
    table = dict(zip(joints.headers, q.T, strict=True))
    log, oriented = readings.log, QUATERNION[0] in readings.columns
    values = joining.means(rows, log.values, oriented)
    table |= zip(readings.columns, values.T, strict=True)
    texts = dict(readings.texts)
    if averaged := any(len(one.readings) > 1 for one in rows):
        texts = {name: cells for name, cells in texts.items() if not _is_sigma(name)}
    sigma = joining.mean_sigmas(rows, log.values, oriented)
    if sigma.size and (sigma > LEAST).all():
        turned = ROTATION_VECTOR if oriented else ()
        names = [*(n for n in readings.columns if n not in QUATERNION), *turned]
        table |= zip((f"sigma_{name}" for name in names), sigma.T, strict=True)
    for name, cells in texts.items():
        table[name] = [cells[one.readings[0]] for one in rows]
    if POSE not in readings.texts:
        time = np.array([log.time[one.readings].mean() for one in rows])
        table["time"] = time - (joined.clock.ahead if joined.clock else 0.0)
    count, way = joined.stands, "time" if joined.clock else "name"
    comment = f"joined by {way}: {count} standstills, {joined.used} readings"
    if averaged:
        comment += ", each sigma that of a mean"
    return encode_table(table, [comment])


def with_images(table: Table) -> Table:
    """The table with the names of images, if it has any, in a column of this name."""
    names = (name for name in table.columns if name.lower() in IMAGES)
    return table.renamed({IMAGE: next(names, IMAGE)})


def _whole(table: Table, stamp: str, names: Sequence[str], notice: Notice) -> Table:
    """The rows that miss none of some columns, nor the time or the name.

    Raises:
        InputError: If there are none.
    """
    for remark in table.remarks:
        notice(f"{table.file}: {remark}")
    kept = ~table.columns[stamp].missing()
    for name in names:
        column = table.columns[name]
        kept &= ~column.missing()
        sign = column.sentinel
        if sign is not None:
            rows = column.numbers == sign
            kept &= ~rows
            told = f"{sign:g} in {np.count_nonzero(rows)} rows of '{name}'"
            notice(f"{table.file}: {told} is taken for a reading that is missing")
    if not kept.any():
        raise table.error(f"no row has all of {enumerated([stamp, *names])}")
    return with_readings(table, kept, "rows", notice)


def _is_sigma(name: str) -> bool:
    return name.partition("_")[0] == "sigma"


def _is_position(one: Foreign) -> bool:
    """Whether a column of a log may be one of joint positions: no counter, no stamp."""
    numbers = one.column.numbers[np.isfinite(one.column.numbers)]
    if not one.column.numeric or OTHER.search(one.words) or STAMPS.search(one.words):
        return False
    unit = one.column.unit or "rad"
    if unit not in ANGLE.units and unit not in LENGTH.units:
        return False
    steps = np.unique(np.diff(numbers))
    return not (len(steps) == 1 and steps[0] > 0.0 and len(numbers) > COUNTED)


def _time_column(table: Table) -> str:
    """The likeliest column of times; empty where there is none."""
    found = [one.name for one in meanings(foreign(table.columns)).get("time", ())]
    return [*found, *(name for name in table.columns if name.lower() == "t"), ""][0]


def _stamp(table: Table) -> str:
    """The column by which a file is joined.

    Raises:
        InputError: If there is none.
    """
    if name := POSE if POSE in table else _time_column(table):
        return name
    raise table.error(
        "there is no column 'time', and no column of names that both logs share",
        allowed=f"one of {', '.join(TIMES)}, 'columns: {{time: NAME}}' in the setup, "
        "or the names of points in both",
    )


def _times(
    table: Table, name: str, kind: NDArray[np.int64] | None = None
) -> tuple[Floats, Sequence[str], bool]:
    """Times [s], or the numbers of rows that have a name, and their names.

    Args:
        table: The log.
        name: Column of its times or names.
        kind: What each row is of, shape (N,); the time of each of these goes on.

    Returns:
        The times, of dates since 1970; the names; and whether nothing tells the unit
        of the times.
    """
    column = table.columns[name]
    if name == POSE:
        return np.arange(float(len(table.lines))), table.texts([POSE])[POSE], False
    loose = column.unit is None and bool((column.numbers < SECONDS).all())
    if not np.isfinite(column.numbers).any():
        time = _dates(table, name)
    else:
        time = table.numbers(name, TIME)
        # Seconds since 1970 have ten digits, others are of smaller units.
        steps = int(np.log10(max(time[0], 1.0))) // 3 - 3 if column.unit is None else 0
        time = time * 1e-3 ** max(steps, 0)
    for rows in joining.Log(time, time, kind).kinds:
        back = np.diff(time[rows]) <= 0.0
        if back.any():
            row = int(rows[int(np.argmax(back)) + 1])
            raise table.cell_error("the time does not go on here", name, row)
    if len(time) < 3:
        raise InputError("is too short to be joined by time", file=table.file)
    return time, (), loose


def _dates(table: Table, name: str) -> Floats:
    """Times of dates, or of clocks with or without a column of dates, (N,) [s]."""
    from dateutil.parser import parse  # type: ignore[import-untyped]

    stamps, first = [], datetime(1970, 1, 1)
    for row, text in enumerate(_with_days(table, name)):
        try:
            try:
                stamp = datetime.fromisoformat(text)
            except ValueError:
                # Points separate day, month and year, where slashes do not say.
                points = "." in text.split()[0]
                stamp = parse(text, default=first, dayfirst=points)
        except (ValueError, OverflowError):
            allowed = "seconds, or a date such as 2026-01-31T12:00:00.5"
            raise table.cell_error("not a time", name, row, allowed) from None
        stamps.append(stamp.timestamp())
    time: Floats = np.array(stamps)
    # A clock without a date begins anew at midnight.
    return np.asarray(time + DAY * np.cumsum(np.diff(time, prepend=time[0]) < -DAY / 2))


def _with_days(table: Table, name: str) -> list[str]:
    """Texts of times, behind those of a column of dates."""
    days = [other for other in table.columns if other.lower() in ("date", "datum")]
    columns = [table.texts([each])[each] for each in (*days[:1], name)]
    return [" ".join(row).replace(",", ".") for row in zip(*columns, strict=True)]


def _kind(unit: str | None) -> Kind:
    """The kind of a column, by its unit."""
    return next((k for k in (ANGLE, LENGTH, PIXEL) if unit in k.units), PURE)
