"""Where a camera and the points it looks at are, from nominal poses of the robot.

The camera sees `X_i = O F_i I P_i` with the end O of a chain at the camera, the chain
F and its end I at the points. The ends are found in two ways, and the better one wins:
from the pose of the points in every image (robot-world and hand-eye calibration), and
from all rows at once, as if the robot had moved the points before one camera. The
first needs images of several points and can do with robot poses that are much alike;
the second is several times as exact where boards look small, and is content with one
point in every image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.camera_pose import carried_points, pose_of_points
from calib_pin.measurement_models.pinhole import NEAR
from calib_pin.measurement_models.registration import fit_pose, register_poses

IMAGES = 50
"""Images that a start is made from; more do not help it."""

ROWS = 2_000
"""Rows that it is made from where images do not count."""

FEW = 3
"""Images below which the poses of a board do not tell both ends."""


@dataclass(frozen=True)
class Rays:
    """What a start is made from.

    Attributes:
        F: The chain, from the end at the camera to that at the points, (N, 4, 4).
        points: The points P by position, shape (J, 3) [m].
        index: Position of each row's point, shape (N,).
        rays: What the camera sees, shape (N, 2).
        image: Number of each row's image, shape (N,).
    """

    F: Floats
    points: Floats
    index: NDArray[np.int64]
    rays: Floats
    image: NDArray[np.int64]

    def ends(
        self, outer: Floats | None, inner: Floats | None, guess: tuple[bool, bool]
    ) -> tuple[Floats, Floats] | None:
        """Both ends of the chain.

        Args:
            outer: The end at the camera where it is known, shape (4, 4).
            inner: The end at the points where it is known, shape (4, 4).
            guess: Which of them may be taken for the identity if there is no other way.

        Returns:
            O and I, shape (4, 4) each, or None where the rows are too few.
        """
        if len(self.F) == 0:
            return None
        found = list(self._candidates(outer, inner))
        if not found and outer is None and inner is None:
            known = [np.eye(4) if taken else None for taken in guess]
            found = list(self._resection(*known))
        return min(found, key=self._error, default=None)

    def _candidates(
        self, outer: Floats | None, inner: Floats | None
    ) -> Iterator[tuple[Floats, Floats]]:
        F, poses = self._images()
        resected = list(self._resection(outer, inner))
        unknown = outer is None and inner is None
        # One or two images are explained by many ends; so it is if nothing else is.
        if len(F) >= (FEW if unknown and resected else 1):
            yield register_poses(F, poses, base=outer, tool=inner)
        yield from resected

    def _images(self) -> tuple[Floats, Floats]:
        """Chain and pose of the points of single images, shape (K, 4, 4) each."""
        order = np.argsort(self.image, kind="stable")
        cuts = np.flatnonzero(np.diff(self.image[order])) + 1
        rows = [part for part in np.split(order, cuts) if len(part) >= 4]
        if len(rows) > IMAGES:
            # Those with the most points; of equal ones some from all over.
            least = sorted(map(len, rows))[-IMAGES]
            rows = [part for part in rows if len(part) >= least]
            rows = [rows[k] for k in np.linspace(0, len(rows) - 1, IMAGES).astype(int)]
        chain, poses = [], []
        for k in rows:
            pose = pose_of_points(self.points[self.index[k]], self.rays[k])
            if pose is not None:
                chain.append(self.F[k[0]])
                poses.append(pose)
        return np.array(chain), np.array(poses)

    def _resection(
        self, outer: Floats | None, inner: Floats | None
    ) -> Iterator[tuple[Floats, Floats]]:
        """Both ends with all rows as one image, where these tell."""
        few = self._some(ROWS)
        if inner is None:
            carried = carried_points(few.F, few.index, few.rays, few.points, outer)
            if carried is None:
                return
            inner = fit_pose(few.points, carried).homogeneous
        if outer is None:
            outer = pose_of_points(few._moved(np.eye(4), inner), few.rays)
        if outer is not None:
            yield outer, inner

    def _some(self, count: int) -> Rays:
        """Rows from all over."""
        rows = np.linspace(0, len(self.F) - 1, min(len(self.F), count)).astype(int)
        # A point that no row is left of would be told by nothing.
        seen, index = np.unique(self.index[rows], return_inverse=True)
        return Rays(
            self.F[rows], self.points[seen], index, self.rays[rows], self.image[rows]
        )

    def _moved(self, outer: Floats, inner: Floats) -> Floats:
        """`O F_i I P_i`, shape (N, 3) [m]."""
        T = outer @ self.F @ inner
        points = self.points[self.index]
        return np.asarray((T[:, :3, :3] @ points[:, :, None])[:, :, 0] + T[:, :3, 3])

    def _error(self, ends: tuple[Floats, Floats]) -> float:
        """Median error of the rays; a point behind the camera has an infinite one."""
        X = self._moved(*ends)
        front = X[:, 2] > NEAR
        depth = np.where(front, X[:, 2], 1.0)
        error = np.linalg.norm(X[:, :2] / depth[:, None] - self.rays, axis=1)
        # Unlike a mean this does not ask what a wrong row says.
        return float(np.median(np.where(front, error, np.inf)))
