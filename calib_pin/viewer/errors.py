"""The errors of measurements where a robot has them, in its base link."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.assessment import registration_reason
from calib_pin.chain import Chain
from calib_pin.fit import register
from calib_pin.formulation import make_problem
from calib_pin.measurement_models import MeasurementModel, Mixed
from calib_pin.measurement_models.tool_point import PointModel
from calib_pin.measurements import Measurements
from calib_pin.problem import Problem
from calib_pin.result import CalibratedModel
from calib_pin.setup import Setup
from calib_pin.spatial import Floats
from calib_pin.training import placed

__all__ = ["ErrorSizes", "StageErrors", "calibrated_errors", "registered_errors"]


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes of the errors of one quantity.

    Attributes:
        unit: `m`, `rad` or `px`.
        sizes: Size in every row, shape (N,); NaN where a row does not have the
            quantity, infinite where it cannot be predicted.
    """

    unit: str
    sizes: Floats

    @property
    def shown(self) -> NDArray[np.bool_]:
        """The rows that have a size, shape (N,)."""
        return np.isfinite(self.sizes)


@dataclass(frozen=True)
class StageErrors:
    """Errors of N measurements as one robot predicts them, in its base link.

    Attributes:
        points: The points of its tool that the rows look at, shape (N, 3) [m].
        vectors: Predicted minus measured position, shape (N, 3) [m]; NaN in rows that
            measure none.
        quantities: Sizes of the errors by the name of the quantity.
    """

    points: Floats
    vectors: Floats
    quantities: Mapping[str, ErrorSizes]

    @property
    def measured(self) -> Floats:
        """Measured positions, shape (N, 3) [m]; NaN in rows that measure none."""
        return self.points - self.vectors


def registered_errors(
    chain: Chain, rows: Measurements, setup: Setup
) -> tuple[StageErrors, str]:
    """Errors of the nominal robot, with base, tool and instrument fitted to the rows.

    Args:
        chain: The nominal chain.
        rows: The rows.
        setup: What is known of frames and instrument.

    Returns:
        The errors, and why the registration must not be trusted; empty where it may.

    Raises:
        InputError: If the measurements do not fit the model.
    """
    setup = replace(setup, parameters=(), fixed=(), bounds={}, prior={})
    problem = make_problem(chain, rows, setup)
    problem, result = register(problem, np.zeros(len(problem.parameters)))
    reason = registration_reason(problem, result)
    return _errors(*placed(problem, result.x, rows)), reason


def calibrated_errors(model: CalibratedModel, rows: Measurements) -> StageErrors:
    """Errors of a calibrated robot, which is taken as it is.

    Args:
        model: The robot.
        rows: The rows.

    Raises:
        InputError: If the measurements do not fit the model.
    """
    problem = model.problem(rows)
    own = np.zeros(len(model.measurement.parameters))
    return _errors(*placed(problem, np.concatenate([model.theta, own]), rows))


def _errors(problem: Problem, theta: Floats) -> StageErrors:
    problem, theta = problem.at(theta)
    error, data, of_robot = problem.error, problem.data, problem.split(theta)[0]
    residual = problem.shown(theta)
    # Of relative measurements as well: where the tool is, not how it has moved.
    T = error.poses(data.q, of_robot, error.factors(data.q, data.payload))
    vectors = np.full((len(data), 3), np.nan)
    sizes = {}
    for quantity in problem.measurement.quantities:
        columns = residual[:, quantity.columns]
        size = np.linalg.norm(columns, axis=1)
        sizes[quantity.name] = ErrorSizes(quantity.unit, size)
        if quantity.unit == "m" and columns.shape[1] == 3:
            vectors[np.isfinite(size)] = columns[np.isfinite(size)]
    to_base = error.base.inverse()
    points = _tool_points(problem.measurement, T, data)
    return StageErrors(
        points @ to_base.rotation.T + to_base.translation,
        vectors @ to_base.rotation.T,
        sizes,
    )


def _tool_points(
    measurement: MeasurementModel, T: Floats, data: Measurements
) -> Floats:
    """The points of the tool that rows look at in the measuring frame, shape (N, 3).

    Args:
        measurement: The measurement model, about its instrument.
        T: Tool poses in the measuring frame, shape (N, 4, 4).
        data: The rows.
    """
    points = T[:, :3, 3].copy()
    parts = {measurement.name: measurement}
    if isinstance(measurement, Mixed):
        parts = dict(measurement.parts)
    for name, (rows, own) in data.by_part.items():
        model = parts[name]
        if isinstance(model, PointModel):
            label, _ = model.names(own.target, own)
            offsets = [point.at(np.zeros(3)) for point in model.points]
            offset = np.array([*offsets, np.zeros(3)])[label]
            points[rows] += np.einsum("nij,nj->ni", T[rows, :3, :3], offset)
    return points
