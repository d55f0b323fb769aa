"""Orientations as files state them, and as quaternions."""

from __future__ import annotations

from itertools import product

import numpy as np

from calib_pin.kinematics.spatial import Floats, from_quaternion, so3_log
from calib_pin.setup import OrientationSetup

NORM = 1e-2
"""Largest difference of the norm of a quaternion from one: it has few digits."""


def quaternions(
    numbers: Floats, columns: str, reading: OrientationSetup | None = None
) -> Floats:
    """Quaternions qx qy qz qw, of the length that was stated, shape (N, 4).

    Args:
        numbers: Numbers in the columns, shape (N, 3) [rad] or (N, 4).
        columns: The way that their names say, one of `STATED`.
        reading: The way in which they are to be read, where it is about these columns.
    """
    if reading is None or reading.columns not in (None, columns):
        return _quaternions(numbers, columns)
    numbers = numbers if columns == "quaternion" else numbers * reading.factor
    result = _quaternions(numbers, reading.hold or columns)
    return inverse(result) if reading.inverse else result


def normalized(given: Floats) -> tuple[Floats, Floats]:
    """Norms of quaternions, shape (N,), and the unit quaternions, shape (N, 4)."""
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(given, axis=1)
    # Dividing a unit quaternion once more may change its last bit, and a file that was
    # written from here must read back as it was.
    divisor = np.where((abs(norm - 1.0) < 1e-14) | (norm == 0.0), 1.0, norm)
    return norm, np.asarray(given / divisor[:, None])


def inverse(quaternions: Floats) -> Floats:
    """Quaternions of inverse rotations, shape (N, 4)."""
    return np.asarray(quaternions * np.array([-1.0, -1.0, -1.0, 1.0]))


def numbers_of(quaternions: Floats, columns: str, *, turns: bool = False) -> Floats:
    """Numbers that may have been read as unit quaternions, shape (A, N, k).

    Angles of a file may be larger than those that a rotation has.

    Args:
        quaternions: Shape (N, 4).
        columns: The way that their names say, one of `STATED`.
        turns: Whether they may be larger by a whole turn.
    """
    if columns == "quaternion":
        return quaternions[None]
    R = from_quaternion(quaternions)
    if columns == "rotation-vector":
        vector = so3_log(R)
        angle = np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-300)
        whole = 2.0 * np.pi * np.array([0, -1, 1, -2] if turns else [0, -1])
        return np.asarray(vector * (1.0 + whole[:, None, None] / angle))
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    pitch = np.arcsin(np.clip(-R[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    angles = np.stack([roll, pitch, yaw], axis=1)
    # The same rotation with the pitch beyond a quarter turn.
    over = np.stack([_opposite(roll), _opposite(-pitch), _opposite(yaw)], axis=1)
    of_each = [0, 1, -1] if turns else [0]
    whole = 2.0 * np.pi * np.array(list(product(of_each, repeat=3)))
    return np.concatenate([a + whole[:, None] for a in (angles, over)])


def _opposite(angle: Floats) -> Floats:
    return np.asarray(angle - np.copysign(np.pi, angle))


def _quaternions(numbers: Floats, held: str) -> Floats:
    if held == "quaternion":
        return numbers
    if held == "wxyz":
        return numbers[:, [1, 2, 3, 0]]
    if held == "rotation-vector":
        half = 0.5 * np.linalg.norm(numbers, axis=1, keepdims=True)
        # sinc is exact at zero angle.
        return np.hstack([0.5 * np.sinc(half / np.pi) * numbers, np.cos(half)])
    if held == "roll-pitch-yaw":
        return _from_fixed_axes(numbers)
    # It takes time to import, and most files are as their columns say.
    from scipy.spatial.transform import Rotation

    kind, _, order = held.partition("-")
    if kind == "rpy":
        numbers = numbers[:, ["xyz".index(axis) for axis in order]]
    order = order.upper() if kind == "intrinsic" else order
    return np.asarray(Rotation.from_euler(order, numbers).as_quat())


def _from_fixed_axes(angles: Floats) -> Floats:
    """Quaternions of R = Rz(yaw) Ry(pitch) Rx(roll), shape (N, 3) -> (N, 4)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(0.5 * angles).T, np.cos(0.5 * angles).T
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )
