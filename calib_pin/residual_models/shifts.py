"""A shift of the geometry that is learned along, and its prior.

The fit has taken along what it could of the effects that are to be learned, so they are
estimated together: a shift of the parameters beside the correction. Left free it would
fit the geometry to a correction that holds near the measurements alone. So errors of
the robot keep the size that they are expected to have about *nominal*, one size for
each kind of parameter, which the likelihood tells with the rest of the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

FREE = 1e4
"""Variance of what a free direction explains, in squares of the residual."""


@dataclass(frozen=True)
class Shifts:
    """Directions in which the parameters of a fit may shift.

    Attributes:
        about: Value of each direction at the fit, from nominal, shape (P,).
        kinds: For each kind of parameter what its errors of expected size contribute to
            the directions, shape (P, p) each. A direction of no kind is free.
    """

    about: Floats
    kinds: tuple[Floats, ...] = ()

    @staticmethod
    def free(count: int) -> Shifts:
        """So many directions of which nothing is known."""
        return Shifts(np.zeros(count))

    def __len__(self) -> int:
        """Number P of directions."""
        return len(self.about)

    def root(self, by_shift: Floats, square: float, sizes: Floats) -> Floats:
        """A root R of the covariance `R R^T` of the shift about nominal, shape (P, k).

        Args:
            by_shift: Derivative of the residuals by the shift, shape (N, d, P).
            square: Mean square of the residuals, of which free directions may explain
                `FREE` times as much.
            sizes: Variance of each kind, in squares of the expected size.
        """
        squares = np.einsum("ndp,ndp->p", by_shift, by_shift) * self._free
        shown = squares > 0.0
        free = np.eye(len(self))[:, shown]
        if shown.any():
            values = by_shift.shape[0] * by_shift.shape[1]
            free *= np.sqrt(square * FREE * values / squares[shown])
        kinds = zip(sizes, self.kinds, strict=True)
        return np.hstack([free, *(np.sqrt(size) * kind for size, kind in kinds)])

    @property
    def _free(self) -> NDArray[np.bool_]:
        """Whether each direction is of no kind, shape (P,)."""
        return np.asarray(~np.hstack([np.zeros((len(self), 1)), *self.kinds]).any(1))
