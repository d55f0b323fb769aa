"""Tool poses at configurations, of which some are relative to where a motion starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.linearization import PoseLinearization


class Configured(Protocol):
    """Where a model is asked; measurements are, too, beside what was measured."""

    @property
    def q(self) -> Floats:
        """Joint positions, shape (N, n) [rad, m]."""
        ...

    @property
    def target(self) -> Sequence[str]:
        """Target that the instrument measures in each."""
        ...

    @property
    def payload(self) -> Sequence[str]:
        """Payload that the robot carries in each."""
        ...

    @property
    def start(self) -> Floats:
        """Where relative measurements start, NaN for others, (N, n) or (0, 0)."""
        ...


@dataclass(frozen=True)
class Configurations:
    """Configurations at which a model is asked; the attributes as in `Configured`."""

    q: Floats
    target: tuple[str, ...]
    payload: tuple[str, ...]
    start: Floats


@dataclass(frozen=True)
class ToolLinearization:
    """Tool poses of N configurations and their derivatives.

    Attributes:
        T: Tool poses in the measurement frame, those of relative measurements in the
            tool at their start, shape (N, 4, 4).
        poses: All as if they were absolute.
        begun: Which are relative, shape (N,).
        start: Where these start; None without any.
    """

    T: Floats
    poses: PoseLinearization
    begun: NDArray[np.bool_]
    start: PoseLinearization | None

    def derivative(self, J_pose: Floats) -> Floats:
        """Derivative by the error parameters, (N, d, 6) -> (N, d, P).

        Args:
            J_pose: Derivative by the body twist of `T`.
        """
        result = self.poses.derivative(J_pose)
        if self.start is not None:
            result[self.begun] -= self.start.derivative(self.at_start(J_pose))
        return result

    def at_start(self, J_pose: Floats) -> Floats:
        """Derivative by the body twist of the tool at the start, (N, d, 6).

        The twist of T_0^-1 T is that of T without that of T_0, transformed by the
        adjoint.
        """
        return np.asarray(J_pose[self.begun] @ adjoint(invert(self.T[self.begun])))


class ToolPoses:
    """Tool poses of an error model, with what does not change between evaluations.

    Args:
        error: The error model.
        at: The configurations.
    """

    def __init__(self, error: ErrorModel, at: Configured) -> None:
        """Find the configurations that are relative to others."""
        self._error, self._at = error, at
        self._begun = np.zeros(len(at.q), bool)
        if at.start.size:
            self._begun = np.isfinite(at.start[:, 0])

    def __call__(self, of_robot: Floats) -> Floats:
        """Tool poses as in `ToolLinearization`, shape (N, 4, 4).

        Args:
            of_robot: Parameter values of the error model, shape (P,).
        """
        error, begun = self._error, self._begun
        T = error.poses(self._at.q, of_robot, self._basis)
        if begun.any():
            T_0 = error.poses(self._at.start[begun], of_robot, self._start_basis)
            T[begun] = invert(T_0) @ T[begun]
        return T

    def linearize(self, of_robot: Floats) -> ToolLinearization:
        """The poses with their derivatives."""
        begun, start = self._begun, None
        poses = self._error.linearize(self._at.q, of_robot, self._basis)
        T = poses.T
        if begun.any():
            start = self._error.linearize(
                self._at.start[begun], of_robot, self._start_basis
            )
            T = T.copy()
            T[begun] = invert(start.T) @ T[begun]
        return ToolLinearization(T, poses, begun, start)

    @cached_property
    def _basis(self) -> Floats:
        """Basis functions of the joint corrections; they depend on commands alone."""
        return self._error.basis(self._at.q, self._at.payload)

    @cached_property
    def _start_basis(self) -> Floats:
        loads = [self._at.payload[k] for k in np.flatnonzero(self._begun).tolist()]
        return self._error.basis(self._at.start[self._begun], loads)
