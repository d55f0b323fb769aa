"""Tool poses of configurations with their derivatives, and whitened measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.measurement_models import Linearization, MeasurementModel
from calib_pin.observations import (
    BlockKey,
    Conditions,
    Labels,
    Measurements,
    Targets,
)
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.linearization import PoseLinearization


@dataclass(frozen=True)
class Configurations:
    """Configurations at which one block of measurements could be taken.

    Attributes:
        key: The block.
        q: Joint positions, shape (N, n) [rad, m].
        target: Target that the instrument measures in each.
        conditions: What holds at each beside the joint positions.
        start: Where relative measurements start, shape (N, n); (0, 0) for others.
    """

    key: BlockKey
    q: Floats
    target: Labels
    conditions: Conditions
    start: Floats

    def rows(self, index: NDArray[Any]) -> Configurations:
        """The configurations that a mask or an index array picks, in its order."""
        return replace(
            self,
            q=self.q[index],
            target=self.target[index],
            conditions=self.conditions.rows(index),
            start=self.start[index] if self.start.size else self.start,
        )


Configured: TypeAlias = Configurations | Measurements
"""Configurations, also those of measurements beside their values."""


@dataclass(frozen=True)
class ToolLinearization:
    """Tool poses of N configurations and their derivatives.

    Attributes:
        T: Tool poses in the measurement frame, those of relative measurements in the
            tool at their start, shape (N, 4, 4).
        poses: All as if they were absolute.
        start: Where relative ones start; None for absolute ones.
    """

    T: Floats
    poses: PoseLinearization
    start: PoseLinearization | None

    def derivative(self, J_pose: Floats) -> Floats:
        """Derivative by the error parameters, (N, d, 6) -> (N, d, P).

        Args:
            J_pose: Derivative by the body twist of `T`.
        """
        result = self.poses.derivative(J_pose)
        if self.start is not None:
            result -= self.start.derivative(self.at_start(J_pose))
        return result

    def at_start(self, J_pose: Floats) -> Floats:
        """Derivative by the body twist of the tool at the start, (N, d, 6).

        The twist of T_0^-1 T is that of T without that of T_0, transformed by the
        adjoint.
        """
        return np.asarray(J_pose @ adjoint(invert(self.T)))


class ToolPoses:
    """Tool poses of an error model, with what does not change between evaluations.

    Args:
        error: The error model.
        at: The configurations.
    """

    def __init__(self, error: ErrorModel, at: Configured) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._error, self._at = error, at

    def __call__(self, of_robot: Floats) -> Floats:
        """Tool poses as in `ToolLinearization`, shape (N, 4, 4).

        Args:
            of_robot: Parameter values of the error model, shape (P,).
        """
        T = self._error.poses(self._at.q, of_robot, self._basis)
        if self._at.start.size:
            start = self._error.poses(self._at.start, of_robot, self._start_basis)
            T = np.asarray(invert(start) @ T)
        return T

    def linearize(self, of_robot: Floats) -> ToolLinearization:
        """The poses with their derivatives."""
        poses, start = self._error.linearize(self._at.q, of_robot, self._basis), None
        T = poses.T
        if self._at.start.size:
            start = self._error.linearize(self._at.start, of_robot, self._start_basis)
            T = np.asarray(invert(start.T) @ T)
        return ToolLinearization(T, poses, start)

    @cached_property
    def _basis(self) -> Floats:
        """Basis functions of the joint corrections; they depend on commands alone."""
        return self._error.basis(self._at.q, self._at.conditions)

    @cached_property
    def _start_basis(self) -> Floats:
        return self._error.basis(self._at.start, self._at.conditions.at_start)


def whitened_jacobian(
    tool: ToolLinearization, linear: Linearization, sigma: Floats
) -> Floats:
    """Whitened Jacobian by all parameters, shape (N, d, P).

    Args:
        tool: Tool poses.
        linear: Linearized measurements of them.
        sigma: Standard deviations of the residual components, shape (N, d).
    """
    J = tool.derivative(whitened(linear.J_pose, sigma))
    return np.concatenate([J, whitened(linear.J_instrument, sigma)], axis=2)


def whitened(values: Floats, sigma: Floats) -> Floats:
    """Values of components in their standard deviations, (N, d, ...) and (N, d)."""
    each = sigma.reshape(*sigma.shape, *[1] * (values.ndim - 2))
    return np.asarray(kept(values, np.isinf(sigma)) / each)


def kept(values: Floats, aside: NDArray[np.bool_]) -> Floats:
    """Values with zeros for those that are set aside, shape (N, d, ...).

    They may be so wrong that they cannot be predicted, and nothing times infinity is
    not nothing.

    Args:
        values: The values.
        aside: Components that are set aside, shape (N, d).
    """
    if not aside.any():
        return values
    return np.where(aside.reshape(*aside.shape, *[1] * (values.ndim - 2)), 0.0, values)


def linearized_at(
    chain: Chain,
    measurement: MeasurementModel,
    T: Floats,
    instrument: Floats,
    q: Floats,
    target: Targets,
) -> Linearization:
    """Linearization of a measurement model where it measures what it predicts.

    Args:
        chain: The chain.
        measurement: The measurement model.
        T: Tool poses in the measurement frame, shape (N, 4, 4).
        instrument: Instrument parameters, shape (K,).
        q: Joint positions, shape (N, n) [rad, m].
        target: Target of each measurement.
    """
    # Derivatives are those of residuals, so a model is told what was measured.
    data = Measurements(
        joints=chain.joints,
        q=q,
        model=measurement.name,
        values=measurement.predict(T, instrument, target),
        target=Labels.of(target),
    )
    return measurement.linearize(T, instrument, data)
