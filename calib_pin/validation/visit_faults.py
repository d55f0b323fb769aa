"""Faults among the visits of an acceptance test: bad and exchanged ones, and moves.

The visits of a pose lie together. One that does not is bad, by Rosner's test with the
visits' own covariance: the farthest are left out one after the other, and so many are
bad as the last of them that is too far tells. A moved instrument moves all visits after
it by a rigid motion, beyond any smooth drift.
"""

from __future__ import annotations

import numpy as np

from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices

CHANCE = 0.01
"""Probability with which a test without any fault is told to have one of a kind."""

MOST = 5
"""Of so many visits of a pose one is bad at most."""

RESOLUTION = 1e-6
"""Scatter of visits that no instrument resolves [m]."""

SPLITS = 200
"""Places at which a move is sought."""

FEW = 6
"""Visits by whose number the scatter of all poses counts for each."""

DEGREES = (2, 4)
"""Degrees of the drift beside which a move is sought, and of that which it beats."""


def bad_visits(attained: Floats, pose: Indices) -> list[int]:
    """Visits that do not belong to the others of their pose.

    Args:
        attained: Measured positions, shape (N, 3) [m].
        pose: Pose of each visit from 0, shape (N,).
    """
    count, found = int(pose.max()) + 1, list[int]()
    for k in range(count):
        left, gone, last = np.flatnonzero(pose == k).tolist(), list[int](), 0
        most = len(left) // MOST
        while len(gone) < most and (n := len(left)) > 4:
            d = attained[left] - attained[left].mean(axis=0)
            C = d.T @ d / (n - 1) + RESOLUTION**2 * np.eye(3)
            squares = np.einsum("ni,ij,nj->n", d, np.linalg.inv(C), d)
            worst = int(np.argmax(squares))
            gone.append(left.pop(worst))
            # The part that one of n visits has of their scatter.
            part = n * squares[worst] / (n - 1) ** 2
            ratio = part / max(1.0 - part, np.finfo(float).eps) * (n - 4) / 3.0
            if n * count * f_tail(ratio, 3, n - 4) < CHANCE:
                last = len(gone)
        found += gone[:last]
    return sorted(found)


def moved_after(attained: Floats, pose: Indices) -> int | None:
    """The first visit after which the instrument was moved; None where it was not.

    Args:
        attained: Measured positions in their order, shape (N, 3) [m].
        pose: Pose of each visit from 0, shape (N,).
    """
    n, K = len(pose), int(pose.max()) + 1
    x = np.array([attained[pose == k].mean(axis=0) for k in range(K)])
    d, centered = attained - x[pose], (x - x.mean(axis=0))[pose]
    # In standard deviations of a visit, which no drift and no move makes larger.
    steps = [np.diff(d[pose == k], axis=0) for k in range(K)]
    every = np.concatenate(steps)
    shared = FEW * (every.T @ every) / max(len(every), 1)
    scatter = np.array([(s.T @ s + shared) / (len(s) + FEW) for s in steps])
    W = np.linalg.inv(np.linalg.cholesky(scatter + RESOLUTION**2 * np.eye(3)))[pose]
    turns = np.cross(np.eye(3), centered[:, None]).transpose(0, 2, 1)
    rigid = W @ np.concatenate([np.tile(np.eye(3), (n, 1, 1)), turns], axis=2)
    own = np.einsum("nk,ij->nikj", np.eye(K)[pose], np.eye(3)).reshape(3 * n, -1)
    values = (W @ d[:, :, None]).reshape(-1)

    def smooth(degree: int) -> tuple[Floats, Floats]:
        """Orthonormal poses' own means and a drift, and what they leave."""
        time = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), degree)
        drift = np.einsum("np,nij->nipj", time[:, 1:], rigid).reshape(3 * n, -1)
        Q = _range(np.column_stack([own, drift]))
        return Q, values - Q @ (Q.T @ values)

    def gain(k: int) -> float:
        Z = np.where(np.arange(n)[:, None, None] >= k, rigid, 0.0).reshape(3 * n, 6)
        return float(np.sum((_range(Z - few @ (few.T @ Z)).T @ r) ** 2))

    (few, r), (many, rest) = map(smooth, DEGREES)
    least = max(2 * K, n // 10)
    places = np.unique(np.linspace(least, n - least, SPLITS).astype(int))
    free = 3 * n - few.shape[1] - 6
    if free <= 0 or least > n - least:
        return None
    place = max(places.tolist(), key=gain)
    best = gain(place)
    # No scatter is that of rounding.
    left = max((float(r @ r) - best) / free, 1e-3)
    beaten = left * (3 * n - many.shape[1]) < float(rest @ rest)
    sure = n * f_tail(best / 6.0 / left, 6, free) < CHANCE
    return place if beaten and sure else None


def _range(A: Floats) -> Floats:
    """Orthonormal basis of columns, rounding left out."""
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s.max(initial=0.0)])
