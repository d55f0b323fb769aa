"""Where the measured point may be, and the points of a board."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.setup import Ball, BoardSetup, Cone, Obstacle, RangerSetup, Region

BOX = ((0.0, -1.0, 0.5), (1.0, 1.0, 0.75))
SPHERE = Ball((1.0, 0.0, 0.5), 0.5)
CONE = Cone((0.0, 0.0, 2.0), (0.0, 0.0, -3.0), 0.3, (0.5, 1.5))


def points(seed: int = 0, count: int = 2000) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 3))


def test_box() -> None:
    given = np.array([[0.5, 0, 0.6], [0.0, -1, 0.5], [-1e-9, 0, 0.6], [0.5, 0, 0.8]])
    assert Region(box=BOX).contains(given).tolist() == [True, True, False, False]


def test_sphere() -> None:
    given = np.array([[1.0, 0, 0.5], [1.5, 0, 0.5], [1.3, 0.4, 0.5], [1.4, 0.4, 0.5]])
    assert Region(sphere=SPHERE).contains(given).tolist() == [True, True, True, False]


def test_cone() -> None:
    edge = np.array([0.0, np.sin(0.3), -np.cos(0.3)])
    rays = [[0, 0, -1.0], [0, 0, -0.4], [0, 0, -1.6], [0, 0, 1.0]]
    rays += [edge * [1, 0.999, 1], edge * [1, 1.001, 1]]
    given = CONE.apex + np.array(rays)
    expected = [True, False, False, False, True, False]
    assert Region(cone=CONE).contains(given).tolist() == expected


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


def test_several_shapes_mean_what_they_have_in_common() -> None:
    given = points()
    parts = [Region(box=BOX), Region(sphere=SPHERE), Region(cone=CONE)]
    common = np.all([part.contains(given) for part in parts], axis=0)
    whole = Region(BOX, SPHERE, Cone((0, 0, 2), (0, 0, -1), 0.6, (0, 2)))
    wider = Region(cone=whole.cone)
    assert whole.contains(given).any()
    np.testing.assert_array_equal(
        whole.contains(given),
        parts[0].contains(given) & parts[1].contains(given) & wider.contains(given),
    )
    np.testing.assert_array_equal(Region(BOX, SPHERE, CONE).contains(given), common)


@pytest.mark.parametrize("region", [Region(), Region(BOX, SPHERE, CONE)])
def test_shapes_of_arrays(region: Region) -> None:
    assert region.contains(np.empty((0, 3))).shape == (0,)
    assert region.contains(points(count=7)).shape == (7,)
    assert region.contains(points()).all() == (region == Region())


def test_the_window_of_a_ranger() -> None:
    assert RangerSetup().range == (0.0, 5.0)
    assert np.degrees(RangerSetup().incidence) == pytest.approx(70.0)


def test_the_kind_of_an_obstacle() -> None:
    assert Obstacle(sphere=0.1).kind == "sphere"
    assert Obstacle(mesh="table.stl", scale=(1e-3, 1e-3, 1e-3)).kind == "mesh"


@pytest.mark.parametrize("kind", ["charuco", "chessboard"])
def test_inner_corners_of_a_board(kind: str) -> None:
    points = BoardSetup(kind, columns=4, rows=3, square=0.5).points
    assert {name: point.xyz for name, point in points.items()} == {
        **{"0": (0.0, 0.0, 0.0), "1": (0.5, 0.0, 0.0), "2": (1.0, 0.0, 0.0)},
        **{"3": (0.0, 0.5, 0.0), "4": (0.5, 0.5, 0.0), "5": (1.0, 0.5, 0.0)},
    }
    assert all(point.estimate is False for point in points.values())


def test_centers_of_circles() -> None:
    points = BoardSetup("circles", columns=4, rows=3, square=0.5).points
    assert list(points) == [str(k) for k in range(12)]
    assert points["4"].xyz == (0.0, 0.5, 0.0) and points["11"].xyz == (1.5, 1.0, 0.0)
