"""Rigid motions and twists for stacks of poses, in Pinocchio's conventions.

A pose is a homogeneous matrix `T_a_b`, shape (..., 4, 4), that maps coordinates of
frame b to frame a. A twist is (linear, angular), shape (..., 6), and belongs to a
right-multiplied increment `T Exp(twist)` (a body twist).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def times(A: Floats, x: Floats) -> Floats:
    """Matrices times vectors, shapes (..., m, n) and (..., n) to (..., m)."""
    return np.asarray((A @ x[..., None])[..., 0])


def skew(vector: Floats) -> Floats:
    """Matrix of the cross product, shape (..., 3) -> (..., 3, 3)."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    result = np.zeros((*vector.shape[:-1], 3, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = z, -y, x
    return result


def invert(T: Floats) -> Floats:
    """Inverse of rigid motions, shape (..., 4, 4)."""
    R_transposed = np.swapaxes(T[..., :3, :3], -1, -2)
    result = np.zeros_like(T)
    result[..., :3, :3] = R_transposed
    result[..., :3, 3] = -(R_transposed @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def adjoint(T: Floats) -> Floats:
    """Adjoint of rigid motions: a twist in b becomes a twist in a, (..., 6, 6)."""
    R = T[..., :3, :3]
    result = np.zeros((*T.shape[:-2], 6, 6))
    result[..., :3, :3] = R
    result[..., 3:, 3:] = R
    result[..., :3, 3:] = skew(T[..., :3, 3]) @ R
    return result


def so3_exp(vector: Floats) -> Floats:
    """Rotation matrices of rotation vectors, shape (..., 3) -> (..., 3, 3)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    K = skew(vector)
    # sinc keeps both coefficients exact at zero angle.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * K + second * (K @ K))


def se3_exp(twist: Floats) -> Floats:
    """Rigid motions of twists (linear, angular), shape (..., 6) -> (..., 4, 4)."""
    vector = twist[..., 3:]
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    K = skew(vector)
    first = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    # Series of (x - sin x) / x^3, which cancels at zero angle.
    series = 1.0 / 6.0 - angle**2 / 120.0 + angle**4 / 5040.0
    second = np.where(small, series, (safe - np.sin(safe)) / safe**3)
    V = np.eye(3) + first * K + second * (K @ K)
    result = np.zeros((*twist.shape[:-1], 4, 4))
    result[..., :3, :3] = so3_exp(vector)
    result[..., :3, 3] = (V @ twist[..., :3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def se3_left_jacobian(twist: Floats) -> Floats:
    """Derivative of the exponential at a twist, shape (..., 6) -> (..., 6, 6).

    `Exp(twist + d) = Exp(J d) Exp(twist)` to first order. The right Jacobian is that of
    the negative twist. Sum of `ad^k / (k + 1)!` (Barfoot, State estimation for
    robotics, 2017, equation 7.81), exact to rounding for turns up to a radian.
    """
    small_adjoint = np.zeros((*twist.shape[:-1], 6, 6))
    small_adjoint[..., :3, :3] = small_adjoint[..., 3:, 3:] = skew(twist[..., 3:])
    small_adjoint[..., :3, 3:] = skew(twist[..., :3])
    result = np.broadcast_to(np.eye(6), small_adjoint.shape)
    for k in reversed(range(2, 20)):
        result = np.eye(6) + small_adjoint @ result / k
    return np.asarray(result)


def interpolate(first: Floats, last: Floats, part: Floats) -> Floats:
    """Poses between two, shape (..., 4, 4), by the part of the way, shape (...).

    The origin goes straight, the rotation takes the shortest turn.
    """
    T = invert(first) @ last
    result = np.zeros(np.broadcast_shapes(T.shape, (*part.shape, 4, 4)))
    result[..., :3, :3] = so3_exp(part[..., None] * so3_log(T[..., :3, :3]))
    result[..., :3, 3] = part[..., None] * T[..., :3, 3]
    result[..., 3, 3] = 1.0
    return np.asarray(first @ result)


def interpolated_twists(
    first: Floats, last: Floats, part: Floats
) -> tuple[Floats, Floats]:
    """Derivative of `interpolate` by body twists of both poses.

    Args:
        first: Poses, shape (..., 4, 4).
        last: Other poses, shape (..., 4, 4).
        part: Part of the way, shape (...).

    Returns:
        Body twists of the pose between by those of either, shape (..., 6, 6) both.
    """
    to_first = invert(first)
    T, between = to_first @ last, to_first @ interpolate(first, last, part)
    turn, share = so3_log(T[..., :3, :3]), part[..., None, None]
    by_last = np.zeros((*T.shape[:-2], 6, 6))
    R = np.swapaxes(between[..., :3, :3], -1, -2) @ T[..., :3, :3]
    by_last[..., :3, :3] = share * R
    turned = so3_log_derivative(part[..., None] * turn)
    by_last[..., 3:, 3:] = share * np.linalg.solve(turned, so3_log_derivative(turn))
    by_first = adjoint(invert(between)) - by_last @ adjoint(invert(T))
    return by_first, by_last


def so3_log(R: Floats) -> Floats:
    """Rotation vectors of rotation matrices, shape (..., 3, 3) -> (..., 3)."""
    quaternion = to_quaternion(R)
    sine = np.linalg.norm(quaternion[..., :3], axis=-1, keepdims=True)
    half = np.arctan2(sine, quaternion[..., 3:])
    factor = np.where(sine > 1e-12, 2.0 * half / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(factor * quaternion[..., :3])


def to_quaternion(R: Floats) -> Floats:
    """Unit quaternions (x, y, z, w) with w >= 0, shape (..., 3, 3) -> (..., 4).

    The largest component is found first (Shepperd's method), so accuracy does not
    drop near half turns.
    """
    trace = np.trace(R, axis1=-2, axis2=-1)
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    squares = np.concatenate(
        [1.0 + 2.0 * diagonal - trace[..., None], (1.0 + trace)[..., None]], axis=-1
    )
    # Row k holds 4 * q_k * (qx, qy, qz, qw).
    products = np.empty((*R.shape[:-2], 4, 4))
    for k in range(4):
        products[..., k, k] = squares[..., k]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[..., i, j] = products[..., j, i] = R[..., i, j] + R[..., j, i]
        products[..., k, 3] = products[..., 3, k] = R[..., j, i] - R[..., i, j]
    best = np.argmax(squares, axis=-1)[..., None, None]
    quaternion = np.take_along_axis(products, best, axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.asarray(np.where(quaternion[..., 3:] < 0.0, -quaternion, quaternion))


def from_quaternion(quaternion: Floats) -> Floats:
    """Rotation matrices of unit quaternions (x, y, z, w), (..., 4) -> (..., 3, 3)."""
    K = skew(quaternion[..., :3])
    w = quaternion[..., 3, None, None]
    return np.asarray(np.eye(3) + 2.0 * (w * K + K @ K))


def so3_log_derivative(vector: Floats) -> Floats:
    """Derivative of `so3_log(R Exp(w))` by w at w = 0, shape (..., 3, 3).

    This is the inverse right Jacobian at the rotation vector (..., 3), singular only
    at a full turn.
    """
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    K = skew(vector)
    half = 0.5 * angle
    small = angle < 1e-4
    safe = np.where(small, 1.0, half)
    exact = (1.0 - safe / np.tan(safe)) / (4.0 * safe**2)
    # Series 1/12 + angle^2/720: the closed form cancels to 0/0 at zero angle.
    coefficient = np.where(small, 1.0 / 12.0 + angle**2 / 720.0, exact)
    return np.asarray(np.eye(3) + 0.5 * K + coefficient * (K @ K))


def nearest_rotation(M: Floats) -> Floats:
    """Rotation matrices closest to M in the Frobenius norm, shape (..., 3, 3)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., -1] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[..., None]
    return np.asarray(U @ Vt)
