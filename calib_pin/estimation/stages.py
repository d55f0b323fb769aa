"""The least squares of a registered problem, and the errors that are most likely.

The robot moves only in directions that its structure shows at nominal geometry and that
the measurements can tell, judged by the standard deviation of unit weight. That is
known after a fit only, so the choice is repeated until it stands; a better fit admits
more directions, with noise-free measurements in the end all of them. At the solution
those are taken back that only looked determined from afar (a tool point that turns out
to lie on the last axis, for one), and those added that the errors themselves have made
visible.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.directions import (
    RANK,
    Directions,
    appearing,
    nuisance_basis,
    practical_directions,
    pruned,
    robot_singular_values,
    visible_directions,
)
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.estimation.places import expected_places
from calib_pin.estimation.problem import EXACT, Problem, absorbed, known_count
from calib_pin.estimation.row_blocks import Expected
from calib_pin.estimation.shrinkage import Evidence, expected_errors
from calib_pin.estimation.solve import Solution, Solver, descend, least_squares, refine
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import states_sigmas
from calib_pin.solvers import LeastSquaresResult, Status

SURPRISE = 10.0
"""Gain in chi-square per direction beyond what chance gives once in six hundred."""

EXPLAINED = 1e-18
"""Part of the cost of the nominal robot below which everything is explained."""


def fit_in_stages(problem: Problem, before: LeastSquaresResult, solver: Solver) -> Fit:
    """Fit a registered problem, without regard to bounds.

    Args:
        problem: The problem.
        before: Its registration with the robot at nominal.
        solver: The solver.
    """
    stages = _Stages(problem, before, solver)
    stages.grow()
    stages.prune()
    stages.extend(EXPLAINED * before.cost)
    last = stages.last
    unit = last.sigma0
    if len(problem.units) or (states_sigmas(problem.data) and not np.isfinite(unit)):
        unit = 1.0
    evidence, result = _shrunk(problem, last, unit)
    found = [stage.solution for stage in reversed(stages.stages)]
    searched = next((solution for solution in found if solution.evolution), found[0])
    return Fit(
        problem=problem,
        before=before.x,
        structure=stages.structure,
        directions=last.directions,
        solution=replace(
            searched,
            result=replace(
                result, nit=before.nit + stages.nit, nfev=before.nfev + stages.nfev
            ),
        ),
        rank=last.rank,
        sigma0=last.sigma0,
        evidence=evidence,
        unit=unit,
        singular_values=last.singular_values(problem),
    )


def fit_in_units(fitted: Fit, units: Floats) -> Fit:
    """A fit in other units, shape (d,), in its directions from where it stands."""
    problem, first = replace(fitted.problem, units=units), fitted.result
    before = least_squares(problem, fitted.before, nuisance_basis(problem.parameters))
    solution = descend(problem, fitted.directions, fitted.theta)
    last = _judged(problem, fitted.directions, solution)
    evidence, result = _shrunk(problem, last, 1.0)
    result = replace(
        result,
        nit=first.nit + before.nit + result.nit,
        nfev=first.nfev + before.nfev + result.nfev,
    )
    return replace(
        fitted,
        problem=problem,
        before=before.x,
        solution=replace(fitted.solution, result=result),
        sigma0=last.sigma0,
        evidence=evidence,
        unit=1.0,
        singular_values=last.singular_values(problem),
    )


@dataclass(frozen=True)
class _Stage:
    """A solution in given directions, with what its Jacobian says of them.

    Attributes:
        directions: The directions.
        solution: The solution.
        rank: Rank of the Jacobian in the directions.
        sigma0: Standard deviation of unit weight; NaN without redundancy.
    """

    directions: Directions
    solution: Solution
    rank: int
    sigma0: float

    @property
    def result(self) -> LeastSquaresResult:
        """Outcome of the solver."""
        return self.solution.result

    def singular_values(self, problem: Problem) -> Floats:
        """Singular values of the moved robot directions, descending."""
        parameters = problem.parameters
        return robot_singular_values(self.directions, self.result.jac, parameters)


def _judged(problem: Problem, directions: Directions, solution: Solution) -> _Stage:
    """Rank and standard deviation of unit weight of a solution."""
    result = solution.result
    basis = problem.parameters.scales[:, None] * directions.basis
    triangle = np.linalg.qr(result.jac @ basis, mode="r")
    s = np.linalg.svd(triangle, compute_uv=False)
    rank = int((s > RANK * s.max(initial=0.0)).sum())
    rank += absorbed(problem)
    dof = known_count(problem) - rank
    sigma0 = float(np.sqrt(2.0 * result.cost / dof)) if dof > 0 else np.nan
    return _Stage(directions, solution, rank, sigma0)


class _Stages:
    """Solutions in one choice of directions after the other; the last one counts.

    Args:
        problem: The registered problem.
        before: Its registration with the robot at nominal.
        solver: The solver.
    """

    def __init__(
        self, problem: Problem, before: LeastSquaresResult, solver: Solver
    ) -> None:
        parameters = problem.parameters
        nominal = np.where(parameters.free, before.x, 0.0)
        for position, value in problem.held_at.items():
            nominal[position] = value
        self._start = before.jac, before.fun
        if problem.held_at:
            r, J = problem.linearize(nominal)
            self._start = J, r
        about = np.zeros(len(parameters))
        terms = problem.terms.values()
        if any(term.measurement.declaration.contact for term in terms):
            # What is touched must be where the tool can touch it.
            about = np.where(parameters.nuisance, nominal, 0.0)
        self.structure, J = analyze_structure(problem, about, solver.rng)
        self._visible = visible_directions(J, parameters)
        self.stages: list[_Stage] = []
        self.nit = self.nfev = 0
        self._problem, self._solver, self._nominal = problem, solver, nominal

    @property
    def last(self) -> _Stage:
        """The stage that counts."""
        return self.stages[-1]

    def grow(self) -> None:
        """Solve and choose anew by what the fit says of sigma0, until that stands."""
        # A search takes errors for which the linear prediction of sigma0 is no good.
        directions = self._chosen(0.0 if self._solver.searches else None)
        tried: set[int] = set()
        while directions.count not in tried:
            tried.add(directions.count)
            sigma0 = self._solve(directions).sigma0
            if np.isfinite(sigma0):
                directions = self._chosen(sigma0)

    def prune(self) -> None:
        """Take directions back that only looked determined from afar."""
        parameters = self._problem.parameters
        while np.isfinite((last := self.last).sigma0):
            directions = pruned(
                last.directions, last.result.jac, parameters, last.sigma0
            )
            if directions.count == last.directions.count:
                break
            self._solve(directions)

    def extend(self, negligible: float) -> None:
        """Move directions that the errors have made visible, if that explains much.

        With noise, errors of their expected size explain nothing, and the robot stays
        within the directions of its nominal geometry.

        Args:
            negligible: Cost that rounding leaves of exact rows.
        """
        last, problem = self.last, self._problem
        if not np.isfinite(last.sigma0) or last.result.cost <= negligible:
            return
        more, promised = appearing(
            last.directions,
            last.result.jac,
            last.result.fun,
            problem.parameters,
            last.sigma0,
        )
        surprise = SURPRISE * more.shape[1]
        # What they explain no longer counts as noise.
        rest = 2.0 * last.result.cost - promised
        if promised * (known_count(problem) - last.rank) <= surprise * rest:
            return
        robot = np.column_stack([last.directions.robot, more])
        directions = replace(last.directions, robot=robot, revealed=more.shape[1])
        # Here Gauss-Newton tells what there is to gain, whatever the solver.
        found = self._counted(directions, descend(problem, directions, last.result.x))
        gain = 2.0 * (last.result.cost - found.result.cost)
        if gain > surprise * found.sigma0**2:
            if self._solver.name == "de":
                self._solve(directions)
            else:
                self.stages.append(found)

    def _chosen(self, sigma0: float | None) -> Directions:
        """The directions that the measurements tell at a deviation of unit weight."""
        J, r = self._start
        count = known_count(self._problem) - absorbed(self._problem)
        parameters = self._problem.parameters
        return practical_directions(J, r, count, parameters, self._visible, sigma0)

    def _solve(self, directions: Directions) -> _Stage:
        previous = None
        if self.stages:
            # Within other directions; the rest returns to nominal.
            x, parameters = self.last.result.x, self._problem.parameters
            kept = directions.basis @ (directions.basis.T @ (x / parameters.scales))
            stay = parameters.nuisance | ~parameters.free
            previous = np.where(stay, x, parameters.scales * kept)
        found = self._solver.solve(self._problem, directions, self._nominal, previous)
        if not np.isfinite(found.result.cost):
            # Without some directions, points may be behind a camera there.
            found = self._solver.solve(self._problem, directions, self._nominal, None)
        self.stages.append(self._counted(directions, found))
        return self.last

    def _counted(self, directions: Directions, found: Solution) -> _Stage:
        self.nit += found.result.nit
        self.nfev += found.result.nfev
        return _judged(self._problem, directions, found)


def _shrunk(
    problem: Problem, last: _Stage, unit: float
) -> tuple[Evidence | None, LeastSquaresResult]:
    """The mode of the posterior from the least squares, and the evidence for it.

    Args:
        problem: The registered problem.
        last: The least squares.
        unit: Standard deviation of unit weight.

    Returns:
        The evidence, None where the rows are exact or tell nothing, and the solution;
        its residual and Jacobian are without the rows of the prior.
    """
    found = last.result
    if not unit > EXACT or last.rank == 0:
        return None, found
    evidence = expected_errors(
        last.directions,
        problem.parameters,
        found.x,
        found.fun,
        found.jac,
        unit,
        expected_places(problem, problem.parameters),
    )
    # A search that was cut short, or met far from a minimum, stays what it is.
    led = Status.CONVERGED, Status.ITERATIONS, Status.STALLED
    if not evidence.matters or found.status not in led:
        return replace(evidence, matters=False), found
    # Whitened like the rows, whose unit weight is not in their standard deviations.
    expected = replace(evidence.expected, sizes=evidence.expected.sizes / unit)
    basis = problem.parameters.scales[:, None] * last.directions.every
    shrunk = refine(replace(problem, expected=expected), found.x, basis)
    return evidence, replace(
        without_prior(problem, expected, shrunk),
        nit=found.nit + shrunk.nit,
        nfev=found.nfev + shrunk.nfev,
    )


def without_prior(
    problem: Problem, expected: Expected | None, found: LeastSquaresResult
) -> LeastSquaresResult:
    """A solution without the rows of an expected size; they stand before priors."""
    if expected is None:
        return found
    start = len(found.fun) - len(problem.further.priors) - len(expected)
    own = np.r_[0:start, start + len(expected) : len(found.fun)]
    fun, jac = found.fun[own], found.jac[own]
    return replace(found, fun=fun, jac=jac, cost=0.5 * float(fun @ fun))
