"""The rows of a configuration in the identification matrix.

The rows are whitened by the noise, their columns are scaled and reduced to the
identifiable subspace, with the nuisances (base, tool, instrument) before the robot.
They can be differentiated by the configuration without new kinematics: if joint k turns
behind the place of parameter p, the body twist V_p of the tool changes by the Lie
bracket

    dV_p / dq_k = [V_p, xi_k]

with the joint's own twist xi_k, else not at all; and the instrument's rows change with
the pose by the `curvature` of the measurement model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.model import linearized_at
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import CurvedModel, MeasurementModel
from calib_pin.parameterizations.linearization import PoseLinearization

Pullback = Callable[[Floats], Floats]
"""Derivative by the rows, (N, d, m), to derivative by the configurations, (N, n)."""


class Rows(Protocol):
    """Rows of an identification matrix as functions of the configuration."""

    @property
    def nuisances(self) -> int:
        """Number of leading columns that are no part of what is sought."""

    @property
    def differentiable(self) -> bool:
        """Whether they have a derivative by the configuration."""

    def rows(self, q: Floats, target: Sequence[str]) -> Floats:
        """Rows of configurations, shape (N, n) -> (N, d, m)."""

    def linearize(self, q: Floats, target: Sequence[str]) -> tuple[Floats, Pullback]:
        """Rows, and what carries derivatives by them back to the configurations."""


@dataclass(frozen=True)
class IdentificationRows:
    """Rows of a problem at nominal geometry.

    Attributes:
        problem: The problem about its registered references.
        basis: Columns in parameters, each a direction times the scales, shape (P, m).
        nuisances: How many of them, the first ones, are directions of nuisances.
        measurement: Measurement model, if not the problem's own: it gives the rows of
            the tip's position, say, in the same columns.
        sigma: Standard deviation of each component, shape (d,).
    """

    problem: Problem
    basis: Floats
    nuisances: int
    measurement: MeasurementModel
    sigma: Floats

    @property
    def differentiable(self) -> bool:
        """Whether the measurement model and the error model have second derivatives.

        Those of joint corrections are not there.
        """
        curved = isinstance(self.measurement, CurvedModel)
        return curved and self.problem.error.geometric

    def rows(self, q: Floats, target: Sequence[str]) -> Floats:
        """Rows of configurations.

        Args:
            q: Configurations, shape (N, n) [rad, m].
            target: Target of each.

        Returns:
            Rows, shape (N, d, m).
        """
        poses, J_pose, J_instrument = self._linear(q, target)
        count, size = J_pose.shape[:2]
        of_robot, of_instrument = self._bases
        rows = poses.derivative(J_pose).reshape(count * size, -1) @ of_robot
        rows += J_instrument.reshape(count * size, -1) @ of_instrument
        return np.asarray(rows.reshape(count, size, -1))

    def linearize(self, q: Floats, target: Sequence[str]) -> tuple[Floats, Pullback]:
        """Rows, and what carries derivatives by them back to the configurations.

        Args:
            q: Configurations, shape (N, n) [rad, m].
            target: Target of each.

        Raises:
            OptionError: If the measurement or the error model has no second
                derivatives.
        """
        measurement = self.measurement
        geometric = self.problem.error.geometric
        if not isinstance(measurement, CurvedModel) or not geometric:
            lacking = f"'{measurement.name}'" if geometric else "a joint correction"
            raise OptionError(
                f"{lacking} has no derivative by the configuration, which "
                "the method 'gradient' needs",
                allowed="exchange, greedy, pso, ga",
            )
        poses, J_pose, J_instrument = self._linear(q, target)
        of_robot, of_instrument = self._bases
        V = poses.derivative(np.tile(np.eye(6), (len(q), 1, 1)))
        rows = J_pose @ (V @ of_robot) + J_instrument @ of_instrument
        curvature = measurement.curvature(poses.T, self._instrument, target)
        xi = poses.joint_twists()

        def pullback(by_rows: Floats) -> Floats:
            G = by_rows @ of_robot.T
            weighted = by_rows / self.sigma[:, None]
            # The instrument's rows change with the pose, whichever joint moves it.
            by_L = weighted @ np.swapaxes(V @ of_robot, 1, 2)
            e = np.einsum("nab,nabc->nc", by_L, curvature.J_pose)
            e += np.einsum(
                "nak,nakc->nc", weighted @ of_instrument.T, curvature.J_instrument
            )
            # F . [V, xi] = xi . (F_v x w + 0, F_v x v + F_w x w) with V = (v, w).
            F = np.swapaxes(J_pose, 1, 2) @ G
            by_place = np.cumsum(_coadjoint(V, F), axis=2)
            ahead = np.concatenate([np.zeros_like(by_place[:, :, :1]), by_place], 2)
            e = e[:, :, None] + ahead[:, :, self._carried]
            return np.asarray(np.einsum("nck,nck->nk", xi, e))

        return np.asarray(rows), pullback

    @property
    def _instrument(self) -> Floats:
        return np.zeros(len(self.measurement.parameters))

    @cached_property
    def _bases(self) -> tuple[Floats, Floats]:
        """Rows of the basis that belong to the error model and to the instrument."""
        count = len(self.problem.error.screws)
        return self.basis[:count], self.basis[count : count + len(self._instrument)]

    @cached_property
    def _carried(self) -> NDArray[np.intp]:
        """Number of leading parameters whose twist each joint turns, shape (n,).

        A joint traversed from child to parent turns before its own placement does.
        """
        error = self.problem.error
        places = [screw.frame for screw in error.screws]
        joints = np.arange(1, len(error.chain.joints) + 1)
        return np.searchsorted(places, joints - error.chain.reversed, side="right")

    def _linear(
        self, q: Floats, target: Sequence[str]
    ) -> tuple[PoseLinearization, Floats, Floats]:
        """Poses with the whitened derivatives by the pose and by the instrument."""
        error, measurement = self.problem.error, self.measurement
        poses = error.linearize(q, np.zeros(len(error.screws)))
        linear = linearized_at(
            error.chain, measurement, poses.T, self._instrument, q, target
        )
        weight = self.sigma[:, None]
        return poses, linear.J_pose / weight, linear.J_instrument / weight


def _coadjoint(V: Floats, F: Floats) -> Floats:
    """`c` with `F . [V, xi] = c . xi` for every xi, each (N, 6, P).

    With `V = (v, w)`, `F = (f, t)`: `c = (f x w, f x v + t x w)`.
    """
    v, w = V[:, :3], V[:, 3:]
    f, t = F[:, :3], F[:, 3:]
    return np.concatenate([_cross(f, w), _cross(f, v) + _cross(t, w)], axis=1)


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross products along the second axis; `numpy.cross` takes three times as long."""
    a_x, a_y, a_z = a[:, 0], a[:, 1], a[:, 2]
    b_x, b_y, b_z = b[:, 0], b[:, 1], b[:, 2]
    parts = [a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x]
    return np.stack(parts, axis=1)
