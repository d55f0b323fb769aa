"""The errors of measurements where a robot has them, in its base link."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MeasurementModel, Mixed
from calib_pin.measurement_models.side_by_side import by_part
from calib_pin.measurement_models.tool_point import PointModel
from calib_pin.observations import Measurements
from calib_pin.validation.evaluation import Prepared


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes of the errors of one quantity.

    Attributes:
        unit: `m`, `rad` or `px`.
        sizes: Size in every measurement, shape (N,); NaN where it does not have
            the quantity, infinite where it cannot be predicted.
    """

    unit: str
    sizes: Floats

    @property
    def shown(self) -> NDArray[np.bool_]:
        """The measurements that have a size, shape (N,)."""
        return np.isfinite(self.sizes)


@dataclass(frozen=True)
class StageErrors:
    """Errors of N measurements as one robot predicts them, in its base link.

    Attributes:
        points: The measured points of its tool, shape (N, 3) [m].
        vectors: Predicted minus measured position, shape (N, 3) [m]; NaN where none
            is measured.
        quantities: Sizes of the errors by the name of the quantity.
    """

    points: Floats
    vectors: Floats
    quantities: Mapping[str, ErrorSizes]

    @property
    def measured(self) -> Floats:
        """Measured positions, shape (N, 3) [m]; NaN where none is measured."""
        return self.points - self.vectors


def stage_errors(robot: Prepared) -> StageErrors:
    """Errors of the measurements that a robot is prepared for."""
    problem, theta = robot.problem.rebased(robot.theta)
    error, data, of_robot = problem.error, problem.data, problem.split(theta)[0]
    residual = problem.masked_errors(theta)
    # Of relative measurements as well: where the tool is, not how it has moved.
    T = error.poses(data.q, of_robot, error.basis(data.q, data.payload))
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
    """The tool points of measurements in the measurement frame, shape (N, 3) [m].

    The tool poses T (N, 4, 4) are in that frame too.
    """
    points = T[:, :3, 3].copy()
    parts = {measurement.name: measurement}
    if isinstance(measurement, Mixed):
        parts = dict(measurement.parts)
    for name, (rows, own) in by_part(data).items():
        model = parts[name]
        if isinstance(model, PointModel):
            label, _ = model.names(own.target, own)
            offsets = [point.at(np.zeros(3)) for point in model.points]
            offset = np.array([*offsets, np.zeros(3)])[label]
            points[rows] += np.einsum("nij,nj->ni", T[rows, :3, :3], offset)
    return points
