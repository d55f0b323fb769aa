"""Residuals and derivatives of blocks of measurements, and stations eliminated of them.

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
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.terms import Block, ToolPoses, whitened, whitened_jacobian
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel, flexures

if TYPE_CHECKING:
    from calib_pin.estimation.many_rows import ManyRows

SINGULAR = 1e-10
"""Singular values below this part of the largest are rounding."""

PIECE = 4096
"""Measurements whose Jacobian is held at once, where there are very many."""

Evaluator: TypeAlias = "RowByRow | ManyRows"
"""The measurements of a block as a function of all parameters, shape (P,).

Derivatives are by the block's own parameters, shape (p,). Where it `reduces`,
`factorize` returns fewer rows than there are values.
"""

Rows = tuple[NDArray[np.intp], Floats, Floats]
"""Positions of parameters (p,), residual (M,) and Jacobian by these (M, p)."""


class RowByRow:
    """Measurements of a block by Pinocchio, a residual row for each value.

    Args:
        block: The block.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
        reduces: Whether only the triangular factor of the rows is wanted, which takes
            no more memory than a piece of them.
        last: The evaluator of the same measurements before, whose references or
            weights may have been others.
    """

    def __init__(
        self,
        block: Block,
        sigma: Floats,
        reduces: bool = False,
        last: Evaluator | None = None,
    ) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._block, self._sigma = block, block.table(sigma)
        self.reduces = reduces
        self._tool = ToolPoses(block.term.error, block.data)
        if isinstance(last, RowByRow) and last._block.term is block.term:
            self._tool = last._tool

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        term, data = self._block.term, self._block.data
        of_robot, instrument = term.values(theta)
        return term.measurement.residual(self._tool(of_robot), instrument, data)

    def points(self, theta: Floats) -> Floats:
        """Tool points in the measurement frame, shape (N, 3)."""
        error, data = self._block.term.error, self._block.data
        basis = error.basis(data.q, data.conditions)
        return error.poses(data.q, self._block.term.values(theta)[0], basis)[:, :3, 3]

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (M,), and Jacobian, shape (M, p), M = N d if whole.

        Its rows are those of all values, or a triangular factor of them.
        """
        if not self.reduces:
            return self._rows(theta)
        block = self._block
        R = np.zeros((0, len(block.term.index) + 1))
        for start in range(0, len(block.data), PIECE):
            rows = slice(start, start + PIECE)
            data, sigma = block.data.rows(rows), self._sigma[rows].reshape(-1)
            piece = block._replace(data=data, values=slice(0, len(sigma)))
            r, J = RowByRow(piece, sigma)._rows(theta)
            more = np.vstack([R, np.column_stack([J, r])])
            R = np.asarray(np.linalg.qr(more, mode="r"))
        return R[:, -1], R[:, :-1]

    def _rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, p)."""
        term, data = self._block.term, self._block.data
        of_robot, instrument = term.values(theta)
        tool = self._tool.linearize(of_robot)
        linear = term.measurement.linearize(tool.T, instrument, data)
        J = whitened_jacobian(tool, linear, self._sigma)
        r = whitened(linear.residual, self._sigma)
        return r.reshape(-1), J.reshape(-1, len(term.index))


def compilable(model: ErrorModel) -> bool:
    """Whether nothing but the joints' own motions changes row by row.

    Compiled kernels know corrections of these alone.
    """
    return model.learned is None and len(flexures(model)) == 0


def evaluator_of(
    block: Block, sigma: Floats, many: bool, last: Evaluator | None
) -> Evaluator:
    """The evaluator of a block of measurements.

    Compiled kernels take measurements that are many and that they can evaluate. Where
    places bend row by row, Pinocchio takes them piece by piece.

    Args:
        block: The measurements with their term.
        sigma: Standard deviations of the residual components of all blocks, (M,).
        many: Whether a Jacobian of all measurements would be too large to be handy.
        last: That of the same measurements with other weights or about other
            references; what it has prepared is used again.
    """
    error, data = block.term.error, block.data
    if many and compilable(error) and not data.start.size:
        from calib_pin.estimation.many_rows import ManyRows

        return ManyRows(block, sigma, last)
    bent = many and len(flexures(error)) > 0 and len(data) > PIECE
    return RowByRow(block, sigma, bent, last)


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
    result = with_response(stations, step)
    for station in stations:
        result[station.own] += station.settled
    return result


def with_response(stations: Sequence[Station], factor: Floats) -> Floats:
    """Changes of all parameters, where only the shared ones were given, (P, k)."""
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
