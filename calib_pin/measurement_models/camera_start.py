"""Where a camera and the points it looks at are, from nominal poses of the robot.

The camera sees `X_i = O F_i I P_i` with the end O of a chain at the camera, the chain
F and its end I at the points. The ends are found in two ways, and the better one wins:
from the pose of the points in every image (robot-world and hand-eye calibration), and
from all rows at once, as if the robot had moved the points before one camera. The
first needs images of several points and can do with robot poses that are much alike;
the second is several times as exact where boards look small, and is content with one
point in every image.

A ray is (x, y): what a camera sees at (x, y, 1), up to scale, with the distortion of
its lens undone. All that is unknown stands in a matrix P with `(x, y, 1) ~ P f` for
features f of the points, which follows from linear equations (direct linear
transformation; Hartley and Zisserman, "Multiple View Geometry", 4.1 and 7.1). Nothing
needs a first guess, and nothing is refined.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats, nearest_rotation
from calib_pin.measurement_models.pinhole import NEAR
from calib_pin.measurement_models.registration import fit_pose, register_poses
from calib_pin.observations import Indices

IMAGES = 50
"""Images that a start is made from; more do not help it."""

ROWS = 2_000
"""Rows that it is made from where images do not count."""

FEW = 3
"""Images below which the poses of a board do not tell both ends."""

FLAT = 0.1
"""Part of the extent of a set of points below which it may count as a plane."""

THIN = 1e-3
"""Part of the extent of a set of points that tells nothing of this direction."""

FARTHEST_FOCAL = 10.0
"""Largest factor between a stated focal length and the one that images tell."""

ROUNDS = 50
"""Corrections of rays by the depths of points that are seen from near by."""

DEGENERATE = 1e-9
"""Part of the largest singular value that is rounding, and extent that is [m]."""


@dataclass(frozen=True)
class Rays:
    """The rays that a start is made from.

    Attributes:
        F: The chain, from the end at the camera to that at the points, (N, 4, 4).
        points: The points P by position, shape (J, 3) [m].
        index: Position of each ray's point, shape (N,).
        rays: Rays that the camera sees, shape (N, 2).
        image: Number of each ray's image, shape (N,).
    """

    F: Floats
    points: Floats
    index: Indices
    rays: Floats
    image: Indices

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
        if outer is not None and inner is not None:
            return outer, inner
        if len(self.F) == 0:
            return None
        pairs = list(self._candidates(outer, inner))
        if not pairs and outer is None and inner is None:
            known = [np.eye(4) if allowed else None for allowed in guess]
            pairs = list(self._resection(*known))
        return min(pairs, key=self.error, default=None)

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

    def focal_factors(self) -> Floats | None:
        """Factors of the focal lengths with which images of a plane can be such.

        The first two columns of a homography are those of a rotation: at right angles
        and of one length (Zhang, "A flexible new technique for camera calibration",
        PAMI 2000, equations 3 and 4). That is linear in the squares of the factors of
        the rays.

        Returns:
            Shape (2,), or None where fewer than three images tell them.
        """
        rows = list[Floats]()
        for k in self._views():
            points = self.points[self.index[k]]
            center, axes, extent = _extent(points)
            if extent[1] <= THIN * extent[0] or extent[2] > THIN * extent[0]:
                continue
            local = (points - center) @ axes.T
            P = _projection(
                self.rays[k], np.column_stack([local[:, :2], np.ones(len(local))])
            )
            if P is not None:
                a, b = P[:, :2].T / np.linalg.norm(P[:, :2])
                rows += [a * b, a**2 - b**2]
        if len(rows) < 2 * FEW:
            return None
        M = np.array(rows)
        squares = np.linalg.lstsq(M[:, :2], -M[:, 2], rcond=None)[0]
        if not (squares > 1.0 / FARTHEST_FOCAL**2).all():
            return None
        return np.asarray(1.0 / np.sqrt(squares))

    def _views(self) -> list[Indices]:
        """Rows of single images, from all over."""
        order = np.argsort(self.image, kind="stable")
        cuts = np.flatnonzero(np.diff(self.image[order])) + 1
        rows = [part for part in np.split(order, cuts) if len(part) >= 4]
        count = min(len(rows), IMAGES)
        return [rows[k] for k in np.linspace(0, len(rows) - 1, count).astype(int)]

    def _images(self) -> tuple[Floats, Floats]:
        """Chain and pose of the points of single images, shape (K, 4, 4) each."""
        chain, poses = [], []
        for k in self._views():
            points = self.points[self.index[k]]
            pose = _pose_of_image(points.tobytes(), self.rays[k].tobytes())
            if pose is not None:
                chain.append(self.F[k[0]])
                poses.append(pose)
        return np.array(chain), np.array(poses)

    def _resection(
        self, outer: Floats | None, inner: Floats | None
    ) -> Iterator[tuple[Floats, Floats]]:
        """Both ends with all rows as one image, where these tell."""
        few = self._thinned(ROWS)
        if inner is None:
            carried = carried_points(few.F, few.index, few.rays, few.points, outer)
            if carried is None:
                return
            inner = fit_pose(few.points, carried).homogeneous
        if outer is None:
            outer = pose_of_points(few._in_camera(np.eye(4), inner), few.rays)
        if outer is not None:
            yield outer, inner

    def _thinned(self, count: int) -> Rays:
        """Rows from all over."""
        rows = np.linspace(0, len(self.F) - 1, min(len(self.F), count)).astype(int)
        # A point that no row is left of would be told by nothing.
        seen, index = np.unique(self.index[rows], return_inverse=True)
        return Rays(
            self.F[rows], self.points[seen], index, self.rays[rows], self.image[rows]
        )

    def _in_camera(self, outer: Floats, inner: Floats) -> Floats:
        """`O F_i I P_i`, shape (N, 3) [m]."""
        T = outer @ self.F @ inner
        points = self.points[self.index]
        return np.asarray((T[:, :3, :3] @ points[:, :, None])[:, :, 0] + T[:, :3, 3])

    def error(self, ends: tuple[Floats, Floats]) -> float:
        """Median error of the rays; a point behind the camera has an infinite one."""
        X = self._in_camera(*ends)
        front = X[:, 2] > NEAR
        depth = np.where(front, X[:, 2], 1.0)
        error = np.linalg.norm(X[:, :2] / depth[:, None] - self.rays, axis=1)
        # Unlike a mean this does not ask what a wrong row says.
        return float(np.median(np.where(front, error, np.inf)))


@lru_cache(maxsize=1024)
def _pose_of_image(points: bytes, rays: bytes) -> Floats | None:
    """`pose_of_points` of an image; readings of one file are tried by the hundred."""
    return pose_of_points(
        np.frombuffer(points).reshape(-1, 3), np.frombuffer(rays).reshape(-1, 2)
    )


@serial_blas
def pose_of_points(points: Floats, rays: Floats) -> Floats | None:
    """The frame of points as the camera sees it, from four rays or more.

    Points about a plane give a homography, others are scaled by their depths, and six
    of these give the camera matrix; the pose with the smallest error is taken.

    Args:
        points: Points in a frame of their own, shape (N, 3) [m].
        rays: Rays that the camera sees of them, shape (N, 2).

    Returns:
        The pose (R, t) of their frame in the camera, shape (4, 4), or None where they
        are too few, lie on a line, or cannot all be in front of the camera.

    Examples:
        >>> board = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
        >>> pose = pose_of_points(board, board[:, :2] / 2.0)
        >>> np.allclose(pose[:3, 3], [0, 0, 2])
        True
    """
    center, axes, extent = _extent(points)
    if len(points) < 4 or extent[1] <= max(THIN * extent[0], DEGENERATE):
        return None
    local = (points - center) @ axes.T
    candidates: list[tuple[float, Floats]] = []
    if extent[2] < FLAT * extent[0]:
        candidates += _scored_pose(_plane_rotation(local, rays), local, rays)
    if extent[2] > THIN * extent[0]:
        if len(points) >= 6:
            candidates += _scored_pose(_space_rotation(local, rays), local, rays)
        candidates += _scored_pose(_scaled_rotation(local, rays), local, rays)
    if not candidates:
        return None
    _, pose = min(candidates, key=lambda candidate: candidate[0])
    pose[:3, :3] = pose[:3, :3] @ axes
    pose[:3, 3] -= pose[:3, :3] @ center
    return pose


def carried_points(
    F: Floats,
    label: Indices,
    rays: Floats,
    points: Floats,
    camera: Floats | None = None,
) -> Floats | None:
    """Points that a chain carries before a camera, in the tip of the chain.

    The camera sees `X_i = R (R_i c_l(i) + p_i) + t` with an unknown R, t and points c.
    With c = A h, h what is known of the points, this is linear in the products of R and
    A and in R, t: as many unknowns for many points as for a few, and one ray for each
    configuration is enough, if there are many. R is taken from them; t and A then
    follow from linear equations as well.

    Args:
        F: Tip poses (R_i, p_i), shape (N, 4, 4).
        label: Which of the points each row sees, shape (N,).
        rays: Rays that the camera sees, shape (N, 2).
        points: The points in a frame of their own, shape (J, 3) [m].
        camera: The pose (R, t) of the chain in the camera where it is known, (4, 4).

    Returns:
        The points c, shape (J, 3) [m], or None where the rows do not determine them.
    """
    center, axes, extent = _extent(points)
    thick = axes[(extent > THIN * extent[0]) & (extent > 0.0)]
    # In units of their size, so that all columns have about the same length.
    spread = (points - center) @ thick.T / (extent[0] or 1.0)
    h = np.column_stack([spread, np.ones(len(points))])
    turned = F[:, :3, :3, None] * h[label][:, None, None, :]
    if camera is None:
        known = np.column_stack([F[:, :3, 3], np.ones(len(F))])
        P = _projection(rays, np.column_stack([turned.reshape(len(F), -1), known]))
        # Two axes make a rotation: tips that stay in a plane are enough.
        if P is None or np.linalg.matrix_rank(P[:, -4:-1], rtol=1e-6) < 2:
            return None
        R = nearest_rotation(P[:, -4:-1])
    else:
        R = camera[:3, :3]
    sight = _sight(rays)
    rows = np.einsum("nab,bc,ncdl->nadl", sight, R, turned).reshape(2 * len(F), -1)
    right = -(sight @ (R @ F[:, :3, 3, None])).reshape(-1)
    if camera is None:
        rows = np.column_stack([rows, sight.reshape(-1, 3)])
    else:
        right -= sight.reshape(-1, 3) @ camera[:3, 3]
    if len(rows) < rows.shape[1]:
        return None
    solution = np.linalg.lstsq(rows, right, rcond=DEGENERATE)[0]
    return np.asarray(h @ solution[: 3 * h.shape[1]].reshape(3, -1).T)


def _extent(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Center (3,), principal axes as rows of a rotation (3, 3), extent along each."""
    center = points.mean(axis=0)
    # Rows of zeros give three axes however few the points are.
    padded = np.vstack([points - center, np.zeros((3, 3))])
    _, values, axes = np.linalg.svd(padded, full_matrices=False)
    axes[2] *= np.sign(np.linalg.det(axes))
    return center, axes, values / np.sqrt(len(points))


def _projection(rays: Floats, features: Floats) -> Floats | None:
    """Matrix P, shape (3, m), of least algebraic error of `(x, y, 1) ~ P f`.

    Features become orthonormal and rays centered before (Hartley's normalization,
    for any number of features); what features do not show is zero in P. The sign is
    that with most of the third components positive.

    Args:
        rays: Shape (N, 2).
        features: Shape (N, m).

    Returns:
        P, or None where it is not determined.
    """
    U, s, Vt = np.linalg.svd(features, full_matrices=False)
    kept = s > DEGENERATE * s[0]
    U = U[:, kept] * np.sqrt(len(U))
    center = rays.mean(axis=0)
    size = float(np.sqrt(np.mean((rays - center) ** 2))) or 1.0
    x, y = (rays - center).T[:, :, None] / size
    zero = np.zeros_like(U)
    A = np.block([[U, zero, -x * U], [zero, U, -y * U]])
    if len(A) < A.shape[1] - 1:
        return None
    # A row of zeros where there is just one too few, for a square factor.
    A = np.vstack([A, np.zeros((1, A.shape[1]))])
    _, values, directions = np.linalg.svd(np.linalg.qr(A, mode="r"))
    if values[-2] <= DEGENERATE * values[0]:
        return None
    P = directions[-1].reshape(3, -1) @ (Vt[kept] / s[kept, None])
    P[:2] = size * P[:2] + center[:, None] * P[2]
    return np.asarray(P * np.sign(np.sum(np.sign(features @ P[2])) or 1.0))


def _plane_rotation(local: Floats, rays: Floats) -> Floats | None:
    """Rotation of points about their plane z = 0, from its homography."""
    P = _projection(rays, np.column_stack([local[:, :2], np.ones(len(local))]))
    if P is None:
        return None
    first, second = P[:, 0], P[:, 1]
    third = np.cross(first, second) / np.sqrt(
        np.linalg.norm(first) * np.linalg.norm(second)
    )
    return nearest_rotation(np.column_stack([first, second, third]))


def _space_rotation(local: Floats, rays: Floats) -> Floats | None:
    """Rotation of points that fill space, from the camera matrix."""
    P = _projection(rays, np.column_stack([local, np.ones(len(local))]))
    return None if P is None else nearest_rotation(P[:, :3])


def _scaled_rotation(local: Floats, rays: Floats) -> Floats | None:
    """Rotation of points that fill space, from four on (POSIT).

    Seen from far away, points are scaled by one factor s, 1 / s their distance; with
    the rotation of these the depth of each corrects its ray (DeMenthon and Davis,
    "Model-based object pose in 25 lines of code", IJCV 1995).
    """
    inverse = np.linalg.pinv(np.column_stack([local, np.ones(len(local))]))
    depth, R = np.ones(len(local)), None
    for _ in range(ROUNDS):
        x, y = (inverse @ (rays * depth[:, None]))[:3].T
        scale = np.sqrt(np.linalg.norm(x) * np.linalg.norm(y))
        if not scale > 0.0:
            return None
        R = nearest_rotation(np.array([x, y, np.cross(x, y) / scale]) / scale)
        before, depth = depth, 1.0 + scale * (local @ R[2])
        if np.allclose(depth, before, rtol=DEGENERATE, atol=0.0):
            break
    return R


def _scored_pose(
    R: Floats | None, local: Floats, rays: Floats
) -> list[tuple[float, Floats]]:
    """Error of the rays and pose with a rotation, where points are in front."""
    if R is None:
        return []
    turned, sight = local @ R.T, _sight(rays)
    right = -(sight @ turned[:, :, None]).reshape(-1)
    t = np.linalg.lstsq(sight.reshape(-1, 3), right, rcond=None)[0]
    seen = turned + t
    if (seen[:, 2] <= 0.0).any():
        return []
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, t
    return [(float(np.sum((seen[:, :2] / seen[:, 2:] - rays) ** 2)), pose)]


def _sight(rays: Floats) -> Floats:
    """Matrices S with `S X = 0` for every point X on a ray, shape (N, 2, 3)."""
    result = np.zeros((len(rays), 2, 3))
    result[:, 0, 0] = result[:, 1, 1] = 1.0
    result[:, :, 2] = -rays
    return result
