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


@pytest.mark.parametrize(
    ("distance", "most"), [(0.0, 37), (0.05, 10_000), (0.25, 10_000), (0.7, 37)]
)
def test_points_keep_their_distance(distance: float, most: int) -> None:
    rng = np.random.default_rng(3)
    # Corners of a grid are as far apart as they may be, and no farther.
    grid = 0.25 * rng.integers(0, 5, (100, 3))
    points = np.concatenate([rng.random((80, 3)), grid, rng.random((80, 3))])
    apart, kept = Apart(distance), list[Floats]()
    for begin in range(0, len(points) + 70, 70):
        block = points[begin : begin + 70]
        kept.append(block[apart.keep(block, most)])
        assert apart.count == sum(map(len, kept)) <= most
    expected = one_by_one(points, distance, most)
    assert np.concatenate(kept).tobytes() == expected.tobytes()
    if distance == 0.25 and most > 37:
        between = np.abs(expected[:, None] - expected).max(axis=2)
        assert (between == 0.25).any()
