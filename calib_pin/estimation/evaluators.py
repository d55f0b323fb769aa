"""Residuals and derivatives of one block of measurements."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from calib_pin.estimation.model import Model, ToolPoses, whitened_jacobian
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Linearization
from calib_pin.observations import Measurements


class Evaluator(Protocol):
    """The measurements of one block as a function of its parameters, shape (p,)."""

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        ...

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        ...

    def normal(self, theta: Floats) -> Floats:
        """Products of the columns of Jacobian and residual, (p + 1, p + 1).

        Half the digits are lost, which is good enough for a step.
        """
        ...

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (M,), and Jacobian, shape (M, p).

        Of very many measurements they are those of a smaller system with the same
        normal equations, to full precision.
        """
        ...


class RowByRow:
    """Measurements of a model by Pinocchio, a residual row for each value.

    Args:
        model: The model.
        data: The measurements.
        sigma: Standard deviations of the residual components, shape (N, d).
    """

    def __init__(self, model: Model, data: Measurements, sigma: Floats) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._model, self._data, self._sigma = model, data, sigma

    @cached_property
    def _tool(self) -> ToolPoses:
        return ToolPoses(self._model.error, self._data)

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, shape (N, d)."""
        of_robot, instrument = self._model.split(theta)
        T = self._tool(of_robot)
        return self._model.measurement.residual(T, instrument, self._data)

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual, shape (N d,)."""
        return whitened(self.errors(theta), self._data, self._sigma)

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        r = self.residual(theta)
        return float(r @ r)

    def normal(self, theta: Floats) -> Floats:
        """Products of the columns of Jacobian and residual, (p + 1, p + 1)."""
        r, J = self.factorize(theta)
        columns = np.column_stack([J, r])
        return np.asarray(columns.T @ columns)

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, p)."""
        of_robot, instrument = self._model.split(theta)
        tool = self._tool.linearize(of_robot)
        linear = self._model.measurement.linearize(tool.T, instrument, self._data)
        known = Linearization(
            linear.residual,
            kept(linear.J_pose, self._data),
            kept(linear.J_instrument, self._data),
        )
        J = whitened_jacobian(tool, known, self._sigma).reshape(-1, len(theta))
        return whitened(linear.residual, self._data, self._sigma), J


def evaluator(model: Model, data: Measurements, sigma: Floats, many: bool) -> Evaluator:
    """Compiled kernels where measurements are many and kernels can evaluate them.

    Args:
        model: The model of the block.
        data: Its measurements.
        sigma: Standard deviations of the residual components, shape (N, d).
        many: Whether a Jacobian of all measurements would be too large to be handy.
    """
    if not many or not model.error.geometric or data.start.size:
        return RowByRow(model, data, sigma)
    from calib_pin.estimation.many_rows import ManyRows

    return ManyRows(model, data, sigma)


def whitened(errors: Floats, data: Measurements, sigma: Floats) -> Floats:
    """Residuals in standard deviations, (N, d) -> (N d,)."""
    return np.asarray((kept(errors, data) / sigma).reshape(-1))


def kept(values: Floats, data: Measurements) -> Floats:
    """Values with zeros for measurements that are set aside, shape (N, ...).

    They may be so wrong that they cannot be predicted, and nothing times infinity is
    not nothing.
    """
    if data.weight.all():
        return values
    aside = (data.weight == 0.0).reshape(-1, *[1] * (values.ndim - 1))
    return np.where(aside, 0.0, values)
