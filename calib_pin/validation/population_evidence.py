"""What a calibration tells of the errors of its robot, for the prior of the next one.

It is the likelihood alone: priors that the calibration had are left out, and so nothing
counts twice. Measurements that repeat a configuration, and effects of gears and
compliance that the model lacks, have errors in common and tell less than as many
independent ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.directions import Directions, projected
from calib_pin.estimation.fitted import by_configuration, shared_variances
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.population_prior import RobotEvidence
from calib_pin.estimation.statistics.systematic import systematic
from calib_pin.estimation.statistics.variance_components import current_units
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.result import CalibrationResult

VISIBLE = 1e-9
"""Part of the largest singular value below which measurements do not see an error."""


@serial_blas
def robot_evidence(result: CalibrationResult) -> RobotEvidence:
    """What a calibration tells of the errors of its robot.

    Args:
        result: The calibration, of this program or read from its folder.

    Raises:
        InputError: If it does not say what was measured, how large the noise is, or
            learned more than errors of parameters.
    """
    refuse = _refusal(result)
    if refuse:
        raise InputError(refuse, file=result.provenance.file or None)
    model, noise = result.model, result.statistics.noise
    units = np.array([component.factor for component in noise])
    problem = replace(model.problem(result.fitted.rows), units=units)
    fun, jac = problem.linearize_rows(model.theta)
    # Priors are the last rows, and tell nothing of this robot.
    count = len(fun) - problem.further.priors
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    A = jac[:count] * parameters.scales
    system = projected(np.column_stack([A[:, robot], fun[:count]]), A, parameters)
    U, s, Vt = np.linalg.svd(system[:, :-1], full_matrices=False)
    shown = s > VISIBLE * s.max(initial=0.0)
    U, s, Vt = U[:, shown], s[shown], Vt[shown]
    x = (model.theta / parameters.scales)[robot]
    rows = s[:, None] * Vt
    basis = np.zeros((len(parameters), len(s)))
    basis[robot] = Vt.T
    half = np.linalg.cholesky(_noise(result, problem, basis, U))
    values = rows @ x - U.T @ system[:, -1]
    return RobotEvidence(
        robot=robot_type(model.chains),
        names=tuple(np.array(parameters.names)[robot].tolist()),
        units=tuple(p.unit for p, own in zip(parameters, robot, strict=True) if own),
        scales=parameters.scales[robot],
        rows=np.linalg.solve(half, rows),
        values=np.linalg.solve(half, values),
    )


def _refusal(result: CalibrationResult) -> str:
    """Why a calibration tells nothing of its robot; empty where it does."""
    if result.model.setup.learned is not None:
        return "a calibration with a learned correction tells a fleet nothing"
    if not np.isfinite(result.fitted.after).any():
        return "the calibration does not say what was measured"
    if not result.statistics.noise:
        return "the calibration does not know its noise: its measurements are too few"
    return ""


def _noise(
    result: CalibrationResult, problem: Problem, basis: Floats, U: Floats
) -> Floats:
    """Covariance of the errors of whitened residual rows along columns, (r, r).

    Args:
        result: The calibration.
        problem: Its problem about the solution, in the units of its noise.
        basis: Directions of the robot that the rows see, shape (P, r).
        U: Orthonormal columns of the rows, shape (M, r).
    """
    layout, theta, parameters = problem.layout, result.model.theta, problem.parameters
    nuisances = np.eye(len(parameters))[:, parameters.free & parameters.nuisance]
    moved = Directions(nuisances, basis, basis[:, :0])
    effects = systematic(problem, theta, moved)
    count = len(layout.row)
    variances = np.ones(len(current_units(problem)))
    if effects is not None:
        variances = effects.noise
    shared = shared_variances(problem, result.statistics.noise, variances)
    of_row = np.ones(len(U))
    of_row[:count] = (variances - shared)[layout.component]
    Q = (U.T * of_row) @ U
    if shared.any():
        Q += by_configuration(problem, U, shared)
    if effects is not None:
        X = U[:count].T @ effects.rows(problem, theta)
        Q += X @ X.T
    return np.asarray(Q)
