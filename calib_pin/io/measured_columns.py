"""Columns of a file: which joint or which measured value each holds, in which unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.columns import (
    ANGLE,
    ELSEWHERE,
    KINDS,
    LENGTH,
    NAMES,
    PURE,
    Floats,
    Kind,
    split_header,
)
from calib_pin.io.table import Table
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import JointColumns, advice, drives_of
from calib_pin.kinematics.joint_space import FREE_TRAVEL
from calib_pin.kinematics.tree import turns
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.measurement_models.declaration import DIAL
from calib_pin.measurement_models.orientations import NORM, normalized, quaternions
from calib_pin.observations import AT, Conditions, Indices, Labels
from calib_pin.setup import STATED, JointMap, OrientationSetup

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

STROKE = replace(LENGTH, largest=0.1)
"""Readings of gauges."""

SIGMAS = {
    unit: replace(KINDS[unit], largest=size, least=1e-12 * size)
    for unit, size in (("m", 1.0), ("rad", 1.0), ("px", 1e3))
}
"""Standard deviations that can be meant, by unit."""

DIRECTION = ".direction"
"""End of the name of a column with the direction in which a joint was approached."""

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
TIME = Kind("s", SECONDS, np.inf)

CONDITIONS = {"temperature": Kind("degC", {"degC": 1.0}, np.inf), "time": TIME}
"""Columns that are read where they hold numbers throughout."""

FEW = 4
"""Measurements from which an orientation that never moves is none."""


MIMICRY = 1e-3
"""Largest distance of a joint from where the one that it mimics takes it [rad, m]:
encoders of both, and limits that are rounded, differ by less."""

NEAR = 0.05
"""Distance of a column from that of a joint, rms in standard deviations of it, below
which it is one of that joint, too."""

LONGEST_TRAVEL = 20.0
"""Largest position of a prismatic joint that can be meant [m]: a long rail."""


def needed(model: str) -> dict[str, Kind]:
    """The measured columns that a model cannot do without."""
    return {name: KINDS[unit] for name, unit in declared(model).columns.items()}


def optional(*models: str) -> dict[str, Kind]:
    """The deviations that models read where there are any; default those of all."""
    ways = [way for m in models or MEASUREMENT_MODELS for way in declared(m).readings]
    return {name: STROKE for names in ways for name in names}


def measured(*models: str) -> dict[str, Kind]:
    """All columns that hold what a model measures; default what any model does."""
    kinds = dict[str, Kind]()
    for model in models or MEASUREMENT_MODELS:
        kinds |= needed(model) | optional(model)
        kinds |= ORIENTATION if declared(model).oriented else {}
    return kinds


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
    deviations = {name for names in sigmas(model).values() for name in names}
    return frozenset({*measured(model)} | deviations - {"sigma"})


def reserved() -> frozenset[str]:
    """Names that have a meaning in every file, whatever the robot's joints are."""
    read = frozenset({"sigma", *NAMES}).union(*map(read_by, MEASUREMENT_MODELS))
    return read | {f"sigma_{name}" for name in measured()}


def orientation_columns(table: Table) -> str:
    """The one way in which a file states orientations, one of `STATED`."""
    first = {w: name for w, names in STATED.items() for name in names if name in table}
    if len(first) != 1:
        text = " and ".join(first.values()) or "none"
        reason = f"model 'pose' needs one orientation, the file has {text}"
        ways = " or ".join(",".join(names) for names in STATED.values())
        raise table.error(reason, ["", *first.values()][-1], ways)
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
    norm, unit = normalized(given)
    off = abs(norm - 1.0)
    if off[row := int(np.argmax(off))] > NORM:
        reason = f"the norm of the quaternion is {norm[row]:.6g}"
        raise table.error(reason, STATED[way][-1], "0.99 to 1.01", row)
    return np.asarray(np.where(unit[:, 3:] < 0.0, -unit, unit))


def read_values(
    table: Table, model: str, orientation: OrientationSetup | None = None
) -> tuple[tuple[str, ...], Floats]:
    """The measured values of a model.

    Args:
        table: The file.
        model: Name of the model.
        orientation: How columns of an orientation are to be read.

    Returns:
        The columns that were used, and the values in the layout of
        `Measurements.values`, shape (N, D).

    Raises:
        InputError: If a column is missing, or a value cannot be; of the deviations of
            contacts, if only some components have one, or one has two.
    """
    about, kinds = declared(model), needed(model)
    unknown = table.columns.keys() - reserved()
    table.require(kinds, f"model '{model}' needs the missing", unknown)
    given = {*optional()} & table.columns.keys() if about.contact else set()
    if given:
        gauges = [name for names in about.readings for name in names if name in given]
        once = all(len({*names} & given) == 1 for names in about.readings)
        if {*gauges} != given or not once:
            reason = f"of a gauge '{model}' needs every column once, and no other"
            needs = ", ".join(map(" or ".join, about.readings))
            raise table.error(reason, max(given), needs)
        values = table.values((name, STROKE) for name in gauges)
        return tuple(gauges), values * [-1.0 if DIAL in n else 1.0 for n in gauges]
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
    units, ways = declared(model).units, sigmas(model)
    if "sigma" in table and len({*units.values()}) > 1:
        reason = (
            f"model '{model}' has components of several units, which need their own"
        )
        raise table.error(reason, "sigma", ", ".join(f"sigma_{of}" for of in ways))
    columns = {of: n for of, names in ways.items() for n in names if n in table}
    if not columns:
        return {}, None
    reason = "a sigma is needed for every component or for none; missing:"
    table.require([f"sigma_{name}" for name in ways if name not in columns], reason)
    kinds = map(SIGMAS.__getitem__, units.values())
    return columns, table.values(zip(columns.values(), kinds, strict=True))


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
    for column, wrong, reason in (
        ("distance", begins != (distance == 0.0), f"{of}, where alone distance is 0"),
        ("distance", distance < 0.0, "a distance from a start is not negative"),
        ("target", np.bincount(start)[start] == 1, f"{of}, and no other row is of it"),
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
    for name, values in zip(POSITION, (positions - center).T, strict=True):
        table.check(name, values, kind)


def read_conditions(table: Table, joints: Sequence[str]) -> tuple[Conditions, set[str]]:
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
    pairs = ((n, table.numbers_if_any(n, kind)) for n, kind in CONDITIONS.items())
    conditions: dict[str, Any] = {n: c for n, c in pairs if c is not None}
    directions = np.zeros((len(table.lines), len(joints)), np.int8)
    used = {*conditions}
    for k, name in enumerate(joint + DIRECTION for joint in joints):
        if name in table:
            column = table.columns[name]
            signs = np.where(column.missing(), 0.0, column.numbers)
            wrong = ~np.isin(signs, (-1, 0, 1))
            allowed = "1, -1, or 0 where it is not known"
            table.refuse(wrong, "not the sign of a joint's last motion", name, allowed)
            directions[:, k] = signs
            conditions |= {"direction": directions, "source": "columns"}
            used.add(name)
    return Conditions(**conditions), used


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
    names = asked or [name for name in MEASUREMENT_MODELS if declared(name).inferred]
    # No instrument repeats all of its digits.
    numbers = [table.columns[name].numbers for name in ORIENTED & table.columns.keys()]
    turned = any(len(n) < FEW or bool(np.ptp(n) != 0.0) for n in numbers)
    present = {*table.columns, *["orientation"] * turned}
    about = {name: declared(name) for name in names}
    columns = {n: [*needed(n), *["orientation"] * about[n].oriented] for n in names}
    needs = {name: {*columns[name]} for name in names}
    partly = [name for name in names if needs[name] & present]
    lacks = "target" not in present
    named = {n for n in names if about[n].naming.required == "every" and lacks}
    idle = {n for n in names if about[n].contact and (partly or n in named)}
    fitting = {n for n in names if needs[n] <= present} - idle
    # What is there in part is told as missing; `u` alone may mean something else.
    for name in () if asked else partly:
        if about[name].inferred == "part" and (turned or not about[name].oriented):
            fitting.add(name)
    fitting = {n for n in fitting if not any(needs[n] < needs[m] for m in fitting)}
    fitting = fitting or {*(() if asked else partly[:1])}
    if len(fitting) == 1:
        return fitting.pop()
    if fitting:
        ways = " and ".join(name for name in names if name in fitting)
        raise table.error(f"the columns allow {ways}; say --model, or a column 'model'")
    models = [f"{n} ({', '.join(columns[n]) or 'target'})" for n in names]
    reason = f"no measured columns for {', '.join(models)}; contacts need --model"
    raise table.error(reason + ELSEWHERE)


def joints_in(
    table: Table, chain: Chain | Chains, joints: Mapping[str, JointMap]
) -> tuple[Table, JointColumns]:
    """A table that knows its joints by name, and the columns of these.

    Args:
        table: The file.
        chain: The chain, or all chains that are measured.
        joints: How file columns become joints; others are taken by their own name.

    Raises:
        InputError: If a column has another meaning already, or see `JointColumns.of`.
    """
    columns, known = JointColumns.of(chain, joints), reserved()
    for joint in columns.maps:
        for name in kinds_of(columns, joint):
            # One that is not there is told as missing.
            if name in known and (name in table or name != joint):
                reason = f"column '{name}' has its own meaning: for joint '{joint}' "
                raise InputError(f"{reason}name another by 'joints' in the setup file")
    return table.whole({*chain.robot.model.names, *joints}), columns


def kinds_of(columns: JointColumns, joint: str) -> dict[str, Kind]:
    """Kinds of the column of a joint, which comes first, and of those it adds."""
    column, given = columns.maps[joint]
    return {name: kind_of(columns, name) for name in (column, *given.coupled)}


def kind_of(columns: JointColumns, name: str) -> Kind:
    """Kind of a column."""
    return ANGLE if columns.angular[name] else LENGTH


def read_positions(
    table: Table,
    chain: Chain | Chains,
    columns: JointColumns,
    chain_of: Labels | None = None,
) -> Floats:
    """Joint positions in the order of the joints.

    A joint that mimics another follows it, and needs no column.

    Args:
        table: The file.
        chain: The chain, or all chains that are measured.
        columns: The columns of their joints.
        chain_of: Chain of each measurement, which has to state the joints of this one;
            others may be blank and then are zero. None if all need all.

    Returns:
        Joint positions, shape (N, n) [rad, m].

    Raises:
        InputError: If a column is missing, its values cannot be in their unit, or a
            joint is not where the one that it mimics takes it.
    """
    chains, present = Chains.of(chain), table.columns.keys()
    drives = zip(columns.joints, columns.names, strict=True)
    lacking = [joint for joint, name in drives if joint and name not in present]
    hint = advice(chains[chains.names[0]], lacking) if lacking else ""
    if lacking and f"joint.{lacking[0]}" in present:
        raise table.error("these are errors that a calibration left, no measurements")
    known = {*columns.names, *reserved(), *chains.robot.model.names}
    table.require(columns.names, "no joint column", present - known, hint or ELSEWHERE)
    q = np.zeros((len(table.lines), len(chains.joints)))
    stated = np.zeros(q.shape, bool)
    for i, joint in enumerate(chains.joints):
        names = kinds_of(columns, joint).keys()
        if not names <= present:
            continue
        rows = np.ones(len(q), bool)
        if chain_of is not None:
            needs = [joint in drives_of(chains[name]) for name in chain_of.names]
            blank = [table.columns[name].missing() for name in names]
            rows = np.array(needs)[chain_of.codes] | ~np.any(blank, axis=0)
        stated[:, i] = rows
        if rows.any():
            part = table if rows.all() else table.rows(np.flatnonzero(rows))
            q[rows, i] = _positions(part, chains, columns, i)
    followed = chains.follow(q)
    off = stated & (abs(followed - q) > MIMICRY)
    for joint in chains.mimics if off.any() else ():
        i, leader = chains.joints.index(joint), chains.mimics[joint].leader
        unit = "rad" if chains.revolute[i] else "m"
        place = f"{followed[np.argmax(off[:, i]), i]:.6g} {unit}"
        reason = f"joint '{joint}' mimics '{leader}', which puts it at {place}"
        allowed = f"less than {MIMICRY:g} {unit} away; the column may be left out"
        table.refuse(off[:, i], reason, columns.maps[joint][0], allowed)
    return followed[:, : len(chain.joints)]


def _positions(table: Table, chains: Chains, columns: JointColumns, i: int) -> Floats:
    """Positions of one joint, shape (N,) [rad, m].

    Raises:
        InputError: If they can only be degrees or millimeters.
    """
    joint, lower, upper = chains.joints[i], chains.lower[i], chains.upper[i]
    kinds, (column, given) = kinds_of(columns, joint), columns.maps[joint]
    parts = {name: table.numbers(name, kind) for name, kind in kinds.items()}
    q, kind = parts[column], kinds[column]
    if given != JointMap(joint):
        # What overflows is told with its line.
        with np.errstate(over="ignore", invalid="ignore"):
            q = q + sum(factor * parts[name] for name, factor in given.coupled.items())
            q = given.sign * given.gear * q + given.offset
    most, free = LONGEST_TRAVEL, FREE_TRAVEL
    if kind is ANGLE:
        most, free = ANGLE.largest, np.pi
    # A turntable may be allowed more turns than any threshold would guess.
    limit, travel = max(abs(lower), abs(upper)), upper - lower
    most = max(most, 2.0 * limit)
    if kind is LENGTH and 0.5 * travel < np.radians(np.ptp(q)) <= travel:
        gear = f"{{joint: {joint}, gear: {np.radians(1.0):.9g}}}"
        reason = f"looks converted as an angle; state 'joints: {{{column}: {gear}}}'"
        table.refuse(np.abs(q) > most, reason, column)
    unit, farthest = table.columns[column].unit or kind.si, q[np.argmax(np.abs(q))]
    # The chain gives free limits to joints without any, which may go further.
    for smaller in kind.smaller(unit)[:1] if (lower, upper) != (-free, free) else ():
        if lower <= kind.units[smaller] / kind.units[unit] * farthest <= upper:
            # A meter or radian of grace: limits are often narrower than the robot's.
            # Few joints stay within six degrees; an angle is none in degrees.
            limit += max(travel, 1.0)
            most = min(most, max(limit, 2.0 * np.pi) if kind is ANGLE else limit)
    return table.check(column, q, replace(kind, largest=most))


def shown_columns(
    q: Floats, columns: JointColumns, degrees: bool = False
) -> dict[str, Floats]:
    """Columns of a file by their headers, for given positions.

    Columns that are coupled to a joint of the chain without being one of its own (an
    external axis) are zero.

    Args:
        q: Joint positions, shape (N, n) [rad, m].
        columns: The columns of the joints.
        degrees: Whether angles are in degrees.

    Raises:
        InputError: If the couplings of the joint map cannot be undone.
        OutputError: If a name would not read back.
    """
    shown = {}
    for name, values in zip(columns.names, columns.values(q).T, strict=True):
        kind = kind_of(columns, name)
        header, unit = column_name(name), "deg" if degrees and kind is ANGLE else ""
        if unit or split_header(name) != (name, None):
            # Other software reads brackets at the end of a name as a unit.
            unit = unit or kind.si
            header = f"{header} [{unit}]"
        shown[header] = values / kind.units[unit] if unit else values
    return shown


def column_name(joint: str) -> str:
    """The name of a column of joint positions.

    Raises:
        OutputError: If it would not read back.
    """
    if joint != joint.strip() or joint in reserved():
        raise OutputError(f"joint '{joint}' cannot be the name of a column")
    return joint


def spare_columns(
    table: Table, chain: Chain | Chains, joints: Mapping[str, JointMap]
) -> list[str]:
    """The columns that hold no joint, neither of the chain nor of the whole robot.

    A recording of all joints is the usual case, so a joint outside the chain is not
    worth a remark. The own name of a joint that is mapped from another column is.
    """
    sources = {*joints, *(c for given in joints.values() for c in given.coupled)}
    mapped = {given.joint for given in joints.values()}
    robot_joints = set(chain.robot.model.names) - mapped - reserved()
    return [name for name in table.columns if name not in sources | robot_joints]


def spare_positions(
    table: Table, chains: Chains, columns: JointColumns, q: Floats, spare: Sequence[str]
) -> dict[tuple[str, str], Floats]:
    """Positions that a file states beside those of the joints, by joint and column.

    Those of joints that are no part of the chains, and columns that follow that of a
    joint closely: a recording has commanded and measured positions, or two encoders.

    Args:
        table: The file.
        chains: The chains that are measured.
        columns: The columns of their joints.
        q: Positions of these, shape (N, n) [rad, m].
        spare: Columns that hold no joint.

    Returns:
        Positions, each of shape (N,) [rad, m].
    """
    model, positions = chains.robot.model, dict[tuple[str, str], Floats]()
    known = reserved()
    for joint in [*model.names][1:]:
        if joint not in chains.joints:
            kind = ANGLE if turns(model, joint) else LENGTH
            if (values := table.numbers_if_any(joint, kind)) is not None:
                positions[joint, joint] = values
    for name in (name for name in spare if name not in known):
        near, nearest = NEAR, dict[tuple[str, str], Floats]()
        for i, joint in enumerate(chains.joints):
            column, given = columns.maps[joint]
            kind = kind_of(columns, column)
            values, other = (table.numbers_if_any(n, kind) for n in (column, name))
            if values is None or other is None:
                continue
            with np.errstate(over="ignore"):  # What means something else.
                rms = float(np.sqrt(np.mean((away := other - values) ** 2)))
            if 0.0 < rms < near * values.std():
                near, moved = rms / values.std(), given.sign * given.gear * away
                nearest = {(joint, name): q[:, i] + moved}
        positions |= nearest
    return positions
