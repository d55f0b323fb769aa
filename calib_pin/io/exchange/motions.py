"""Joint commands as robots run them: URScript, and a trajectory of ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import yaml

from calib_pin.errors import OptionError
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats

FASTEST = 100.0
"""Speed from which a limit is none [rad/s, m/s]."""

ACCELERATION = 1.2
"""Acceleration of moves in URScript [rad/s^2], of which Universal Robots make 1.4."""


def speed_limits(chain: Chain, part: float) -> Floats:
    """Speeds of the joints, a part of those that the URDF allows, shape (n,).

    Raises:
        OptionError: If the URDF states none of a joint.
    """
    model = chain.robot.model
    limits = np.array(
        [model.velocityLimit[model.idx_vs[model.getJointId(j)]] for j in chain.joints]
    )
    without = [
        joint
        for joint, limit in zip(chain.joints, limits, strict=True)
        if not 0.0 < limit < FASTEST
    ]
    if without:
        raise OptionError(
            f"the URDF states no speed of {', '.join(without)}, which a program needs",
            file=chain.robot.file,
            allowed='<limit velocity="..."/>',
        )
    return np.asarray(part * limits)


def moving_times(q: Floats, limits: Floats) -> Floats:
    """When each command is reached at these speeds, the first at zero, shape (N,) [s].

    Example:
        >>> moving_times(np.array([[0.0, 0.0], [1.0, 3.0]]), np.array([1.0, 2.0]))
        array([0. , 1.5])
    """
    steps = np.max(np.abs(np.diff(q, axis=0)) / limits, axis=1, initial=0.0)
    return np.concatenate([[0.0], np.cumsum(steps)])


def urscript(chain: Chain, q: Floats, part: float, comments: Sequence[str]) -> bytes:
    """A program of moves from command to command.

    Args:
        chain: The chain.
        q: Joint commands, shape (N, n) [rad].
        part: Part of the allowed speeds.
        comments: Lines for its head.

    Raises:
        OptionError: If the robot is not one of six revolute joints, or its URDF states
            no speeds.
    """
    if len(chain.joints) != 6 or not chain.revolute.all():
        raise OptionError(
            "URScript is for six revolute joints", value=len(chain.joints)
        )
    v = float(speed_limits(chain, part).min())
    lines = [f"# {line}" for line in comments] + ["def commands():"]
    for row in q:
        numbers = ", ".join(repr(float(angle)) for angle in row)
        lines.append(f"  movej([{numbers}], a={ACCELERATION}, v={v:.6g})")
    return "\n".join([*lines, "end", "commands()", ""]).encode()


def joint_trajectory(
    chain: Chain, q: Floats, part: float, comments: Sequence[str]
) -> bytes:
    """A message `trajectory_msgs/JointTrajectory`; the robot begins at the first point.

    Args:
        chain: The chain.
        q: Joint commands, shape (N, n) [rad, m].
        part: Part of the allowed speeds.
        comments: Lines for its head.

    Raises:
        OptionError: If the URDF states no speeds.
    """
    times = moving_times(q, speed_limits(chain, part))
    points = [
        {
            "positions": row.tolist(),
            "time_from_start": {"sec": int(time), "nanosec": int(1e9 * (time % 1.0))},
        }
        for row, time in zip(q, times, strict=True)
    ]
    document = {"joint_names": [*chain.joints], "points": points}
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    return "\n".join([*(f"# {line}" for line in comments), text]).encode()


PROGRAMS: Mapping[str, Callable[[Chain, Floats, float, Sequence[str]], bytes]] = {
    "urscript": urscript,
    "joint-trajectory": joint_trajectory,
}
"""Programs of joint commands by name."""
