"""The nominal robot: its frames fitted, and its structure at random configurations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.configurations import asked, observable_configurations
from calib_pin.estimation.directions import nuisance_basis, visible_directions
from calib_pin.estimation.identifiability import Structure, structure
from calib_pin.estimation.problem import Problem, sigma_at
from calib_pin.estimation.registration import registered
from calib_pin.estimation.scale import scale_observable
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.tool_poses import Configured
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import LeastSquaresResult


@serial_blas
def register(problem: Problem, theta: Floats) -> tuple[Problem, LeastSquaresResult]:
    """Fit only base, tool and instrument; the robot keeps its values.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,); those of the robot count.

    Returns:
        The problem about its registered references and the least-squares result.
    """
    parameters = problem.parameters
    problem = registered(problem, theta)
    start = np.where(parameters.nuisance, 0.0, theta)
    return problem, least_squares(problem, start, nuisance_basis(parameters))


@serial_blas
def analyze_structure(
    problem: Problem, theta: Floats, rng: np.random.Generator
) -> tuple[Structure, Floats]:
    """Structure at zero robot errors over random configurations.

    Args:
        problem: The problem about its registered references.
        theta: Parameter values with the robot at nominal, shape (P,).
        rng: Random generator.

    Returns:
        The structure of the data alone, and the directions that the data or a prior
        let the robot move in, shape (P, r).
    """
    # Mixed rows have only a part of the components each.
    least = min(
        q.columns.stop - q.columns.start for q in problem.measurement.quantities
    )
    count = max(50, -(-3 * len(problem.parameters) // least))
    q, target = observable_configurations(problem, theta, count, rng)
    found, J = structure_at(problem, theta, q, target)
    return found, visible_directions(J, problem.parameters)


@serial_blas
def structure_at(
    problem: Problem, theta: Floats, q: Floats, target: Sequence[str]
) -> tuple[Structure, Floats]:
    """Structure at zero robot errors of given configurations.

    Args:
        problem: The problem about its registered references.
        theta: Parameter values with the robot at nominal, shape (P,).
        q: Configurations, shape (K, n) [rad, m].
        target: Target of each.

    Returns:
        The structure, and the whitened Jacobian with the rows of the priors, (M, P).
    """
    at = asked(problem, q, target)
    J = jacobian_at(problem, theta, at)
    found = structure(J[: len(J) - problem.priors], problem.parameters, len(q))
    return replace(found, scaled=scale_observable(problem, theta, at, J)), J


def jacobian_at(problem: Problem, theta: Floats, at: Configured) -> Floats:
    """Whitened Jacobian of noise-free measurements and of all further rows, (M, P).

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        at: The configurations.
    """
    J = problem.jacobian(theta, at, sigma_at(problem, at.target))
    rows = J.reshape(-1, len(theta))
    return np.concatenate([rows, problem.further.jacobian(theta)])
