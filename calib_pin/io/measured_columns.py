"""Measured columns of a file: which model reads which, their values and conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.io.columns import ANGLE, ELSEWHERE, KINDS, LENGTH, PURE, Floats, Kind
from calib_pin.io.table import Table
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.measurement_models.declaration import DIAL
from calib_pin.measurement_models.orientations import quaternions
from calib_pin.observations import AT, BlockKey, Conditions, Indices
from calib_pin.setup import STATED, OrientationSetup

POSITION = ("x", "y", "z")
"""Columns of a position."""

ORIENTATION: Mapping[str, Kind] = {
    name: PURE if way == "quaternion" else ANGLE
    for way, names in STATED.items()
    for name in names
}
"""The kinds of the columns of an orientation, in all the ways to state it."""

ORIENTED = frozenset(ORIENTATION)
"""Their names."""

NAMES = (*BlockKey._fields, "target", "payload", "set")
"""Columns of names; the first tell blocks apart."""

STROKE = replace(LENGTH, largest=0.1)
"""Readings of gauges."""

SIGMAS = {
    unit: replace(KINDS[unit], largest=size, least=1e-12 * size)
    for unit, size in (("m", 1.0), ("rad", 1.0), ("px", 1e3))
}
"""Standard deviations that can be meant, by unit."""

DIRECTION = ".direction"
"""End of the name of a column with the direction in which a joint was approached."""

CONDITIONS = {
    "temperature": Kind("degC", {"degC": 1.0}, np.inf),
    "time": Kind("s", {"s": 1, "ms": 1e-3, "us": 1e-6, "min": 60, "h": 3600}, np.inf),
}
"""Columns that are read where they hold numbers throughout."""

FEW = 4
"""Measurements from which an orientation that never moves is none."""


def needed(model: str) -> dict[str, Kind]:
    """The measured columns that a model cannot do without."""
    return {name: KINDS[unit] for name, unit in declared(model).columns.items()}


def optional(*models: str) -> dict[str, Kind]:
    """The deviations that models read where there are any; default those of all."""
    ways = [way for m in models or MEASUREMENT_MODELS for way in declared(m).readings]
    return {name: STROKE for names in ways for name in names}


def measured(*models: str) -> dict[str, Kind]:
    """All columns that hold what a model measures; default what any model does."""
    found = dict[str, Kind]()
    for model in models or MEASUREMENT_MODELS:
        found |= needed(model) | optional(model)
        found |= ORIENTATION if declared(model).oriented else {}
    return found


def sigmas(model: str) -> dict[str, tuple[str, ...]]:
    """Columns of a standard deviation, by residual component; the last one counts."""
    components, readings = declared(model).components, declared(model).readings
    ways: Sequence[tuple[str, ...]] = readings or [()] * len(components)
    return {
        name: ("sigma", f"sigma_{name}", *(f"sigma_{other}" for other in others))
        for name, others in zip(components, ways, strict=True)
    }


def read_by(model: str) -> frozenset[str]:
    """Columns that a model reads where there are any, beside those that all do."""
    stated = {name for names in sigmas(model).values() for name in names}
    return frozenset({*measured(model)} | stated - {"sigma"})


def reserved() -> frozenset[str]:
    """Names that have a meaning in every file, whatever the robot's joints are."""
    read = frozenset({"sigma", *NAMES}).union(*map(read_by, MEASUREMENT_MODELS))
    return read | {f"sigma_{name}" for name in measured()}


def orientation_columns(table: Table) -> str:
    """The one way in which a file states orientations, one of `STATED`."""
    first = {
        way: name for way, names in STATED.items() for name in names if name in table
    }
    if len(first) != 1:
        found = " and ".join(first.values()) or "none"
        reason = f"model 'pose' needs one orientation, the file has {found}"
        ways = " or ".join(",".join(names) for names in STATED.values())
        raise table.error(reason, [None, *first.values()][-1], ways)
    (way,) = first
    table.require(STATED[way], f"the orientation {', '.join(STATED[way])} lacks")
    return way


def read_quaternions(
    table: Table, way: str, reading: OrientationSetup | None = None
) -> Floats:
    """Unit quaternions qx qy qz qw with qw >= 0, shape (N, 4).

    Args:
        table: The file.
        way: How it states orientations, one of `STATED`.
        reading: How they are to be read.
    """
    kinds = [(name, ORIENTATION[name]) for name in STATED[way]]
    given = quaternions(table.values(kinds), way, reading)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(given, axis=1)
    off = abs(norm - 1.0)
    if off[row := int(np.argmax(off))] > 1e-2:
        cells = ", ".join(table.columns[name].text(row) for name in STATED[way])
        reason = f"the norm of the quaternion '{cells}' is {norm[row]:.6g}"
        raise table.error(reason, STATED[way][-1], "0.99 to 1.01", row)
    # Dividing a unit quaternion once more may change its last bit, and a file that was
    # written from here must read back as it was.
    norm[off < 1e-14] = 1.0
    unit = given / norm[:, None]
    return np.asarray(np.where(unit[:, 3:] < 0.0, -unit, unit))


def read_values(
    table: Table,
    model: str,
    spare: Sequence[str],
    orientation: OrientationSetup | None = None,
) -> tuple[tuple[str, ...], Floats]:
    """The measured values of a model.

    Args:
        table: The file.
        model: Name of the model.
        spare: Columns that are no joints, for a hint at a missing one.
        orientation: How columns of an orientation are to be read.

    Returns:
        The columns that were used, and the values in the layout of
        `Measurements.values`, shape (N, D).

    Raises:
        InputError: If a column is missing, or a value cannot be; of the deviations of
            contacts, if only some components have one, or one has two.
    """
    about, kinds = declared(model), needed(model)
    unknown = {*spare} - reserved()
    table.require(kinds, f"model '{model}' needs the missing", unknown)
    there = {*optional()} & table.columns.keys() if about.contact else set()
    if there:
        found = [name for names in about.readings for name in names if name in there]
        once = all(len({*names} & there) == 1 for names in about.readings)
        if {*found} != there or not once:
            reason = f"of a gauge '{model}' needs every column once, and no other"
            needs = ", ".join(map(" or ".join, about.readings))
            raise table.error(reason, max(there), needs)
        values = table.values((name, STROKE) for name in found)
        return tuple(found), values * [-1.0 if DIAL in n else 1.0 for n in found]
    values = table.values(kinds.items())
    if not about.oriented:
        return tuple(kinds), values
    way = orientation_columns(table)
    turned = read_quaternions(table, way, orientation)
    return (*kinds, *STATED[way]), np.hstack([values, turned])


def read_sigma(table: Table, model: str) -> tuple[Mapping[str, str], Floats | None]:
    """The standard deviations of a model's residual components.

    Args:
        table: The file.
        model: Name of the model.

    Returns:
        The column of each component and the values, shape (N, d) [m, rad, px]; nothing
        and None where the file states none.

    Raises:
        InputError: If only some components have one, its meaning would have to be
            guessed, or a value cannot be.
    """
    stated, ways = declared(model), sigmas(model)
    # Beside its own column that of a contact is of something that is not read either.
    odd = {n for n in measured() if n not in table} if stated.contact else set()
    odd = {f"sigma_{name}" for name in odd | {*measured(model)}} - read_by(model)
    odd |= {"sigma"} if len({*stated.units.values()}) > 1 else set()
    for name in (name for name in table.columns if name in odd):
        reason = f"model '{model}' has no component of this standard deviation"
        raise table.error(reason, name, ", ".join(f"sigma_{of}" for of in ways))
    found = {of: name for of, names in ways.items() for name in names if name in table}
    if not found:
        return {}, None
    reason = "a sigma is needed for every component or for none; missing:"
    table.require([f"sigma_{name}" for name in ways if name not in found], reason)
    kinds = map(SIGMAS.__getitem__, stated.units.values())
    return found, table.values(zip(found.values(), kinds, strict=True))


def place_of(target: str) -> str:
    """The plane, socket or other place in the name of a target."""
    return target.rpartition(AT)[2]


def find_starts(table: Table, distance: Floats, q: Floats) -> Indices:
    """The row at which the relative measurement of each row starts, shape (N,).

    Rows of one target belong together; the first of them is their start.

    Args:
        table: The file.
        distance: Distances from the start, shape (N,) [m].
        q: Joint positions, shape (N, n) [rad, m].

    Raises:
        InputError: If a start is not one, nothing starts there, or a row cannot be
            measured from it.
    """
    target, payload = table.labels("target").codes, table.labels("payload").codes
    _, first, which = np.unique(target, return_index=True, return_inverse=True)
    start: Indices = first[which]
    begins = start == np.arange(len(start))
    of = "the first row of a target is its start"
    named = "target" if "target" in table else "distance"
    for column, wrong, reason in (
        ("distance", begins != (distance == 0.0), f"{of}, where alone distance is 0"),
        ("distance", distance < 0.0, "a distance from a start is not negative"),
        (named, np.bincount(start)[start] == 1, f"{of}, and no other row is of it"),
        ("distance", ~begins & (q == q[start]).all(axis=1), "the joints did not move"),
        ("payload", payload != payload[start], "the payload is not that of the start"),
    ):
        table.refuse(wrong, reason, column)
    return start


def check_spread(
    table: Table, chain: Chain, positions: Floats, base: Floats | None = None
) -> None:
    """Refuse positions that lie much farther apart than the chain can reach.

    Args:
        table: The file, with columns x, y and z.
        chain: The chain.
        positions: Values of these columns, shape (N, 3) [m].
        base: Where the chain stands among them, shape (3,) [m]; None if unknown.

    Raises:
        InputError: If they do; blames the outermost position.
    """
    placements = (*chain.placements, chain.tip_placement)
    reach = sum(float(np.linalg.norm(M.translation)) for M in placements)
    reach += float((chain.upper - chain.lower)[~chain.revolute].sum())
    center = np.median(positions, axis=0) if base is None else base
    # One meter for a tool, and a factor for a URDF that is far off.
    kind = replace(LENGTH, largest=4.0 * (reach + 1.0))
    for name, values, away in zip(POSITION, positions.T, center, strict=True):
        why = f"the robot reaches {reach:.3g} m"
        table.check(name, values, kind, why, abs(values - away))


def read_conditions(
    table: Table, joints: Sequence[str]
) -> tuple[Conditions, frozenset[str]]:
    """The conditions that a file states, but for the payload.

    A temperature or a time that is not a number in each row, such as a date, is none.

    Args:
        table: The file.
        joints: Names of the joints.

    Returns:
        The conditions, and the columns that hold them.

    Raises:
        InputError: If a direction of approach is none of -1, 0 and 1, or blank.
    """
    stated: dict[str, Any] = {
        name: numbers
        for name, kind in CONDITIONS.items()
        if (numbers := table.found(name, kind)) is not None
    }
    used = [joint + DIRECTION for joint in joints if joint + DIRECTION in table]
    columns = np.zeros((len(table.lines), len(joints)), np.int8)
    for name in used:
        column = table.columns[name]
        signs = np.where(column.missing(), 0.0, column.numbers)
        allowed = "1, -1, or 0 where it is not known"
        wrong = ~np.isin(signs, (-1, 0, 1))
        table.refuse(wrong, "not the sign of a joint's last motion", name, allowed)
        columns[:, joints.index(name.removesuffix(DIRECTION))] = signs
    read = frozenset({*used, *stated})
    stated |= {"direction": columns, "source": "columns"} if used else {}
    return Conditions(**stated), read


def asked_models(model: str | None) -> tuple[str, ...]:
    """The measurement models of an option: one, or several with a plus between them.

    Raises:
        OptionError: If there is no model of a name, or one is named twice.
    """
    names = () if model is None else tuple(model.split("+"))
    for name in names:
        declared(name)
    if len(set(names)) != len(names):
        raise OptionError("a measurement model is named twice", value=model)
    return names


def infer_model(table: Table, asked: Sequence[str] = ()) -> str:
    """The one model whose columns a file has.

    A model that measures less than another gives way to it: position to pose, and
    contacts to all.

    Args:
        table: The file.
        asked: The model that is asked for, which wins; of several the file has to be
            one, none allows all that columns tell apart.

    Raises:
        InputError: If there is none, or more than one.
    """
    if len(asked) == 1:
        return asked[0]
    names = asked or [name for name in MEASUREMENT_MODELS if declared(name).inference]
    there, needs = {*table.columns}, {name: {*needed(name)} for name in names}
    partly = [name for name in names if needs[name] & there]
    # No instrument repeats all of its digits.
    turned = [table.columns[name].numbers for name in ORIENTED & there]
    oriented = any(len(n) < FEW or bool(np.ptp(n) != 0.0) for n in turned)

    def fits(name: str) -> bool:
        about = declared(name)
        if about.oriented and not oriented:
            return False
        if about.contact:
            return not partly and ("target" in there or not _names(name))
        # What is there in part is told as missing; `u` alone may mean something else.
        if not asked and about.inference and not about.inference.complete:
            return name in partly or about.oriented
        return needs[name] <= there

    fitting = [name for name in names if fits(name)]
    fuller = [needs[name] for name in fitting if declared(name).oriented]
    fitting = [
        name
        for name in fitting
        if declared(name).oriented or not any(needs[name] <= other for other in fuller)
    ]
    if len(fitting) == 1 or (partly and not fitting and not asked):
        return [*fitting, *partly][0]
    if fitting:
        reason = f"the columns allow {' and '.join(fitting)}; name what is measured "
        reason += "with --model, or row by row in a column 'model'"
        raise table.error(reason)
    told = ", ".join(f"{name} ({_columns_of(name)})" for name in names)
    reason = f"no measured columns for {told}; contacts need --model"
    raise table.error(reason + ELSEWHERE)


def _names(model: str) -> bool:
    """Whether every measurement has to name a target."""
    return declared(model).naming.required == "every"


def _columns_of(model: str) -> str:
    about = ["orientation"] * declared(model).oriented + ["target"] * _names(model)
    return ", ".join([*needed(model), *about]) or "nothing"
