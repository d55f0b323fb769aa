"""A robot with its calibration, which predicts measurements and corrects commands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MeasurementModel
from calib_pin.observations import Measurements
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.residual_models import LearnedCorrection
from calib_pin.setup import Setup


@dataclass(frozen=True)
class CalibratedModel:
    """A robot with its calibration: what predicts measurements and corrects commands.

    Attributes:
        error: Error model about the fitted base and tool frame.
        measurement: Measurement model about the fitted instrument.
        theta: Values of the error model's parameters, shape (P,), frames at zero.
        setup: The setup it was fitted with.
    """

    error: ErrorModel
    measurement: MeasurementModel
    theta: Floats
    setup: Setup

    @staticmethod
    def create(problem: Problem, theta: Floats) -> CalibratedModel:
        """The model of a problem at parameter values, shape (P,).

        Frames and instrument move into their references; the robot keeps its values.
        """
        moved, values = problem.rebased(theta)
        return CalibratedModel(
            error=moved.error,
            measurement=moved.measurement,
            theta=moved.split(values)[0],
            setup=moved.setup,
        )

    @property
    def chain(self) -> Chain:
        """The nominal chain."""
        return self.error.chain

    @serial_blas
    def poses(self, q: Floats) -> Floats:
        """Predicted tool poses in the measurement frame, shape (N, n) -> (N, 4, 4)."""
        return self.error.poses(q, self.theta)

    def outside(self, q: Floats) -> NDArray[np.bool_]:
        """Where a learned correction fades, being far from its training, shape (N,).

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
        """
        learned = self.error.learned
        if not isinstance(learned, LearnedCorrection):
            return np.zeros(len(q), bool)
        return ~learned.model.region.inside(q)

    @property
    def geometric(self) -> bool:
        """Whether there is nothing but geometry, which a URDF can hold."""
        moved = self.theta[self.error.joint_corrections].any()
        return self.error.learned is None and not moved

    @property
    def without_corrections(self) -> CalibratedModel:
        """The model without what a URDF cannot hold: of a true robot, its geometry.

        Of a fit that is no use, see `CalibrationResult.geometry`.
        """
        theta = self.theta.copy()
        theta[self.error.joint_corrections] = 0.0
        return replace(self, error=replace(self.error, learned=None), theta=theta)

    def urdf_corrections(self) -> dict[str, pin.SE3]:
        """Right-multiplied corrections of the URDF's joint origins, by joint name."""
        products = self.error.corrections(self.theta)
        names = [*self.chain.joints, self.chain.tip_joint]
        return {
            name: product
            for name, product in zip(names, products[1:-1], strict=True)
            if name is not None and product != pin.SE3.Identity()
        }

    @property
    def tool_carries_tip(self) -> bool:
        """Whether the tool frame holds an error that the URDF has no place for."""
        tip = self.error.corrections(self.theta)[-2]
        return self.chain.tip_joint is None and tip != pin.SE3.Identity()

    @property
    def tool(self) -> pin.SE3:
        """The tool in the tip frame of the corrected URDF.

        An error behind the last joint has no place in a URDF whose tip is that
        joint's own link; the tool frame carries it.
        """
        if self.chain.tip_joint is not None:
            return self.error.tool
        return self.error.corrections(self.theta)[-2] * self.error.tool

    def problem(self, data: Measurements) -> Problem:
        """The problem of other measurements about this calibration."""
        return Problem(self.error, self.measurement, data, self.setup)
