"""A robot with errors before an instrument: predictions at any configurations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.tool_poses import Configured, ToolLinearization, ToolPoses
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Linearization, MeasurementModel
from calib_pin.observations import Measurements
from calib_pin.parameterizations.error_model import ErrorModel


@dataclass(frozen=True)
class Model:
    """An error model and a measurement model, about their references.

    A vector theta of parameter values belongs to these references; `rebased` moves
    both.

    Attributes:
        error: The error model about its reference frames.
        measurement: The measurement model about its reference values.
    """

    error: ErrorModel
    measurement: MeasurementModel

    @property
    def components(self) -> int:
        """Residual components d of a measurement."""
        return int(self.measurement.quantities[-1].columns.stop)

    def split(self, theta: Floats) -> tuple[Floats, Floats]:
        """Values of the error model and of the measurement model, (..., P) each."""
        count = len(self.error.screws)
        return theta[..., :count], theta[..., count:]

    def poses(self, theta: Floats, at: Configured) -> Floats:
        """Tool poses as in `ToolLinearization`, shape (N, 4, 4).

        Args:
            theta: Parameter values, shape (P,).
            at: The configurations.
        """
        return ToolPoses(self.error, at)(self.split(theta)[0])

    def predict(self, theta: Floats, at: Configured) -> Floats:
        """Noise-free values in the layout of `Measurements.values`, shape (N, D).

        The arguments are as in `poses`.
        """
        instrument = self.split(theta)[1]
        return self.measurement.predict(self.poses(theta, at), instrument, at.target)

    def observable(self, theta: Floats, at: Configured) -> NDArray[np.bool_]:
        """Whether the instrument can measure at each configuration, shape (N,).

        The arguments are as in `poses`.
        """
        instrument = self.split(theta)[1]
        return self.measurement.observable(self.poses(theta, at), instrument, at.target)

    def jacobian(self, theta: Floats, at: Configured, sigma: Floats) -> Floats:
        """Whitened Jacobian of noise-free measurements, shape (N, d, P).

        Args:
            theta: Parameter values, shape (P,).
            at: The configurations.
            sigma: Standard deviations of the residual components, shape (N, d).
        """
        of_robot, instrument = self.split(theta)
        tool = ToolPoses(self.error, at).linearize(of_robot)
        linear = linearized_at(
            self.error.chain,
            self.measurement,
            tool.T,
            instrument,
            at.q,
            at.target,
            self.predict(theta, at),
        )
        return whitened_jacobian(tool, linear, sigma)

    def rebased(self, theta: Floats) -> tuple[Self, Floats]:
        """The same model about other values of frames and instrument.

        Args:
            theta: Parameter values, shape (P,).

        Returns:
            The model with these in its references, and values about them, shape (P,):
            zero for frames and instrument, those of the robot as they are.
        """
        of_robot, instrument = self.split(theta)
        error, products = self.error, self.error.corrections(of_robot)
        moved = replace(
            self,
            error=error.with_frames(
                error.base * products[0], error.tool * products[-1]
            ),
            measurement=self.measurement.rebased(instrument),
        )
        nuisance = np.append(error.parameters.nuisance, np.ones(len(instrument), bool))
        return moved, np.where(nuisance, 0.0, theta)


def whitened_jacobian(
    tool: ToolLinearization, linear: Linearization, sigma: Floats
) -> Floats:
    """Whitened Jacobian by all parameters, shape (N, d, P).

    Args:
        tool: Tool poses.
        linear: What is measured of them.
        sigma: Standard deviations of the residual components, shape (N, d).
    """
    weight = 1.0 / sigma[:, :, None]
    J = tool.derivative(linear.J_pose * weight)
    if not linear.J_instrument.shape[2]:
        return J
    return np.concatenate([J, linear.J_instrument * weight], axis=2)


def linearized_at(
    chain: Chain,
    measurement: MeasurementModel,
    T: Floats,
    instrument: Floats,
    q: Floats,
    target: Sequence[str],
    exact: Floats | None = None,
) -> Linearization:
    """Linearization of a measurement model where it measures what it predicts.

    Args:
        chain: The chain.
        measurement: The measurement model.
        T: Tool poses in the measurement frame, shape (N, 4, 4).
        instrument: Instrument parameters, shape (K,).
        q: Joint positions, shape (N, n) [rad, m].
        target: Target of each measurement.
        exact: The values that it predicts, shape (N, D), where they are known.
    """
    if exact is None:
        exact = measurement.predict(T, instrument, target)
    # Derivatives are those of residuals, so a model is told what was measured.
    data = Measurements(
        joints=chain.joints,
        q=q,
        model=measurement.name,
        values=exact,
        target=tuple(target),
    )
    return measurement.linearize(T, instrument, data)
