"""Logs that are joined by time or by names: tables in, a measurement file out."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from itertools import product
from typing import Any

import numpy as np

import calib_pin.io.foreign_headers as headers
import calib_pin.io.measured_columns as measured_columns
import calib_pin.observations.joining as joining
from calib_pin.errors import InputError, counted, enumerated, in_file
from calib_pin.io.columns import ANGLE, LENGTH, NAMES, Floats, kind_of_unit
from calib_pin.io.dialects.base import header
from calib_pin.io.measurements import encode_table
from calib_pin.io.table import Notice, Table, require_columns, with_readings
from calib_pin.measurement_models.declaration import QUATERNION, ROTATION_VECTOR
from calib_pin.setup import STATED
from calib_pin.units import steps_of

SECONDS = 1e8
"""Times from here on are counted from 1970, and their digits tell the unit."""

STAMPS = re.compile(
    r"(?:^|[ _.\-/])(?:seq|frame|count|counter|index|n?secs?|nanosec|stamp|time|"
    r"timestamp)(?:$|[ _.\-#])"
)
"""Words of counters and of times."""

COUNTED = 10
"""Numbers that grow by equal steps from which a column is a counter."""

IMAGE = "image"
"""Column of the names of images, whose rows are all of one time."""

IMAGES = (IMAGE, "img", "filename")
"""Names of it elsewhere."""

LEAST = 1e-11
"""Standard deviation of a mean that is rounding, not scatter [m, rad, px]."""

APART = 0.01
"""Distance of readings of one name from which they are not of one point [m]."""

POSE = "pose"
"""Column of the names by which two files are joined, in the result."""


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
    """Join two logs: their standstills, and the measurement file that they become.

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
    ours, theirs = _stamped(ours, theirs)
    joints = _joints(ours, columns)
    ours, q = _read_log(ours, joints, "", (), notice)
    theirs, measured, way = _readings(theirs, notice)
    theirs, values = _read_log(theirs, measured, way, NAMES, notice)
    measured += QUATERNION if way else ()
    with in_file(f"{ours.file}, {theirs.file}"):
        if POSE in ours:
            names = ours.labels(POSE), theirs.labels(POSE)
            joined = joining.join_by_name(q, values, *names)
            _require_points(theirs, measured, values.values, joined)
        else:
            stamps = ours.columns["time"], theirs.columns["time"]
            # Nothing says in which unit the times are.
            if all(c.unit is None and np.all(c.numbers < SECONDS) for c in stamps):
                q, values, steps = joining.in_one_unit(q, values)
                if steps:
                    read = f"{'joints' if steps > 0 else 'readings'} are read as "
                    read += [*measured_columns.TIME.units][abs(steps)]
                    notice(f"the times of the {read}: so both last as long")
            joined = joining.join(q, values, settle, tolerance)
        if not joined.standstills:
            raise InputError("no reading falls into a standstill of the joints")
    if alone := enumerated(joined.alone):
        notice(f"in one of both files only, and left out: {alone}")
    if IMAGE in theirs:
        images = theirs.labels(IMAGE)
        used = {images[k] for stand in joined.standstills for k in stand.readings}
        if lost := enumerated(name for name in images.distinct if name not in used):
            notice(f"the joints do not stand at the time of {lost}: left out")
    units = {name: ours.columns[name].unit or "" for name in joints}
    data = _encoded(joined, units, theirs, measured, values, keep or IMAGE in theirs)
    return joined, data


def _encoded(
    joined: joining.Joined,
    joints: Mapping[str, str],
    table: Table,
    measured: Sequence[str],
    values: joining.Log,
    keep: bool,
) -> bytes:
    """The measurement file of two logs.

    Args:
        joined: The standstills and their readings.
        joints: The joints, and the units in which they are written.
        table: The log of the readings.
        measured: The measured columns.
        values: Their values.
        keep: Whether every reading is a row.
    """
    rows, oriented = [*joined.standstills], "qx" in measured
    if keep:
        rows = [replace(row, readings=k) for row in rows for k in row.readings[:, None]]
        rows.sort(key=lambda row: int(row.readings[0]))
    cells: dict[str, Any] = {}
    q = np.array([row.q for row in rows])
    for (name, unit), column in zip(joints.items(), q.T, strict=True):
        # Steps of servos are told in radians.
        unit = "" if steps_of(unit) else unit
        cells[header(name, unit)] = column / kind_of_unit(unit).units.get(unit, 1.0)
    means = joining.means(rows, values.values, oriented)
    cells |= zip(measured, means.T, strict=True)
    sigma = joining.mean_sigmas(rows, values.values, oriented)
    if sigma.size and (sigma > LEAST).all():
        names = [name for name in measured if name not in QUATERNION]
        names += ROTATION_VECTOR if oriented else ()
        cells |= zip((f"sigma_{name}" for name in names), sigma.T, strict=True)
    averaged = any(len(row.readings) > 1 for row in rows)
    table = table.rows(np.array([row.readings[0] for row in rows]))
    for name in _copied_columns(table):
        if not (averaged and name.startswith("sigma")):
            column = table.columns[name]
            cells[header(name, column.unit)] = column.texts().map(str.strip)
    if joined.clock:
        time = np.array([values.time[row.readings].mean() for row in rows])
        cells["time"] = time - joined.clock.ahead
    kind = "time" if joined.clock else "name"
    comment = f"joined by {kind}: {counted(joined.stands, 'standstill')}, "
    comment += counted(joined.used, "reading")
    comment += ", each sigma that of a mean" * averaged
    return encode_table(cells, [comment])


def _stamped(ours: Table, theirs: Table) -> tuple[Table, Table]:
    """Two files whose times are called `time`, or the names that both have `POSE`.

    Raises:
        InputError: If there are neither, or joints have a name twice.
    """
    both = ours, theirs
    times = [*map(_time_column, both)]
    pairs = product(_name_columns(ours), _name_columns(theirs))
    common = (pair for pair in pairs if set.intersection(*map(_names, both, pair)))
    named = (POSE, POSE) if POSE in ours and POSE in theirs else None
    if all(times) and named is None:
        spare = f"{POSE} (of the file)"  # One of them alone has names.
        ours = ours.renamed({"time": times[0], spare: POSE})
        return ours, theirs.renamed({"time": times[1], spare: POSE})
    if (named := named or next(common, None)) is None:
        reason = "there is no column 'time', and none of names, 'pose', that both have"
        allowed = "time, timestamp, stamp, zeit, t, or 'columns: {time: NAME}'"
        raise (theirs if times[0] else ours).error(reason, allowed=allowed)
    ours, theirs = ours.renamed({POSE: named[0]}), theirs.renamed({POSE: named[1]})
    labels = ours.labels(POSE).map(str.lower)
    again = ~labels.where("")
    again[np.unique(labels.codes, return_index=True)[1]] = False
    # Nothing says whose a reading is.
    ours.refuse(again, "another row of the joints has this name", POSE)
    return ours, theirs


def _time_column(table: Table) -> str:
    """The likeliest column of times; empty where there is none."""
    choices = headers.measured(headers.foreign(table.columns)).get("time", ())
    names = (column.name for column in choices)
    return next(names, next((n for n in table.columns if n.lower() == "t"), ""))


def _name_columns(table: Table) -> list[str]:
    """Columns that may have the names of poses, or of the points measured there."""
    choices = headers.measured(headers.foreign(table.columns)).get("target", ())
    text = (n for n, column in table.columns.items() if np.isnan(column.numbers).all())
    likely = [POSE] * (POSE in table) + [one.name for one in choices if not one.unit]
    return list(dict.fromkeys([*likely, *text]))


def _names(table: Table, column: str) -> set[str]:
    """The names in a column, in lower case."""
    return {name.lower() for name in table.labels(column).distinct if name}


def _require_points(
    table: Table, measured: Sequence[str], values: Floats, joined: joining.Joined
) -> None:
    """Refuse readings of one name that lie apart: nobody has measured their mean.

    Args:
        table: The readings.
        measured: Names of their values.
        values: These, shape (N, k) [SI units].
        joined: Which of them have one name.

    Raises:
        InputError: If those of a name do.
    """
    lengths = [k for k, n in enumerate(measured) if n in ("x", "y", "z", "distance")]
    for rows in (standstill.readings for standstill in joined.standstills):
        apart = float(np.ptp(values[rows][:, lengths], axis=0).max(initial=0.0))
        if apart > APART:
            reason = f"readings of one name are {1e3 * apart:.0f} mm apart"
            allowed = "a column 'station', 'tool' or 'target', maybe by 'columns'"
            raise table.error(reason, POSE, allowed, int(rows[-1]))


def _joints(table: Table, columns: Collection[str]) -> list[str]:
    """Columns of joints: those that are named, or those of positions."""
    fields = headers.foreign(table.columns)
    # The pose that a controller computes, or an instrument's in the same log.
    points = (column.name for way in headers.vectors(fields) for column in way.values())
    known = {POSE, "time", *NAMES, *points}
    reserved = {POSE, "time", *measured_columns.reserved()}
    names = [name for name in columns if name in table and name not in reserved]
    names = names or [k.name for k in fields if k.name not in known and _is_position(k)]
    if not names:
        raise table.error("there are no columns of joints beside the time")
    return names


def _readings(table: Table, notice: Notice) -> tuple[Table, list[str], str]:
    """A log by our names, its measured columns, and how it states orientations.

    A list of images has none. Readings of several targets, tools or stations may
    alternate, or share a time.
    """
    # Other columns that the setup names may be those of the joints.
    measured, oriented = measured_columns.measured(), measured_columns.ORIENTED
    lacking = {ours: table.missing[ours] for ours in table.missing.keys() & measured}
    require_columns([replace(table, missing=lacking)])
    table = with_images(headers.with_our_names(table))
    turned = oriented & table.columns.keys()
    way = measured_columns.orientation_columns(table) if turned else ""
    names = [name for name in table.columns if name in measured.keys() - oriented]
    # Beside other values a deviation is one from some nominal value.
    names = [n for n in names if n not in measured_columns.optional()] or names
    if not (names or way or IMAGE in table):
        allowed = "x, y, z, distance, u, v, an orientation, or a column 'image'"
        raise table.error("there are no measured columns", allowed=allowed)
    used = {"time", *names, *oriented, *_copied_columns(table), "temperature"}
    if ignored := table.ignored([name for name in table.columns if name not in used]):
        notice(ignored)
    return table, names, way


def _copied_columns(table: Table) -> list[str]:
    """Columns of readings that are written as they are."""
    names = [name for name in (*NAMES, IMAGE) if name in table]
    if IMAGE in table or POSE in table:
        names += [name for name in table.columns if name.startswith("sigma")]
    return names + [POSE] * (POSE in table)


def _read_log(
    table: Table, names: Sequence[str], way: str, apart: Sequence[str], notice: Notice
) -> tuple[Table, joining.Log]:
    """The rows of a log in the order of their times, and their numbers [SI].

    Args:
        table: The log.
        names: Columns of numbers.
        way: How it states orientations, which become quaternions; empty if it does not.
        apart: Columns of names of what a row is of.
        notice: Called with sentences about the file and what was left out.
    """
    stamp = POSE if POSE in table else "time"
    for remark in table.remarks:
        notice(f"{table.file}: {remark}")
    missing = {stamp: table.columns[stamp].missing()}
    for name in (*names, *STATED.get(way, ())):
        missing[name] = table.columns[name].missing()
    table = with_readings(table, missing, "rows", notice)
    values = [table.numbers(n, kind_of_unit(table.columns[n].unit)) for n in names]
    values += [*measured_columns.read_quaternions(table, way).T] if way else []
    kind = np.zeros(len(table.lines), np.int64)
    for labels in table.texts(apart).values():
        kind = kind * len(labels.names) + labels.codes
    time = _times(table, stamp)
    rows = np.vstack([np.empty((0, len(time))), *values]).T
    log, back = joining.Log(time, rows, kind), np.zeros(len(time), bool)
    # Images may stand in any order.
    for group in log.kinds if IMAGE not in table else ():
        back[group[1:]] = np.diff(time[group]) <= 0.0
    table.refuse(back, "the time does not go on here", stamp)
    order = np.argsort(time, kind="stable")
    log = joining.Log(time[order], rows[order], kind[order])
    return table.rows(order), joining.continuous(log) if way else log


def _is_position(foreign: headers.Foreign) -> bool:
    """Whether a column of a log may be one of joint positions: no counter, no stamp."""
    unit = foreign.column.unit or ANGLE.si
    known = unit in ANGLE.units or unit in LENGTH.units
    steps = np.unique(np.diff(foreign.numbers))
    counter = len(steps) == 1 and steps[0] > 0.0 and len(foreign.numbers) > COUNTED
    return foreign.numeric and known and not (counter or STAMPS.search(foreign.words))


def _times(table: Table, name: str) -> Floats:
    """Times [s], of dates since 1970, or the numbers of named rows, shape (N,)."""
    column = table.columns[name]
    if name == POSE:
        return np.arange(len(table.lines), dtype=np.float64)
    if len(table.lines) < 3:
        raise InputError("is too short to be joined by time", file=table.file)
    if not np.isfinite(column.numbers).any():
        time = np.full(len(table.lines), np.nan)
        for row, text in enumerate(table.labels(name)):
            with suppress(ValueError):
                time[row] = datetime.fromisoformat(text).timestamp()
        allowed = "seconds, or a date such as 2026-01-31T12:00:00.5"
        table.refuse(np.isnan(time), "not a time", name, allowed)
        return time
    time = table.numbers(name, measured_columns.TIME)
    # Seconds since 1970 have ten digits, others are of smaller units.
    steps = int(np.log10(max(time[0], 1.0))) // 3 - 3 if column.unit is None else 0
    return time * 1e-3 ** max(steps, 0)
