"""Measurements that are read otherwise than their columns say, see `ReadingSetup`.

Files and findings go the same way: what a finding has tried is what its lines in the
setup file do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.kinematics.spatial import from_quaternion
from calib_pin.measurement_models import as_declared, declared
from calib_pin.measurement_models.orientations import inverse
from calib_pin.observations import (
    Booleans,
    Floats,
    Frame,
    Indices,
    Labels,
    Measurements,
    Observations,
    apart,
    with_directions,
)
from calib_pin.setup import AXES, ConvertedSetup, ReadingSetup

Numbers = Callable[[Floats], Indices]
"""Number of each line of a file, by its joint positions, ascending."""


def read_otherwise(data: Observations, reading: ReadingSetup) -> Observations:
    """Measurements as a setup says that they are to be read.

    Orientations are left to the reader of files, which alone knows their numbers.

    Args:
        data: The measurements as their columns say.
        reading: What is to be changed.

    Raises:
        InputError: If a line does not exist.
        OptionError: If a joint does not exist.
    """
    shifted = partial(_from_below, places=reading.shift_from)
    shifts = {key: partial(shifted, numbers=numbers) for key, numbers in SHIFTS.items()}
    steps = STEPS | shifts
    for key in fields(ReadingSetup):
        value = getattr(reading, key.name)
        if key.name in steps and value != getattr(ReadingSetup(), key.name):
            data = steps[key.name](data, value)
    return data


def as_stated(data: Observations, reading: ReadingSetup) -> Observations:
    """Measurements read as a setup says; those of files have been read so already.

    Raises:
        InputError: If they have not the columns of their models.
        OptionError: If orientations without a file are to be read otherwise.
    """
    if any(data.files.distinct):
        return data
    if reading.orientation is not None:
        raise OptionError(
            "'reading.orientation' is for files; give quaternions qx qy qz qw"
        )
    # What the caller does with the arrays afterwards is not to change the result.
    data = Observations(tuple(map(as_declared, deepcopy(data.blocks))))
    return with_directions(read_otherwise(data, reading))


def with_positions(data: Observations, q: Floats) -> Observations:
    """The same measurements at other joint positions, shape (N, n) [rad, m]."""
    pairs = zip(data.blocks, data.slices, strict=True)
    return Observations(tuple(replace(block, q=q[rows]) for block, rows in pairs))


def with_values(
    data: Observations, change: Callable[[Measurements, Booleans], Floats]
) -> Observations:
    """The same measurements with other values.

    Args:
        data: The measurements.
        change: Values of a block, given it and which of its columns are lengths.
    """
    return Observations(
        tuple(replace(b, values=change(b, measured_lengths(b))) for b in data.blocks)
    )


def in_files(data: Observations) -> list[Indices]:
    """The measurements of each file in the order of its lines."""
    order = data.in_order
    ends = np.flatnonzero(np.diff(data.files.codes[order])) + 1
    return np.split(order, ends)


def last_motions(data: Observations, rows: Indices | slice = slice(None)) -> Floats:
    """Motion of the joints from the measurement before in the file, shape (N, n).

    [rad, m]; none before the first of a file.

    Args:
        data: The measurements.
        rows: Those whose last motions are asked for.
    """
    before = np.arange(len(data))
    for index in in_files(data):
        before[index[1:]] = index[:-1]
    return np.asarray(data.q[rows] - data.q[before[rows]])


def elapsed(data: Observations) -> Floats:
    """Part of all measurements in the order of the files before each, shape (N,)."""
    result = np.empty(len(data))
    result[data.in_order] = np.linspace(0.0, 1.0, len(data))
    return result


def located(data: Observations, place: str) -> int:
    """The measurement that stands at a place, by its position.

    Args:
        data: The measurements.
        place: Line, after its file and a colon if there are several files; of
            measurements from no file the number, from 1.

    Raises:
        InputError: If there is none.
    """
    file, _, line = place.rpartition(":")
    names = [
        name
        for name in data.files.distinct
        if not file or name == file or name.endswith(f"/{file}")
    ]
    matches = np.zeros(len(data), bool)
    if len(names) == 1:
        in_file = data.files.where(names[0])
        lines = data.lines if data.lines[in_file].any() else _numbers(data)
        matches = in_file & (lines == int(line))
    if not matches.any():
        raise InputError(
            f"'reading' names the line {place}, where no measurement stands"
            if len(names) == 1 or file
            else f"'reading' names the line {place}, but there are several files",
            allowed="a line of a measurement, such as 12, or file.csv:12",
        )
    return int(np.argmax(matches))


def place_of(data: Observations, row: int) -> str:
    """Where a measurement stands, as `located` finds it."""
    return places_of(data, [row])[0]


def places_of(data: Observations, rows: Sequence[int]) -> tuple[str, ...]:
    """The same of several; very many have to be ordered once."""
    names = data.files.distinct
    ends = [name.rpartition("/")[2] for name in names]
    shown = {
        name: end if ends.count(end) == 1 else name
        for name, end in zip(names, ends, strict=True)
    }
    numbers = _numbers(data) if "" in names else data.lines

    def place(row: int) -> str:
        file = data.files[row]
        if not file:
            return str(numbers[row])
        line = str(data.lines[row])
        return line if len(names) == 1 else f"{shown[file]}:{line}"

    return tuple(map(place, rows))


def _numbers(data: Observations) -> Indices:
    return np.argsort(data.in_order) + 1


def measured_lengths(block: Measurements) -> Booleans:
    """Which columns of the values of a block are lengths."""
    kind = declared(block.model)
    units = [*(kind.units if kind.contact else kind.columns).values()]
    units = units[: block.values.shape[1]]
    units += [""] * (block.values.shape[1] - len(units))
    return np.array([unit == "m" for unit in units], bool)


def _inverted(data: Observations, _: bool) -> Observations:
    def change(block: Measurements, lengths: Booleans) -> Floats:
        if not declared(block.model).oriented:
            return block.values
        R = from_quaternion(block.values[:, 3:])
        position = -np.einsum("nji,nj->ni", R, block.values[:, :3])
        return np.hstack([position, inverse(block.values[:, 3:])])

    return with_values(data, change)


def _exchanged(data: Observations, pairs: Sequence[tuple[str, ...]]) -> Observations:
    q = data.q.copy()
    for pair in pairs:
        one, other = (located(data, place) for place in pair)
        q[[one, other]] = q[[other, one]]
    return with_positions(data, q)


def _converted(data: Observations, parts: Sequence[ConvertedSetup]) -> Observations:
    for part in parts:
        which = np.ones(len(data), bool)
        if part.lines:
            rows = np.array([located(data, place) for place in part.lines])
            rank = np.argsort(data.in_order)
            which = np.isin(np.arange(len(data)), rows)
            if not part.each:
                which = (rank >= rank[rows[0]]) & (rank <= rank[rows[1]])
        if part.joints:
            q, columns = data.q.copy(), _columns(data, part.joints)
            q[:, columns] *= np.where(which, part.factor, 1.0)[:, None]
            data = with_positions(data, q)
        else:
            data = scaled(data, np.where(which, part.factor, 1.0))
    return data


def scaled(data: Observations, factors: Floats) -> Observations:
    """The same measurements with their lengths times factors, shape (N,)."""
    of_block = iter(data.slices)

    def change(block: Measurements, lengths: Booleans) -> Floats:
        factor = factors[next(of_block), None]
        return np.where(lengths, block.values * factor, block.values)

    return with_values(data, change)


def _columns(data: Observations, joints: Sequence[str]) -> list[int]:
    for joint in joints:
        if joint not in data.joints:
            raise OptionError(
                f"'reading' names the joint '{joint}', which the measurements do not "
                f"have{nearest(joint, data.joints)}",
                allowed=", ".join(data.joints),
            )
    return [data.joints.index(joint) for joint in joints]


def _reversed(data: Observations, _: bool) -> Observations:
    q = data.q.copy()
    for index in in_files(data):
        q[index] = data.q[index[::-1]]
    return with_positions(data, q)


def postures(q: Floats) -> Indices:
    """Number of the posture of each line, (N,), by the joint positions, (N, n).

    Repeated ones count once.
    """
    return np.append(0, np.cumsum(np.any(np.diff(q, axis=0) != 0.0, axis=1)))


def from_below(
    data: Observations, shift: int, numbers: Numbers, places: Sequence[str] = ()
) -> Indices:
    """For each measurement the one whose joint positions it has, -1 for none, (N,).

    Args:
        data: The measurements.
        shift: How many numbers these stand below it.
        numbers: Numbers of lines.
        places: Lines from which on they do; default all.

    Raises:
        InputError: If such a line does not exist.
    """
    parts, result = in_files(data), np.arange(len(data))
    if places:
        first = [located(data, place) for place in places]
        parts = [run[k:] for run in parts for k in np.flatnonzero(np.isin(run, first))]
    for run in parts:
        number = numbers(data.q[run])
        target = np.searchsorted(number, number + shift)
        exists = (number + shift >= 0) & (target < len(run))
        result[run] = np.where(exists, run[np.minimum(target, len(run) - 1)], -1)
    return result


def _from_below(
    data: Observations, shift: int, numbers: Numbers, places: Sequence[str]
) -> Observations:
    """Measurements with the joint positions of others, see `from_below`."""
    source = from_below(data, shift, numbers, places)
    if (source < 0).all():
        raise InputError(
            f"'reading' shifts joint positions by {shift}, beyond any file"
        )
    return with_positions(data, data.q[source]).rows(source >= 0)


def _lagging(data: Observations, lag: Mapping[str, float]) -> Observations:
    parts = np.zeros(len(data.joints))
    parts[_columns(data, [*lag])] = list(lag.values())
    return with_positions(data, data.q - parts * last_motions(data))


def _axes_swapped(data: Observations, axes: Sequence[str]) -> Observations:
    """Positions whose columns x, y and z hold other axes."""
    columns = [AXES.index(name.removeprefix("-")) for name in axes]
    signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in axes])

    def change(block: Measurements, lengths: Booleans) -> Floats:
        values = block.values.copy()
        if tuple(declared(block.model).columns)[:3] == AXES:
            values[:, columns] = signs * block.values[:, :3]
        return values

    return with_values(data, change)


def _negated(data: Observations, _: bool) -> Observations:
    """Readings of gauges that count the other way."""
    return with_values(
        data, lambda b, _: -b.values if declared(b.model).contact else b.values
    )


def _steadied(data: Observations, drift: Sequence[float]) -> Observations:
    part, of_block = elapsed(data)[:, None], iter(data.slices)

    def change(block: Measurements, lengths: Booleans) -> Floats:
        values, time = block.values.copy(), part[next(of_block)]
        columns = tuple(declared(block.model).columns)
        count = 3 if columns[:3] == AXES else int(columns[:1] == ("distance",))
        values[:, :count] -= time * np.array(drift[:count])
        return values

    return with_values(data, change)


def _renamed(data: Observations, places: Sequence[str], kind: Frame) -> Observations:
    """Another station or tool from some lines on."""
    rank = np.argsort(data.in_order)
    first = [rank[located(data, place)] for place in places]
    part = np.searchsorted(np.sort(first), rank, side="right")
    names = tuple(str(k + 1) for k in range(len(first) + 1))
    return apart(data, kind, Labels(names, part))[0]


def _without(data: Observations, places: Sequence[str]) -> Observations:
    kept = np.ones(len(data), bool)
    kept[[located(data, place) for place in places]] = False
    if not kept.any():
        raise InputError("'reading' leaves out all measurements")
    return data.rows(kept)


def _unstated(data: Observations, _: bool) -> Observations:
    return Observations(tuple(replace(block, sigma=None) for block in data.blocks))


STEPS: dict[str, Callable[[Observations, Any], Observations]] = {
    "inverted": _inverted,
    "exchanged": _exchanged,
    "converted": _converted,
    "reversed": _reversed,
    "lag": _lagging,
    "axes": _axes_swapped,
    "scale": lambda data, factor: scaled(data, np.full(len(data), factor)),
    "opposite": _negated,
    "drift": _steadied,
    "moved": partial(_renamed, kind="station"),
    "remounted": partial(_renamed, kind="tool"),
    "without": _without,
    "sigmas": _unstated,
}
"""The change of each key but `orientation` and shifts."""

SHIFTS: dict[str, Numbers] = {
    "shift": lambda q: np.arange(len(q)),
    "shift_configurations": postures,
}
"""Numbers of lines by which each key shifts joint positions."""
