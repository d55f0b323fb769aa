"""Other frames for the same robot: z along every joint's axis, as vendors have it.

Only the axes of the joints are physical. A frame may stand anywhere on its axis and
turn about it, so the same robot has many descriptions; a vendor's own, with offsets of
meters that cancel between parallel axes, is one of them. Frames are laid on the axes as
near as they can be to given ones, and the forward kinematics stays what it was.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, se3_exp

ACROSS = 0.9
"""Cosine from which a direction is too near an axis to tell a turn about it."""


def axis_frames(chain: Chain) -> list[tuple[Floats, Floats]]:
    """A point and the direction of every joint's axis in the base, at zero positions.

    Directions are those in which joints count, also of joints that are traversed from
    child to parent.
    """
    frames = chain.joint_frames()
    signs = np.where(chain.reversed, -1.0, 1.0)
    return [
        (frame[:3, 3], sign * frame[:3, :3] @ axis)
        for frame, axis, sign in zip(frames, chain.axes, signs, strict=True)
    ]


def along(point: Floats, axis: Floats, near: pin.SE3) -> pin.SE3:
    """The frame with z along an axis that is nearest to another.

    Args:
        point: A point of the axis, shape (3,) [m].
        axis: Unit vector, shape (3,).
        near: The other.

    Examples:
        >>> frame = along(np.array([1.0, 0, 5]), np.array([0, 0, 1.0]), pin.SE3(1))
        >>> frame.translation.tolist(), frame.rotation.tolist() == np.eye(3).tolist()
        ([1.0, 0.0, 0.0], True)
    """
    # Of a frame that lies across, another axis tells the turn.
    k = 0 if abs(axis @ near.rotation[:, 0]) < ACROSS else 1
    x = near.rotation[:, k] - axis * (axis @ near.rotation[:, k])
    x /= np.linalg.norm(x)
    origin = point + axis * (axis @ (near.translation - point))
    return pin.SE3(np.column_stack([x, np.cross(axis, x), axis]), origin)


def poses_about_z(
    origins: Sequence[pin.SE3], turns: Sequence[bool], q: Floats
) -> Floats:
    """Poses of the tip of joints that turn about, or slide along, their own z axis.

    Args:
        origins: Of each of the n joints in the frame of the one before, and of the tip.
        turns: Whether each joint turns.
        q: Joint positions, shape (N, n) [rad, m].
    """
    T = origins[0].homogeneous
    for origin, turn, positions in zip(origins[1:], turns, q.T, strict=True):
        twists = np.zeros((len(q), 6))
        twists[:, 5 if turn else 2] = positions
        T = T @ se3_exp(twists) @ origin.homogeneous
    return np.asarray(T)
