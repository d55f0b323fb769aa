"""The likelihood of the robot alone, as few independent equations.

Priors are left out, frames and instrument projected out.
Measurements that repeat a configuration, and effects of gears and compliance that the
model lacks, have errors in common and tell less than as many independent ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import Directions, projected
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fitted import by_configuration, shared_variances
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.systematic import systematic
from calib_pin.kinematics.spatial import Floats

VISIBLE = 1e-9
"""Part of the largest singular value below which measurements do not see an error."""


@dataclass(frozen=True)
class RobotRows:
    """Equations `W theta = c` for the errors of a robot, with noise of deviation one.

    Attributes:
        robot: The parameters that are errors of the robot and free, shape (P,), K of
            them.
        rows: W for these divided by their scales, shape (r, K).
        values: c, shape (r,).
        along: How each measured value enters these, shape (r, M): the M whitened
            residuals of the problem times it are `W theta - c`.
    """

    robot: NDArray[np.bool_]
    rows: Floats
    values: Floats
    along: Floats


def robot_rows(
    problem: Problem, theta: Floats, components: Sequence[VarianceComponent]
) -> RobotRows:
    """The equations for the robot that the measurements of a problem amount to.

    Args:
        problem: The problem, in the units of its noise.
        theta: Parameter values near its solution, shape (P,); linearized there.
        components: The noise of every quantity.
    """
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    fun, jac = problem.linearize_rows(theta)
    # Priors are the last rows.
    count = len(fun) - len(problem.further.priors)
    A = jac[:count] * parameters.scales
    system = projected(np.column_stack([A[:, robot], fun[:count]]), A, parameters)
    U, s, Vt = np.linalg.svd(system[:, :-1], full_matrices=False)
    shown = s > VISIBLE * s.max(initial=0.0)
    U, rows = U[:, shown], s[shown, None] * Vt[shown]
    values = rows @ (theta / parameters.scales)[robot] - U.T @ system[:, -1]
    basis = np.zeros((len(parameters), len(values)))
    basis[robot] = Vt[shown].T
    half = np.linalg.cholesky(_noise(problem, theta, components, basis, U))
    of_values = U[: len(problem.layout.row)].T
    whitened = (np.linalg.solve(half, part) for part in (rows, values, of_values))
    return RobotRows(robot, *whitened)


def _noise(
    problem: Problem,
    theta: Floats,
    components: Sequence[VarianceComponent],
    basis: Floats,
    U: Floats,
) -> Floats:
    """Covariance of the errors of whitened residual rows along columns, (r, r).

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        components: The noise of every quantity.
        basis: Directions of the robot that the rows see, shape (P, r).
        U: Orthonormal columns of the rows, shape (M, r).
    """
    layout, parameters = problem.layout, problem.parameters
    nuisances = np.eye(len(parameters))[:, parameters.free & parameters.nuisance]
    effects = systematic(problem, theta, Directions(nuisances, basis, basis[:, :0]))
    count = len(layout.row)
    variances = np.ones(len(layout.components)) if effects is None else effects.noise
    shared = shared_variances(problem, components, variances)
    of_row = np.ones(len(U))
    of_row[:count] = (variances - shared)[layout.component]
    Q = (U.T * of_row) @ U
    if shared.any():
        Q += by_configuration(problem, U, shared)
    if effects is not None:
        X = U[:count].T @ effects.rows(problem, theta)
        Q += X @ X.T
    return np.asarray(Q)
