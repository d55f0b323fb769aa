"""Closed-form registration: exact, without a guess, and best where it is not unique."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats, from_quaternion, so3_exp, so3_log
from calib_pin.measurement_models.registration import (
    fit_pose,
    register_plane,
    register_points,
    register_poses,
)
from tests.measurement_models.test_contact_registration import on_plane

Poses = Callable[[np.random.Generator, int], Floats]
ARM = load_chain("space6")
TRIALS = 16


def rotations(rng: np.random.Generator, count: int) -> Floats:
    """Uniformly distributed rotations."""
    quaternions = rng.normal(size=(count, 4))
    return from_quaternion(
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    )


def frame(rng: np.random.Generator, trial: int, reach: float) -> Floats:
    """Any frame; every second one is turned by half a turn."""
    R = rotations(rng, 1)[0]
    if trial % 2:
        axis = rng.normal(size=3)
        R = so3_exp(np.pi * axis / np.linalg.norm(axis))
    return pose(R, rng.uniform(-reach, reach, 3))


def pose(R: Floats, t: Floats) -> Floats:
    result = np.zeros((*R.shape[:-2], 4, 4))
    result[..., :3, :3], result[..., :3, 3], result[..., 3, 3] = R, t, 1.0
    return result


def turns_of(rng: np.random.Generator, count: int, largest: float) -> Floats:
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return so3_exp(rng.uniform(0, largest, (count, 1)) * axes)


def general(rng: np.random.Generator, count: int) -> Floats:
    return pose(rotations(rng, count), rng.uniform(-1, 1, (count, 3)))


def similar(rng: np.random.Generator, count: int) -> Floats:
    """Orientations within 0.1 rad."""
    return pose(turns_of(rng, count, 0.1), rng.uniform(-1, 1, (count, 3)))


def of_an_arm(rng: np.random.Generator, count: int) -> Floats:
    return ARM.poses(ARM.random_configurations(count, rng))


# Sets from which not everything can be known.


def one_orientation(rng: np.random.Generator, count: int) -> Floats:
    R = np.tile(rotations(rng, 1), (count, 1, 1))
    return pose(R, rng.uniform(-1, 1, (count, 3)))


def planar(rng: np.random.Generator, count: int) -> Floats:
    """A planar arm: turns about z, and a constant height."""
    xy = rng.uniform(-1, 1, (count, 2))
    R = so3_exp(rng.uniform(-3, 3, (count, 1)) * [[0.0, 0.0, 1.0]])
    return pose(R, np.column_stack([xy, np.full(count, 0.3)]))


def last_joint_only(rng: np.random.Generator, count: int) -> Floats:
    turns = so3_exp(rng.uniform(-3, 3, (count, 1)) * [[0.0, 0.0, 1.0]])
    return pose(rotations(rng, 1) @ turns, np.tile(rng.normal(size=3), (count, 1)))


UNIQUE = [general, similar, of_an_arm]
DEGENERATE = [one_orientation, planar, last_joint_only]


def register_point(F: Floats, y: Floats, t: Floats | None = None) -> tuple[Floats, ...]:
    """Base and point of a tool with one point, known or not."""
    known = {} if t is None else {"tool": t[None]}
    R, b, found = register_points(F, y, **known)
    assert found.shape == (1, 3)
    return R, b, found[0]


def seen_points(F: Floats, R: Floats, b: Floats, t: Floats) -> Floats:
    return (F[:, :3, :3] @ t + F[:, :3, 3]) @ R.T + b


@pytest.mark.parametrize("poses", UNIQUE)
@pytest.mark.parametrize("known", [False, True])
def test_points_are_registered_without_a_guess(poses: Poses, known: bool) -> None:
    rng = np.random.default_rng(7)
    for trial in range(TRIALS):
        F = poses(rng, (4, 5, 6, 30)[trial // 2 % 4])
        kept = F.copy()
        B, t = frame(rng, trial, 5.0), rng.uniform(-0.3, 0.3, 3)
        R, b = B[:3, :3], B[:3, 3]
        y = seen_points(F, R, b, t)
        found = register_point(F, y, t if known else None)
        for x, other in zip((R, b, t), found, strict=True):
            np.testing.assert_allclose(other, x, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(F, kept)


@pytest.mark.parametrize("known", [(), (1,), (0, 2), (0, 1, 2)])
def test_several_points_are_registered_without_a_guess(known: tuple[int, ...]) -> None:
    """Each row sees one of them."""
    rng = np.random.default_rng(18)
    for trial, poses in enumerate(UNIQUE):
        count = (9, 12, 30)[trial]
        F, label = poses(rng, count), np.arange(count) % 3
        B, t = frame(rng, trial, 5.0), rng.uniform(-0.3, 0.3, (3, 3))
        R, b = B[:3, :3], B[:3, 3]
        y = (np.einsum("nij,nj->ni", F[:, :3, :3], t[label]) + F[:, :3, 3]) @ R.T + b
        given = np.full((3, 3), np.nan)
        given[list(known)] = t[list(known)]
        found = register_points(F, y, tool=given, label=label)
        for x, other in zip((R, b, t), found, strict=True):
            np.testing.assert_allclose(other, x, rtol=0, atol=1e-9)
        _, _, reached = register_points(F, y, base=(R, b), tool=given, label=label)
        np.testing.assert_allclose(reached, t, rtol=0, atol=1e-9)


def test_a_point_that_no_row_sees() -> None:
    rng = np.random.default_rng(19)
    F, label = general(rng, 8), np.zeros(8, int)
    R, b, t = rotations(rng, 1)[0], rng.normal(size=3), rng.normal(size=3)
    y, known = seen_points(F, R, b, t), np.array([[np.nan] * 3, [1.0, 2.0, 3.0]])
    for unseen in (known, np.full((2, 3), np.nan)):
        for found in (
            register_points(F, y, tool=unseen, label=label)[2],
            register_points(F, y, base=(R, b), tool=unseen, label=label)[2],
        ):
            np.testing.assert_allclose(found[0], t, rtol=0, atol=1e-9)
            np.testing.assert_array_equal(found[1], unseen[1])


def test_points_show_a_pose() -> None:
    """What they leave open of it is not turned."""
    rng = np.random.default_rng(20)
    X = frame(rng, 0, 1.0)
    here = rng.normal(size=(5, 3))
    there = here @ X[:3, :3].T + X[:3, 3]
    found = fit_pose(here, there)
    np.testing.assert_allclose(found.homogeneous, X, atol=1e-8)
    one = fit_pose(here[:1], there[:1])
    np.testing.assert_array_equal(one.rotation, np.eye(3))
    np.testing.assert_allclose(one.act(here[0]), there[0], atol=1e-12)
    # Of two points, a turn about their line.
    two = fit_pose(here[:2], there[:2])
    np.testing.assert_allclose(two.act(here[1]), there[1], atol=1e-7)
    line, seen = (p[1] - p[0] for p in (here, there))
    axis = np.cross(line, seen)
    turn = so3_log(two.rotation[None])[0]
    np.testing.assert_allclose(np.cross(turn, axis), 0.0, atol=1e-6)


@pytest.mark.parametrize("poses", UNIQUE)
@pytest.mark.parametrize("known", ["nothing", "base", "tool", "both"])
def test_poses_are_registered_without_a_guess(poses: Poses, known: str) -> None:
    rng = np.random.default_rng(8)
    for trial in range(TRIALS // 2):
        F = poses(rng, (4, 5, 6, 30)[trial // 2 % 4])
        B, X = frame(rng, trial, 5.0), frame(rng, trial, 0.3)
        base = B if known in ("base", "both") else None
        tool = X if known in ("tool", "both") else None
        found = register_poses(F, B @ F @ X, base=base, tool=tool)
        for x, other in zip((B, X), found, strict=True):
            np.testing.assert_allclose(other, x, rtol=0, atol=1e-9)


@pytest.mark.parametrize("poses", DEGENERATE)
def test_what_is_not_unique_is_still_explained(poses: Poses) -> None:
    rng = np.random.default_rng(9)
    for count in (1, 2, 3, 5, 20):
        F = poses(rng, count)
        R, b, t = rotations(rng, 1)[0], rng.normal(size=3), rng.normal(size=3) * 0.2
        y = seen_points(F, R, b, t)
        for tool in (None, t):
            found = register_point(F, y, tool)
            assert np.abs(seen_points(F, *found) - y).max() < 1e-9
            # Of equal solutions the one without a large lever.
            assert np.abs(found[2]).max() < 3.0

        B, X = pose(R, b), pose(rotations(rng, 1)[0], t)
        Y = B @ F @ X
        for base, tool in ((None, None), (B, None), (None, X)):
            B_found, X_found = register_poses(F, Y, base=base, tool=tool)
            assert np.abs(B_found @ F @ X_found - Y).max() < 1e-9


@pytest.mark.parametrize("poses", [general, similar, planar])
def test_noisy_points_reach_the_least_squares(poses: Poses) -> None:
    rng = np.random.default_rng(10)
    for known in (False, True):
        F = poses(rng, 12)
        R, b, t = rotations(rng, 1)[0], rng.normal(size=3), rng.normal(size=3) * 0.2
        y = seen_points(F, R, b, t) + 1e-3 * rng.normal(size=(12, 3))
        R_found, b_found, t_found = register_point(F, y, t if known else None)

        def residual(x: Floats, R=R, F=F, y=y, given=t if known else None) -> Floats:
            point = x[6:] if given is None else given
            moved = seen_points(F, R @ so3_exp(x[:3]), x[3:6], point)
            return np.asarray((moved - y).reshape(-1))

        truth = np.concatenate([np.zeros(3), b, t])
        best = least_squares(residual, truth[:6] if known else truth, xtol=1e-15)
        cost = np.sum((seen_points(F, R_found, b_found, t_found) - y) ** 2)
        assert cost < 2 * best.cost * (1 + 1e-6) + 1e-20


def test_far_away_tracker_keeps_its_digits() -> None:
    rng = np.random.default_rng(13)
    F = general(rng, 20)
    R, b, t = rotations(rng, 1)[0], np.array([300.0, -200.0, 50.0]), np.full(3, 0.1)
    R_found, b_found, t_found = register_point(F, seen_points(F, R, b, t))
    np.testing.assert_allclose(R_found, R, rtol=0, atol=1e-11)
    # Of 360 m sixteen digits, and ten times that for the lever.
    np.testing.assert_allclose(b_found, b, rtol=0, atol=1e-10)
    np.testing.assert_allclose(t_found, t, rtol=0, atol=1e-11)


def test_planes() -> None:
    rng = np.random.default_rng(16)
    for trial in range(TRIALS):
        normal = rng.normal(size=3)
        normal = np.eye(3)[trial] if trial < 3 else normal / np.linalg.norm(normal)
        offset = rng.uniform(-2.0, -0.1)
        points = on_plane(normal, offset, (3, 4, 50)[trial % 3], rng)
        n, f = register_plane(points)
        assert f <= 0.0
        np.testing.assert_allclose(n, normal, rtol=0, atol=1e-9)
        assert abs(f - offset) < 1e-9


def test_planes_of_few_or_collinear_points() -> None:
    for count in (1, 2, 3):
        points = np.arange(1.0, count + 1.0)[:, None] * [[1.0, 2.0, -1.0]]
        n, f = register_plane(points)
        assert abs(np.linalg.norm(n) - 1.0) < 1e-13
        np.testing.assert_allclose(points @ n + f, 0.0, atol=1e-13)
