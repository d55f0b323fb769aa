"""The position of a point on the tool: laser tracker, motion capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib_pin.measurement_models.base import (
    Batch,
    Curvature,
    FreeInstrument,
    Linearization,
    Quantity,
    plain_batch,
    rotation_curvature,
)
from calib_pin.measurements import Measurements
from calib_pin.registration import register_points
from calib_pin.spatial import Floats

__all__ = ["Position"]


@dataclass(frozen=True)
class Position(FreeInstrument):
    """`residual = p(T) - y`, the origin of the tool frame in the measuring frame [m].

    A point has no orientation: `tool.frame.rx|ry|rz` are unidentifiable.
    """

    name: str = "position"

    @property
    def quantities(self) -> Sequence[Quantity]:
        """One: the position."""
        return (Quantity("position", "m", slice(0, 3), 1e-4),)

    def predict(self, T: Floats, own: Floats, target: Sequence[str]) -> Floats:
        """Origins of the tool frame, shape (N, 3) [m]."""
        return np.array(T[:, :3, 3])

    def disturb(self, values: Floats, noise: Floats) -> Floats:
        """Add noise to the coordinates."""
        return values + noise

    def residual(self, T: Floats, own: Floats, data: Measurements) -> Floats:
        """Predicted minus measured position, shape (N, 3) [m]."""
        return T[:, :3, 3] - data.values

    def linearize(self, T: Floats, own: Floats, data: Measurements) -> Linearization:
        """`dp = R v` for a body twist (v, w)."""
        by_twist = np.zeros((len(T), 3, 6))
        by_twist[:, :, :3] = T[:, :3, :3]
        return Linearization(
            self.residual(T, own, data), by_twist, np.zeros((len(T), 3, 0))
        )

    def curvature(self, T: Floats, own: Floats, target: Sequence[str]) -> Curvature:
        """The rows turn with the tool."""
        by_twist = np.zeros((len(T), 3, 6, 6))
        by_twist[:, :, :3] = rotation_curvature(T[:, :3, :3])
        return Curvature(by_twist, np.zeros((len(T), 3, 0, 6)))

    def batch(self, data: Measurements, weights: Floats) -> Batch:
        """Carries the origin of the tool to the base."""
        from calib_pin import kernels

        return plain_batch(kernels.position_costs, data.values, weights)

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Position, pin.SE3, pin.SE3]:
        """Absolute orientation, with the unknown point eliminated."""
        if base is None:
            point = None if tool is None else tool.translation
            R, b, point = register_points(F, data.values, tool=point)
            base = pin.SE3(R, b)
        else:
            inside = (data.values - base.translation) @ base.rotation - F[:, :3, 3]
            point = np.einsum("nji,nj->i", F[:, :3, :3], inside) / len(F)
        return self, base, tool or pin.SE3(np.eye(3), point)
