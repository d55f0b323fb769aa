"""Poses of known points in a camera: exact, without a guess, from few points."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats, se3_exp, so3_exp
from calib_pin.measurement_models.camera_start import carried_points, pose_of_points

ARM = load_chain("space6")
GRID = np.array([[i, j, 0.0] for i in range(4) for j in range(3)]) * 0.03


def pose(R: Floats, t: Floats) -> Floats:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = R, t
    return result


def moved(T: Floats, points: Floats) -> Floats:
    return np.einsum("...ij,...j->...i", T[..., :3, :3], points) + T[..., :3, 3]


def rays_of(X: Floats) -> Floats:
    assert (X[:, 2] > 0.0).all()
    return X[:, :2] / X[:, 2:]


def board(kind: str, rng: np.random.Generator) -> Floats:
    """Points in a frame of their own, anywhere and turned."""
    points = {
        "four": GRID[[0, 2, 9, 11]],
        "grid": GRID,
        # A sheet that is not quite flat, and six points that are not at all.
        "bent": GRID + [0.0, 0.0, 1.0] * rng.uniform(-1e-3, 1e-3, (12, 1)),
        "corner": 0.05 * np.vstack([np.zeros(3), np.eye(3)]),
        "five": rng.uniform(-0.05, 0.05, (5, 3)),
        "six": rng.uniform(-0.05, 0.05, (6, 3)),
        "many": rng.uniform(-0.05, 0.05, (30, 3)),
    }[kind]
    return moved(se3_exp(rng.normal(size=6)), points)


@pytest.mark.parametrize(
    "kind", ["four", "grid", "bent", "corner", "five", "six", "many"]
)
def test_poses_without_a_guess(kind: str) -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        points = board(kind, rng)
        middle, turn = points.mean(axis=0), so3_exp(rng.normal(size=3))
        place = np.append(rng.uniform(-0.2, 0.2, 2), rng.uniform(0.3, 1.0))
        truth = pose(turn, place - turn @ middle)
        found = pose_of_points(points, rays_of(moved(truth, points)))
        assert found is not None
        np.testing.assert_allclose(found, truth, atol=1e-8)
        assert abs(np.linalg.det(found[:3, :3]) - 1.0) < 1e-12


@pytest.mark.parametrize(
    "points",
    [
        GRID[:3],
        np.outer(np.arange(8.0), [0.1, 0.2, 0.0]),
        np.zeros((8, 3)),
    ],
)
def test_points_that_do_not_tell_a_pose(points: Floats) -> None:
    rays = rays_of(points + np.array([0.0, 0.0, 1.0]))
    assert pose_of_points(points, rays) is None


# Points that a robot carries before a camera.

CAMERA = pose(so3_exp(np.array([0.2, 0.1, -0.4])), np.array([0.1, 0.2, 4.0]))


def carried(count: int, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Tip poses, points in their frame, and the same points in the tip."""
    rng = np.random.default_rng(seed)
    F = ARM.poses(ARM.random_configurations(count, rng))
    return F, GRID, moved(se3_exp(rng.normal(size=6) * 0.1), GRID)


@pytest.mark.parametrize(
    ("rows", "which"), [(30, [4]), (40, [0, 11]), (60, list(range(12)))]
)
@pytest.mark.parametrize("known", [False, True])
def test_carried_points(rows: int, which: list[int], known: bool) -> None:
    F, points, truth = carried(rows)
    label = np.arange(rows) % len(which)
    rays = rays_of(moved(CAMERA, moved(F, truth[which][label])))
    camera = CAMERA if known else None
    found = carried_points(F, label, rays, points[which], camera)
    assert found is not None
    np.testing.assert_allclose(found, truth[which], atol=1e-9)


def test_a_point_that_turns_about_one_axis_stays_on_its_ring() -> None:
    """How high it stands on the axis is not told, and must not spoil the rest."""
    rng = np.random.default_rng(2)
    F = np.tile(np.eye(4), (40, 1, 1))
    F[:, :3, :3] = so3_exp(rng.uniform(-3, 3, (40, 1)) * [[0.0, 0.0, 1.0]])
    F[:, :3, 3] = rng.uniform(-1, 1, (40, 3))
    truth, label = np.array([[0.1, -0.05, 0.2]]), np.zeros(40, np.int64)
    rays = rays_of(moved(CAMERA, moved(F, truth[label])))
    found = carried_points(F, label, rays, truth)
    assert found is not None
    np.testing.assert_allclose(found[0, :2], truth[0, :2], atol=1e-9)


def test_rows_that_do_not_tell_a_carried_point() -> None:
    """Too few, or all alike."""
    for F in (carried(1)[0], carried(18)[0], np.repeat(carried(1)[0], 60, axis=0)):
        _, points, truth = carried(1)
        label = np.zeros(len(F), np.int64)
        rays = rays_of(moved(CAMERA, moved(F, truth[:1][label])))
        assert carried_points(F, label, rays, points[:1]) is None
