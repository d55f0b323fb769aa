"""The errors of measurements where a robot has them, in one of its links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.problem import error_table
from calib_pin.estimation.terms import Block
from calib_pin.kinematics.skeleton import base_poses
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.tool_point import PointModel
from calib_pin.report.surroundings import Thing, surroundings
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
    """Errors of N measurements as one robot predicts them, in one of its links.

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


def stage_errors(robot: Prepared, link: str) -> StageErrors:
    """Errors of the measurements that a robot is prepared for, in one of its links."""
    problem, theta = robot.problem.rebased(robot.theta)
    data, residual = problem.data, problem.errors(theta)
    points, vectors = np.zeros((len(data), 3)), np.full((len(data), 3), np.nan)
    for block in problem.blocks:
        q, base = data.q[block.rows], block.term.error.base.inverse().homogeneous
        seen = _in_base(block, theta)
        to_link = base_poses(problem.chains, block.term.key.chain, link, q)
        points[block.rows] = (to_link @ seen)[:, :3, 3]
        turn = to_link[:, :3, :3] @ base[:3, :3]
        errors = block.table(residual)
        for quantity in block.term.measurement.quantities:
            columns = errors[:, quantity.columns]
            if quantity.unit == "m" and columns.shape[1] == 3:
                vectors[block.rows] = np.einsum("nij,nj->ni", turn, columns)
    table = error_table(problem, theta)
    sizes = {
        quantity.name: ErrorSizes(
            quantity.unit, np.linalg.norm(table[:, quantity.columns], axis=1)
        )
        for quantity in problem.layout.quantities
    }
    return StageErrors(points, vectors, sizes)


def things_around(robot: Prepared, reach: float) -> list[Thing]:
    """Instruments and targets around a robot that is prepared for measurements.

    Args:
        robot: The robot.
        reach: Its size [m].
    """
    problem, theta = robot.problem.rebased(robot.theta)
    touched = {
        block.term.key: (block.data.target, _in_base(block, theta)[:, :3, 3])
        for block in problem.blocks
    }
    return surroundings(problem.terms, touched, reach)


def _in_base(block: Block, theta: Floats) -> Floats:
    """Poses of the tool at the measured points, in the base link, (N, 4, 4)."""
    base = block.term.error.base.inverse().homogeneous
    return np.asarray(base @ _tool_poses(block, theta))


def _tool_poses(block: Block, theta: Floats) -> Floats:
    """Poses of the tool at the measured points, in the measurement frame, (N, 4, 4).

    Of relative measurements as well: where the tool is, not how it has moved.
    """
    term, data = block.term, block.data
    error, of_robot = term.error, term.values(theta)[0]
    T = error.poses(data.q, of_robot, error.basis(data.q, data.conditions))
    model = term.measurement
    if isinstance(model, PointModel):
        label, _ = model.names(data.target, data)
        offsets = [point.at(np.zeros(3)) for point in model.points]
        offset = np.array([*offsets, np.zeros(3)])[label]
        T[:, :3, 3] += np.einsum("nij,nj->ni", T[:, :3, :3], offset)
    return np.asarray(T)
