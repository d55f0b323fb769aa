"""Points that keep a distance, against looking at all of them."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.spread import Apart


def one_by_one(points: Floats, distance: float, most: int) -> Floats:
    """Those that are far enough from all before them."""
    kept = list[Floats]()
    for point in points:
        if len(kept) < most and all(
            np.abs(point - other).max() >= distance for other in kept
        ):
            kept.append(point)
    return np.array(kept)


@pytest.mark.parametrize("distance", [0.0, 0.05, 0.25, 0.7])
@pytest.mark.parametrize("most", [37, 10_000])
def test_points_keep_their_distance(distance: float, most: int) -> None:
    rng = np.random.default_rng(3)
    # Corners of a grid are as far apart as they may be, and no farther.
    grid = 0.25 * rng.integers(0, 5, (150, 3))
    points = np.concatenate([rng.random((250, 3)), grid, rng.random((300, 3))])
    apart, kept = Apart(distance), list[Floats]()
    for begin in range(0, len(points), 70):
        block = points[begin : begin + 70]
        kept.append(block[apart.keep(block, most)])
        assert apart.count == sum(map(len, kept)) <= most
    expected = one_by_one(points, distance, most)
    assert np.concatenate(kept).tobytes() == expected.tobytes()
    if distance == 0.25 and most > 37:
        between = np.abs(expected[:, None] - expected).max(axis=2)
        assert (between == 0.25).any()


def test_nothing_is_kept_of_nothing() -> None:
    for distance in (0.0, 0.1):
        apart = Apart(distance)
        assert apart.keep(np.empty((0, 2)), 5).tolist() == []
        assert apart.keep(np.zeros((3, 2)), 0).tolist() == []
        assert apart.count == 0
