"""One fit of one set of rows: register, choose the directions, solve, covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.identifiability import (
    Directions,
    Structure,
    practical_directions,
    pruned,
    structure,
    visible_directions,
)
from calib_pin.parameters import ParameterSet
from calib_pin.problem import Problem, observable_configurations
from calib_pin.solvers import LeastSquaresResult, gauss_newton
from calib_pin.spatial import Floats

__all__ = ["Fit", "analyze_structure", "fit", "register"]


@dataclass(frozen=True)
class Fit:
    """A fitted problem.

    Attributes:
        problem: The problem about its registered references.
        before: Parameters with only the nuisances fitted, shape (P,).
        structure: Structural analysis at nominal geometry.
        directions: The directions that were moved and those left at nominal.
        result: Outcome of the solver.
        rank: Practical rank: nuisance and robot directions that were estimated.
        sigma0: Standard deviation of unit weight; NaN without redundancy.
        covariance: Of the parameters, shape (P, P); that of the stated sigmas where
            the data have them, else scaled by sigma0.
        singular_values: Of the whitened, scaled Jacobian of the estimated robot
            directions at the solution with the nuisances projected out, descending.
    """

    problem: Problem
    before: Floats
    structure: Structure
    directions: Directions
    result: LeastSquaresResult
    rank: int
    sigma0: float
    covariance: Floats
    singular_values: Floats

    @property
    def theta(self) -> Floats:
        """Parameter values, shape (P,)."""
        return self.result.x

    @property
    def dof(self) -> int:
        """Residual components minus the rank."""
        return len(self.result.fun) - self.rank


def fit(
    problem: Problem,
    rng: np.random.Generator,
    *,
    callback: Callable[[int, float], None] | None = None,
) -> Fit:
    """Fit a problem.

    The robot moves only in directions that its structure shows at nominal geometry and
    that the rows can tell, judged by the standard deviation of unit weight. That is
    known after a fit only, so the choice is repeated until it stands; a better fit
    admits more directions, with noise-free rows in the end all of them. At the solution
    those are taken back that only looked determined from afar: a tool point that turns
    out to lie on the last axis, for one.

    Args:
        problem: The problem; its frames are registered here.
        rng: Random generator for the configurations of the structural analysis.
        callback: Called with the step count and the cost after each step.
    """
    problem, before = register(problem, np.zeros(len(problem.parameters)))
    parameters, bounds = problem.parameters, _bounds(problem)
    scale = parameters.scales[:, None]
    found, visible = analyze_structure(problem, np.zeros(len(parameters)), rng)

    directions = practical_directions(before.jac, before.fun, parameters, visible)
    start, pruning = before.x, False
    tried = {directions.basis.shape[1]}
    steps, evaluations = before.nit, before.nfev
    while True:
        result = gauss_newton(
            problem.linearize,
            problem.residual,
            start,
            scale * directions.basis,
            bounds=bounds,
            callback=callback,
        )
        steps, evaluations = steps + result.nit, evaluations + result.nfev
        moved = _unbounded(scale * directions.basis, result.active)
        J = np.linalg.qr(result.jac @ moved, mode="r")
        _, s, Vt = np.linalg.svd(J, full_matrices=False)
        rank = int((s > 1e-12 * s[0]).sum()) if len(s) else 0
        dof = len(result.fun) - rank
        if dof <= 0:
            sigma0 = np.nan
            break
        sigma0 = float(np.sqrt(2.0 * result.cost / dof))
        again = directions
        if not pruning:
            again = practical_directions(
                before.jac, before.fun, parameters, visible, sigma0
            )
            pruning = again.basis.shape[1] in tried
            tried.add(again.basis.shape[1])
        if pruning:
            again = pruned(directions, result.jac, parameters, sigma0)
        if again.basis.shape[1] == directions.basis.shape[1]:
            break
        # Directions that were taken back return to nominal.
        kept = again.basis @ (again.basis.T @ (result.x[:, None] / scale))
        start = np.where(parameters.nuisance, result.x, (scale * kept)[:, 0])
        directions = again

    half = moved @ (Vt[:rank].T / s[:rank])
    weight = 1.0 if problem.data.sigma is not None else sigma0**2
    return Fit(
        problem=problem,
        before=before.x,
        structure=found,
        directions=directions,
        result=replace(result, nit=steps, nfev=evaluations),
        rank=rank,
        sigma0=sigma0,
        covariance=weight * half @ half.T,
        singular_values=_robot_singular_values(result.jac, moved, parameters),
    )


def register(problem: Problem, theta: Floats) -> tuple[Problem, LeastSquaresResult]:
    """Fit only base, tool and instrument; the robot keeps its values.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,); those of the robot count.

    Returns:
        The problem about its registered references and the least-squares result.
    """
    parameters = problem.parameters
    problem = problem.register(theta)
    start = np.where(parameters.nuisance, 0.0, theta)
    free = parameters.free & parameters.nuisance
    return problem, gauss_newton(
        problem.linearize,
        problem.residual,
        start,
        np.diag(parameters.scales)[:, free],
        bounds=_bounds(problem),
    )


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
    components = problem.measurement.quantities[-1].columns.stop
    count = max(50, -(-3 * len(problem.parameters) // components))
    q, target = observable_configurations(problem, theta, count, rng)
    _, J = problem.about(theta, q, target).linearize(theta)
    rows = count * components
    return (
        structure(J[:rows], problem.parameters),
        visible_directions(J, problem.parameters),
    )


def _bounds(problem: Problem) -> tuple[Floats, Floats] | None:
    bounds = problem.parameters.bounds
    return bounds if np.isfinite(bounds).any() else None


def _unbounded(basis: Floats, active: tuple[int, ...]) -> Floats:
    """Directions of a basis that leave the parameters at their bounds in place."""
    if not active:
        return basis
    _, s, Vt = np.linalg.svd(basis[list(active)])
    return np.asarray(basis @ Vt[int((s > 1e-12 * s[0]).sum()) :].T)


def _robot_singular_values(
    J: Floats, moved: Floats, parameters: ParameterSet
) -> Floats:
    """Singular values of the moved robot directions, the nuisances projected out."""
    nuisance = parameters.free & parameters.nuisance
    U, s, _ = np.linalg.svd(
        J[:, nuisance] * parameters.scales[nuisance], full_matrices=False
    )
    U = U[:, s > 1e-12 * s.max(initial=0.0)]
    # Nuisances may be mixed in where a bound ties them to the robot.
    directions = np.where(parameters.nuisance[:, None], 0.0, moved)
    robot = J @ directions[:, np.abs(directions).max(axis=0, initial=0.0) > 0.0]
    return np.asarray(np.linalg.svd(robot - U @ (U.T @ robot), compute_uv=False))
