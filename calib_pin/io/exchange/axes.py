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
from calib_pin.kinematics.spatial import Floats

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


def relative(frames: Sequence[pin.SE3], first: pin.SE3) -> list[pin.SE3]:
    """Each frame in the one before it, the first in another."""
    before = [first, *frames[:-1]]
    return [a.actInv(b) for a, b in zip(before, frames, strict=True)]


def revolute_poses(first: pin.SE3, origins: Sequence[pin.SE3], q: Floats) -> Floats:
    """Poses of the last frame where every joint turns about the z axis of its own.

    Args:
        first: Where the first origin is.
        origins: Of each joint, in the frame of the one before.
        q: Joint positions, shape (N, n) [rad].
    """
    poses = np.empty((len(q), 4, 4))
    for pose, positions in zip(poses, q, strict=True):
        T = first
        for origin, position in zip(origins, positions, strict=True):
            turn = pin.SE3(pin.utils.rotate("z", float(position)), np.zeros(3))
            T = T * origin * turn
        pose[:] = T.homogeneous
    return poses
