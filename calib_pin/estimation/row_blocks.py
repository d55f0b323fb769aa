"""Residual rows beside the measurements: known distances, expected sizes, priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib_pin.kinematics.spatial import Floats


class RowBlock(Protocol):
    """Whitened residual rows as a function of all parameters."""

    def __len__(self) -> int:
        """Number p of rows."""
        ...

    def residual(self, theta: Floats) -> Floats:
        """The rows for one vector of parameters or for many, (..., P) -> (..., p)."""
        ...

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, (P,) -> (p, P)."""
        ...


@dataclass(frozen=True)
class Expected:
    """A normal prior about zero on directions of the robot's errors.

    Attributes:
        directions: Orthonormal, of the parameters divided by their scale, shape (P, k).
        size: Standard deviation along each of them, in scales.
        scales: Scales of the parameters, shape (P,).
    """

    directions: Floats
    size: float
    scales: Floats

    def __len__(self) -> int:
        """Number k of directions."""
        return int(self.directions.shape[1])

    def residual(self, theta: Floats) -> Floats:
        """Distances from zero in standard deviations, (..., P) -> (..., k)."""
        return np.asarray((theta / self.scales) @ self.directions / self.size)

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, shape (k, P)."""
        return self.residual(np.eye(len(theta))).T


@dataclass(frozen=True)
class Priors:
    """Normal priors about zero on single parameters.

    Attributes:
        sigma: Standard deviations, infinite where there is none, shape (P,).
    """

    sigma: Floats

    def __len__(self) -> int:
        """Number of priors."""
        return int(np.isfinite(self.sigma).sum())

    def residual(self, theta: Floats) -> Floats:
        """Parameters in standard deviations, (..., P) -> (..., p)."""
        return np.asarray((theta / self.sigma)[..., np.isfinite(self.sigma)])

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, shape (p, P)."""
        return np.asarray(np.diag(1.0 / self.sigma)[np.isfinite(self.sigma)])


@dataclass(frozen=True)
class Blocks:
    """Several blocks one behind the other.

    Attributes:
        blocks: The blocks, none of them empty.
    """

    blocks: Sequence[RowBlock]

    def __len__(self) -> int:
        """Number p of rows."""
        return sum(map(len, self.blocks))

    def residual(self, theta: Floats) -> Floats:
        """All rows, (..., P) -> (..., p)."""
        empty = np.empty((*theta.shape[:-1], 0))
        rows = [block.residual(theta) for block in self.blocks]
        return np.concatenate([empty, *rows], axis=-1)

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, shape (p, P)."""
        empty = np.empty((0, len(theta)))
        rows = [block.jacobian(theta) for block in self.blocks]
        return np.concatenate([empty, *rows])
