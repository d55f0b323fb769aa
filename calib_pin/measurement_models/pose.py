"""The 6-D pose of the tool: laser tracker with a 6-D probe, motion-capture body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import (
    Floats,
    from_quaternion,
    so3_exp,
    so3_log,
    so3_log_derivative,
    to_quaternion,
)
from calib_pin.measurement_models.base import (
    Batch,
    Geometry,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.declaration import (
    INSTRUMENT,
    Declaration,
    Quantity,
)
from calib_pin.measurement_models.registration import register_poses
from calib_pin.observations import Measurements, Targets
from calib_pin.setup import Setup


@dataclass(frozen=True)
class Pose(MeasurementModel):
    """Position in the measurement frame [m] and rotation vector in the tool [rad].

    `residual = (p(T) - y, log(R_y^T R))`; values are x y z and qx qy qz qw.
    """

    declaration = Declaration(
        name="pose",
        help="position and orientation of the tool: tracker, 6-D probe",
        components=("x", "y", "z", "rx", "ry", "rz"),
        quantities=(
            Quantity("position", "m", slice(0, 3), 1e-4),
            Quantity("orientation", "rad", slice(3, 6), 1e-4),
        ),
        oriented=True,
        external=True,
        tracks="pose",
        inferred="part",
        yardstick=INSTRUMENT,
    )

    @classmethod
    def from_setup(cls, setup: Setup, targets: Sequence[str]) -> Pose:
        """The model: it needs nothing of a setup."""
        return cls()

    def predict(self, T: Floats, instrument: Floats, target: Targets) -> Floats:
        """Position and unit quaternion of the tool, shape (N, 7)."""
        return np.column_stack([T[:, :3, 3], to_quaternion(T[:, :3, :3])])

    def disturb(self, values: Floats, noise: Floats) -> Floats:
        """Shift the position and turn the orientation in the tool frame."""
        R = from_quaternion(values[:, 3:]) @ so3_exp(noise[:, 3:])
        return np.column_stack([values[:, :3] + noise[:, :3], to_quaternion(R)])

    def residual(self, T: Floats, instrument: Floats, data: Measurements) -> Floats:
        """Predicted against measured pose, shape (N, 6) [m, rad]."""
        R_y = from_quaternion(data.values[:, 3:])
        turn = so3_log(np.swapaxes(R_y, 1, 2) @ T[:, :3, :3])
        return np.column_stack([T[:, :3, 3] - data.values[:, :3], turn])

    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """`dp = R v` and `dlog = J_log w` for a body twist (v, w)."""
        residual = self.residual(T, instrument, data)
        J_pose = np.zeros((len(T), 6, 6))
        J_pose[:, :3, :3] = T[:, :3, :3]
        J_pose[:, 3:, 3:] = so3_log_derivative(residual[:, 3:])
        return Linearization(residual, J_pose, np.zeros((len(T), 6, 0)))

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Carries the origin and the axes of the tool to the base."""
        rows = np.arange(len(data))
        R_y = from_quaternion(data.values[:, 3:]).reshape(-1, 9)
        values = np.concatenate([data.values[:, :3], R_y], axis=1)
        alone = np.zeros_like(rows)

        def geometry(instrument: Floats) -> Geometry:
            origin = np.zeros((len(instrument), 1, 3))
            return Geometry(origin, origin)

        return [Batch("pose", rows, alone, alone, values, weights, geometry)]

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Pose, pin.SE3, pin.SE3]:
        """Robot-world and hand-eye registration."""
        poses = np.zeros((len(F), 4, 4))
        poses[:, :3, :3] = from_quaternion(data.values[:, 3:])
        poses[:, :3, 3] = data.values[:, :3]
        poses[:, 3, 3] = 1.0
        B, X = register_poses(
            F,
            poses,
            base=None if base is None else base.homogeneous,
            tool=None if tool is None else tool.homogeneous,
        )
        return self, base or pin.SE3(B), tool or pin.SE3(X)
