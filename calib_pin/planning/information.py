"""Information matrices, and what becomes of them when a configuration joins or leaves.

With the nuisances first, the Cholesky factor of an information matrix M = sum J' J

    M = R' R,   R = [R_nn  R_nr]
                    [  0   R_rr]

holds the Schur complement S = R_rr' R_rr: the information about the robot alone, the
nuisances projected out. Rows U whitened by it, Y = U R^-1, hold in their first columns
those whitened by the nuisances alone, and give by the matrix determinant lemma

    det(M + s U'U) / det(M) = det(I + s Y Y'),   s = +1 or -1,

so that a trial costs a product of d rows with R^-1, not a factorization.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib_pin.kinematics.spatial import Floats


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
        # Scipy takes as long to load as Pinocchio; a calibration does without it.
        from scipy.linalg.lapack import dtrtri

        diagonal = np.sqrt(np.maximum(np.diag(M), 0.0))
        if not diagonal.all():
            return None
        try:
            # With a unit diagonal the factor shows rounding as it is: relative.
            R = np.linalg.cholesky(M / np.outer(diagonal, diagonal)).T
        except np.linalg.LinAlgError:
            return None
        inverse = dtrtri(R)[0]
        if np.linalg.norm(inverse) * ROUNDING > 1.0:
            return None
        return Information(R * diagonal, inverse / diagonal[:, None], nuisances)

    @cached_property
    def svd(self) -> tuple[Floats, Floats, Floats]:
        """Of R_rr: left vectors in columns, values, right vectors in columns.

        The values s_1 >= ... >= s_r, r = m - f, are those of the scaled identification
        matrix of the robot; their squares are the eigenvalues of S, whose eigenvectors
        are the right vectors.
        """
        f = self.nuisances
        left, s, right = np.linalg.svd(self.factor[f:, f:])
        return left, s, right.T

    @property
    def singular_values(self) -> Floats:
        """Of the scaled identification matrix of the robot, descending, shape (r,)."""
        return self.svd[1]

    def pull(self, by_robot: Floats) -> Floats:
        """Derivative by S, symmetric (r, r), to derivative by M, (m, m)."""
        f = self.nuisances
        absorbed = self.inverse[:f, :f] @ self.factor[:f, f:]
        E = np.concatenate([-absorbed, np.eye(len(by_robot))])
        return np.asarray(E @ by_robot @ E.T)

    def trials(self, rows: Floats, sign: float) -> Trials:
        """The change by rows if they were added (sign 1) or taken away (-1).

        Args:
            rows: Rows of T configurations, component by component, shape (d, T, m).
            sign: 1 or -1.
        """
        return Trials(sign, rows @ self.inverse, self.nuisances)


@dataclass(frozen=True)
class Trials:
    """Rank-d changes of an information matrix, one per configuration.

    Attributes:
        sign: 1 where rows would be added, -1 where they would be taken away.
        whitened: Y = U R^-1, shape (d, T, m).
        nuisances: Number f of its leading columns that belong to nuisances.
    """

    sign: float
    whitened: Floats
    nuisances: int

    @cached_property
    def of_all(self) -> Floats:
        """Factors L with `L L' = I + s Y Y'`, shape (pairs, T); NaN where singular."""
        return _factors_of(products_of(self.whitened), self.sign)

    @cached_property
    def of_nuisances(self) -> Floats:
        """Those with `L L' = I + s Y_n Y_n'`, of the nuisances alone, (pairs, T)."""
        nuisances = self.whitened[:, :, : self.nuisances]
        return _factors_of(products_of(nuisances), self.sign)

    def robot(self) -> Floats:
        """Rows Z R_rr^-1 that change S to `S + s Z'Z`, shape (d, T, r)."""
        of_robot = self.whitened[:, :, self.nuisances :]
        return whiten(self.of_nuisances, of_robot) if self.nuisances else of_robot


ROUNDING = 1e-7
"""Least singular value of a factor with columns of unit length: by rounding a singular
matrix has up to 2e-8. The diagonal of the factor would not do, it may be 1e-4."""


ALONE = 1e-9
"""Pivot of `I - Y Y'` below which rows hold all that is known of something: without
them nothing remains of it but rounding, which conditioning enlarges, of either sign."""


def whiten(L: Floats, rows: Floats) -> Floats:
    """`L^-1` times the rows of each configuration, (pairs, T) and (d, T, m)."""
    result = np.empty_like(rows)
    for a in range(len(rows)):
        rest = rows[a].copy()
        for b in range(a):
            rest -= L[_pair(a, b)][:, None] * result[b]
        result[a] = rest / L[_pair(a, a)][:, None]
    return result


def products_of(rows: Floats) -> Floats:
    """Lower parts of `Y Y'` row by row, shape (d, T, m) -> (pairs, T)."""
    a, b = np.tril_indices(len(rows))
    result = np.empty((len(a), rows.shape[1]))
    for k in range(len(a)):
        result[k] = np.einsum("ti,ti->t", rows[a[k]], rows[b[k]])
    return result


def _factors_of(products: Floats, sign: float) -> Floats:
    """Lower factors L with `L L' = I + s G`, all at once; NaN where there is none.

    Products are the lower parts of G row by row, shape (pairs, ...).
    """
    A = _about_identity(products, sign)
    L = np.empty_like(A)
    with np.errstate(invalid="ignore", divide="ignore"):
        for a in range(_size(A)):
            pivot = A[_pair(a, a)]
            for b in range(a):
                rest = A[_pair(a, b)]
                for c in range(b):
                    rest -= L[_pair(a, c)] * L[_pair(b, c)]
                L[_pair(a, b)] = rest / L[_pair(b, b)]
                pivot -= L[_pair(a, b)] ** 2
            L[_pair(a, a)] = np.sqrt(np.where(pivot > ALONE, pivot, np.nan))
    return L


def log_determinants(products: Floats, sign: float) -> Floats:
    """`log det(I + s G)`, all at once; NaN where it is not positive definite.

    Args:
        products: Lower parts of G row by row, shape (pairs, ...).
        sign: The s.

    Returns:
        Logarithms, shape (...,).
    """
    A = _about_identity(products, sign)
    least = A[0]
    determinant = np.ones_like(least)
    # For a few hundred configurations a call costs more than its numbers: elimination
    # without roots has the fewest.
    with np.errstate(invalid="ignore", divide="ignore"):
        for a in range(_size(A)):
            pivot = A[_pair(a, a)]
            determinant = determinant * pivot
            least = np.minimum(least, pivot)
            for b in range(a + 1, _size(A)):
                ratio = A[_pair(b, a)] / pivot
                for c in range(a + 1, b + 1):
                    A[_pair(b, c)] -= ratio * A[_pair(c, a)]
        return np.asarray(np.log(np.where(least > ALONE, determinant, np.nan)))


def _about_identity(products: Floats, sign: float) -> Floats:
    A = sign * products
    for a in range(_size(A)):
        A[_pair(a, a)] += 1.0
    return np.asarray(A)


def _pair(a: int, b: int) -> int:
    """Place of the entry (a, b) in a lower part row by row."""
    return a * (a + 1) // 2 + b


def _size(products: Floats) -> int:
    """The d of d (d + 1) / 2 pairs."""
    return (math.isqrt(8 * len(products) + 1) - 1) // 2
