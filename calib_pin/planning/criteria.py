"""Criteria for a set of configurations, as costs of its information matrix.

With the nuisances first, the Cholesky factor of an information matrix M = sum J' J

    M = R' R,   R = [R_nn  R_nr]
                    [  0   R_rr]

holds the Schur complement S = R_rr' R_rr: the information about the robot alone, the
nuisances projected out.

Every cost is the logarithm of what is to be small, so that steps of a search compare.
With singular values s_1 >= ... >= s_m of the scaled identification matrix of the robot:

    condition, O2   log(s_1 / s_m)              Driels, Pathre
    O1              -log(s_1 ... s_m) / m       Borm, Menq; the D-criterion
    O3              -log(s_m)                   Nahvi et al.
    O4              -log(s_m^2 / s_1)           Nahvi, Hollerbach
    O5              log(1/s_1 + ... + 1/s_m)    Sun, Hollerbach
    prediction      log(trace(J_0 M^-1 J_0')) / 2   Wu, Klimchik et al.

Those of singular values are power means of the eigenvalues x = s^2,

    a log(mean_p(x)) - b log(mean_-p(x)),   mean_p(x) = (sum_i x_i^p)^(1/p),

of which the exponents infinity and zero give the extremes and the geometric mean.

A search tries all candidates at every step. A configuration with rows U that joins a
set (s = 1) or leaves it (s = -1) changes the covariance C = M^-1 by

    dC = -s C U' (I + s U C U')^-1 U C,

so that to first order in it a cost with the derivative B by M changes by

    s trace((I + s U C U')^-1 U B U').

This orders trials of `prediction` as they are, and others nearly so; of the best few
the costs themselves decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from calib_pin.estimation.identifiability import observability
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices

ROUNDING = 1e-7
"""Least singular value, of columns of unit length, with which they determine all: by
rounding it is up to 2e-8 where they do not."""


@dataclass(frozen=True)
class Information:
    """A factored information matrix.

    Attributes:
        factor: R, upper triangular, shape (m, m).
        inverse: R^-1, shape (m, m).
        nuisances: Number f of leading columns that are projected out.
    """

    factor: Floats
    inverse: Floats
    nuisances: int

    @staticmethod
    def of(M: Floats, nuisances: int) -> Information | None:
        """Factor an information matrix; None if it is singular.

        Args:
            M: Symmetric matrix, shape (m, m).
            nuisances: Number of its leading rows that are projected out.
        """
        diagonal = np.sqrt(np.maximum(np.diag(M), 0.0))
        if not diagonal.all():
            return None
        try:
            # With a unit diagonal the factor shows rounding as it is: relative.
            R = np.linalg.cholesky(M / np.outer(diagonal, diagonal)).T
        except np.linalg.LinAlgError:
            return None
        inverse = np.linalg.inv(R)
        if np.linalg.norm(inverse) * ROUNDING > 1.0:
            return None
        return Information(R * diagonal, inverse / diagonal[:, None], nuisances)

    @cached_property
    def singular_values(self) -> Floats:
        """Of the scaled identification matrix of the robot, descending, shape (r,).

        Those of R_rr, r = m - f; their squares are the eigenvalues of S.
        """
        f = self.nuisances
        return np.asarray(np.linalg.svd(self.factor[f:, f:], compute_uv=False))

    @cached_property
    def right_vectors(self) -> Floats:
        """Right vectors of R_rr, the eigenvectors of S, in columns, shape (r, r)."""
        f = self.nuisances
        return np.asarray(np.linalg.svd(self.factor[f:, f:])[2].T)


SHARPER = (4.0, 16.0, 64.0)
"""Exponents of power means in place of the largest and the smallest eigenvalue.

Where several eigenvalues are extreme the criterion itself has a corner, and a descent
along its gradient would stop there.
"""


@dataclass(frozen=True)
class Spectral:
    """A criterion of the singular values.

    Attributes:
        name: Name as users write it.
        largest: Weight a of the mean with the exponent.
        smallest: Weight b of the mean with its opposite.
        exponent: The exponent p.
    """

    name: str
    largest: float
    smallest: float
    exponent: float = np.inf

    @property
    def tried(self) -> int:
        """Trials whose costs are computed, the best ones to first order.

        With more, exchange ends no lower; corners need more than smooth costs.
        """
        return 12 if np.isinf(self.exponent) else 4

    @property
    def sharpnesses(self) -> tuple[float, ...]:
        """Exponents of successive descents; one where the cost is smooth."""
        return SHARPER if np.isinf(self.exponent) else (self.exponent,)

    def cost(self, information: Information) -> float:
        """The cost of the singular values."""
        return self._mean_cost(information.singular_values**2, self.exponent)[0]

    def value(self, information: Information, count: int) -> float:
        """The index, or the condition number, of a count of configurations."""
        s = information.singular_values
        if self.name == "condition":
            return float(s[0] / s[-1])
        return observability(s, count)[self.name]

    def slope(self, information: Information, sharpness: float) -> tuple[float, Floats]:
        """A smooth cost and its derivative by the information matrix, (m, m).

        By the chain rule through eigenvalues, S and M.
        """
        V, f = information.right_vectors, information.nuisances
        cost, by_eigenvalue = self._mean_cost(information.singular_values**2, sharpness)
        absorbed = information.inverse[:f, :f] @ information.factor[:f, f:]
        EV = np.concatenate([-absorbed @ V, V])
        return cost, (EV * by_eigenvalue) @ EV.T

    def _mean_cost(self, x: Floats, exponent: float) -> tuple[float, Floats]:
        """The cost of eigenvalues, shape (r,), and its derivative by these."""
        high, by_high = _power_mean(x, exponent)
        low, by_low = _power_mean(x, -exponent)
        cost = self.largest * high - self.smallest * low
        return cost, self.largest * by_high - self.smallest * by_low


@dataclass(frozen=True)
class Prediction:
    """The root-mean-square error of the tip that noise leaves, at given test poses.

    Attributes:
        tests: `J_0' J_0`, the mean over the test poses, in the columns of the
            information matrix, shape (m, m) [m^2].
        name: Name as users write it.
        tried: Trials whose costs are computed: first order has them in order.
    """

    tests: Floats
    name: str = "prediction"
    tried: int = 1
    sharpnesses: tuple[float, ...] = (np.inf,)

    def cost(self, information: Information) -> float:
        """Logarithm of the error."""
        return float(np.log(self.value(information, 0)))

    def value(self, information: Information, count: int) -> float:
        """The error [m]."""
        R_inverse = information.inverse
        return float(np.sqrt(np.sum((self.tests @ R_inverse) * R_inverse)))

    def slope(self, information: Information, sharpness: float) -> tuple[float, Floats]:
        """`d trace(A M^-1) = -trace(M^-1 A M^-1 dM)`."""
        C = information.inverse @ information.inverse.T
        trace = float(np.sum(self.tests * C))
        return 0.5 * float(np.log(trace)), -0.5 / trace * (C @ self.tests @ C)


def _power_mean(x: Floats, exponent: float) -> tuple[float, Floats]:
    """Logarithm of the mean of positive numbers, and its derivative by these."""
    logs = np.log(x)
    if exponent == 0.0:
        return float(logs.mean()), 1.0 / (x.size * x)
    signed = np.copysign(1.0, exponent) * logs
    if np.isinf(exponent):
        extreme = int(signed.argmax())
        return float(logs[extreme]), (np.arange(x.size) == extreme) / x
    size = abs(exponent)
    weights = np.exp(size * (signed - signed.max()))
    total = float(weights.sum())
    return (size * signed.max() + np.log(total)) / exponent, weights / total / x


Criterion: TypeAlias = "Spectral | Prediction"
"""A cost of information matrices."""

CRITERIA: dict[str, Spectral] = {
    "condition": Spectral("condition", 0.5, 0.5),
    "O1": Spectral("O1", 0.0, 0.5, 0.0),
    "O2": Spectral("O2", 0.5, 0.5),
    "O3": Spectral("O3", 0.0, 0.5),
    "O4": Spectral("O4", 0.5, 1.0),
    "O5": Spectral("O5", 0.0, 0.5, 0.5),
}
"""The criteria of the singular values, by name."""


ALONE = 1e-9
"""Eigenvalue of `I - U C U'` below which rows hold all that is known of something:
without them nothing remains of it but rounding, which conditioning enlarges."""


@dataclass(eq=False)
class Selection:
    """A subset of C candidates with its information, its cost and what would change it.

    Satisfies `solvers.Subset`.

    Attributes:
        rows: Rows of the candidates, shape (C, d, m).
        nuisances: Number of leading columns that are projected out.
        criterion: Criterion to minimize.
        known: Information that is there already, shape (m, m).
        members: Candidates to begin with.
        measured: Number of rows that the known information comes from.
        chosen: The members, in the order in which they were added.
    """

    rows: Floats
    nuisances: int
    criterion: Criterion
    known: Floats
    members: InitVar[Sequence[int] | Indices] = ()
    measured: int = 0

    def __post_init__(self, members: Sequence[int] | Indices) -> None:
        """Sum what the members tell."""
        self.reset(list(members))

    @property
    def left(self) -> int:
        """Number of candidates that are not members."""
        return len(self.rows) - len(self.chosen)

    @property
    def value(self) -> float:
        """The value of the criterion."""
        if self._information is None:
            return np.inf
        return self.criterion.value(self._information, self.measured + len(self.chosen))

    def best_to_add(self) -> tuple[int, float]:
        """The candidate to add and the cost after that."""
        others = np.ones(len(self.rows), bool)
        others[self.chosen] = False
        return self._best(np.flatnonzero(others), 1.0)

    def best_to_remove(self) -> tuple[int, float]:
        """The member to remove and the cost after that."""
        return self._best(np.array(self.chosen), -1.0)

    def add(self, candidate: int) -> None:
        """Add a candidate."""
        self.reset([*self.chosen, candidate])

    def remove(self, candidate: int) -> None:
        """Remove a member."""
        self.reset([k for k in self.chosen if k != candidate])

    def reset(self, chosen: list[int]) -> None:
        """Become another subset."""
        self.chosen = list(chosen)
        # Summed anew each time: differences of information matrices lose digits.
        U = self.rows[self.chosen].reshape(-1, self.rows.shape[2])
        self._M = self.known + U.T @ U
        self._information, self.cost = self._evaluate(self._M)

    def _evaluate(self, M: Floats) -> tuple[Information | None, float]:
        """An information matrix factored, and its cost; infinite where singular."""
        information = Information.of(M, self.nuisances)
        if information is None:
            return None, np.inf
        return information, self.criterion.cost(information)

    def _best(self, candidates: Indices, sign: float) -> tuple[int, float]:
        if self._information is None:
            return int(candidates[0]), np.inf
        # The first sharpness counts several small eigenvalues, not the least alone.
        sharpness = self.criterion.sharpnesses[0]
        _, B = self.criterion.slope(self._information, sharpness)
        U = self.rows[candidates]
        count, d, m = U.shape
        # As one table: products of many small ones take several times as long.
        both = self._information.inverse, B
        Y, by_U = ((U.reshape(-1, m) @ A).reshape(U.shape) for A in both)
        I_G = np.eye(d) + sign * Y @ np.swapaxes(Y, 1, 2)
        alone = np.zeros(count, bool)
        if sign < 0.0:
            alone = np.linalg.eigvalsh(I_G)[:, 0] <= ALONE
            I_G[alone] = np.eye(d)
        pairs = by_U @ np.swapaxes(U, 1, 2)
        order = sign * np.trace(np.linalg.solve(I_G, pairs), axis1=1, axis2=2)
        order[alone] = np.inf
        tried = min(self.criterion.tried, len(candidates))
        first = np.argpartition(order, tried - 1)[:tried]
        costs = [
            self._evaluate(self._M + sign * self.rows[k].T @ self.rows[k])[1]
            for k in candidates[first]
        ]
        best = int(np.argmin(costs))
        return int(candidates[first][best]), costs[best]
