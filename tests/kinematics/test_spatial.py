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


@pytest.mark.parametrize("shape", [(), (0,), (2, 3)])
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


def test_skew_invert_and_adjoint() -> None:
    a, b = np.random.default_rng(3).normal(size=(2, 20, 3))
    np.testing.assert_allclose(
        (skew(a) @ b[:, :, None])[:, :, 0], np.cross(a, b), atol=1e-14
    )
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


def test_log_at_half_turns() -> None:
    axes = directions(50)
    turns = so3_exp(np.pi * axes)
    log = so3_log(turns)
    np.testing.assert_allclose(np.linalg.norm(log, axis=1), np.pi, rtol=ROUNDING)
    # Both directions are right.
    np.testing.assert_allclose(so3_exp(log), turns, rtol=0, atol=ROUNDING)
    # Beyond, it comes back from the other side.
    np.testing.assert_allclose(so3_log(so3_exp(4.0 * axes)), (4 - 2 * np.pi) * axes)
    # Small ones keep their digits.
    small = 1e-9 * axes
    np.testing.assert_allclose(so3_log(so3_exp(small)), small, rtol=0, atol=1e-15)


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
    quarter, half = so3_exp(np.array([0.0, 0.0, np.pi / 2])), np.sqrt(0.5)
    np.testing.assert_allclose(
        to_quaternion(quarter), [0, 0, half, half], atol=ROUNDING
    )


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 9e-5, 1.1e-4, 1e-3, 0.1, 1.0, 3.0])
def test_log_derivative(size: float) -> None:
    vectors = size * directions(5)
    found = so3_log_derivative(vectors)
    # The inverse of the right Jacobian, the sum of (-K)^k / (k + 1)!.
    term, right = np.tile(np.eye(3), (len(vectors), 1, 1)), 0.0
    for k in range(1, 40):
        right = right + term
        term = -term @ skew(vectors) / (k + 1)
    np.testing.assert_allclose(
        found @ right, [np.eye(3)] * len(vectors), rtol=0, atol=ROUNDING
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
    for M in (rng.normal(size=(3, 3)), -np.eye(3), np.diag([1.0, 2.0, 0.0])):
        R = nearest_rotation(M)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=ROUNDING)
        assert np.linalg.det(R) > 0.0
        best = np.linalg.norm(M - R)
        others = so3_exp(rng.normal(size=(200, 3))) @ R
        assert np.linalg.norm(M - others, axis=(1, 2)).min() >= best - 1e-12
    assert np.linalg.det(nearest_rotation(np.zeros((3, 3)))) > 0.0
    R = so3_exp(np.array([0.3, -2.0, 1.0]))
    np.testing.assert_allclose(nearest_rotation(7.0 * R), R, atol=ROUNDING)
