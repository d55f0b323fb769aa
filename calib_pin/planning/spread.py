"""Points that are spread evenly: a quasi-random sequence, and a distance they keep."""

from __future__ import annotations

import numpy as np

from calib_pin.kinematics.spatial import Floats


def quasi_random(shift: Floats, begin: int, count: int) -> Floats:
    """Members of an additive recurrence in the unit cube, shape (count, n).

    `x_k = shift + k a (mod 1)` with `a_j = g^-j` and g the root of `g^(n+1) = g + 1`,
    the generalized golden ratio (Roberts 2018): low discrepancy for any number.
    """
    n = len(shift)
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1))
    steps = ratio ** -np.arange(1.0, n + 1)
    return np.asarray((shift + np.arange(begin, begin + count)[:, None] * steps) % 1.0)


def apart(points: Floats, others: Floats, distance: float) -> list[int]:
    """Positions of points that keep a distance from others and from those before them.

    Args:
        points: The points, shape (N, n).
        others: Those that they keep away from, shape (K, n).
        distance: The distance, the largest difference of a component.
    """
    # Scipy takes as long to load as Pinocchio; most plans keep no distance.
    from scipy.spatial import cKDTree

    kept: list[int] = []
    limit = {"p": np.inf, "distance_upper_bound": distance}
    # Infinite where nothing is near.
    near, _ = cKDTree(others).query(points, **limit)
    for k in np.flatnonzero(near >= distance):
        between = np.abs(points[kept] - points[k]).max(axis=1, initial=0.0)
        if (between >= distance).all():
            kept.append(int(k))
    return kept
