"""Parameters of single stations, eliminated from the least squares station by station.

The normal equations of many stations are block-arrow: each frame, tool or instrument
that only one station has meets the robot, and no other station. With the columns A of
these and B of all others, the best change of the former follows from that of the
latter, `a = -A^+ (r + B b)`, and what is left for b is `r + B b` with the range of A
projected out (the Schur complement, by orthogonal projection). So the cost grows with
the measurements and not with the square of the stations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

SINGULAR = 1e-10
"""Singular values below this part of the largest are rounding."""

Rows = tuple[NDArray[np.intp], Floats, Floats]
"""Positions of parameters (p,), residual (M,) and Jacobian by these (M, p)."""


@dataclass(frozen=True)
class Station:
    """The parameters of one station alone, about a linearization.

    Attributes:
        own: Their positions, shape (k,).
        shared: Positions of the other parameters of its measurements, shape (m,).
        root: Factor of their covariance by its own measurements, `A^+ = root U^T`, with
            U orthonormal, shape (k, rank).
        response: Their change with the others', `-A^+ B`, shape (k, m).
        settled: Their best change by themselves, `-A^+ r`, shape (k,).
    """

    own: NDArray[np.intp]
    shared: NDArray[np.intp]
    root: Floats
    response: Floats
    settled: Floats


def eliminate(own: NDArray[np.intp], rows: Sequence[Rows]) -> tuple[Station, Rows]:
    """Eliminate the parameters of a station from the rows of its measurements.

    Args:
        own: Positions of its parameters, shape (k,).
        rows: Its linearized measurements.

    Returns:
        The station, and the rows that are left for the other parameters.
    """
    every, r, J = _stacked(rows)
    is_own = np.isin(every, own)
    A, B = J[:, is_own], J[:, ~is_own]
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    kept = s > SINGULAR * s.max(initial=0.0)
    U, root = U[:, kept], Vt[kept].T / s[kept]
    along, rest = U.T @ B, U.T @ r
    shared = every[~is_own]
    station = Station(every[is_own], shared, root, -root @ along, -root @ rest)
    return station, (shared, r - U @ rest, B - U @ along)


def completed(stations: Sequence[Station], step: Floats) -> Floats:
    """A step of the shared parameters with that of the eliminated ones, shape (P,)."""
    result = step.copy()
    for station in stations:
        result[station.own] = station.settled + station.response @ step[station.shared]
    return result


def with_response(stations: Sequence[Station], factor: Floats) -> Floats:
    """Changes of all parameters, where only the shared ones were given, (P, k)."""
    if not stations:
        return factor
    result = factor.copy()
    for station in stations:
        result[station.own] = station.response @ factor[station.shared]
    return result


def own_deviations(stations: Sequence[Station], count: int) -> Floats:
    """Deviations of parameters by the measurements of their own station, shape (P, k).

    A column has one noise for each station: stations are independent of each other.

    Args:
        stations: The stations.
        count: Number of parameters P.
    """
    width = max((station.root.shape[1] for station in stations), default=0)
    result = np.zeros((count, width))
    for station in stations:
        result[station.own, : station.root.shape[1]] = station.root
    return result


def reduced(rows: Sequence[Rows], count: int) -> tuple[Floats, Floats]:
    """A residual and a Jacobian by all parameters with the same normal equations.

    Args:
        rows: Linearized measurements.
        count: Number of parameters P.
    """
    every, r, columns = _stacked(rows)
    if not (np.isfinite(r).all() and np.isfinite(columns).all()):
        return np.full(1, np.nan), np.zeros((1, count))
    R = np.asarray(np.linalg.qr(np.column_stack([columns, r]), mode="r"))
    J = np.zeros((len(R), count))
    J[:, every] = R[:, :-1]
    return R[:, -1], J


def _stacked(rows: Sequence[Rows]) -> Rows:
    """Rows behind one another, by all parameters of any of them."""
    if len(rows) == 1 and (np.diff(rows[0][0]) > 0).all():
        return rows[0]
    every = np.unique(np.concatenate([index for index, _, _ in rows]))
    J = np.zeros((sum(len(r) for _, r, _ in rows), len(every)))
    start = 0
    for index, r, columns in rows:
        # Several parameters of a term may be one.
        at = np.searchsorted(every, index)
        np.add.at(J[start : start + len(r)].T, at, columns.T)
        start += len(r)
    return every, np.concatenate([r for _, r, _ in rows]), J
