"""Points that are spread evenly: a quasi-random sequence, and a distance they keep."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


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


class Apart:
    """Points that keep a distance, the largest difference of a component.

    Args:
        distance: The distance; zero if there is none to keep.

    Attributes:
        count: Number of points kept so far.
    """

    def __init__(self, distance: float) -> None:
        """Begin without points."""
        self.count = 0
        self._distance = distance
        self._trees: list[cKDTree] = []

    def keep(self, points: Floats, most: int) -> NDArray[np.intp]:
        """Keep points that are far enough from all before them.

        Args:
            points: The next points, shape (N, n).
            most: Largest number of points that are kept in all.

        Returns:
            Positions of those that are kept.
        """
        kept = np.arange(len(points))
        if self._distance > 0.0:
            kept = self._far(points)
        kept = kept[: max(most - self.count, 0)]
        self.count += len(kept)
        if self._distance > 0.0 and len(kept):
            self._remember(points[kept])
        return kept

    def _far(self, points: Floats) -> NDArray[np.intp]:
        far = np.ones(len(points), bool)
        for tree in self._trees:
            # Infinite where nothing is near.
            near, _ = tree.query(
                points[far], p=np.inf, distance_upper_bound=self._distance
            )
            far[far] = near >= self._distance
        kept: list[int] = []
        for k in np.flatnonzero(far):
            between = np.abs(points[kept] - points[k]).max(axis=1, initial=0.0)
            if (between >= self._distance).all():
                kept.append(int(k))
        return np.array(kept, np.intp)

    def _remember(self, points: Floats) -> None:
        # Scipy takes as long to load as Pinocchio; most plans keep no distance.
        from scipy.spatial import cKDTree

        # Trees of twice the size of the next: a point is sorted in a few times only.
        while self._trees and self._trees[-1].n <= len(points):
            points = np.concatenate([self._trees.pop().data, points])
        self._trees.append(cKDTree(points))
