"""Closed-form registration of references that a tool point touches or is measured from.

Sockets, planes, spheres and fixed reference points of distances, and the tool point
itself, on nominal kinematics and without a first guess; the results start the
least-squares fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.registration import register_plane
from calib_pin.observations import Indices


@serial_blas
def register_sockets(
    F: Floats,
    tool: Floats,
    label: Indices,
    sockets: Floats,
    socket: Indices,
) -> tuple[Floats, Floats]:
    """Fit `R_i t_l(i) + p_i = c_s(i)`: points of a tool that rest in sockets.

    The nominal lengths of the robot are what sets the scale.

    Args:
        F: Tip poses (R_i, p_i) in the base, shape (N, 4, 4).
        tool: Points t in the tip frame, shape (J, 3) [m]; NaN where unknown.
        label: Which of them each row has in a socket, shape (N,).
        sockets: Centers c in the base, shape (S, 3) [m]; NaN where unknown.
        socket: Which of them it is, shape (N,).

    Returns:
        Points t (J, 3) and centers c (S, 3) [m]; NaN where no row tells.
    """
    R, right = F[:, :3, :3], -F[:, :3, 3]
    t, c = tool.copy(), sockets.copy()
    blocks, unknown = [], []
    for known, index, signed in (
        (t, label, R),
        (c, socket, np.broadcast_to(-np.eye(3), R.shape)),
    ):
        given = ~np.isnan(known[:, 0])
        right = right - np.einsum(
            "nij,nj->ni", signed, np.where(given[:, None], known, 0.0)[index]
        )
        for k in np.flatnonzero(~given):
            if (index == k).any():
                blocks.append(np.where((index == k)[:, None, None], signed, 0.0))
                unknown.append((known, k))
    if unknown:
        A = np.concatenate(blocks, axis=2).reshape(right.size, -1)
        solution = np.linalg.lstsq(A, right.reshape(-1), rcond=1e-9)[0]
        for (known, k), value in zip(unknown, solution.reshape(-1, 3), strict=True):
            known[k] = value
    return t, c


@dataclass(frozen=True)
class Reached:
    """A tool point that touches something, or hangs on a wire, and its site.

    Attributes:
        point: The point in the tip frame, shape (3,) [m].
        site: Center of the sphere, or where the wire leaves, or the plane's normal,
            shape (3,) [m].
        size: Radius of the sphere, bias of the wire, or offset of the plane [m].
    """

    point: Floats
    site: Floats
    size: float


@serial_blas
def register_touched_plane(F: Floats, point: Floats | None) -> Reached:
    """Fit `n . (R_i t + p_i) + f = 0`: an unknown plane and the point that touches it.

    The equation is linear in n, n t^T and f; their common factor is free, so that they
    are the null vector of the rows. Where it fails, poses being too few or too much
    alike, the point stays at the tip.

    Args:
        F: Tip poses (R_i, p_i), shape (N, 4, 4).
        point: The point t in the tip frame where it is known, shape (3,) [m].
    """
    R, p = F[:, :3, :3], F[:, :3, 3]
    candidates = [np.zeros(3) if point is None else point]
    if point is None and len(F) >= 12:
        center = p.mean(axis=0)
        A = np.column_stack([p - center, R.reshape(-1, 9), np.ones(len(F))])
        v = np.linalg.svd(A, full_matrices=len(A) < A.shape[1])[2][-1]
        if (length := float(v[:3] @ v[:3])) > 1e-12:
            candidates.append(v[3:12].reshape(3, 3).T @ v[:3] / length)
    return _best(F, candidates, _plane_through)


@serial_blas
def register_distances(
    F: Floats,
    distances: Floats | None,
    point: Floats | None,
    *,
    biased: bool = False,
) -> Reached:
    """Fit `|R_i t + p_i - a| + b = d_i`: a wire, or a sphere of unknown radius.

    Squared, the equation is linear in a, t, a t^T, b and one number more. Where that
    fails, poses being too few or too much alike, the point stays at the tip.

    Args:
        F: Tip poses (R_i, p_i), shape (N, 4, 4).
        distances: Distances d, shape (N,) [m]; None for a sphere, which has one.
        point: The point t in the tip frame where it is known, shape (3,) [m].
        biased: Whether they have an unknown bias b; without it is zero.
    """
    R, p = F[:, :3, :3], F[:, :3, 3]
    candidates = [np.zeros(3) if point is None else point]
    if point is None and len(F) >= 16 + biased:
        x = p - p.mean(axis=0)
        right = -np.sum(x**2, axis=1)
        columns = [
            np.ones(len(F)),
            *(2.0 * np.einsum("ni,nij->nj", x, R)).T,
            *(-2.0 * x).T,
            *(-2.0 * R.reshape(-1, 9)).T,
        ]
        if distances is not None:
            right = right + distances**2
            columns += [2.0 * distances] if biased else []
        solution = np.linalg.lstsq(np.column_stack(columns), right, rcond=1e-9)[0]
        candidates.append(solution[1:4])
    return _best(F, candidates, lambda at: _center_of(at, distances, biased))


@serial_blas
def register_relative_distances(F: Floats, distances: Floats) -> Floats:
    """Fit `|(R_i - I) t + p_i| = d_i`: how far a point of the tool has come.

    Squared, the equation is linear in t and in the six entries of t t^T. Where that
    fails, the point stays at the tip.

    Args:
        F: Tip poses (R_i, p_i) in the tip's pose at the start, shape (N, 4, 4).
        distances: Distances d, shape (N,) [m].

    Returns:
        The point t in the tip frame, shape (3,) [m].
    """
    turn, p = F[:, :3, :3] - np.eye(3), F[:, :3, 3]
    square = np.einsum("nia,nib->nab", turn, turn)
    i, j = np.triu_indices(3)
    twice = np.where(i == j, 1.0, 2.0)
    columns = [2.0 * np.einsum("ni,nia->na", p, turn), square[:, i, j] * twice]
    A, right = np.column_stack(columns), distances**2 - np.sum(p**2, axis=1)
    candidates = [np.zeros(3)]
    if len(F) >= 9:
        candidates.append(np.linalg.lstsq(A, right, rcond=1e-9)[0][:3])

    def misfit(t: Floats) -> float:
        reach = np.linalg.norm(turn @ t + p, axis=1)
        return float(np.linalg.norm(reach - distances))

    return min(candidates, key=misfit)


def _best(
    F: Floats,
    candidates: Sequence[Floats],
    through: Callable[[Floats], tuple[Floats, float, Floats]],
) -> Reached:
    """The fit with the best candidate for the point of the tool."""
    fits = []
    for t in candidates:
        site, size, misfit = through(F[:, :3, :3] @ t + F[:, :3, 3])
        fits.append((float(np.linalg.norm(misfit)), Reached(t, site, size)))
    return min(fits, key=lambda pair: pair[0])[1]


def _plane_through(points: Floats) -> tuple[Floats, float, Floats]:
    """Normal and offset of a plane through points, and their distances from it."""
    normal, offset = register_plane(points)
    return normal, offset, points @ normal + offset


def _center_of(
    points: Floats, distances: Floats | None, biased: bool
) -> tuple[Floats, float, Floats]:
    """Center at given distances from points, their bias or the radius, the misfit."""
    center = points.mean(axis=0)
    x = points - center
    right = -np.sum(x**2, axis=1)
    columns = [np.ones(len(x)), *(-2.0 * x).T]
    if distances is not None:
        right = right + distances**2
        columns += [2.0 * distances] if biased else []
    solution = np.linalg.lstsq(np.column_stack(columns), right, rcond=1e-9)[0]
    a = solution[1:4]
    reach = np.linalg.norm(x - a, axis=1)
    if distances is None:
        size = float(reach.mean())
        return a + center, size, reach - size
    size = float(solution[4]) if biased else 0.0
    return a + center, size, reach + size - distances
