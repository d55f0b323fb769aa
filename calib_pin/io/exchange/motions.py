"""Joint commands as robots run them: URScript, and a trajectory of ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import yaml

from calib_pin.errors import OptionError
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices

FASTEST = 100.0
"""Speed from which a limit is none [rad/s, m/s]."""

ACCELERATION = 1.2
"""Acceleration of moves in URScript [rad/s^2], of which Universal Robots make 1.4."""


ROUNDING = 1e-9
"""Part by which a speed may be above its limit."""


def speed_limits(chain: Chain, part: float) -> Floats:
    """Speeds of the joints, a part of those that the URDF allows, shape (n,).

    Joints that mimic another are as fast as that takes them.

    Raises:
        OptionError: If the URDF states none of a joint.
    """
    model, drives = chain.robot.model, JointColumns.of(chain)
    index = [model.idx_vs[model.getJointId(joint)] for joint in drives.joints]
    limits = model.velocityLimit[index]
    pairs = zip(drives.joints, limits, strict=True)
    without = [joint for joint, limit in pairs if not 0.0 < limit < FASTEST]
    if without:
        reason = f"the URDF states no speed of {', '.join(without)}, which is needed"
        allowed = '<limit velocity="..."/>'
        raise OptionError(reason, file=chain.robot.file, allowed=allowed)
    return np.asarray(np.abs(drives.factors) @ (part * limits))


def moving_times(q: Floats, limits: Floats) -> Floats:
    """When each command is reached at these speeds, the first at zero, shape (N,) [s].

    Examples:
        >>> moving_times(np.array([[0.0, 0.0], [1.0, 3.0]]), np.array([1.0, 2.0]))
        array([0. , 1.5])
    """
    steps = np.max(np.abs(np.diff(q, axis=0)) / limits, axis=1, initial=0.0)
    return np.concatenate([[0.0], np.cumsum(steps)])


def paced(
    chain: Chain, q: Floats, rows: Indices, time: Floats
) -> tuple[Floats, Indices]:
    """When commands are reached in a motion that has times of its own.

    Args:
        chain: The chain.
        q: Joint commands, shape (N, n) [rad, m].
        rows: The rows of the motion that they are of, shape (N,).
        time: Times of all its rows, shape (M,) [s].

    Returns:
        Times of the commands, shape (N,), and the rows to which a joint would move
        faster than the URDF allows; none if it states no speeds.
    """
    try:
        limits = speed_limits(chain, 1.0)
    except OptionError:
        limits = np.full(len(chain.joints), np.inf)
    times, least = time[rows], np.diff(moving_times(q, limits))
    late = least > np.diff(times) * (1.0 + ROUNDING)
    return times, rows[1:][late]


def urscript(
    chain: Chain,
    columns: JointColumns,
    q: Floats,
    part: float,
    comments: Sequence[str],
    times: Floats | None = None,
) -> bytes:
    """A program of moves from command to command.

    Args:
        chain: The chain.
        columns: What the controller takes.
        q: Joint commands, shape (N, n) [rad].
        part: Part of the allowed speeds.
        comments: Lines for its head.
        times: When each is reached, shape (N,) [s]; default by the speeds.

    Raises:
        OptionError: If the robot is not one of six revolute joints, or its URDF states
            no speeds.
    """
    if len(columns.names) != 6 or not columns.revolute.all():
        value = f"{len(columns.names)} joints, {columns.revolute.sum()} revolute"
        raise OptionError("URScript is for six revolute joints", value=value)
    v = float(speed_limits(chain, part).min())
    lines = [f"# {line}" for line in comments] + ["def commands():"]
    for k, row in enumerate(columns.values(q)):
        # Without an exponent, which URScript does not promise to read.
        numbers = ", ".join(f"{number:.9f}" for number in row)
        pace = f"a={ACCELERATION}, v={v:.6f}"
        if times is not None and k:
            pace = f"t={times[k] - times[k - 1]:.6f}"
        lines.append(f"  movej([{numbers}], {pace})")
    return "\n".join([*lines, "end", "commands()", ""]).encode()


def joint_trajectory(
    chain: Chain,
    _: JointColumns,
    q: Floats,
    part: float,
    comments: Sequence[str],
    times: Floats | None = None,
) -> bytes:
    """A message `trajectory_msgs/JointTrajectory`; the robot begins at the first point.

    A point that takes no time, as a target that stands twice, is left out: controllers
    refuse a message whose times do not increase.

    Args:
        chain: The chain.
        q: Joint commands, shape (N, n) [rad, m].
        part: Part of the allowed speeds.
        comments: Lines for its head.
        times: When each is reached, shape (N,) [s]; default by the speeds.

    Raises:
        OptionError: If the URDF states no speeds, and there are no times.
    """
    if times is None:
        times = moving_times(q, speed_limits(chain, part))
    drives, stamps = JointColumns.of(chain), np.rint(1e9 * (times - times[:1]))
    later = np.diff(stamps, prepend=-1.0) > 0.0
    whole = (divmod(int(stamp), 10**9) for stamp in stamps[later])
    stamped = [dict(zip(("sec", "nanosec"), parts, strict=True)) for parts in whole]
    rows = zip(drives.values(q[later]).tolist(), stamped, strict=True)
    points = [{"positions": row, "time_from_start": stamp} for row, stamp in rows]
    document = {"joint_names": [*drives.joints], "points": points}
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    return "\n".join([*(f"# {line}" for line in comments), text]).encode()


PROGRAMS: Mapping[str, Callable[..., bytes]] = {
    "urscript": urscript,
    "joint-trajectory": joint_trajectory,
}
"""Programs of joint commands by name."""
