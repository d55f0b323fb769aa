"""Joint columns of a file: which column is which joint, in which unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

import numpy as np

from calib_pin.errors import CalibPinError, InputError
from calib_pin.io.columns import (
    ANGLE,
    ELSEWHERE,
    LENGTH,
    Floats,
    Kind,
    closest,
    split_header,
)
from calib_pin.io.measured_columns import reserved
from calib_pin.io.table import Table
from calib_pin.io.written_columns import column_name
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import JointColumns, advice, drives_of
from calib_pin.kinematics.joint_space import FREE_TRAVEL
from calib_pin.kinematics.tree import turns
from calib_pin.observations import Labels
from calib_pin.setup import JointMap

MIMICRY = 1e-3
"""Largest distance of a joint from where the one that it mimics takes it [rad, m]:
encoders of both, and limits that are rounded, differ by less."""

NEAR = 0.05
"""Distance of a column from that of a joint, rms in standard deviations of it, below
which it is one of that joint, too."""

SOME = 1000
"""Rows that tell how near it is."""

LONGEST_TRAVEL = 20.0
"""Largest position of a prismatic joint that can be meant [m]: a long rail."""


def own_columns(
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
    columns = JointColumns.of(chain, joints)
    for joint in columns.maps:
        for name in kinds_of(columns, joint):
            # One that is not there is told as missing.
            if name in reserved() and (name in table or name != joint):
                raise InputError(
                    f"column '{name}' has a meaning of its own and cannot be that of "
                    f"joint '{joint}'; give the joint a column of another name by "
                    "'joints' in the setup file"
                )
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
    chains, count = Chains.of(chain), len(table.lines)
    needed = {name: frozenset(drives_of(chains[name])) for name in chains.names}
    if chain_of is None:
        needed = {"": frozenset[str]().union(*needed.values())}
        chain_of = Labels.all("", count)
    _check_present(table, chains, columns, needed)
    q, stated = np.zeros((count, len(chains.joints))), {}
    for i, joint in enumerate(chains.joints):
        kinds = kinds_of(columns, joint)
        if not all(name in table for name in kinds):
            continue
        needs = np.array([joint in needed[name] for name in chain_of.names])
        rows = needs[chain_of.codes]
        if not rows.all():
            blank = [table.columns[name].blank() for name in kinds]
            rows |= ~np.any(blank, axis=0)
        limits = float(chains.lower[i]), float(chains.upper[i])
        if rows.all():
            q[:, i] = _positions(table, columns, joint, limits)
        elif rows.any():
            own = table.rows(np.flatnonzero(rows), kinds)
            q[rows, i] = _positions(own, columns, joint, limits)
        stated[joint] = rows
    followed = chains.follow(q)
    for joint in chains.mimics.keys() & stated.keys():
        i, leader = chains.joints.index(joint), chains.mimics[joint].leader
        apart = abs(followed - q)[:, i]
        if chains.revolute[i]:  # A controller may report it within one turn.
            apart = abs(apart - 2.0 * np.pi * np.round(apart / (2.0 * np.pi)))
        # One that leads nothing may lack.
        far = stated[joint] & stated.get(leader, True) & (apart > MIMICRY)
        if far.any():
            row, name = int(np.argmax(far)), columns.maps[joint][0]
            kind = kinds_of(columns, joint)[name]
            raise table.cell_error(
                f"joint '{joint}' mimics '{leader}', which puts it at "
                f"{followed[row, i]:.6g} {kind.si}",
                name,
                row,
                f"{MIMICRY:g} {kind.si} away from there or less; the column may be "
                "left out",
            )
    return followed[:, : len(chain.joints)]


def _positions(
    table: Table, columns: JointColumns, joint: str, limits: tuple[float, float]
) -> Floats:
    """Positions of one joint, shape (N,) [rad, m]."""
    kinds, (column, given) = kinds_of(columns, joint), columns.maps[joint]
    parts = {c: table.numbers(c, kind) for c, kind in kinds.items()}
    position = parts[column]
    if given != JointMap(joint):
        # What overflows is told with its line.
        with np.errstate(over="ignore", invalid="ignore"):
            for name, factor in given.coupled.items():
                position = position + factor * parts[name]
            position = given.sign * given.gear * position + given.offset
    _check_unit(table, column, kinds[column], given, position, limits)
    return position


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
        shown[header] = values / ANGLE.units["deg"] if unit == "deg" else values
    return shown


def spare_columns(
    table: Table, chain: Chain | Chains, joints: Mapping[str, JointMap]
) -> list[str]:
    """The columns that hold no joint, neither of the chain nor of the whole robot.

    A recording of all joints is the usual case, so a joint outside the chain is not
    worth a remark. The own name of a joint that is mapped from another column is.
    """
    taken = {*joints, *(c for given in joints.values() for c in given.coupled)}
    mapped = {given.joint for given in joints.values()}
    own = set(chain.robot.model.names) - mapped - reserved()
    return [name for name in table.columns if name not in taken | own]


def spare_positions(
    table: Table,
    chains: Chains,
    columns: JointColumns,
    q: Floats,
    spare: Sequence[str],
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
    model, found = chains.robot.model, dict[tuple[str, str], Floats]()
    for joint in [*model.names][1:]:
        if joint not in chains.joints and joint in table:
            kind = ANGLE if turns(model, joint) else LENGTH
            positions = _all_numbers(table, joint, kind)
            found |= {} if positions is None else {(joint, joint): positions}
    some = table.rows(slice(SOME), table.columns)
    kinds = {column: kind_of(columns, column) for column, _ in columns.maps.values()}
    here = {column: _all_numbers(some, column, kind) for column, kind in kinds.items()}
    for name in (name for name in spare if name not in reserved()):
        far = {}
        for joint, (column, _) in columns.maps.items():
            own, there = here[column], _all_numbers(some, name, kinds[column])
            if own is not None and there is not None:
                with np.errstate(over="ignore"):  # What means something else.
                    rms = float(np.sqrt(np.mean((there - own) ** 2)))
                far[joint] = rms / max(float(own.std()), 1e-300)
        closest = min(far, key=lambda joint: far[joint], default="")
        if closest and 0.0 < far[closest] < NEAR:
            column, given = columns.maps[closest]
            own, there = (
                _all_numbers(table, one, kinds[column]) for one in (column, name)
            )
            if own is not None and there is not None:
                position = q[:, chains.joints.index(closest)]
                moved = given.sign * given.gear * (there - own)
                found[closest, name] = position + moved
    return found


def _all_numbers(table: Table, name: str, kind: Kind) -> Floats | None:
    """The numbers of a column [SI unit of the kind]; None where it has others."""
    if name not in table:
        return None
    try:
        return table.numbers(name, kind)
    except CalibPinError:
        return None


def _check_present(
    table: Table,
    chains: Chains,
    columns: JointColumns,
    needed: Mapping[str, Set[str]],
) -> None:
    """Refuse files without a joint that measurements of a chain need."""
    every = frozenset[str]().union(*needed.values())
    joint_of = {
        name: joint
        for joint in columns.joints
        if joint in every
        for name in kinds_of(columns, joint)
    }
    missing = [column for column in joint_of if column not in table]
    if not missing:
        return
    first, rest = missing[0], missing[1:]
    known = {*joint_of, *reserved(), *chains.robot.model.names}
    free = [name for name in table.columns if name not in known]
    chain = next(name for name in needed if joint_of[first] in needed[name])
    what = f"joint '{joint_of[first]}' of the chain" + f" '{chain}'" * bool(chain)
    if first != joint_of[first]:
        what = f"column '{first}' for {what}"
    also = f"; missing as well: {', '.join(rest)}" if rest else ""
    hint = closest(first, free)
    # A column that is only coupled has no joint of its own.
    maps = [(joint, columns.maps[joint][0]) for joint in filter(None, columns.joints)]
    own = [joint for joint, column in maps if column in missing]
    hint = hint or advice(chains[chain or chains.names[0]], own) or ELSEWHERE
    raise table.error(f"{what} is missing{also}{hint}", first)


def _check_unit(
    table: Table,
    column: str,
    kind: Kind,
    given: JointMap,
    q: Floats,
    limits: tuple[float, float],
) -> None:
    """Refuse positions that can only be degrees or millimeters."""
    lower, upper = limits
    general = kind.largest if kind is ANGLE else LONGEST_TRAVEL
    # A turntable may be allowed more turns than any threshold would guess.
    largest = max(general, 2.0 * abs(lower), 2.0 * abs(upper))
    why = ""
    if given != JointMap(given.joint):
        offset = f"{given.offset:g} {kind.si}"
        why = f"as mapped to joint '{given.joint}' with an offset of {offset}"
    table.check_size(column, q, kind, largest, why)
    unit = table.columns[column].unit or kind.si
    # The chain gives these to joints without limits, which may go further.
    free = (-np.pi, np.pi) if kind is ANGLE else (-FREE_TRAVEL, FREE_TRAVEL)
    if limits == free or unit not in kind.smaller:
        return
    excess = np.maximum(lower - q, q - upper)
    row = int(np.argmax(excess))
    ratio = kind.units[kind.smaller[unit]] / kind.units[unit]
    # A meter or radian of grace: limits in URDFs are often narrower than the robot's.
    far_off = excess[row] > max(upper - lower, 1.0)
    if far_off and lower <= ratio * q[row] <= upper:
        why = f"the limits are {lower:.6g} to {upper:.6g}"
        raise table.implausible(column, row, float(q[row]), kind, why)
