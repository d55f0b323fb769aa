"""Read files of targets or of joint motions; write files of joint commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import calib_pin.io.measured_columns as measured_columns
from calib_pin.control.joints import Joints
from calib_pin.errors import OutputError
from calib_pin.io.measurements import encode_table
from calib_pin.io.table import Table, read_table
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.kinematics.spatial import Floats, from_quaternion
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.setup import JointMap

ROW = "row"
"""Column with the line number of a target in its file."""


@dataclass(frozen=True)
class Targets:
    """The targets or the joint motion in a file, for a robot with n joints.

    Attributes:
        table: Cells of the file.
        columns: Columns of the joints.
        q: Joint positions, shape (N, n) [rad, m]; those of continuous joints in the
            turns of the shortest way from row to row. None where the file has none.
        T: Poses of the N targets, with identity rotation where the file states no
            orientation, shape (N, 4, 4); None where the file holds joint positions
            only, which is a motion of the nominal robot.
        oriented: Whether the file states orientations.
    """

    table: Table
    columns: JointColumns
    q: Floats | None
    T: Floats | None
    oriented: bool


def read_target_file(
    path: str | Path,
    chain: Chain,
    *,
    columns: Mapping[str, str] = {},
    joints: Mapping[str, JointMap] = {},
    base: Floats | None = None,
    timed: bool = False,
    notice: Callable[[str], None] | None = None,
) -> Targets:
    r"""Read targets or a joint motion.

    Args:
        path: CSV file with target positions (orientations are optional), all joint
            positions, or both.
        chain: Chain whose joints the file may hold.
        columns: What columns with foreign names are, ours to theirs.
        joints: Mapping of file columns to joints; a joint without one is read from the
            column of its own name.
        base: Origin of the base of the chain in the frame of the targets, shape (3,)
            [m]; default zero.
        timed: Whether the times of targets are asked for, see `read_times`.
        notice: Called with one sentence that lists the ignored columns.

    Raises:
        InputError: If the file holds neither targets nor joint positions, or a value is
            invalid; names the file and, where it can, the line, the column and the
            value.

    Examples:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "targets.csv"
        ...     _ = file.write_text("x [mm],y [mm],z [mm]\n900,0,250\n")
        ...     targets = read_target_file(file, chain)
        >>> targets.T[0, :3, 3].tolist(), targets.oriented
        ([0.9, 0.0, 0.25], False)
    """
    table = read_table(path, columns=columns)
    table, joint_columns = measured_columns.joints_in(table, chain, joints)
    oriented = bool(measured_columns.ORIENTED & table.columns.keys())
    has_targets = oriented or bool({*measured_columns.POSITION} & table.columns.keys())
    has_joints = bool({*joint_columns.names} & table.columns.keys())
    if not has_targets and not has_joints:
        needs = f"x, y, z of targets, or the joints {', '.join(joint_columns.names)}"
        raise table.error("neither targets nor joint positions", allowed=needs)
    q = None
    if has_joints:
        given = measured_columns.read_positions(table, chain, joint_columns)
        q = Joints.of(chain).continued(given)
    if not has_targets:
        return Targets(table, joint_columns, q, None, False)
    spare = measured_columns.spare_columns(table, chain, joints)
    spare = [name for name in spare if name not in joint_columns.names]
    model = (Pose if oriented else Position).declaration.name
    used, values = measured_columns.read_values(table, model)
    center = np.zeros(3) if base is None else base
    measured_columns.check_spread(table, chain, values[:, :3], center)
    read = {*used, *["time"][:timed]}
    ignored = table.ignored([name for name in spare if name not in read])
    if ignored and notice is not None:
        notice(ignored)
    T = np.tile(np.eye(4), (len(values), 1, 1))
    T[:, :3, 3] = values[:, :3]
    if oriented:
        T[:, :3, :3] = from_quaternion(values[:, 3:])
    return Targets(table, joint_columns, q, T, oriented)


def read_times(targets: Targets) -> Floats | None:
    """The times of a motion or of targets, shape (N,) [s]; None where there are none.

    Raises:
        InputError: If a time is none, or not after the one before.
    """
    if "time" not in targets.table:
        return None
    time = targets.table.numbers("time", measured_columns.TIME)
    back = np.diff(time, prepend=-np.inf) <= 0.0
    targets.table.refuse(back, "the time does not go on here", "time")
    return time


def encode_commands(
    targets: Targets,
    q: Floats,
    rows: NDArray[np.int64],
    *,
    degrees: bool = False,
    times: Floats | None = None,
    comments: Sequence[str] = (),
) -> bytes:
    r"""Joint commands as a CSV file.

    Joint columns keep the names and units of the target file, if it has any. For
    targets, a column `row` holds the line number of each; in a motion the other columns
    hold what they held.

    Args:
        targets: The requested targets or motion.
        q: Joint commands for K of the targets, shape (K, n) [rad, m].
        rows: Indices of these targets, shape (K,).
        degrees: Whether angles are in degrees, where the target file has no joints.
        times: When each is reached, shape (K,) [s], as a column `time`.
        comments: Lines for the head of the file.

    Raises:
        InputError: If the joint map cannot be undone.
        OutputError: If a name would not read back.

    Examples:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space6")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     asked = Path(folder) / "targets.csv"
        ...     _ = asked.write_text("x,y,z\n0.9,0,0.25\n")
        ...     targets = read_target_file(asked, chain)
        >>> encode_commands(targets, np.zeros((1, 6)), np.array([0])).splitlines()[1]
        b'0.0,0.0,0.0,0.0,0.0,0.0,2'
    """
    columns = _command_columns(targets, q, rows, degrees)
    if targets.T is not None:
        if ROW in targets.columns.names:
            raise OutputError(f"a joint column is called '{ROW}', as lines of targets")
        columns[ROW] = targets.table.lines[rows].tolist()
    if times is not None:
        columns["time"] = times.tolist()
    return encode_table(columns, comments)


def _command_columns(
    targets: Targets, q: Floats, rows: NDArray[np.int64], degrees: bool
) -> dict[str, Sequence[object]]:
    """Cells by header of the joint columns, and of all columns of a motion.

    The change is added to the value in the file, so that a column coupled with a joint
    outside the chain (an external axis) keeps the contribution of that joint.
    """
    ours, columns = targets.columns, targets.table.columns
    if targets.q is None:
        shown = measured_columns.shown_columns(q, ours, degrees)
        return {header: column.tolist() for header, column in shown.items()}
    before = targets.q[rows]
    # Columns that are only coupled stay.
    moved = dict(zip(ours.names, (ours.values(q) - ours.values(before)).T, strict=True))
    moved = {n: moved[n] for n, j in zip(ours.names, ours.joints, strict=True) if j}
    for k, (joint, (name, given)) in enumerate(ours.maps.items()):
        if joint not in ours.joints and name in columns:  # It mimics another.
            moved[name] = (q - before)[:, k] / (given.sign * given.gear)
    result = dict[str, Sequence[object]]()
    for name in columns if targets.T is None else dict.fromkeys([*ours.names, *moved]):
        column = columns[name]
        if name in moved:
            kind = measured_columns.kind_of(ours, name)
            change = moved[name] / kind.units[column.unit or kind.si]
            result[column.header] = (column.numbers[rows] + change).tolist()
        else:
            result[column.header] = [*column.rows(rows).texts()]
    return result
