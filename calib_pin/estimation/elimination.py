"""Parameters of single stations, eliminated from the least squares station by station.

The normal equations of many stations are block-arrow: each frame, tool or instrument
that only one station has meets the robot, and no other station. With the columns A of
these and B of all others, the best change of the former follows from that of the
latter, `a = -A^+ (r + B b)`, and what is left for b is `r + B b` with the range of A
projected out (the Schur complement, by orthogonal projection). So the cost grows with
the measurements and not with the square of the stations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

WORTHWHILE = 60
"""Parameters of single stations from which they are eliminated: as many as a robot has.

With fewer, all together cost less, and every rank is that of all."""

SINGULAR = 1e-10
"""Singular values below this part of the largest are rounding."""

Rows = tuple[NDArray[np.intp], Floats, Floats]
"""Positions of parameters (p,), residual (M,) and Jacobian by these (M, p)."""

Products = tuple[NDArray[np.intp], Floats]
"""Positions of parameters, behind them one for the residual, (p + 1,), and products of
all pairs of these columns, (p + 1, p + 1)."""


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


def station_parameters(
    indices: Mapping[str, Sequence[NDArray[np.intp]]], loose: NDArray[np.bool_]
) -> dict[str, NDArray[np.intp]]:
    """The parameters that only one station has, by station; empty where they are few.

    Args:
        indices: By station the parameters of each of its blocks.
        loose: The parameters that nothing but measurements knows, shape (P,).
    """
    count = np.zeros(len(loose), np.int64)
    of_station = {
        name: np.unique(np.concatenate(list(parts))) for name, parts in indices.items()
    }
    for positions in of_station.values():
        count[positions] += 1
    alone = loose & (count == 1)
    if len(of_station) == 1 or alone.sum() < WORTHWHILE:
        return {}
    return {name: found[alone[found]] for name, found in of_station.items()}


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


def eliminate_products(
    stations: Sequence[tuple[NDArray[np.intp], Products]],
) -> tuple[list[Station], list[Products]]:
    """The same of all stations from products of columns: good for a step.

    Half the digits are lost. Stations that are alike are computed at once.

    Args:
        stations: Positions of the parameters of each, shape (k,), with the products of
            its measurements.

    Returns:
        The stations, and what is left for the other parameters.
    """
    alike: dict[tuple[int, ...], list[Products]] = {}
    for own, (index, K) in stations:
        mine = np.searchsorted(index, own)
        order = np.append(mine, np.delete(np.arange(len(index)), mine))
        alike.setdefault((len(index), len(mine)), []).append(
            (index[order], K[order[:, None], order])
        )
    found, left = [], []
    for (_, count), products in alike.items():
        K = np.array([K for _, K in products])
        if not np.isfinite(K).all():
            left += products
            continue
        roots, vectors, size = _spectrum(K[:, :count, :count])
        inverse = np.where(roots > 0.0, 1.0 / np.where(roots > 0.0, roots, 1.0), 0.0)
        root = vectors * inverse[:, None, :] / size[:, :, None]
        along = np.swapaxes(root, 1, 2) @ K[:, :count, count:]
        response = -root @ along
        rest = K[:, count:, count:] - np.swapaxes(along, 1, 2) @ along
        # Columns that the station's own can do all of are left with rounding.
        before, after = (np.einsum("sii->si", A) for A in (K[:, count:, count:], rest))
        lost = after <= K.shape[1] * np.finfo(float).eps * before
        rest[lost[:, :, None] | lost[:, None, :]] = 0.0
        for k, (index, _) in enumerate(products):
            own, others = index[:count], index[count:]
            found.append(
                Station(
                    own, others[:-1], root[k], response[k, :, :-1], response[k, :, -1]
                )
            )
            left.append((others, rest[k]))
    return found, left


def added(parts: Sequence[Products]) -> Products:
    """The sum of products of columns, by all parameters of any of them."""
    sums: dict[bytes, list[Products]] = {}
    for index, K in parts:
        sums.setdefault(index.tobytes(), []).append((index, K))
    alike = [
        (found[0][0], np.sum([K for _, K in found], axis=0)) for found in sums.values()
    ]
    index, K = alike[0]
    if len(alike) == 1 and (np.diff(index) > 0).all():
        return index, K
    every = np.unique(np.concatenate([index for index, _ in alike]))
    total = np.zeros((len(every), len(every)))
    for index, K in alike:
        at = np.searchsorted(every, index)
        # Several parameters of a part may be one.
        np.add.at(total, (at[:, None], at), K)
    return every, total


def square_root(products: Products, count: int) -> tuple[Floats, Floats]:
    """A system (r, J) with such products, up to what rounding has destroyed.

    Singular values below 1e-8 of the largest, columns brought to one length, are
    rounding; they come out as zero.

    Args:
        products: Products of columns.
        count: Number of all parameters P.

    Returns:
        Residual, shape (p + 1,), and Jacobian, shape (p + 1, P).
    """
    index, K = products
    r, J = np.zeros(len(K)), np.zeros((len(K), count))
    if not np.isfinite(K).all():
        return r + np.nan, J
    root, vectors, size = _spectrum(K[:-1, :-1])
    root, vectors = root[kept := root > 0.0], vectors[:, kept]
    J[: len(root), index[:-1]] = root[:, None] * vectors.T * size
    r[: len(root)] = vectors.T @ (K[:-1, -1] / size) / root
    # What no parameter changes stands in a row of its own.
    r[-1] = np.sqrt(max(K[-1, -1] - float(r @ r), 0.0))
    return r, J


def _spectrum(K: Floats) -> tuple[Floats, Floats, Floats]:
    """Roots of eigenvalues, (..., k), and eigenvectors of products, shape (..., k, k).

    Columns are brought to one length first; what they are divided by is the third.
    Roots are zero where there is only rounding.
    """
    size = np.sqrt(np.einsum("...ii->...i", K))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(K / size[..., :, None] / size[..., None, :])
    least = K.shape[-1] * np.finfo(float).eps * values.max(axis=-1, initial=0.0)
    kept = values > least[..., None]
    return np.sqrt(np.where(kept, values, 0.0)), vectors, size


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
    every = np.unique(np.concatenate([index for index, _, _ in rows]))
    J = np.zeros((sum(len(r) for _, r, _ in rows), len(every)))
    start = 0
    for index, r, columns in rows:
        # Several parameters of a part may be one.
        at = np.searchsorted(every, index)
        np.add.at(J[start : start + len(r)].T, at, columns.T)
        start += len(r)
    return every, np.concatenate([r for _, r, _ in rows]), J
