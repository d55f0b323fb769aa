"""What every candidate does to a determinant, followed from change to change.

The leverage of a candidate with rows U is `G = U M^-1 U'`. When rows u of one of them
join (s = 1) or leave (-1), all follow by the Woodbury identity from a product with d
columns, however large M is:

    M^-1  <-  M^-1 - s X K^-1 X',    X = M^-1 u',   K = I + s u X,
    G     <-  G - s (U X) K^-1 (U X)'

The determinant of the robot's part is that of M over that of its nuisance block M_nn,
so both have their leverages here.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.information import Information, log_determinants, products_of

STEEP = 1e-3
"""Factor of a determinant in one direction below which a change loses digits: beyond,
and beyond its inverse, everything is computed anew."""


class Leverages:
    """Leverages of C candidates in a subset of them.

    Args:
        found: The information of the subset.
        rows: Rows of the candidates, component by component, shape (d, C, m).

    Attributes:
        volume: Logarithm of det(S), the information about the robot alone.
    """

    def __init__(self, found: Information, rows: Floats) -> None:
        """Compute the leverages of all candidates."""
        f, Y = found.nuisances, rows @ found.inverse
        # Column by column, so that products run along the candidates.
        columns = np.ascontiguousarray(np.moveaxis(rows, 2, 0))
        self._columns = columns, columns[:f]
        inverse = found.inverse @ found.inverse.T
        of_nuisances = found.inverse[:f, :f]
        self._inverses = [inverse, of_nuisances @ of_nuisances.T]
        # Lower parts of G by M, and by M_nn: shape (pairs, 2, C).
        self._lower = np.tril_indices(len(rows))
        nuisance = products_of(Y[:, :, :f])
        self._leverages = np.stack([nuisance + products_of(Y[:, :, f:]), nuisance], 1)
        self.volume = 2.0 * float(np.log(np.diag(found.factor)[f:]).sum())

    def copy(self) -> Leverages:
        """A copy that changes on its own."""
        result = copy(self)
        result._inverses = [inverse.copy() for inverse in self._inverses]
        result._leverages = self._leverages.copy()
        return result

    def volumes(self, sign: float, some: Sequence[int] | slice = slice(None)) -> Floats:
        """What `volume` would be after a candidate joins (1) or leaves (-1).

        Args:
            sign: 1 or -1.
            some: Positions of the candidates, K of them.

        Returns:
            Volumes, shape (K,); NaN where nothing would be determined.
        """
        return self.volume + self._growth(self._leverages[:, :, some], sign)

    def change(self, candidate: int, sign: float) -> bool:
        """Let a candidate join (1) or leave (-1).

        Returns:
            False, and nothing has changed, if that would lose too many digits.
        """
        a, b = self._lower
        _, size, count = self._columns[0].shape
        K = np.tile(np.eye(size), (2, 1, 1))
        K[:, a, b] += sign * self._leverages[:, :, candidate].T
        K[:, b, a] = K[:, a, b]
        factors = np.linalg.eigvalsh(K)
        if factors.min() < STEEP or factors.max() > 1.0 / STEEP:
            return False
        of_all, of_nuisances = np.log(factors).sum(axis=1)
        self.volume += float(of_all - of_nuisances)
        K_inverse = np.linalg.inv(K)
        for k, columns in enumerate(self._columns):
            X = self._inverses[k] @ columns[:, :, candidate]
            moved = X.T @ columns.reshape(len(columns), size * count)
            solved = K_inverse[k] @ moved
            self._inverses[k] -= sign * (X @ K_inverse[k] @ X.T)
            shape = size, size, count
            change = moved.reshape(shape)[:, a] * solved.reshape(shape)[:, b]
            self._leverages[:, k] -= sign * change.sum(axis=0)
        return True

    def _growth(self, leverages: Floats, sign: float) -> Floats:
        """Logarithms of the factors of det(S), (pairs, 2, ...) -> (...,)."""
        of_all, of_nuisances = log_determinants(leverages, sign)
        return np.asarray(of_all - of_nuisances)
