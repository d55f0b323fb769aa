"""The learned correction of a calibrated robot."""

from __future__ import annotations

from dataclasses import dataclass

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.base import ResidualModel, Space


@dataclass(frozen=True)
class LearnedCorrection:
    """A residual model, with its shift of the geometry in error parameters.

    Attributes:
        model: The residual model.
        shift: Change of the P parameters of the error model, shape (P,).
    """

    model: ResidualModel
    shift: Floats

    @property
    def space(self) -> Space:
        """Space of the correction."""
        return self.model.space

    def __call__(self, q: Floats) -> Floats:
        """Corrections, shape (N, n) -> (N, n) [rad, m] or (N, 6) [m, rad]."""
        return self.model(q)

    def weight(self, q: Floats) -> Floats:
        """Weight from 1 near training configurations to 0 far away, shape (N,)."""
        return self.model.region.weight(q)
