"""Studentized residuals: distance of each configuration from a fit.

A residual of a fitted row is smaller than its error, because the fit has followed the
error; the higher the leverage, the smaller the residual. With the hat matrix H of the
accepted rows, the whitened residuals `r_g` of an accepted configuration g have the
covariance `I - H_gg`, and those of one that was not fitted `I + H_gg` (Huber and
Ronchetti, Robust Statistics, 2009, 7.2). All targets and repetitions of a configuration
fail together, so it is judged as a whole, but for the corners in an image, each of
which is judged for itself:

    z_g^2 = r_g^T (I -+ H_gg)^-1 r_g

is chi-square distributed. For an accepted configuration it is the distance from a fit
without that configuration.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import inverse_root
from calib_pin.estimation.problem import Problem, current_units
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, states_sigmas

LEAST = 1e-6
"""Smallest scale in stated or assumed deviations: less is numerically zero."""

ALONE = 1e-6
"""Part of a residual's variance below which its leverage is one: the fit meets it."""

DENSE = 8
"""Numbers for each value up to which a table of all numbers is faster than sorting."""

COUNTED = 0.5
"""Fewest independent components of a configuration that is used to estimate noise."""


class Studentized:
    """Normalized residuals of N rows in G configurations and Q quantities.

    Args:
        problem: The problem of the rows.
        components: Squares of the normalized residuals, independent with unit
            variance if the standard deviations of the rows are right, shape (M,);
            infinite where nothing is predicted.
        counts: Degrees of freedom of each, 0 to 1, shape (M,).

    Attributes:
        labels: Configuration of each row, or the row of an image itself, shape (N,).
        whole: Configuration in which each of these was measured, shape (G,).
        layout: Row and quantity of each residual component.
        components: As above.
        configuration: Configuration of each of the C cells: what a configuration has
            of a quantity, shape (C,).
        quantity: Quantity of each cell, shape (C,).
        squares: Sum of the squares in each, shape (C,).
        counts: Number of independent components in each, shape (C,).
        least: Smallest credible scale, by quantity, shape (Q,).
    """

    def __init__(self, problem: Problem, components: Floats, counts: Floats) -> None:
        """Add up what configurations have of quantities."""
        self.layout, self.labels = problem.layout, failing(problem)
        self.whole = np.zeros(int(self.labels.max(initial=-1)) + 1, np.int64)
        self.whole[self.labels] = problem.data.groups()
        width, row = len(self.layout.components), self.layout.row
        cells, place = _numbered(self.labels[row] * width + self.layout.component)
        self.configuration, self.quantity = cells // width, cells % width
        self.components = components
        sums = (np.bincount(place, of, len(cells)) for of in (components, counts))
        self.squares, self.counts = (np.asarray(total, float) for total in sums)
        self.least = np.full(width, LEAST)
        if states_sigmas(problem.data):
            # Residuals smaller than the stated sigma do not contradict it.
            self.least = 1.0 / current_units(problem)

    def robust_scale(self, share: float = 0.5) -> Floats:
        """Scale by the median over configurations, by quantity, shape (Q,).

        Consistent for normal noise whatever the number of components, and correct
        within a factor while at least half of the configurations are good.

        Args:
            share: Quantile of the configurations that is used; 0.5 is the median.
        """
        result = self.least.copy()
        used = np.flatnonzero(self.counts >= COUNTED)
        used = used[np.argsort(self.quantity[used], kind="stable")]
        ratios = self.squares[used] / _quantiles(self.counts[used], 1.0 - share)
        ends = np.cumsum(np.bincount(self.quantity[used], minlength=len(result)))
        for k, own in enumerate(np.split(ratios, ends[:-1])):
            if len(own):
                result[k] = np.sqrt(np.sort(own)[int(share * (len(own) - 1))])
        return np.asarray(np.maximum(result, self.least))

    def scale(self, accepted: NDArray[np.bool_]) -> Floats:
        """Scale by the mean square of accepted configurations, shape (G,) -> (Q,)."""
        used, width = accepted[self.configuration], len(self.least)
        squares, counts = (
            np.bincount(self.quantity[used], values[used], width)
            for values in (self.squares, self.counts)
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = np.sqrt(squares / counts)
        return np.asarray(np.fmax(scale, self.least))

    def statistic(self, scale: Floats) -> Floats:
        """z^2 of each configuration at a scale by quantity, shape (G,)."""
        with np.errstate(over="ignore"):
            squares = self.squares / scale[self.quantity] ** 2
        return np.asarray(np.bincount(self.configuration, squares), float)

    def sizes(self, scale: Floats) -> Floats:
        """Normalized residual z of each row at a scale by quantity, shape (N,)."""
        scaled = self.components / scale[self.layout.component] ** 2
        return np.sqrt(np.bincount(self.layout.row, scaled, len(self.labels)))

    def limit(self, tail: float) -> Floats:
        """Quantile of z^2 of each configuration at a tail probability, shape (G,)."""
        counts = np.asarray(np.bincount(self.configuration, self.counts), float)
        return _quantiles(counts, tail)


def failing(problem: Problem) -> Indices:
    """Labels of rows that fail together, 0 to G - 1, shape (N,)."""
    labels, every = problem.data.groups(), np.arange(len(problem.data))
    alone = [b for b in problem.blocks if b.term.measurement.declaration.separable]
    if not alone:
        return labels
    labels = labels + len(every)
    for block in alone:
        labels[block.rows] = every[block.rows]
    return np.unique(labels, return_inverse=True)[1]


def studentized(
    problem: Problem, theta: Floats, basis: Floats, accepted: NDArray[np.bool_]
) -> Studentized:
    """Normalized residuals of all rows about a fit of some of them.

    With very many rows every leverage is negligible, so they are not linearized.

    Args:
        problem: The problem with all its rows at full weight.
        theta: Solution of the fit, shape (P,).
        basis: Directions that were fitted, shape (P, k).
        accepted: The rows that were fitted, shape (N,).
    """
    layout, finite = problem.layout, np.isfinite(problem.sigma)
    if problem.many:
        squares = squared_or_infinite(problem.residual(theta)[: len(finite)])
        return Studentized(problem, squares, finite.astype(float))
    fun, jac = problem.linearize_rows(theta)
    count = len(layout.row)
    r, A = fun[:count], jac @ basis
    own = A[:count]
    bad = ~(np.isfinite(r) & np.isfinite(jac[:count]).all(axis=1))
    own[bad] = 0.0
    fitted = own[accepted[layout.row]]
    B = own @ inverse_root(np.concatenate([fitted, A[count:]]))
    r, counts = np.where(bad, 0.0, r), finite.astype(float)
    for rows in by_size(failing(problem)[layout.row]):
        sign = np.where(accepted[layout.row[rows[:, 0]]], -1.0, 1.0)
        U, eigenvalues = spectrum(B[rows])
        left = 1.0 + sign[:, None] * eigenvalues
        alone = left < ALONE
        factor = np.where(alone, 0.0, 1.0 / np.sqrt(np.where(alone, 1.0, left)))
        along = np.einsum("gmk,gm->gk", U, r[rows])
        r[rows] += np.einsum("gmk,gk->gm", U, (factor - 1.0) * along)
        counts[rows] -= np.einsum("gmk,gk->gm", U**2, alone.astype(float))
    squares = squared_or_infinite(r)
    squares[bad & finite] = np.inf
    return Studentized(problem, squares, counts)


def by_size(labels: Indices) -> Iterator[Indices]:
    """Positions of the members of G groups of one size m after the other, (G, m).

    Groups of one size are factored together.

    Args:
        labels: Group of each member, shape (M,).
    """
    order, sizes = np.argsort(labels, kind="stable"), np.bincount(labels)
    of_member = sizes[labels[order]]
    for size in np.unique(of_member).tolist():
        yield order[of_member == size].reshape(-1, size)


def spectrum(B: Floats) -> tuple[Floats, Floats]:
    """Eigenvectors and eigenvalues of B B^T that span the range of B.

    Args:
        B: Factors, shape (G, m, k).

    Returns:
        Eigenvectors, shape (G, m, l), and eigenvalues, shape (G, l), l = min(m, k).
    """
    if B.shape[1] <= B.shape[2]:
        eigenvalues, U = np.linalg.eigh(B @ np.swapaxes(B, 1, 2))
        return U, eigenvalues
    U, s, _ = np.linalg.svd(B, full_matrices=False)
    return U, s**2


def squared_or_infinite(r: Floats) -> Floats:
    """Squares, infinite where a residual is not a number."""
    with np.errstate(over="ignore"):
        return np.where(np.isfinite(r), r**2, np.inf)


def _numbered(values: Indices) -> tuple[Indices, Indices]:
    """Distinct values, ascending, and which of them each one is, (M,) -> (C,), (M,)."""
    largest = int(values.max(initial=-1))
    if largest > DENSE * len(values):
        # Of very many stations a configuration has measurements of one.
        return np.unique(values, return_inverse=True)
    used = np.zeros(largest + 1, bool)
    used[values] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1)[values]


def _quantiles(counts: Floats, tail: float) -> Floats:
    """Chi-square quantiles by rounded degrees of freedom; infinite for zero."""
    rounded, place = np.unique(np.round(counts), return_inverse=True)
    each = [chi_square_quantile(n, tail) if n > 0 else np.inf for n in rounded.tolist()]
    return np.array(each, float)[place]
