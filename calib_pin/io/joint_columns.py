"""Joint columns of a file: which column is which joint, in which unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np

from calib_pin.errors import CalibPinError, InputError, nearest
from calib_pin.io.columns import ANGLE, ELSEWHERE, LENGTH, Floats, Kind, closest
from calib_pin.io.measured_columns import reserved
from calib_pin.io.table import Table
from calib_pin.io.written_columns import column_name
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
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


@dataclass(frozen=True)
class JointSource:
    """Where the position of one joint of the chain comes from.

    Attributes:
        joint: URDF joint.
        column: File column of the joint.
        kinds: Kind of that column and of those that are coupled to it.
        map: How they become the position; None where the column is the position.
    """

    joint: str
    column: str
    kinds: Mapping[str, Kind]
    map: JointMap | None


def joint_sources(
    chain: Chain | Chains, joints: Mapping[str, JointMap]
) -> tuple[JointSource, ...]:
    """Find the column of every joint of the chain.

    Args:
        chain: The chain, or all chains that are measured.
        joints: Joint map by file column; maps of joints outside the chain are idle.

    Returns:
        One source per joint, in chain order.

    Raises:
        InputError: If the map names a joint that the robot does not have, or leaves a
            joint with two columns or none, or a column has another meaning already.
    """
    mapped = _columns_of_joints(chain, joints)
    column_of = {joint: mapped.get(joint, joint) for joint in chain.joints}
    kind_of = {
        column_of[joint]: ANGLE if revolute else LENGTH
        for joint, revolute in zip(chain.joints, chain.revolute, strict=True)
    }
    sources = []
    for joint, column in column_of.items():
        given = joints.get(column)
        if given is not None and given.joint != joint:
            raise InputError(
                f"column '{column}' is mapped to joint '{given.joint}', so joint "
                f"'{joint}' has no column; map another one to it"
            )
        coupled = given.coupled if given is not None else {}
        # A coupled column has its own joint's unit, or that of the joint it moves.
        kinds = {c: kind_of.get(c, kind_of[column]) for c in (column, *coupled)}
        for name in kinds:
            if name in reserved():
                raise InputError(
                    f"column '{name}' has a meaning of its own and cannot be that of "
                    f"joint '{joint}'; give the joint a column of another name by "
                    "'joints' in the setup file"
                )
        sources.append(JointSource(joint, column, kinds, given))
    return tuple(sources)


def read_positions(
    table: Table,
    chain: Chain | Chains,
    sources: Sequence[JointSource],
    chain_of: Labels | None = None,
) -> Floats:
    """Joint positions in the order of the sources.

    A joint that mimics another follows it, and needs no column.

    Args:
        table: The file.
        chain: The chain, or all chains that are measured.
        sources: The columns of their joints.
        chain_of: Chain of each measurement, which has to state the joints of this one;
            others may be blank and then are zero. None if all need all.

    Returns:
        Joint positions, shape (N, n) [rad, m].

    Raises:
        InputError: If a column is missing, its values cannot be in their unit, or a
            joint is not where the one that it mimics takes it.
    """
    chains, count = Chains.of(chain), len(table.lines)
    needed = {name: stated_joints(chains[name]) for name in chains.names}
    if chain_of is None:
        needed = {"": frozenset[str]().union(*needed.values())}
        chain_of = Labels.all("", count)
    _check_present(table, chains, sources, needed)
    q, stated = np.zeros((count, len(sources))), np.zeros((count, len(sources)), bool)
    for i, source in enumerate(sources):
        if not all(name in table for name in source.kinds):
            continue
        needs = np.array([source.joint in needed[name] for name in chain_of.names])
        rows = needs[chain_of.codes]
        if not rows.all():
            blank = [table.columns[name].blank() for name in source.kinds]
            rows |= ~np.any(blank, axis=0)
        limits = float(chains.lower[i]), float(chains.upper[i])
        if rows.all():
            q[:, i] = _positions(table, source, limits)
        elif rows.any():
            own = table.rows(np.flatnonzero(rows), source.kinds)
            q[rows, i] = _positions(own, source, limits)
        stated[:, i] = rows
    followed = chains.follow(q)
    for joint, mimic in chains.mimics.items():
        i, leader = chains.joints.index(joint), chains.joints.index(mimic.leader)
        far = stated[:, i] & stated[:, leader] & (abs(followed - q)[:, i] > MIMICRY)
        if far.any():
            row, kind = int(np.argmax(far)), sources[i].kinds[sources[i].column]
            raise table.cell_error(
                f"joint '{joint}' mimics '{mimic.leader}', which puts it at "
                f"{followed[row, i]:.6g} {kind.si}",
                sources[i].column,
                row,
                f"{MIMICRY:g} {kind.si} away from there or less; the column may be "
                "left out",
            )
    return followed


def _positions(
    table: Table, source: JointSource, limits: tuple[float, float]
) -> Floats:
    """Positions of one joint, shape (N,) [rad, m]."""
    parts = {c: table.numbers(c, kind) for c, kind in source.kinds.items()}
    position = parts[source.column]
    if source.map is not None:
        # What overflows is told with its line.
        with np.errstate(over="ignore", invalid="ignore"):
            for name, factor in source.map.coupled.items():
                position = position + factor * parts[name]
            position = source.map.sign * source.map.gear * position + source.map.offset
    _check_unit(table, source, position, limits)
    return position


def stated_joints(chain: Chain) -> frozenset[str]:
    """The joints that a measurement of a chain states: those that mimic none."""
    return frozenset(
        chain.mimics[joint].leader if joint in chain.mimics else joint
        for joint in chain.joints
    )


def column_values(q: Floats, sources: Sequence[JointSource]) -> dict[str, Floats]:
    """The values of a file's columns for given positions.

    Columns that are coupled to a joint of the chain without being one of its own (an
    external axis) are zero.

    Args:
        q: Joint positions, shape (N, n) [rad, m].
        sources: The columns of the joints.

    Returns:
        Values by column, each of shape (N,).

    Raises:
        InputError: If the couplings of the joint map cannot be undone.
    """
    columns = [source.column for source in sources]
    A, moved = np.eye(len(sources)), np.array(q, float)
    for i, source in enumerate(sources):
        if source.map is None:
            continue
        moved[:, i] -= source.map.offset
        moved[:, i] /= source.map.sign * source.map.gear
        for name, factor in source.map.coupled.items():
            if name in columns:
                A[i, columns.index(name)] += factor
    if np.linalg.matrix_rank(A) < len(A):
        raise InputError("the couplings in 'joints' cannot be undone")
    # Without couplings nothing is solved, so that no digit changes.
    values = moved if (np.eye(len(A)) == A).all() else np.linalg.solve(A, moved.T).T
    result = dict(zip(columns, values.T, strict=True))
    others = dict.fromkeys(c for source in sources for c in source.kinds)
    return result | {c: np.zeros(len(q)) for c in others if c not in result}


def shown_columns(
    values: Mapping[str, Floats], sources: Sequence[JointSource], degrees: bool
) -> dict[str, Floats]:
    """Columns of joint positions by their headers.

    Args:
        values: Values by column, as `column_values` gives them [rad, m].
        sources: The columns of the joints.
        degrees: Whether angles are in degrees.

    Raises:
        OutputError: If a name would not read back.
    """
    kinds = {c: kind for source in sources for c, kind in source.kinds.items()}
    shown = {}
    for name, column in values.items():
        header = column_name(name)
        if degrees and kinds[name] is ANGLE:
            header, column = f"{header} [deg]", column / ANGLE.units["deg"]
        shown[header] = column
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
    sources: Sequence[JointSource],
    q: Floats,
    spare: Sequence[str],
) -> dict[tuple[str, str], Floats]:
    """Positions that a file states beside those of the joints, by joint and column.

    Those of joints that are no part of the chains, and columns that follow that of a
    joint closely: a recording has commanded and measured positions, or two encoders.

    Args:
        table: The file.
        chains: The chains that are measured.
        sources: The columns of their joints.
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
    here = {c: _all_numbers(some, c, k) for s in sources for c, k in s.kinds.items()}
    for name in (name for name in spare if name not in reserved()):
        far = {}
        for i, source in enumerate(sources):
            own = here.get(source.column)
            there = _all_numbers(some, name, source.kinds[source.column])
            if own is not None and there is not None:
                with np.errstate(over="ignore"):  # What means something else.
                    rms = float(np.sqrt(np.mean((there - own) ** 2)))
                far[i] = rms / max(float(own.std()), 1e-300)
        closest = min(far, key=lambda i: far[i], default=-1)
        if closest >= 0 and 0.0 < far[closest] < NEAR:
            found |= _followed(table, sources[closest], name, q[:, closest])
    return found


def _followed(
    table: Table, source: JointSource, name: str, q: Floats
) -> dict[tuple[str, str], Floats]:
    """Positions of a joint by another column; none where it is not one throughout."""
    kind = source.kinds[source.column]
    here, there = (_all_numbers(table, c, kind) for c in (source.column, name))
    if here is None or there is None:
        return {}
    factor = 1.0 if source.map is None else source.map.sign * source.map.gear
    return {(source.joint, name): q + factor * (there - here)}


def _all_numbers(table: Table, name: str, kind: Kind) -> Floats | None:
    """The numbers of a column [SI unit of the kind]; None where it has others."""
    if name not in table:
        return None
    try:
        return table.numbers(name, kind)
    except CalibPinError:
        return None


def _columns_of_joints(
    chain: Chain | Chains, joints: Mapping[str, JointMap]
) -> dict[str, str]:
    """The mapped column by joint, checked against the robot."""
    # The first name is Pinocchio's "universe", which is no joint.
    known = list(chain.robot.model.names)[1:]
    mapped: dict[str, str] = {}
    for column, given in joints.items():
        if given.joint not in known:
            raise InputError(
                f"'joints' maps column '{column}' to joint '{given.joint}', which the "
                f"robot does not have{nearest(given.joint, known)}",
                allowed=", ".join(chain.joints),
            )
        if given.joint in mapped:
            raise InputError(
                f"'joints' maps two columns, '{mapped[given.joint]}' and '{column}', "
                f"to joint '{given.joint}'"
            )
        mapped[given.joint] = column
    return mapped


def _check_present(
    table: Table,
    chains: Chains,
    sources: Sequence[JointSource],
    needed: Mapping[str, Set[str]],
) -> None:
    """Refuse files without a joint that measurements of a chain need."""
    joint_of = {
        column: source.joint
        for source in sources
        if any(source.joint in joints for joints in needed.values())
        for column in source.kinds
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
    raise table.error(
        f"{what} is missing{hint}{also}{'' if hint else ELSEWHERE}", first
    )


def _check_unit(
    table: Table, source: JointSource, q: Floats, limits: tuple[float, float]
) -> None:
    """Refuse positions that can only be degrees or millimeters."""
    lower, upper = limits
    kind = source.kinds[source.column]
    general = kind.largest if kind is ANGLE else LONGEST_TRAVEL
    # A turntable may be allowed more turns than any threshold would guess.
    largest = max(general, 2.0 * abs(lower), 2.0 * abs(upper))
    why = ""
    if source.map is not None:
        offset = f"{source.map.offset:g} {kind.si}"
        why = f"as mapped to joint '{source.joint}' with an offset of {offset}"
    table.check_size(source.column, q, kind, largest, why)
    unit = table.columns[source.column].unit or kind.si
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
        raise table.implausible(source.column, row, float(q[row]), kind, why)
