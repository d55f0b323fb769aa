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
    register_reached,
)

Poses = Callable[[np.random.Generator, int], Floats]
ARM = load_chain("space6")
TRIALS = 200


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


def on_a_line(rng: np.random.Generator, count: int) -> Floats:
    t = rng.uniform(-1, 1, (count, 1)) * [[1.0, 2.0, 3.0]]
    return pose(np.tile(np.eye(3), (count, 1, 1)), t)


def last_joint_only(rng: np.random.Generator, count: int) -> Floats:
    turns = so3_exp(rng.uniform(-3, 3, (count, 1)) * [[0.0, 0.0, 1.0]])
    return pose(rotations(rng, 1) @ turns, np.tile(rng.normal(size=3), (count, 1)))


def about_a_point(rng: np.random.Generator, count: int) -> Floats:
    return pose(rotations(rng, count), np.zeros((count, 3)))


def half_turns(rng: np.random.Generator, count: int) -> Floats:
    axes = np.pi * np.eye(3)[rng.integers(0, 3, count)]
    return pose(so3_exp(axes), rng.uniform(-1, 1, (count, 3)))


def one_pose(rng: np.random.Generator, count: int) -> Floats:
    return np.tile(general(rng, 1), (count, 1, 1))


UNIQUE = [general, similar, of_an_arm]
DEGENERATE = [
    one_orientation,
    planar,
    on_a_line,
    last_joint_only,
    about_a_point,
    half_turns,
    one_pose,
]


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
    found = 0
    for trial in range(TRIALS):
        F = poses(rng, (4, 5, 6, 30)[trial // 2 % 4])
        B, t = frame(rng, trial, 5.0), rng.uniform(-0.3, 0.3, 3)
        R, b = B[:3, :3], B[:3, 3]
        y = seen_points(F, R, b, t)
        R_found, b_found, t_found = register_point(F, y, t if known else None)
        pairs = ((R, R_found), (b, b_found), (t, t_found))
        found += max(np.abs(x - y).max() for x, y in pairs) < 1e-9
    assert found == TRIALS


@pytest.mark.parametrize("poses", UNIQUE)
@pytest.mark.parametrize("known", [(), (1,), (0, 2), (0, 1, 2)])
def test_several_points_are_registered_without_a_guess(
    poses: Poses, known: tuple[int, ...]
) -> None:
    """Each row sees one of them."""
    rng = np.random.default_rng(18)
    for trial in range(10):
        count = (9, 12, 30)[trial % 3]
        F, label = poses(rng, count), np.arange(count) % 3
        B, t = frame(rng, trial, 5.0), rng.uniform(-0.3, 0.3, (3, 3))
        R, b = B[:3, :3], B[:3, 3]
        y = (np.einsum("nij,nj->ni", F[:, :3, :3], t[label]) + F[:, :3, 3]) @ R.T + b
        given = np.full((3, 3), np.nan)
        given[list(known)] = t[list(known)]
        found = register_points(F, y, tool=given, label=label)
        for x, other in zip((R, b, t), found, strict=True):
            np.testing.assert_allclose(other, x, rtol=0, atol=1e-9)
        reached = register_reached(F, y, R, b, given, label)
        np.testing.assert_allclose(reached, t, rtol=0, atol=1e-9)


def test_a_point_that_no_row_sees() -> None:
    rng = np.random.default_rng(19)
    F, label = general(rng, 8), np.zeros(8, int)
    R, b, t = rotations(rng, 1)[0], rng.normal(size=3), rng.normal(size=3)
    y, known = seen_points(F, R, b, t), np.array([[np.nan] * 3, [1.0, 2.0, 3.0]])
    for unseen in (known, np.full((2, 3), np.nan)):
        for found in (
            register_points(F, y, tool=unseen, label=label)[2],
            register_reached(F, y, R, b, unseen, label),
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
    np.testing.assert_allclose(one.act(here[0]), there[0], atol=1e-14)
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
    found = 0
    for trial in range(TRIALS // 2):
        F = poses(rng, (4, 5, 6, 30)[trial // 2 % 4])
        B, X = frame(rng, trial, 5.0), frame(rng, trial, 0.3)
        B_found, X_found = register_poses(
            F,
            B @ F @ X,
            base=B if known in ("base", "both") else None,
            tool=X if known in ("tool", "both") else None,
        )
        found += max(np.abs(B - B_found).max(), np.abs(X - X_found).max()) < 1e-9
    assert found == TRIALS // 2


@pytest.mark.parametrize("poses", DEGENERATE)
@pytest.mark.parametrize("count", [1, 2, 3, 5, 20])
def test_what_is_not_unique_is_still_explained(poses: Poses, count: int) -> None:
    rng = np.random.default_rng(9)
    for _ in range(4):
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


@pytest.mark.parametrize("poses", [*UNIQUE, *DEGENERATE])
@pytest.mark.parametrize("known", [False, True])
def test_noisy_points_reach_the_least_squares(poses: Poses, known: bool) -> None:
    rng = np.random.default_rng(10)
    for _ in range(4):
        F = poses(rng, 12)
        R, b, t = rotations(rng, 1)[0], rng.normal(size=3), rng.normal(size=3) * 0.2
        y = seen_points(F, R, b, t) + 1e-3 * rng.normal(size=(12, 3))
        R_found, b_found, t_found = register_point(F, y, t if known else None)

        def residual(
            x: Floats, F: Floats = F, y: Floats = y, t: Floats = t, R: Floats = R
        ) -> Floats:
            point = t if known else x[6:]
            moved = seen_points(F, R @ so3_exp(x[:3]), x[3:6], point)
            return np.asarray((moved - y).reshape(-1))

        truth = np.concatenate([np.zeros(3), b, t])
        best = least_squares(residual, truth[:6] if known else truth, xtol=1e-15)
        cost = np.sum((seen_points(F, R_found, b_found, t_found) - y) ** 2)
        assert cost < 2 * best.cost * (1 + 1e-6) + 1e-20


@pytest.mark.parametrize("poses", UNIQUE)
def test_noisy_poses_come_close_to_the_least_squares(poses: Poses) -> None:
    rng = np.random.default_rng(11)
    for count in (4, 30):
        F = poses(rng, count)
        B = pose(rotations(rng, 1)[0], rng.normal(size=3))
        X = pose(rotations(rng, 1)[0], rng.normal(size=3) * 0.2)
        Y = B @ F @ X
        Y[:, :3, :3] = Y[:, :3, :3] @ so3_exp(1e-3 * rng.normal(size=(count, 3)))
        Y[:, :3, 3] += 1e-3 * rng.normal(size=(count, 3))

        def residual(x: Floats, F: Floats = F, Y: Floats = Y, B=B, X=X) -> Floats:
            moved = B @ pose(so3_exp(x[:3]), x[3:6]) @ F
            moved = moved @ X @ pose(so3_exp(x[6:9]), x[9:])
            turn = so3_log(np.swapaxes(Y[:, :3, :3], 1, 2) @ moved[:, :3, :3])
            return np.concatenate([moved[:, :3, 3] - Y[:, :3, 3], turn]).reshape(-1)

        best = least_squares(residual, np.zeros(12), xtol=1e-15).cost
        B, X = register_poses(F, Y)
        cost = 0.5 * np.sum(residual(np.zeros(12), F, Y, B, X) ** 2)
        # An unknown rotation of X is fitted as a free matrix: not quite the best.
        assert cost < 1.5 * best if count == 30 else cost < 3.0 * best


def test_points_are_found_under_large_noise() -> None:
    # A tenth of the reach: the wrong minimum of a single start would be far worse.
    rng = np.random.default_rng(12)
    for _ in range(20):
        F = general(rng, 10)
        R, b, t = rotations(rng, 1)[0], rng.normal(size=3), rng.normal(size=3) * 0.2
        y = seen_points(F, R, b, t) + 0.1 * rng.normal(size=(10, 3))
        R_found, *_ = register_points(F, y)
        assert np.linalg.norm(so3_log(R.T @ R_found)) < 0.5


def test_far_away_tracker_keeps_its_digits() -> None:
    rng = np.random.default_rng(13)
    F = general(rng, 20)
    R, b, t = rotations(rng, 1)[0], np.array([300.0, -200.0, 50.0]), np.full(3, 0.1)
    R_found, b_found, t_found = register_point(F, seen_points(F, R, b, t))
    np.testing.assert_allclose(R_found, R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(b_found, b, rtol=0, atol=1e-11)
    np.testing.assert_allclose(t_found, t, rtol=0, atol=1e-12)


def test_same_input_same_bytes() -> None:
    F = general(np.random.default_rng(14), 10)
    first, second = (register_points(F, F[:, :3, 3]) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


def test_inputs_are_not_changed() -> None:
    F = general(np.random.default_rng(15), 10)
    points, kept = F[:, :3, 3].copy(), F.copy()
    register_points(F, points)
    register_poses(F, F, tool=np.eye(4))
    np.testing.assert_array_equal(F, kept)
    np.testing.assert_array_equal(points, kept[:, :3, 3])


def points_of_plane(
    rng: np.random.Generator, count: int, normal: Floats, offset: float
) -> Floats:
    points = rng.uniform(-1, 1, (count, 3))
    return np.asarray(points - np.outer(points @ normal + offset, normal))


def test_planes() -> None:
    rng = np.random.default_rng(16)
    for trial in range(TRIALS):
        normal = rng.normal(size=3)
        normal = np.eye(3)[trial] if trial < 3 else normal / np.linalg.norm(normal)
        offset = rng.uniform(-2.0, -0.1)
        points = points_of_plane(rng, (3, 4, 50)[trial % 3], normal, offset)
        n, f = register_plane(points)
        assert f <= 0.0
        np.testing.assert_allclose(n, normal, rtol=0, atol=1e-9)
        assert abs(f - offset) < 1e-9


@pytest.mark.parametrize("count", [1, 2, 3])
def test_planes_of_few_or_collinear_points(count: int) -> None:
    points = np.arange(1.0, count + 1.0)[:, None] * [[1.0, 2.0, -1.0]]
    n, f = register_plane(points)
    assert abs(np.linalg.norm(n) - 1.0) < 1e-14
    np.testing.assert_allclose(points @ n + f, 0.0, atol=1e-14)


def test_noisy_plane_is_the_least_squares() -> None:
    rng = np.random.default_rng(17)
    points = points_of_plane(rng, 30, np.array([0.6, 0.0, 0.8]), -1.0)
    points += 1e-2 * rng.normal(size=points.shape)
    n, f = register_plane(points)
    cost = np.sum((points @ n + f) ** 2)
    for _ in range(100):
        other = so3_exp(1e-3 * rng.normal(size=3)) @ n
        nearby = points @ other + f + 1e-3 * rng.normal()
        assert np.sum(nearby**2) >= cost
