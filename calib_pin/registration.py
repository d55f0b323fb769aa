"""Closed-form registration of an unknown base and tool on nominal kinematics.

Both problems are solved without a first guess; the results start the least-squares
fit, which then applies the weights.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from calib_pin.spatial import Floats, nearest_rotation, skew, so3_exp

__all__ = ["register_plane", "register_points", "register_poses"]


def register_points(
    F: Floats, points: Floats, *, tool: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Fit `y_i = R (R_i t + p_i) + b` to points seen from an unknown frame.

    For a given rotation R the best t and R^T b follow from a linear problem whose
    matrix [R_i, I] does not depend on R. With them projected out the cost is a
    quadratic form in the nine entries of R, so that a search over rotations costs
    nothing: all 24 rotations of the cube are refined and the best one wins.

    Args:
        F: Tip poses (R_i, p_i) in the base, shape (N, 4, 4).
        points: Measured points y_i, shape (N, 3) [m].
        tool: The point t in the tip frame where it is known, shape (3,) [m].

    Returns:
        Rotation R (3, 3) and translation b (3,) of the base in the measuring frame,
        and the point t (3,) [m].
    """
    count = len(F)
    R_i, p_i = F[:, :3, :3], F[:, :3, 3]
    identity = np.broadcast_to(np.eye(3), (count, 3, 3))
    if tool is None:
        A = np.concatenate([R_i, identity], axis=2).reshape(3 * count, 6)
        fixed = p_i
    else:
        A = identity.reshape(3 * count, 3)
        fixed = p_i + R_i @ tool
    # Centering by the mean keeps the quadratic form small and well conditioned.
    center, origin = points.mean(axis=0), fixed.mean(axis=0)
    # vec(R^T (y_i - center)) = L vec(R), rows over i and the component.
    L = np.zeros((count, 3, 3, 3))
    for k in range(3):
        L[:, k, :, k] = points - center
    system = np.column_stack([L.reshape(3 * count, 9), (fixed - origin).reshape(-1)])
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    U = U[:, s > 1e-9 * s[0]]
    system -= U @ (U.T @ system)
    H, g = system[:, :9].T @ system[:, :9], system[:, :9].T @ system[:, 9]
    R = _minimize_over_rotations(H, g)
    right = ((points - center) @ R - (fixed - origin)).reshape(-1)
    solution = np.linalg.lstsq(A, right, rcond=1e-9)[0]
    b = center - R @ origin + R @ solution[-3:]
    return R, b, (solution[:3] if tool is None else tool)


def register_poses(
    F: Floats, poses: Floats, *, base: Floats | None = None, tool: Floats | None = None
) -> tuple[Floats, Floats]:
    """Fit `Y_i = B F_i X` to measured poses (robot-world and hand-eye calibration).

    The rotations of B and X follow from the null vector of
    `Y_i X^T - B F_i = 0` (Kronecker form), polished by alternating Procrustes steps,
    the translations from a linear problem.

    Args:
        F: Tip poses in the base, shape (N, 4, 4).
        poses: Measured tool poses Y_i, shape (N, 4, 4).
        base: B where it is known, shape (4, 4).
        tool: X where it is known, shape (4, 4).

    Returns:
        B and X, each of shape (4, 4).
    """
    count = len(F)
    R_y, R_f = poses[:, :3, :3], F[:, :3, :3]
    if base is not None:
        R_b = base[:3, :3]
        R_x = nearest_rotation(np.einsum("nji,jk,nkl->il", R_f, R_b.T, R_y))
        R_x = R_x if tool is None else tool[:3, :3]
    elif tool is not None:
        R_x = tool[:3, :3]
        R_b = nearest_rotation(np.einsum("nij,kj,nlk->il", R_y, R_x, R_f))
    else:
        R_b, R_x = _hand_eye_rotations(R_y, R_f)

    # R_y t_y-part: t_y = R_b (R_f t_x + t_f) + t_b, linear in (t_b, t_x).
    A = np.zeros((count, 3, 6))
    A[:, :, :3] = np.eye(3)
    A[:, :, 3:] = R_b @ R_f
    right = poses[:, :3, 3] - F[:, :3, 3] @ R_b.T
    unknown = np.repeat([base is None, tool is None], 3)
    known = np.concatenate(
        [
            np.zeros(3) if base is None else base[:3, 3],
            np.zeros(3) if tool is None else tool[:3, 3],
        ]
    )
    right = right - A @ known
    solution = known.copy()
    if unknown.any():
        solution[unknown] += np.linalg.lstsq(
            A[:, :, unknown].reshape(3 * count, -1), right.reshape(-1), rcond=1e-9
        )[0]
    return _pose(R_b, solution[:3]), _pose(R_x, solution[3:])


def register_plane(points: Floats) -> tuple[Floats, float]:
    """Plane of least squared distance through points, shape (N, 3) [m].

    Returns:
        Unit normal n (3,) and offset f <= 0 [m] of `n . p + f = 0`.
    """
    center = points.mean(axis=0)
    normal = np.linalg.svd(points - center)[2][2]
    offset = -float(normal @ center)
    return (normal, offset) if offset <= 0.0 else (-normal, -offset)


def _pose(R: Floats, t: Floats) -> Floats:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = R, t
    return result


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


def _minimize_over_rotations(H: Floats, g: Floats) -> Floats:
    """Minimize `r^T H r - 2 g^T r` over rotations, r the rows of R, from all starts.

    All starts take their damped Newton steps at once.
    """

    def cost(R: Floats) -> Floats:
        r = R.reshape(-1, 9)
        return np.asarray(np.einsum("ni,ij,nj->n", r, H, r) - 2.0 * r @ g)

    R: Floats = np.array(_cube_rotations())
    values, damping = cost(R), np.full(len(R), 1e-3)
    generators = skew(np.eye(3))
    for _ in range(100):
        # Columns: derivative of the entries of R Exp(w) by w.
        D = (R[:, None] @ generators).reshape(-1, 3, 9)
        gradient = D @ (R.reshape(-1, 9) @ H - g)[:, :, None]
        curvature = D @ H @ np.swapaxes(D, 1, 2)
        size = np.trace(curvature, axis1=1, axis2=2) / 3.0 + 1e-300
        curvature += (damping * size)[:, None, None] * np.eye(3)
        step: Floats = np.asarray(-np.linalg.solve(curvature, gradient)[:, :, 0])
        candidates: Floats = R @ so3_exp(step)
        fresh = cost(candidates)
        better = fresh <= values
        R = np.where(better[:, None, None], candidates, R)
        values = np.where(better, fresh, values)
        damping = np.where(better, np.maximum(damping / 10.0, 1e-12), damping * 10.0)
        if (np.linalg.norm(step[np.argmin(values)]) < 1e-9) or (damping > 1e8).all():
            break
    return np.asarray(R[np.argmin(values)])


def _hand_eye_rotations(R_y: Floats, R_f: Floats) -> tuple[Floats, Floats]:
    """Rotations B and X of `Y_i = B F_i X` from `Y_i X^T - B F_i = 0`."""
    count = len(R_y)
    identity = np.eye(3)
    # Row-major vec: vec(Y X^T) = (Y kron I) vec(X^T), vec(B F) = (I kron F^T) vec(B).
    K = np.zeros((count, 9, 18))
    K[:, :, :9] = np.einsum("nij,kl->nikjl", R_y, identity).reshape(count, 9, 9)
    K[:, :, 9:] = -np.einsum("ij,nlk->nikjl", identity, R_f).reshape(count, 9, 9)
    M = K.reshape(9 * count, 18)
    null = np.linalg.eigh(M.T @ M)[1][:, 0]
    X_t, B = null[:9].reshape(3, 3), null[9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(X_t)) or 1.0
    R_x, R_b = nearest_rotation(sign * X_t).T, nearest_rotation(sign * B)
    for _ in range(20):
        R_b = nearest_rotation(np.einsum("nij,kj,nlk->il", R_y, R_x, R_f))
        R_x = nearest_rotation(np.einsum("nji,kj,nkl->il", R_f, R_b, R_y))
    return R_b, R_x
