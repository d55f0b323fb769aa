"""Information matrices, factored.

With the nuisances first, the Cholesky factor of an information matrix M = sum J' J

    M = R' R,   R = [R_nn  R_nr]
                    [  0   R_rr]

holds the Schur complement S = R_rr' R_rr: the information about the robot alone, the
nuisances projected out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib_pin.kinematics.spatial import Floats

ROUNDING = 1e-7
"""Least singular value of a factor with columns of unit length: by rounding a singular
matrix has up to 2e-8. The diagonal of the factor would not do, it may be 1e-4."""


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

    def pull(self, by_robot: Floats) -> Floats:
        """Derivative by S, symmetric (r, r), to derivative by M, (m, m)."""
        f = self.nuisances
        absorbed = self.inverse[:f, :f] @ self.factor[:f, f:]
        E = np.concatenate([-absorbed, np.eye(len(by_robot))])
        return np.asarray(E @ by_robot @ E.T)
