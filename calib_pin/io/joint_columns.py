"""Joint columns of a file: which column is which joint, in which unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib_pin.errors import InputError, OutputError
from calib_pin.io.columns import ANGLE, ELSEWHERE, LENGTH, Floats, Kind, split_header
from calib_pin.io.measured_columns import reserved
from calib_pin.io.table import Table
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
    chains, there = Chains.of(chain), table.columns.keys()
    drives = zip(columns.joints, columns.names, strict=True)
    lacking = [joint for joint, name in drives if joint and name not in there]
    hint = advice(chains[chains.names[0]], lacking) if lacking else ""
    known = {*columns.names, *reserved(), *chains.robot.model.names}
    table.require(columns.names, "no joint column", there - known, hint or ELSEWHERE)
    q, stated = np.zeros((len(table.lines), len(chains.joints))), {}
    for i, joint in enumerate(chains.joints):
        names = kinds_of(columns, joint).keys()
        if not names <= there:
            continue
        rows = np.ones(len(q), bool)
        if chain_of is not None:
            needs = [joint in drives_of(chains[name]) for name in chain_of.names]
            blank = [table.columns[name].missing() for name in names]
            rows = np.array(needs)[chain_of.codes] | ~np.any(blank, axis=0)
        stated[joint] = rows
        if rows.any():
            part = table if rows.all() else table.rows(np.flatnonzero(rows))
            q[rows, i] = _positions(part, chains, columns, i)
    followed = chains.follow(q)
    for joint in chains.mimics.keys() & stated.keys():
        i, leader = chains.joints.index(joint), chains.mimics[joint].leader
        apart, unit = abs(followed - q)[:, i], "rad" if chains.revolute[i] else "m"
        if chains.revolute[i]:  # A controller may report it within one turn.
            apart = abs(apart - 2.0 * np.pi * np.round(apart / (2.0 * np.pi)))
        # One that leads nothing may lack.
        far = stated[joint] & stated.get(leader, True) & (apart > MIMICRY)
        place = f"{followed[np.argmax(far), i]:.6g} {unit}"
        reason = f"joint '{joint}' mimics '{leader}', which puts it at {place}"
        allowed = f"less than {MIMICRY:g} {unit} away; the column may be left out"
        table.refuse(far, reason, columns.maps[joint][0], allowed)
    return followed[:, : len(chain.joints)]


def _positions(table: Table, chains: Chains, columns: JointColumns, i: int) -> Floats:
    """Positions of one joint, shape (N,) [rad, m].

    Raises:
        InputError: If they can only be degrees or millimeters.
    """
    joint, lower, upper = chains.joints[i], chains.lower[i], chains.upper[i]
    kinds, (column, given) = kinds_of(columns, joint), columns.maps[joint]
    parts = {name: table.numbers(name, kind) for name, kind in kinds.items()}
    q, kind, why = parts[column], kinds[column], ""
    if given != JointMap(joint):
        # What overflows is told with its line.
        with np.errstate(over="ignore", invalid="ignore"):
            q = q + sum(factor * parts[name] for name, factor in given.coupled.items())
            q = given.sign * given.gear * q + given.offset
        why = f"as mapped to joint '{joint}', offset {given.offset:g} {kind.si}"
    angle = kind is ANGLE
    most, free = (ANGLE.largest, np.pi) if angle else (LONGEST_TRAVEL, FREE_TRAVEL)
    # A turntable may be allowed more turns than any threshold would guess.
    most = max(most, 2.0 * abs(lower), 2.0 * abs(upper))
    table.check(column, q, replace(kind, largest=most), why)
    unit = table.columns[column].unit or kind.si
    # The chain gives free limits to joints without any, which may go further.
    if (lower, upper) != (-free, free) and (smaller := kind.smaller(unit)):
        excess = np.maximum(lower - q, q - upper)
        ratio = kind.units[smaller[0]] / kind.units[unit]
        if lower <= ratio * q[np.argmax(excess)] <= upper:
            # A meter or radian of grace: limits are often narrower than the robot's.
            grace = replace(kind, largest=max(upper - lower, 1.0))
            why = f"the limits are {lower:.6g} to {upper:.6g}"
            table.check(column, q, grace, why, excess)
    return q


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
        if joint not in chains.joints:
            own = table.found(joint, ANGLE if turns(model, joint) else LENGTH)
            found |= {} if own is None else {(joint, joint): own}
    for name in (name for name in spare if name not in reserved()):
        near, nearest = NEAR, dict[tuple[str, str], Floats]()
        for i, joint in enumerate(chains.joints):
            column, given = columns.maps[joint]
            kind = kind_of(columns, column)
            own, other = table.found(column, kind), table.found(name, kind)
            if own is None or other is None:
                continue
            with np.errstate(over="ignore"):  # What means something else.
                rms = float(np.sqrt(np.mean((other - own) ** 2)))
            if 0.0 < rms < near * own.std():
                near, moved = rms / own.std(), given.sign * given.gear * (other - own)
                nearest = {(joint, name): q[:, i] + moved}
        found |= nearest
    return found
