"""Pixels of triangles: all that they cover, once, and the nearest of several."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.report.figures import pixels
from calib_pin.report.figures.pixels import covered, nearest

SIZE = 60, 40


def inside(triangle: np.ndarray) -> np.ndarray:
    """Pixels (h, w) whose middle lies in a triangle (3, 2), by three half planes."""
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    sides = []
    for k in range(3):
        (xa, ya), (xb, yb) = triangle[k], triangle[(k + 1) % 3]
        sides.append((xb - xa) * (y - ya) - (yb - ya) * (x - xa))
    signs = np.array(sides)
    return np.asarray((signs > 0.0).all(axis=0) | (signs < 0.0).all(axis=0))


def counted(triangles: np.ndarray) -> np.ndarray:
    found = np.zeros((len(triangles), *SIZE[::-1]), int)
    for owner, row, column in covered(triangles, SIZE):
        np.add.at(found, (owner, row, column), 1)
    return found


@pytest.mark.parametrize("batch", [50, 4_000_000])
def test_each_pixel_of_a_triangle_is_there_once(
    monkeypatch: pytest.MonkeyPatch, batch: int
) -> None:
    monkeypatch.setattr(pixels, "FRAGMENTS", batch)
    rng = np.random.default_rng(0)
    triangles = rng.uniform(-20.0, 80.0, (40, 1, 2)) + rng.normal(0, 15, (40, 3, 2))
    found = counted(triangles)
    for triangle, pixel in zip(triangles, found, strict=True):
        np.testing.assert_array_equal(pixel, inside(triangle))


def test_triangles_side_by_side_share_no_pixel() -> None:
    corners = np.array([[3.5, 2.5], [40.5, 6.5], [33.0, 30.5], [5.0, 22.0]])
    found = counted(corners[[[0, 1, 2], [0, 2, 3]]])
    assert found.sum(axis=0).max() == 1
    # Neither a line nor a point covers anything.
    assert counted(corners[[[0, 1, 1], [2, 2, 2]]]).sum() == 0


def test_the_nearest_triangle_wins_wherever_it_is_nearest() -> None:
    whole = np.array([[-100.0, -100.0], [200.0, -100.0], [-100.0, 300.0]])
    part = np.array([[10.0, 5.0], [50.0, 5.0], [10.0, 35.0]])
    # The second one crosses the first along a column.
    depths = np.array([[2.0, 2.0, 2.0], [1.0 / 0.3, 1.0 / 0.7, 1.0 / 0.3]])
    for order in ([0, 1], [1, 0]):
        spots = np.array([whole, part])[order]
        near, winner = nearest(SIZE, spots, 1.0 / depths[order])
        second = order.index(1)
        expected = inside(part) & (np.arange(SIZE[0]) + 0.5 > 30.0)
        np.testing.assert_array_equal(winner == second, expected)
        assert near[0, 0] == pytest.approx(0.5)
        assert near[6, 40] == pytest.approx(0.3 + 0.4 * 30.5 / 40.0)


def test_an_empty_image() -> None:
    near, winner = nearest(SIZE, np.zeros((0, 3, 2)), np.zeros((0, 3)))
    assert near.shape == winner.shape == SIZE[::-1]
    assert not near.any() and (winner == -1).all()
