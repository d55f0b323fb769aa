"""Where the measured point may be, and the points of a board."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.setup import Ball, BoardSetup, Cone, Region

BOX = ((0.0, -1.0, 0.5), (1.0, 1.0, 0.75))
SPHERE = Ball((1.0, 0.0, 0.5), 0.5)
CONE = Cone((0.0, 0.0, 2.0), (0.0, 0.0, -3.0), 0.3, (0.5, 1.5))


def points(seed: int = 0, count: int = 2000) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 3))


def test_boxes_and_spheres_hold_their_surface() -> None:
    given = np.array([[0.5, 0, 0.6], [0.0, -1, 0.5], [-1e-9, 0, 0.6], [0.5, 0, 0.8]])
    assert Region(box=BOX).contains(given).tolist() == [True, True, False, False]
    given = np.array([[1.0, 0, 0.5], [1.5, 0, 0.5], [1.3, 0.3, 0.5], [1.4, 0.4, 0.5]])
    assert Region(sphere=SPHERE).contains(given).tolist() == [True, True, True, False]


def test_several_shapes_mean_what_they_have_in_common() -> None:
    given = points()
    cone = Cone((0, 0, 2), (0, 0, -1), 0.6, (0, 2))
    parts = [Region(box=BOX), Region(sphere=SPHERE), Region(cone=cone)]
    common = np.all([part.contains(given) for part in parts], axis=0)
    assert common.any()
    np.testing.assert_array_equal(Region(BOX, SPHERE, cone).contains(given), common)
    assert Region().contains(given).all()
    assert Region(BOX, SPHERE, cone).contains(np.empty((0, 3))).shape == (0,)


def test_the_angle_of_a_cone_agrees_with_its_definition() -> None:
    given = points()
    ray = given - CONE.apex
    cosine = ray @ [0, 0, -1] / np.linalg.norm(ray, axis=1)
    distance = np.linalg.norm(ray, axis=1)
    for angle in (1e-3, 0.3, 2.0, np.pi):
        cone = Cone(CONE.apex, CONE.axis, angle, (0.5, 1.5))
        seen = (cosine >= np.cos(angle)) & (distance >= 0.5) & (distance <= 1.5)
        np.testing.assert_array_equal(cone.contains(given), seen)


def test_an_instrument_sees_its_axis_however_narrow_its_cone() -> None:
    axis = (0.1, 0.7, -0.3)
    cone = Cone((0.3, 0.2, 0.1), axis, 1e-7, (0.0, 10.0))
    given = np.array(cone.apex) + np.linspace(0, 5, 20)[:, None] * np.array(axis)
    assert cone.contains(given).all()


@pytest.mark.parametrize("kind", ["charuco", "chessboard", "circles"])
def test_points_of_a_board(kind: str) -> None:
    """Inner corners of squares, and centers of circles."""
    points = BoardSetup(kind, columns=4, rows=3, square=0.5).points
    columns, rows = (4, 3) if kind == "circles" else (3, 2)
    assert {name: point.xyz for name, point in points.items()} == {
        str(k): (0.5 * (k % columns), 0.5 * (k // columns), 0.0)
        for k in range(columns * rows)
    }
    assert all(point.estimate is False for point in points.values())
