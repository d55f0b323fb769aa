"""Closed-form registration of an unknown base and tool on nominal kinematics.

Both problems are solved without a first guess; the results start the least-squares
fit, which then applies the weights.
"""

from __future__ import annotations

from functools import cache
from itertools import permutations, product

import numpy as np
import pinocchio as pin

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats, nearest_rotation, skew, so3_exp
from calib_pin.observations import Indices

UNKNOWN = np.full((1, 3), np.nan)
"""One point of the tool that nobody knows."""

NEAR = 2.0
"""Cost of a rotation, in least costs of a matrix, beyond which others are tried."""

SETTLED = 4
"""Steps in which the cost of a rotation must fall by a millionth to go on."""


@serial_blas
def register_points(
    F: Floats,
    points: Floats,
    *,
    base: tuple[Floats, Floats] | None = None,
    tool: Floats = UNKNOWN,
    label: Indices | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Fit `y_i = R (R_i t_l(i) + p_i) + b` to points seen from an unknown frame.

    For a given rotation R the best t and R^T b follow from a linear problem whose
    matrix [R_i, I] does not depend on R. With them projected out the cost is a
    quadratic form in the nine entries of R, so that a search over rotations costs
    nothing: the rotation next to the best matrix is refined and, unless no other can be
    much better, all 24 rotations of the cube are, and the best one wins. Of several
    points t every row sees one (Wu et al., partial pose measurements).

    Args:
        F: Tip poses (R_i, p_i) in the base, shape (N, 4, 4).
        points: Measured points y_i, shape (N, 3) [m].
        base: R and b where they are known.
        tool: Points t in the tip frame, shape (J, 3) [m]; NaN where unknown.
        label: Which of them each row sees, shape (N,); default the first.

    Returns:
        Rotation R (3, 3) and translation b (3,) of the base in the measurement frame,
        and the points t (J, 3) [m]; NaN where no row sees one that is unknown.

    Examples:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> q = chain.random_configurations(9, np.random.default_rng(0))
        >>> F = chain.poses(q)
        >>> points = F[:, :3, :3] @ [0.0, 0.0, 0.1] + F[:, :3, 3] + [1.0, 2.0, 3.0]
        >>> R, b, t = register_points(F, points)
        >>> np.allclose(R, np.eye(3)), np.allclose(b, [1, 2, 3])
        (True, True)
        >>> np.allclose(t, [0, 0, 0.1])
        True
    """
    label = np.zeros(len(F), np.int64) if label is None else label
    R, b = base or (_minimize_over_rotations(_point_rows(F, points, tool, label)), None)
    b, t = _translations(R, F, points, b, tool, label)
    return R, b, t


@serial_blas
def register_poses(
    F: Floats, poses: Floats, *, base: Floats | None = None, tool: Floats | None = None
) -> tuple[Floats, Floats]:
    """Fit `Y_i = B F_i X` to measured poses (robot-world and hand-eye calibration).

    The origins of the poses are points, as in `register_points`. For a given rotation
    of B the best X^T of `Y_i X^T = B F_i` is linear in B as well if it may be any
    matrix, so that all rows together are a quadratic form in the rotation of B. The
    origins settle what the rotations leave open where all turns are about one axis.

    Args:
        F: Tip poses in the base, shape (N, 4, 4).
        poses: Measured tool poses Y_i, shape (N, 4, 4).
        base: B where it is known, shape (4, 4).
        tool: X where it is known, shape (4, 4).

    Returns:
        B and X, each of shape (4, 4).

    Examples:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> q = chain.random_configurations(9, np.random.default_rng(0))
        >>> B, X = register_poses(chain.poses(q), chain.poses(q))
        >>> np.allclose(B, np.eye(4)), np.allclose(X, np.eye(4))
        (True, True)
    """
    R_f, R_y, points = F[:, :3, :3], poses[:, :3, :3], poses[:, :3, 3]
    label = np.zeros(len(F), np.int64)
    t = UNKNOWN if tool is None else tool[None, :3, 3]
    R_x = None if tool is None else tool[:3, :3]
    if base is None:
        rows = [_point_rows(F, points, t, label), _rotation_rows(R_f, R_y, R_x)]
        R_b, b = _minimize_over_rotations(np.concatenate(rows)), None
    else:
        R_b, b = base[:3, :3], base[:3, 3]
    if R_x is None:
        R_x = nearest_rotation(np.einsum("nji,kj,nkl->il", R_f, R_b, R_y))
    b, t = _translations(R_b, F, points, b, t, label)
    return _pose(R_b, b), _pose(R_x, t[0])


@serial_blas
def register_plane(points: Floats) -> tuple[Floats, float]:
    """Plane of least squared distance through points, shape (N, 3) [m].

    Returns:
        Unit normal n (3,) and offset f <= 0 [m] of `n . p + f = 0`.
    """
    center = points.mean(axis=0)
    # Of many points the left vectors would not fit into memory.
    normal = np.linalg.svd(points - center, full_matrices=len(points) < 3)[2][2]
    offset = -float(normal @ center)
    return (normal, offset) if offset <= 0.0 else (-normal, -offset)


@serial_blas
def fit_pose(here: Floats, there: Floats) -> pin.SE3:
    """The pose that brings points there, `there = R here + t` (Arun et al. 1987).

    Undetermined components of the rotation are zero.

    Args:
        here: Points, shape (K, 3) [m].
        there: The same points in the other frame, shape (K, 3) [m].
    """
    center, target = here.mean(axis=0), there.mean(axis=0)
    spread = (there - target).T @ (here - center)
    # Of all rotations that fit equally well this takes the one closest to none.
    size = np.linalg.norm(spread)
    R = nearest_rotation(spread + 1e-9 * size * np.eye(3)) if size else np.eye(3)
    return pin.SE3(R, target - R @ center)


def _point_rows(F: Floats, points: Floats, tool: Floats, label: Indices) -> Floats:
    """Rows (A, a), shape (3 N, 10), whose residual `A vec(R) - a` a rotation leaves.

    It is that of `R^T (y_i - b) = R_i t + p_i` with R^T b, and t unless it is known,
    projected out; vec takes R by rows.
    """
    count = len(F)
    # Centering by the mean keeps the rows small and well conditioned.
    centered = points - points.mean(axis=0)
    L = np.zeros((count, 3, 3, 3))
    for k in range(3):
        L[:, k, :, k] = centered
    right = F[:, :3, 3] + _known_offsets(F, tool, label)
    right = right - right.mean(axis=0)
    rows = np.column_stack([L.reshape(3 * count, 9), right.reshape(-1)])
    matrix = _translation_matrix(F, _unknown(tool, label), label)
    U, s, _ = np.linalg.svd(matrix, full_matrices=False)
    U = U[:, s > 1e-9 * s[0]]
    return np.asarray(rows - U @ (U.T @ rows))


def _rotation_rows(R_f: Floats, R_y: Floats, R_x: Floats | None) -> Floats:
    """Rows (A, a), shape (9 N, 10), of `R_b R_f = R_y R_x^T`, as in `_point_rows`.

    An unknown R_x^T is projected out as a free matrix, the mean of `R_y^T R_b R_f`.
    """
    count = len(R_f)
    L = np.einsum("ia,nbl->nilab", np.eye(3), R_f).reshape(count, 3, 27)
    right = np.zeros((count, 3, 3))
    if R_x is None:
        L -= R_y @ np.mean(np.swapaxes(R_y, 1, 2) @ L, axis=0)
    else:
        right = R_y @ R_x.T
    return np.column_stack([L.reshape(9 * count, 9), right.reshape(-1)])


def _unknown(tool: Floats, label: Indices) -> Indices:
    """Points of the tool that are unknown and that some row sees."""
    seen = np.bincount(label, minlength=len(tool)) > 0
    return np.flatnonzero(np.isnan(tool[:, 0]) & seen)


def _known_offsets(F: Floats, tool: Floats, label: Indices) -> Floats:
    """Rotated offsets of the known points, zero for the others, shape (N, 3)."""
    offsets = np.nan_to_num(tool)[label]
    return np.asarray(np.einsum("nij,nj->ni", F[:, :3, :3], offsets))


def _translation_matrix(F: Floats, unknown: Indices, label: Indices) -> Floats:
    """Matrix of R^T b and of every unknown t, shape (3 N, 3 + 3 U)."""
    blocks = [np.broadcast_to(np.eye(3), (len(F), 3, 3))]
    for k in unknown:
        blocks.append(np.where((label == k)[:, None, None], F[:, :3, :3], 0.0))
    return np.concatenate(blocks, axis=2).reshape(3 * len(F), -1)


def _translations(
    R: Floats,
    F: Floats,
    points: Floats,
    b: Floats | None,
    tool: Floats,
    label: Indices,
) -> tuple[Floats, Floats]:
    """Translations b and t of `y_i = R (R_i t + p_i) + b`, given b and known t."""
    center, origin = points.mean(axis=0), F[:, :3, 3].mean(axis=0)
    if b is not None:
        center, origin = b, np.zeros(3)
    right = (points - center) @ R - (F[:, :3, 3] - origin)
    right = right - _known_offsets(F, tool, label)
    unknown = _unknown(tool, label)
    A = _translation_matrix(F, unknown, label)
    if b is not None:
        A = A[:, 3:]
    solution = np.linalg.lstsq(A, right.reshape(-1), rcond=1e-9)[0]
    t = tool.copy()
    if len(unknown):
        t[unknown] = solution[-3 * len(unknown) :].reshape(-1, 3)
    if b is None:
        b = center - R @ origin + R @ solution[:3]
    return b, t


def _pose(R: Floats, t: Floats) -> Floats:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = R, t
    return result


@cache
def _cube_rotations() -> list[Floats]:
    """The 24 rotations that map the coordinate axes onto each other."""
    result = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), order] = signs
            if np.linalg.det(M) > 0.0:
                result.append(M)
    return result


def _minimize_over_rotations(rows: Floats) -> Floats:
    """Rotation R of least `|A vec(R) - a|^2`, with rows (A, a) of shape (M, 10).

    No rotation costs less than the best matrix does. Where the one next to that costs
    hardly more there is no better one to be sought from all sides.
    """
    # The triangular factor has the same residual norm. Unlike the normal matrix it
    # keeps small residuals exact, which the last digits of R need.
    factor: Floats = np.asarray(np.linalg.qr(rows, mode="r"))
    A, a = factor[:, :9], factor[:, 9]
    free: Floats = np.asarray(np.linalg.lstsq(A, a, rcond=None)[0])
    R, cost = _best_rotation(A, a, nearest_rotation(free.reshape(3, 3))[None])
    if cost > NEAR * float(np.sum((A @ free - a) ** 2)):
        R, _ = _best_rotation(A, a, np.array(_cube_rotations()))
    return R


def _best_rotation(A: Floats, a: Floats, R: Floats) -> tuple[Floats, float]:
    """The best rotation, and its cost, from starts of shape (S, 3, 3).

    All of them take their damped Newton steps at once.
    """

    def residual(R: Floats) -> Floats:
        return np.asarray(R.reshape(-1, 9) @ A.T - a)

    residuals, damping = residual(R), np.full(len(R), 1e-3)
    values = np.sum(residuals**2, axis=1)
    generators, best = skew(np.eye(3)), [np.inf] * SETTLED
    for _ in range(100):
        # Rows: derivative of the residual by w in R Exp(w).
        D = (R[:, None] @ generators).reshape(-1, 3, 9) @ A.T
        gradient = (D @ residuals[:, :, None])[:, :, 0]
        # The cost bends with the residual, too, which is large where nothing fits.
        S = np.swapaxes(R, 1, 2) @ (residuals @ A).reshape(-1, 3, 3)
        trace = np.trace(S, axis1=1, axis2=2)[:, None, None]
        normal = D @ np.swapaxes(D, 1, 2)
        size = np.trace(normal, axis1=1, axis2=2) / 3.0 + 1e-300
        bends, V = np.linalg.eigh(
            normal + 0.5 * (S + np.swapaxes(S, 1, 2)) - trace * np.eye(3)
        )
        along = (gradient[:, None] @ V)[:, 0] / (
            np.abs(bends) + (damping * size)[:, None]
        )
        step: Floats = -(V @ along[:, :, None])[:, :, 0]
        candidates: Floats = R @ so3_exp(step)
        tried = residual(candidates)
        fresh = np.sum(tried**2, axis=1)
        better = fresh <= values
        R = np.where(better[:, None, None], candidates, R)
        residuals = np.where(better[:, None], tried, residuals)
        values = np.where(better, fresh, values)
        damping = np.where(better, np.maximum(damping / 10.0, 1e-12), damping * 10.0)
        best.append(float(values.min()))
        # Of measurements that nothing explains the last digits mean nothing.
        settled = best[-1] > (1.0 - 1e-6) * best[-1 - SETTLED]
        small = np.linalg.norm(step[np.argmin(values)]) < 1e-9
        if small or settled or (damping > 1e8).all():
            break
    return np.asarray(R[np.argmin(values)]), float(values.min())
