"""Rigid motions in stacks, against Pinocchio one by one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.kinematics.spatial import (
    Floats,
    adjoint,
    from_quaternion,
    invert,
    nearest_rotation,
    se3_exp,
    skew,
    so3_exp,
    so3_log,
    so3_log_derivative,
    to_quaternion,
)

ROUNDING = 40 * np.finfo(float).eps
"""An entry of a rotation is a sum of three products of factors known to a few eps."""

SIZES = [0.0, 1e-300, 1e-12, 1e-8, 1e-5, 9.9e-5, 1.1e-4, 1e-2, 1.0, 3.0]
NEAR_HALF_TURN = [np.pi - 1e-2, np.pi - 1e-6, np.pi - 1e-9, np.pi - 1e-14]


def directions(count: int) -> Floats:
    """Unit vectors; the first are the axes and the diagonals."""
    rng = np.random.default_rng(0)
    some = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 1], [1, 0, -1], [0, 1, 1]]])
    found = np.concatenate([some, rng.normal(size=(count, 3))])
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def motions(count: int) -> Floats:
    rng = np.random.default_rng(1)
    return np.array([pin.exp6(rng.normal(size=6)).homogeneous for _ in range(count)])


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_stacks_of_any_shape(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    vectors = rng.normal(size=(*shape, 3))
    R = so3_exp(vectors)
    T = np.zeros((*shape, 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, vectors, 1.0
    cases = [
        (skew, vectors, (3, 3)),
        (so3_exp, vectors, (3, 3)),
        (se3_exp, rng.normal(size=(*shape, 6)), (4, 4)),
        (so3_log, R, (3,)),
        (so3_log_derivative, vectors, (3, 3)),
        (to_quaternion, R, (4,)),
        (from_quaternion, to_quaternion(R), (3, 3)),
        (invert, T, (4, 4)),
        (adjoint, T, (6, 6)),
    ]
    for function, argument, tail in cases:
        result = function(argument)
        assert result.shape == (*shape, *tail)
        for index in np.ndindex(shape):
            one = function(argument[index])
            np.testing.assert_allclose(result[index], one, rtol=0, atol=1e-14)


def test_empty_stacks() -> None:
    assert so3_log(np.zeros((0, 3, 3))).shape == (0, 3)
    assert so3_exp(np.zeros((0, 3))).shape == (0, 3, 3)
    assert se3_exp(np.zeros((0, 6))).shape == (0, 4, 4)
    assert adjoint(np.zeros((0, 4, 4))).shape == (0, 6, 6)
    assert invert(np.zeros((0, 4, 4))).shape == (0, 4, 4)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(3).normal(size=(2, 20, 3))
    np.testing.assert_allclose(
        (skew(a) @ b[:, :, None])[:, :, 0], np.cross(a, b), atol=1e-15
    )


def test_invert_and_adjoint() -> None:
    T = motions(20)
    for matrix, inverse, action in zip(T, invert(T), adjoint(T), strict=True):
        motion = pin.SE3(matrix)
        np.testing.assert_allclose(inverse, motion.inverse().homogeneous, atol=1e-14)
        np.testing.assert_allclose(action, motion.action, atol=1e-14)
    np.testing.assert_allclose(adjoint(invert(T)), np.linalg.inv(adjoint(T)), atol=1e-9)


def test_exp_and_log_of_rotations() -> None:
    axes = directions(20)
    for size in SIZES + NEAR_HALF_TURN:
        vectors = size * axes
        R = so3_exp(vectors)
        expected = [pin.exp3(vector) for vector in vectors]
        np.testing.assert_allclose(R, expected, rtol=0, atol=ROUNDING)
        unit = R @ np.swapaxes(R, 1, 2)
        np.testing.assert_allclose(unit, [np.eye(3)] * len(R), rtol=0, atol=ROUNDING)
        # Not worse near a half turn, where the arc cosine loses half the digits.
        np.testing.assert_allclose(so3_log(R), vectors, rtol=1e-9, atol=ROUNDING)


@pytest.mark.parametrize("size", [*SIZES, 9.9e-3, 1.01e-2, 6.0, *NEAR_HALF_TURN])
def test_exp_of_motions(size: float) -> None:
    rng = np.random.default_rng(4)
    twists = np.column_stack([rng.normal(size=(29, 3)), size * directions(20)])
    expected = np.array([pin.exp6(twist).homogeneous for twist in twists])
    np.testing.assert_allclose(se3_exp(twists), expected, rtol=0, atol=2e-14)
    # And the series of the exponential of 4 x 4 matrices.
    A = np.zeros((len(twists), 4, 4))
    A[:, :3, :3], A[:, :3, 3] = skew(twists[:, 3:]), twists[:, :3]
    # Halved and squared again, so that the sum stays small.
    term = total = np.tile(np.eye(4), (len(twists), 1, 1))
    for k in range(1, 20):
        term = term @ A / (16.0 * k)
        total = total + term
    for _ in range(4):
        total = total @ total
    np.testing.assert_allclose(se3_exp(twists), total, rtol=0, atol=2e-14)


def test_log_of_small_rotations_is_precise() -> None:
    vectors = 1e-9 * directions(20)
    np.testing.assert_allclose(so3_log(so3_exp(vectors)), vectors, rtol=1e-6)


def test_log_at_half_turns() -> None:
    axes = directions(50)
    turns = so3_exp(np.pi * axes)
    log = so3_log(turns)
    np.testing.assert_allclose(np.linalg.norm(log, axis=1), np.pi, rtol=ROUNDING)
    # Both directions are right.
    np.testing.assert_allclose(so3_exp(log), turns, rtol=0, atol=ROUNDING)


def test_log_of_large_vectors_wraps() -> None:
    axes = directions(10)
    np.testing.assert_allclose(so3_log(so3_exp(4.0 * axes)), (4 - 2 * np.pi) * axes)


def test_quaternions() -> None:
    vectors = np.concatenate(
        [size * directions(20) for size in [0.0, 1e-9, 0.5, 2.0, 3.1, *NEAR_HALF_TURN]]
    )
    R = so3_exp(vectors)
    quaternions = to_quaternion(R)
    assert (quaternions[:, 3] >= 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, rtol=ROUNDING)
    np.testing.assert_allclose(from_quaternion(quaternions), R, rtol=0, atol=ROUNDING)
    for matrix, quaternion in zip(R, quaternions, strict=True):
        other = pin.Quaternion(quaternion)
        np.testing.assert_allclose(other.matrix(), matrix, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(
        from_quaternion(-quaternions), from_quaternion(quaternions)
    )


def test_quaternion_order_is_x_y_z_w() -> None:
    quarter = so3_exp(np.array([0.0, 0.0, np.pi / 2]))
    half = np.sqrt(0.5)
    np.testing.assert_allclose(to_quaternion(quarter), [0, 0, half, half], atol=1e-15)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 9e-5, 1.1e-4, 1e-3, 0.1, 1.0, 3.0])
def test_log_derivative(size: float) -> None:
    vectors = size * directions(5)
    found = so3_log_derivative(vectors)
    # Pinocchio's own is off by 7e-11 at 1e-3 rad.
    expected = [pin.Jlog3(pin.exp3(vector)) for vector in vectors]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    # The inverse of the right Jacobian, the sum of (-K)^k / (k + 1)!.
    term, right = np.tile(np.eye(3), (len(vectors), 1, 1)), 0.0
    for k in range(1, 40):
        right = right + term
        term = -term @ skew(vectors) / (k + 1)
    np.testing.assert_allclose(
        found @ right, [np.eye(3)] * len(vectors), rtol=0, atol=1e-14
    )
    # Logarithms up to 3 long are known to some eps: 1e-10 of the quotient at this step.
    R, step = so3_exp(vectors), 1e-5
    for k in range(3):
        shift = so3_exp(step * np.eye(3)[k])
        ahead, behind = so3_log(R @ shift), so3_log(R @ shift.T)
        difference = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(found[:, :, k], difference, rtol=0, atol=1e-9)


def test_log_derivative_at_a_half_turn() -> None:
    found = so3_log_derivative(np.pi * directions(5))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(np.linalg.det(found), (np.pi / 2) ** 2, rtol=1e-12)


def test_nearest_rotation() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        M = rng.normal(size=(3, 3))
        R = nearest_rotation(M)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) > 0.0
        best = np.linalg.norm(M - R)
        others = so3_exp(rng.normal(size=(50, 3))) @ R
        assert (np.linalg.norm(M - others, axis=(1, 2)) >= best).all()
    for rank in range(3):
        M = np.diag([1.0, 2.0, 3.0][:rank] + [0.0] * (3 - rank))
        R = nearest_rotation(M)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) > 0.0
    R = so3_exp(np.array([0.3, -2.0, 1.0]))
    np.testing.assert_allclose(nearest_rotation(7.0 * R), R, atol=1e-15)
