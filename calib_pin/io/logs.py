"""Logs that are joined by time or by names: tables in, a measurement file out."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib_pin.io.foreign_headers as headers
import calib_pin.io.measured_columns as measured_columns
import calib_pin.observations.joining as joining
from calib_pin.errors import InputError, enumerated, stated_in
from calib_pin.io.columns import ANGLE, LENGTH, PIXEL, PURE, Floats, Kind
from calib_pin.io.dialects.base import header
from calib_pin.io.measured_columns import NAMES
from calib_pin.io.measurements import encode_table
from calib_pin.io.table import Notice, Table, require_columns, with_readings
from calib_pin.measurement_models.declaration import QUATERNION, ROTATION_VECTOR
from calib_pin.setup import STATED
from calib_pin.units import steps_of

TIME = Kind("s", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}, np.inf)

SECONDS = 1e8
"""Times from here on are counted from 1970, and their digits tell the unit."""

STAMPS = re.compile(
    r"(?:^|[ _.\-/])(?:seq|frame|count|counter|index|n?secs?|nanosec|stamp|time|"
    r"timestamp)(?:$|[ _.\-#])"
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


@dataclass(frozen=True)
class Series:
    """Joint positions or measured values by time, or by names.

    Attributes:
        log: Time and values in SI units; an orientation as a quaternion, the last.
        units: The columns of the values, and the unit in which each is written.
        texts: Further columns by name, N strings each; `POSE` of logs without times,
            `IMAGE` of images; standard deviations of those that are no series.
        loose: Whether nothing says in which unit the times are.
    """

    log: joining.Log
    units: Mapping[str, str | None]
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    loose: bool = False


def named_alike(ours: Table, theirs: Table) -> tuple[Table, Table]:
    """Two files; where these have no times, columns of the same names called `POSE`.

    Args:
        ours: The file of the joints, in which each name stands once. Numbers with
            decimals are no names.
        theirs: The file of the readings.
    """
    if all(map(_time_column, tables := (ours, theirs))):
        return tables
    names = (
        {
            name: [cell.strip().lower() for cell in column.texts()]
            for name, column in table.columns.items()
            if not np.any(column.numbers[np.isfinite(column.numbers)] % 1.0)
        }
        for table in tables
    )
    own, other = joining.shared_names(*names) or (POSE, POSE)
    return ours.renamed({POSE: own}), theirs.renamed({POSE: other})


def with_images(table: Table) -> Table:
    """The table with the names of images, if it has any, in a column of this name."""
    names = (name for name in table.columns if name.lower() in IMAGES)
    return table.renamed({IMAGE: next(names, IMAGE)})


def join_logs(
    ours: Table,
    theirs: Table,
    columns: Collection[str],
    settle: float,
    tolerance: float,
    notice: Notice,
    keep: bool,
) -> tuple[joining.Joined, bytes]:
    """What joins two logs, and the measurement file that they become.

    Args:
        ours: The log of the joints.
        theirs: The log of the readings.
        columns: Columns of `ours` that are joints; where it has none of these, those of
            positions are.
        settle: Time that joints stand before readings count [s].
        tolerance: Longest time without a sample of the joints [s].
        notice: Called with sentences about the logs and what was left out.
        keep: Whether every reading is a row, as of images, or the mean of a standstill
            with its standard deviation.

    Raises:
        InputError: If nothing joins them, one has no time or no values, or its time
            goes back.
    """
    joints = _read_joints(ours, columns, notice)
    readings = _read_readings(theirs, notice)
    q, values = joints.log, readings.log
    with stated_in(f"{ours.file}, {theirs.file}"):
        if POSE in joints.texts:
            names = joints.texts[POSE], readings.texts[POSE]
            found = joining.join_by_name(q, values, *names)
        else:
            if joints.loose and readings.loose:
                q, values, steps = joining.in_one_unit(q, values)
                if steps:
                    read = f"{'joints' if steps > 0 else 'readings'} are read as "
                    read += [*TIME.units][abs(steps)]
                    notice(f"the times of the {read}: so both last as long")
            found = joining.join(q, values, settle, tolerance)
        if not found.standstills:
            raise InputError("no reading falls into a standstill of the joints")
    if alone := enumerated(found.alone):
        notice(f"in one of both files only, and left out: {alone}")
    images = readings.texts.get(IMAGE, ())
    used = {images[k] for one in found.standstills for k in one.readings if images}
    if lost := [name for name in dict.fromkeys(images) if name not in used]:
        notice(f"the joints do not stand at the time of {enumerated(lost)}: left out")
    return found, _encoded(found, joints, replace(readings, log=values), keep=keep)


def _read_joints(table: Table, columns: Collection[str], notice: Notice) -> Series:
    """The joints of a log: those that the setup names, or its columns of positions.

    Args:
        table: The file, read with `columns`.
        columns: The columns that are joints, if the table has any of them.
        notice: Called with sentences about the file and what was left out.

    Raises:
        InputError: If it has no time or nothing else, or the time goes back.
    """
    stamp, found = _stamp(table), headers.foreign(table.columns)
    # The pose that a controller computes, or an instrument's in the same log.
    points = (one.name for way in headers.vectors(found) for one in way.values())
    others = {stamp, *NAMES, *points}
    reserved = {stamp, *measured_columns.reserved()}
    names = [name for name in columns if name in table and name not in reserved]
    names = names or [k.name for k in found if k.name not in others and _is_position(k)]
    if not names:
        raise table.error("there are no columns of joints beside the time")
    return _read(table, names, notice, "", ())


def _read_readings(table: Table, notice: Notice) -> Series:
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
    measured, oriented = measured_columns.measured(), measured_columns.ORIENTED
    lacking = {ours: table.missing[ours] for ours in table.missing.keys() & measured}
    require_columns([replace(table, missing=lacking)])
    table = with_images(headers.understood(table))
    stamp, own = _stamp(table), [n for n in table.columns if n in measured]
    turned = any(name in oriented for name in own)
    way = measured_columns.orientation_columns(table) if turned else ""
    own = [name for name in own if name not in oriented]
    # Beside other values a deviation is one from some nominal value.
    own = [n for n in own if n not in measured_columns.optional()] or own
    if not (own or way or IMAGE in table):
        reason = "there are no measured columns; 'columns' in the setup says which are"
        allowed = "x, y, z, distance, u, v, an orientation, or a column 'image'"
        raise table.error(reason, allowed=allowed)
    texts = [*NAMES, IMAGE]
    if IMAGE in table or stamp == POSE:
        texts += [name for name in table.columns if name.startswith("sigma")]
    used = {stamp, *own, *oriented, *texts, "temperature"}
    if ignored := table.ignored([name for name in table.columns if name not in used]):
        notice(ignored)
    return _read(table, own, notice, way, texts)


def _read(
    table: Table, names: Sequence[str], notice: Notice, way: str, kept: Sequence[str]
) -> Series:
    """The rows of a log in the order of their times.

    Args:
        table: The log.
        names: Columns of numbers.
        notice: Called with sentences about the file and what was left out.
        way: How it states orientations; empty where it does not.
        kept: Columns of texts: of names of what a row is of, and others.
    """
    stamp = _stamp(table)
    for remark in table.remarks:
        notice(f"{table.file}: {remark}")
    missing = {stamp: table.columns[stamp].missing()}
    for name in (*names, *STATED.get(way, ())):
        column = table.columns[name]
        signs = column.numbers == column.sentinel
        missing[name] = column.missing() | signs
        if signs.any():
            told = f"{column.sentinel:g} in {np.count_nonzero(signs)} rows of '{name}'"
            notice(f"{table.file}: {told} is taken for a reading that is missing")
    table = with_readings(table, missing, "rows", notice)
    units = {name: table.columns[name].unit for name in names}
    values = [table.numbers(name, _kind(unit)) for name, unit in units.items()]
    # Steps of servos are told in radians.
    units = {n: None if steps_of(unit or "") else unit for n, unit in units.items()}
    if way:
        values += [*measured_columns.read_quaternions(table, way).T]
        units |= dict.fromkeys(QUATERNION)
    kept = [name for name in (*kept, POSE) if name in table]
    texts = {name: table.columns[name].texts().map(str.strip) for name in kept}
    kind = np.zeros(len(table.lines), np.int64)
    for labels in (texts[name] for name in NAMES if name in texts):
        kind = kind * len(labels.names) + labels.codes
    # Images may stand in any order.
    ordered = np.arange(len(kind)) if IMAGE in texts else kind
    time, loose = _times(table, stamp, ordered)
    order = np.argsort(time, kind="stable")
    rows = np.vstack([np.empty((0, len(time))), *values]).T[order]
    log = joining.Log(time[order], rows, kind[order])
    cells = {
        table.columns[n].header if n.startswith("sigma") else n: [*labels[order]]
        for n, labels in texts.items()
    }
    return Series(joining.continuous(log) if way else log, units, cells, loose)


def _encoded(
    joined: joining.Joined, joints: Series, readings: Series, *, keep: bool
) -> bytes:
    """A measurement file of two logs.

    Args:
        joined: The standstills and their readings.
        joints: The log of the joints.
        readings: The log of the readings.
        keep: Whether every reading is a row, as of images, or the mean of a standstill
            with its standard deviation.
    """
    rows, log, oriented = [*joined.standstills], readings.log, "qx" in readings.units
    if keep or IMAGE in readings.texts:
        rows = [replace(one, readings=k) for one in rows for k in one.readings[:, None]]
        rows.sort(key=lambda one: int(one.readings[0]))
    table: dict[str, Any] = {}
    q = np.array([one.q for one in rows])
    for (name, unit), column in zip(joints.units.items(), q.T, strict=True):
        table[header(name, unit)] = column / _kind(unit).units.get(unit or "", 1.0)
    values = joining.means(rows, log.values, oriented)
    table |= zip(readings.units, values.T, strict=True)
    sigma = joining.mean_sigmas(rows, log.values, oriented)
    if sigma.size and (sigma > LEAST).all():
        names = [name for name in readings.units if name not in QUATERNION]
        names += ROTATION_VECTOR if oriented else ()
        table |= zip((f"sigma_{name}" for name in names), sigma.T, strict=True)
    averaged = any(len(one.readings) > 1 for one in rows)
    for name, cells in readings.texts.items():
        if not (averaged and name.startswith("sigma")):
            table[name] = [cells[one.readings[0]] for one in rows]
    if joined.clock:
        time = np.array([log.time[one.readings].mean() for one in rows])
        table["time"] = time - joined.clock.ahead
    way = "time" if joined.clock else "name"
    comment = f"joined by {way}: {joined.stands} standstills, {joined.used} readings"
    comment += ", each sigma that of a mean" * averaged
    return encode_table(table, [comment])


def _is_position(one: headers.Foreign) -> bool:
    """Whether a column of a log may be one of joint positions: no counter, no stamp."""
    unit = one.column.unit or ANGLE.si
    known = unit in ANGLE.units or unit in LENGTH.units
    steps = np.unique(np.diff(one.numbers))
    counter = len(steps) == 1 and steps[0] > 0.0 and len(one.numbers) > COUNTED
    return one.numeric and known and not (counter or STAMPS.search(one.words))


def _time_column(table: Table) -> str:
    """The likeliest column of times; empty where there is none."""
    found = headers.measured(headers.foreign(table.columns)).get("time", ())
    names = (one.name for one in found)
    return next(names, next((n for n in table.columns if n.lower() == "t"), ""))


def _stamp(table: Table) -> str:
    """The column by which a file is joined.

    Raises:
        InputError: If there is none.
    """
    if name := POSE if POSE in table else _time_column(table):
        return name
    reason = "there is no column 'time', and no column of names that both logs share"
    allowed = "time, timestamp, stamp, zeit, t, or 'columns: {time: NAME}' in the setup"
    raise table.error(reason, allowed=allowed)


def _times(table: Table, name: str, kind: NDArray[np.int64]) -> tuple[Floats, bool]:
    """Times [s], of dates since 1970, or the numbers of rows that have a name.

    Args:
        table: The log.
        name: Column of its times or names.
        kind: What each row is of, shape (N,); the time of each of these goes on.

    Returns:
        The times, shape (N,), and whether nothing tells their unit.
    """
    column = table.columns[name]
    if name == POSE:
        return np.arange(float(len(table.lines))), False
    loose = column.unit is None and bool((column.numbers < SECONDS).all())
    if not np.isfinite(column.numbers).any():
        time = _dates(table, name)
    else:
        time = table.numbers(name, TIME)
        # Seconds since 1970 have ten digits, others are of smaller units.
        steps = int(np.log10(max(time[0], 1.0))) // 3 - 3 if column.unit is None else 0
        time = time * 1e-3 ** max(steps, 0)
    back = np.zeros(len(time), bool)
    for rows in joining.Log(time, time, kind).kinds:
        back[rows[1:]] = np.diff(time[rows]) <= 0.0
    table.refuse(back, "the time does not go on here", name)
    if len(time) < 3:
        raise InputError("is too short to be joined by time", file=table.file)
    return time, loose


def _dates(table: Table, name: str) -> Floats:
    """Times of dates, or of clocks with or without a column of dates, (N,) [s]."""
    from dateutil.parser import parse  # type: ignore[import-untyped]

    def seconds(text: str) -> float:
        with suppress(ValueError):
            return datetime.fromisoformat(text).timestamp()
        with suppress(ValueError, OverflowError):
            # Points separate day, month and year, where slashes do not say.
            points = "." in text.split()[0]
            found = parse(text, default=datetime(1970, 1, 1), dayfirst=points)
            return float(found.timestamp())
        return np.nan

    days = [other for other in table.columns if other.lower() in ("date", "datum")]
    cells = table.texts([*days[:1], name]).values()
    texts = (" ".join(row).replace(",", ".") for row in zip(*cells, strict=True))
    time = np.array([*map(seconds, texts)])
    allowed = "seconds, or a date such as 2026-01-31T12:00:00.5"
    table.refuse(np.isnan(time), "not a time", name, allowed)
    # A clock without a date begins anew at midnight.
    return np.asarray(time + DAY * np.cumsum(np.diff(time, prepend=time[0]) < -DAY / 2))


def _kind(unit: str | None) -> Kind:
    """The kind of a column, by its unit."""
    return next((k for k in (ANGLE, LENGTH, PIXEL) if unit in k.units), PURE)
