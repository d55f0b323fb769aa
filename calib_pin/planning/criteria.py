"""Criteria for a set of configurations, as costs of its information matrix.

Every cost is the logarithm of what is to be small, so that steps of a search compare.
With singular values s_1 >= ... >= s_m of the scaled identification matrix of the robot:

    condition, O2   log(s_1 / s_m)              Driels, Pathre
    O1              -log(s_1 ... s_m) / m       Borm, Menq; the D-criterion
    O3              -log(s_m)                   Nahvi et al.
    O4              -log(s_m^2 / s_1)           Nahvi, Hollerbach
    O5              log(1/s_1 + ... + 1/s_m)    Sun, Hollerbach
    prediction      log(trace(J_0 M^-1 J_0')) / 2   Wu, Klimchik et al.

Trials of a search are exact and cheap. The determinant and the trace follow a rank-d
change in closed form. The others need eigenvalues of the changed matrix, but not of
every trial: in the eigenbasis of the matrix before the change, the diagonal of the
changed one bounds the cost from below (its eigenvalues majorize it, Schur 1923), and so
do, closer, the eigenvalues of a diagonal block. Only trials whose bounds beat the best
cost so far are computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.identifiability import observability
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.information import (
    Information,
    log_determinants,
    products_of,
    whiten,
)

PINCHED = 5
"""Smallest eigenvalues whose coupling enters the closer bounds."""

SHARPER = (4.0, 16.0, 64.0)
"""Exponents of power means in place of the largest and the smallest eigenvalue.

Where several eigenvalues are extreme the criterion itself has a corner, and a descent
along its gradient would stop there.
"""


@dataclass(frozen=True)
class Lazy:
    """Costs of T trials, of which bounds are known before the costs themselves.

    Attributes:
        bounds: Lower bounds of the costs, shape (T,); infinite where there is none.
        closer: Closer and closer bounds of some trials by their positions, the last
            ones the costs themselves; none where the bounds are costs already.
    """

    bounds: Floats
    closer: tuple[Callable[[NDArray[np.intp]], Floats], ...] = ()

    def best(self, barred: NDArray[np.bool_]) -> tuple[int, float]:
        """Position and cost of the best trial.

        Args:
            barred: True for trials that do not count, shape (T,).
        """
        bounds = np.where(barred | np.isnan(self.bounds), np.inf, self.bounds)
        if not self.closer:
            position = int(bounds.argmin())
            return position, float(bounds[position])
        order = np.argsort(bounds, kind="stable")
        best, least, begin, size = int(order[0]), np.inf, 0, 8
        order = order[np.isfinite(bounds[order])]
        while begin < len(order) and bounds[order[begin]] < least:
            some, costs = order[begin : begin + size], np.empty(0)
            for bound in self.closer:
                costs = bound(some)
                some, costs = some[costs < least], costs[costs < least]
                if not len(some):
                    break
            else:
                k = int(costs.argmin())
                best, least = int(some[k]), float(costs[k])
            begin, size = begin + size, 2 * size
        return best, least


@dataclass(frozen=True)
class Spectral:
    """A criterion of the singular values.

    Attributes:
        name: Name as users write it.
        of: Cost of eigenvalues s^2, shape (..., r) -> (...,); a monotone function of
            majorization (the more equal, the less).
        smooth: Smooth cost and its derivative by the eigenvalues, (r,) -> (r,), for a
            sharpness.
        sharpnesses: Those of successive descents; one where the cost is smooth.
    """

    name: str
    of: Callable[[Floats], Floats]
    smooth: Callable[[Floats, float], tuple[float, Floats]]
    sharpnesses: tuple[float, ...] = (np.inf,)

    def cost(self, found: Information) -> float:
        """The cost of the singular values."""
        return float(self.of(found.singular_values**2))

    def value(self, found: Information, count: int) -> float:
        """The index, or the condition number, of a count of configurations."""
        s = found.singular_values
        if self.name == "condition":
            return float(s[0] / s[-1])
        return observability(s, count)[self.name]

    def trials(self, found: Information, rows: Floats, sign: float) -> Lazy:
        """Costs after rows of single configurations join or leave.

        Bounds by the diagonal, closer ones with a block, then the eigenvalues.

        Args:
            found: The information before.
            rows: Rows of T configurations, component by component, shape (d, T, m).
            sign: 1 where they join, -1 where they leave.
        """
        trials = found.trials(rows, sign)
        left, s, _ = found.svd
        eigenvalues = s**2
        # In the eigenbasis of S, where it is diagonal.
        Z = trials.robot() @ (left * s)
        diagonal = eigenvalues + sign * np.einsum("dti,dti->ti", Z, Z)

        def changed(some: NDArray[np.intp], columns: slice) -> Floats:
            """Eigenvalues of a block of the changed matrices."""
            rows = np.swapaxes(Z[:, some, columns], 0, 1)
            blocks = sign * (np.swapaxes(rows, 1, 2) @ rows)
            blocks += np.diag(eigenvalues[columns])
            return np.asarray(np.linalg.eigvalsh(blocks), float)

        def pinched(some: NDArray[np.intp]) -> Floats:
            # Also the matrix without what couples a block to the rest is majorized.
            rest = diagonal[some, :-PINCHED]
            least = changed(some, slice(-PINCHED, None))
            return self._guarded(np.concatenate([rest, least], axis=1))

        def exact(some: NDArray[np.intp]) -> Floats:
            return self._guarded(changed(some, slice(None)))

        return Lazy(self._guarded(diagonal), (pinched, exact))

    def slope(self, found: Information, sharpness: float) -> tuple[float, Floats]:
        """A smooth cost and its derivative by the information matrix, (m, m).

        By the chain rule through eigenvalues, S and M. Power means with the sharpness
        as exponent replace the extreme eigenvalues; the larger, the closer.
        """
        _, s, V = found.svd
        cost, by_eigenvalue = self.smooth(s**2, sharpness)
        return cost, found.pull((V * by_eigenvalue) @ V.T)

    def _guarded(self, eigenvalues: Floats) -> Floats:
        """Costs; infinite where an eigenvalue is not positive."""
        valid = np.asarray((eigenvalues > 0.0).all(axis=-1))
        safe = np.where(valid[..., None], eigenvalues, 1.0)
        return np.where(valid, self.of(safe), np.inf)


@dataclass(frozen=True)
class Determinant(Spectral):
    """O1, which needs no singular values."""

    def cost(self, found: Information) -> float:
        """From the diagonal of the factor; no singular values are needed."""
        f = found.nuisances
        return -float(np.log(np.diag(found.factor)[f:]).mean())

    def trials(self, found: Information, rows: Floats, sign: float) -> Lazy:
        """By the determinant lemma, for M and for the nuisances alone."""
        f = found.nuisances
        Y = found.trials(rows, sign).whitened
        gained = log_determinants(products_of(Y), sign)
        if f:
            gained -= log_determinants(products_of(Y[:, :, :f]), sign)
        return Lazy(self.cost(found) - 0.5 * gained / (len(found.factor) - f))


@dataclass(frozen=True)
class Prediction:
    """The root-mean-square error of the tip that noise leaves, at given test poses.

    Attributes:
        tests: `J_0' J_0`, the mean over the test poses, in the columns of the
            information matrix, shape (m, m) [m^2].
        name: Name as users write it.
    """

    tests: Floats
    name: str = "prediction"
    sharpnesses: tuple[float, ...] = (np.inf,)

    def cost(self, found: Information) -> float:
        """Logarithm of the error."""
        return 0.5 * float(np.log(np.trace(self._whitened(found))))

    def value(self, found: Information, count: int) -> float:
        """The error [m]."""
        return float(np.sqrt(np.trace(self._whitened(found))))

    def trials(self, found: Information, rows: Floats, sign: float) -> Lazy:
        """By the Woodbury identity."""
        trials = found.trials(rows, sign)
        A = self._whitened(found)
        Y = whiten(trials.of_all, trials.whitened)
        gain = np.einsum("dti,dti->t", Y @ A, Y)
        left = np.trace(A) - sign * gain
        with np.errstate(invalid="ignore"):
            return Lazy(0.5 * np.log(np.where(left > 0.0, left, np.nan)))

    def slope(self, found: Information, sharpness: float) -> tuple[float, Floats]:
        """`d trace(A M^-1) = -trace(M^-1 A M^-1 dM)`."""
        A = self._whitened(found)
        left = float(np.trace(A))
        by_M = -0.5 / left * (found.inverse @ A @ found.inverse.T)
        return 0.5 * float(np.log(left)), by_M

    def _whitened(self, found: Information) -> Floats:
        """`R^-T J_0' J_0 R^-1`, whose trace is that of `J_0 M^-1 J_0'`."""
        return np.asarray(found.inverse.T @ self.tests @ found.inverse)


def _power_mean(eigenvalues: Floats, exponent: float) -> tuple[float, Floats]:
    """Logarithm of `(sum_i x_i^p)^(1/p)`, and its derivative by x.

    For p -> inf the largest, for p -> -inf the smallest eigenvalue.
    """
    logs = np.log(eigenvalues)
    top = float((exponent * logs).max())
    weights = np.exp(exponent * logs - top)
    total = float(weights.sum())
    return (top + np.log(total)) / exponent, weights / total / eigenvalues


def _extremes(
    largest: float, smallest: float, eigenvalues: Floats, sharpness: float
) -> tuple[float, Floats]:
    """`a log(x_max) - b log(x_min)` by power means, with its derivative."""
    high, by_high = _power_mean(eigenvalues, sharpness)
    low, by_low = _power_mean(eigenvalues, -sharpness)
    cost = largest * high - smallest * low
    return cost, largest * by_high - smallest * by_low


def _log_condition(eigenvalues: Floats) -> Floats:
    largest, smallest = eigenvalues.max(axis=-1), eigenvalues.min(axis=-1)
    return np.asarray(0.5 * np.log(largest / smallest))


def _log_mean(eigenvalues: Floats) -> Floats:
    return np.asarray(-0.5 * np.log(eigenvalues).mean(axis=-1))


def _log_least(eigenvalues: Floats) -> Floats:
    return np.asarray(-0.5 * np.log(eigenvalues.min(axis=-1)))


def _log_spread(eigenvalues: Floats) -> Floats:
    largest, smallest = eigenvalues.max(axis=-1), eigenvalues.min(axis=-1)
    return np.asarray(0.5 * np.log(largest) - np.log(smallest))


def _log_sum(eigenvalues: Floats) -> Floats:
    return np.asarray(np.log((eigenvalues**-0.5).sum(axis=-1)))


def _volume(eigenvalues: Floats, sharpness: float) -> tuple[float, Floats]:
    cost = -0.5 * float(np.log(eigenvalues).mean())
    return cost, -0.5 / (eigenvalues.size * eigenvalues)


def _log_roots(eigenvalues: Floats, sharpness: float) -> tuple[float, Floats]:
    roots = eigenvalues**-0.5
    total = float(roots.sum())
    return float(np.log(total)), -0.5 * roots / eigenvalues / total


Criterion = Spectral | Prediction
"""A cost of information matrices."""

CRITERIA: dict[str, Spectral] = {
    "condition": Spectral(
        "condition", _log_condition, partial(_extremes, 0.5, 0.5), SHARPER
    ),
    "O1": Determinant("O1", _log_mean, _volume),
    "O2": Spectral("O2", _log_condition, partial(_extremes, 0.5, 0.5), SHARPER),
    "O3": Spectral("O3", _log_least, partial(_extremes, 0.0, 0.5), SHARPER),
    "O4": Spectral("O4", _log_spread, partial(_extremes, 0.5, 1.0), SHARPER),
    "O5": Spectral("O5", _log_sum, _log_roots),
}
"""The criteria of the singular values, by name."""
