"""Faults among the visits of an acceptance test: bad and exchanged ones, and moves.

The visits of a pose lie together. One that does not is bad, by Rosner's test with the
visits' own covariance: the farthest are left out one after the other, and so many are
bad as the last of them that is too far tells. A moved instrument moves all visits after
it by a rigid motion, beyond any smooth drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices

CHANCE = 0.01
"""Probability with which a test without any fault is told to have one of a kind."""

MOST = 5
"""Of so many visits of a pose one is bad at most."""

RESOLUTION = 1e-6
"""Scatter of visits that no instrument resolves [m]."""

NEAR = 0.1
"""Part of its distance from its own pose within which a visit belongs to another."""

SPLITS = 60
"""Places at which a move is sought first."""

FEW = 6
"""Visits by whose number the scatter of all poses counts for each."""

DEGREES = (2, 4)
"""Degrees of the drift beside which a move is sought, and of that which it beats."""


@dataclass(frozen=True)
class VisitFaults:
    """Faults among the visits.

    Attributes:
        bad: Visits that do not belong to the others of their pose, with the pose that
            each belongs to instead; its own where there is none.
        away: How far each is from the mean of the others [m].
        moved: First visit after which the instrument was moved; None where it was not.
        step: Length of that move at the visits, root mean square [m].
    """

    bad: Mapping[int, int]
    away: Mapping[int, float]
    moved: int | None
    step: float


def visit_faults(attained: Floats, pose: Indices) -> VisitFaults:
    """The faults among visits in their order.

    Args:
        attained: Measured positions, shape (N, 3) [m].
        pose: Pose of each visit from 0, shape (N,).
    """
    count = int(pose.max()) + 1
    bad = np.zeros(len(pose), bool)
    for k in range(count):
        own = np.flatnonzero(pose == k)
        bad[own[_bad(attained[own], CHANCE / count)]] = True
    means = np.array([attained[(pose == k) & ~bad].mean(axis=0) for k in range(count)])
    belongs, far = {}, {}
    for row in np.flatnonzero(bad).tolist():
        away = np.linalg.norm(means - attained[row], axis=1)
        k, own = int(np.argmin(away)), int(pose[row])
        far[row] = float(away[own])
        belongs[row] = k if away[k] < NEAR * away[own] else own
    rows = np.flatnonzero(~bad)
    moved, step = _move(attained[rows] - means[pose[rows]], means[pose[rows]])
    place = None if moved is None else int(rows[moved])
    return VisitFaults(belongs, far, place, step)


def _bad(x: Floats, chance: float) -> list[int]:
    """Positions of visits of a pose, shape (n, 3), that are too far from the others."""
    left, found, last = list(range(len(x))), [], 0
    while len(found) < len(x) // MOST and (n := len(left)) > 4:
        d = x[left] - x[left].mean(axis=0)
        C = d.T @ d / (n - 1) + RESOLUTION**2 * np.eye(3)
        squares = np.einsum("ni,ij,nj->n", d, np.linalg.inv(C), d)
        k = int(np.argmax(squares))
        # The part that one of n visits has of their scatter.
        part = n * squares[k] / (n - 1) ** 2
        found.append(left.pop(k))
        if n * stats.beta.sf(min(part, 1.0), 1.5, 0.5 * (n - 4)) < chance:
            last = len(found)
    return found[:last]


def _move(d: Floats, x: Floats) -> tuple[int | None, float]:
    """The first visit after a move, by deviations from poses x, both (N, 3)."""
    _, pose = np.unique(x, axis=0, return_inverse=True)
    pose, n = pose.reshape(-1), len(d)
    K = int(pose.max()) + 1
    least = max(2 * K, n // 10)
    if n < 2 * least + 1:
        return None, 0.0
    centered = (x - x.mean(axis=0)) / max(float(np.ptp(x)), RESOLUTION)
    turns = np.cross(np.eye(3), centered[:, None]).transpose(0, 2, 1)
    rigid = np.concatenate([np.tile(np.eye(3), (n, 1, 1)), turns], axis=2)
    # In standard deviations of a visit, which no drift and no move makes larger.
    W = _whitening(d, pose)[pose]
    values, by = (W @ d[:, :, None]).reshape(-1), W @ rigid
    own = np.einsum("nk,ij->nikj", np.eye(K)[pose], np.eye(3)).reshape(3 * n, -1)

    def smooth(degree: int) -> Floats:
        """Orthonormal columns of the poses' own means and a drift of a degree."""
        time = np.linspace(-1.0, 1.0, n)
        powers = np.polynomial.legendre.legvander(time, degree)[:, 1:]
        drift = np.einsum("np,nij->nipj", powers, by).reshape(3 * n, -1)
        return _range(np.column_stack([own, drift]))

    def after(k: int) -> Floats:
        return np.where(np.arange(n)[:, None, None] >= k, by, 0.0).reshape(3 * n, 6)

    few, many = map(smooth, DEGREES)
    r, s = (values - Q @ (Q.T @ values) for Q in (few, many))

    def gain(k: int) -> float:
        Z = after(k)
        return float(np.sum((_range(Z - few @ (few.T @ Z)).T @ r) ** 2))

    places = np.linspace(least, n - least, SPLITS).astype(int)
    place, near = max(places.tolist(), key=gain), int(np.diff(places).max())
    ends = max(place - near, least), min(place + near, n - least) + 1
    place = max(range(*ends), key=gain)
    left, free = float(r @ r) - gain(place), 3 * n - few.shape[1] - 6
    if free <= 0 or float(s @ s) * free < left * (3 * n - many.shape[1]):
        return None, 0.0
    chance = stats.f.sf(gain(place) / 6.0 / (left / free), 6, free)
    if not chance * n < CHANCE:
        return None, 0.0
    columns = np.column_stack([few, after(place)])
    found = np.linalg.lstsq(columns, values, rcond=1e-9)[0][-6:]
    return place, float(np.sqrt(np.mean(np.sum((rigid @ found) ** 2, axis=1))))


def _whitening(d: Floats, pose: Indices) -> Floats:
    """Factors that give the visits of each pose a scatter of one, shape (K, 3, 3)."""
    steps = [np.diff(d[pose == k], axis=0) for k in range(int(pose.max()) + 1)]
    every = np.concatenate(steps)
    # A few visits have that of all poses.
    shared = FEW * (every.T @ every) / len(every)
    found = [0.5 * (s.T @ s + shared) / (len(s) + FEW) for s in steps]
    C = np.array(found) + RESOLUTION**2 * np.eye(3)
    return np.linalg.inv(np.linalg.cholesky(C))


def _range(A: Floats) -> Floats:
    """Orthonormal basis of columns, rounding left out."""
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s.max(initial=0.0)])
