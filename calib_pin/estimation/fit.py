"""One fit of one set of rows: register, choose the directions, solve, covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.directions import (
    Directions,
    half_covariance,
    practical_directions,
    robot_singular_values,
    rounding,
)
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.nominal import analyze_structure, register
from calib_pin.estimation.problem import EXACT, Problem, expecting
from calib_pin.estimation.robust.weights import robustly
from calib_pin.estimation.row_blocks import Expected
from calib_pin.estimation.shrinkage import Evidence, expected_errors
from calib_pin.estimation.solve import Solver, descend, least_squares, refine
from calib_pin.estimation.stages import Solution, Stages, judge
from calib_pin.estimation.statistics.systematic import systematic
from calib_pin.estimation.statistics.variance_components import variance_components
from calib_pin.estimation.unit_weights import balanced
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.mixed import contact_rows
from calib_pin.observations import states_sigmas
from calib_pin.progress import Progress
from calib_pin.solvers import LeastSquaresResult, Status

CLOSE = 1e-9
"""Part of the cost that a step must promise where a fit only checks another one: of
thousands of rows a thousandth of a standard deviation."""

EXPLAINED = 1e-18
"""Part of the cost of the nominal robot below which everything is explained."""

PULL = 0.01
"""Posterior deviations by which a parameter must want to leave its bound inwards: less
than anyone sees, and more than rounding or an unfinished iteration leaves."""


@serial_blas
def fit(
    problem: Problem,
    rng: np.random.Generator,
    *,
    progress: Progress | None = None,
) -> Fit:
    """Fit a problem with the solver of its setup.

    The robot moves only in directions that its structure shows at nominal geometry and
    that the rows can tell, judged by the standard deviation of unit weight. That is
    known after a fit only, so the choice is repeated until it stands; a better fit
    admits more directions, with noise-free rows in the end all of them. At the solution
    those are taken back that only looked determined from afar: a tool point that turns
    out to lie on the last axis, for one.

    Args:
        problem: The problem; its frames are registered here.
        rng: Random generator for the configurations of the structural analysis and
            for the search of a solver that has one.
        progress: Told how far such a search is.

    Raises:
        OptionError: If the setup names a solver or an option that does not exist.
    """
    solver = Solver(problem, rng, progress)

    def solve(problem: Problem) -> Fit:
        problem, before = register(problem, np.zeros(len(problem.parameters)))
        return _bounded(problem, lambda held: _fit(held, before, rng, solver))

    def described(problem: Problem) -> Fit:
        return _described(balanced(problem, solve, _again))

    return robustly(problem, described, rng)


def _again(fitted: Fit, units: Floats) -> Fit:
    """A fit in other units from where it stands, in the directions that it moved."""
    problem, parameters = (
        replace(fitted.problem, units=units),
        fitted.problem.parameters,
    )
    frames = np.diag(parameters.scales)[:, parameters.free & parameters.nuisance]
    before = least_squares(problem, fitted.before, frames)
    found = descend(problem, fitted.directions, fitted.theta)
    last = judge(problem, fitted.directions, found)
    evidence, result = _shrunk(problem, last, 1.0)
    return replace(
        fitted,
        problem=problem,
        before=before.x,
        result=replace(
            result,
            nit=fitted.result.nit + before.nit + result.nit,
            nfev=fitted.result.nfev + before.nfev + result.nfev,
        ),
        sigma0=last.sigma0,
        evidence=evidence,
        unit=1.0,
        singular_values=robot_singular_values(
            last.directions, last.result.jac, parameters
        ),
    )


@serial_blas
def refitted(fitted: Fit, kept: NDArray[np.bool_]) -> Fit | None:
    """A fit of some of the rows of another, from where that stands.

    What all rows say of noise, directions and the size of errors holds for it.

    Args:
        fitted: The fit.
        kept: The rows to fit, shape (N,), none of them set aside.

    Returns:
        The fit; None where it takes a fit from the start: without some target, with
        bounds, after a search.
    """
    whole, parameters = fitted.problem, fitted.problem.parameters
    rows = whole.data.rows(kept)
    complete = set(rows.target) == set(whole.data.target)
    bounded = np.isfinite(parameters.bounds).any() or whole.many
    plain = fitted.solver == "gauss-newton" and fitted.result.status.success
    if not (complete and plain and fitted.noise) or bounded:
        return None
    problem, (held, result, moved) = replace(whole, data=rows), fitted.held
    scales = parameters.scales
    frames = np.diag(scales)[:, parameters.free & parameters.nuisance]

    def again(
        some: Problem, x: Floats, known: tuple[Floats, Floats], basis: Floats
    ) -> LeastSquaresResult:
        # The first step is known from the rows of the whole.
        count = len(kept) * whole.components
        own = np.ones(len(known[0]), bool)
        own[:count] = np.repeat(kept, whole.components)
        r, J = (part[own] for part in known)
        start = x - basis @ np.linalg.lstsq(J @ basis, r, rcond=None)[0]
        return refine(some, start, basis, CLOSE)

    before = again(problem, fitted.before, fitted.registered, frames)
    found = again(
        replace(held, data=rows),
        fitted.theta,
        (result.fun, result.jac),
        scales[:, None] * moved,
    )
    return replace(
        fitted,
        problem=problem,
        before=before.x,
        result=_without_prior(problem, held.expected, found),
        effects=None,
        outliers=(),
        squared=None,
    )


def _without_prior(
    problem: Problem, expected: Expected | None, found: LeastSquaresResult
) -> LeastSquaresResult:
    """A solution without the rows of an expected size; they stand before priors."""
    if expected is None:
        return found
    if problem.many:
        fun, jac = problem.factorize(found.x)
    else:
        start = len(found.fun) - problem.priors - len(expected)
        own = np.r_[0:start, start + len(expected) : len(found.fun)]
        fun, jac = found.fun[own], found.jac[own]
    return replace(found, fun=fun, jac=jac, cost=0.5 * float(fun @ fun))


def _described(fitted: Fit) -> Fit:
    """A fit with the noise of its quantities."""
    if not fitted.dof > 0 or not fitted.unit > EXACT:
        return fitted
    return replace(fitted, noise=variance_components(*fitted.held))


@serial_blas
def with_effects(fitted: Fit) -> Fit:
    """A fit that knows what gears and compliance left in its residuals."""
    if not fitted.noise:
        return fitted
    effects = systematic(fitted.problem, fitted.theta, fitted.directions)
    return replace(fitted, effects=effects)


def _fit(
    problem: Problem,
    before: LeastSquaresResult,
    rng: np.random.Generator,
    solver: Solver,
) -> Fit:
    """Fit a registered problem from its registration, without regard to bounds."""
    parameters = problem.parameters
    nominal = np.where(parameters.free, before.x, 0.0)
    for position, value in problem.held_at.items():
        nominal[position] = value
    r, J = before.fun, before.jac
    if problem.held_at:
        r, J = problem.linearize(nominal)
    about = np.zeros(len(parameters))
    if contact_rows(problem.measurement, problem.data.target).any():
        # What is touched must be where the tool can touch it.
        about = np.where(parameters.nuisance, nominal, 0.0)
    found, visible = analyze_structure(problem, about, rng)
    stages = Stages(problem, solver, nominal)

    def choose(sigma0: float | None) -> Directions:
        known = (J, r)
        if problem.many and stages.solutions:
            # The start had half the digits; at the solution there are all of them.
            known = (stages.solutions[-1].result.jac, stages.solutions[-1].result.fun)
        return practical_directions(*known, problem.count, parameters, visible, sigma0)

    # A search takes errors for which the linear prediction of sigma0 is no good.
    stages.grow(choose(0.0 if solver.searches else None), choose)
    stages.prune()
    stages.extend(EXPLAINED * before.cost)

    solutions = stages.solutions
    last = solutions[-1]
    unit = last.sigma0
    if len(problem.units) or (states_sigmas(problem.data) and not np.isfinite(unit)):
        unit = 1.0
    evidence, result = _shrunk(problem, last, unit)
    found_by = [solution.found for solution in reversed(solutions)]
    searched = next((found for found in found_by if found.evolution), found_by[0])
    return Fit(
        problem=problem,
        before=before.x,
        structure=found,
        directions=last.directions,
        evidence=evidence,
        unit=unit,
        result=replace(
            result,
            nit=before.nit + stages.nit,
            nfev=before.nfev + stages.nfev,
        ),
        rank=last.rank,
        sigma0=last.sigma0,
        singular_values=robot_singular_values(
            last.directions, last.result.jac, parameters
        ),
        revealed=stages.revealed,
        solver=solver.name,
        evaluator=searched.evaluator,
        evolution=searched.evolution,
    )


def _bounded(problem: Problem, run: Callable[[Problem], Fit]) -> Fit:
    """Fit under the bounds of the parameters.

    A parameter that runs out of its bounds is held there and leaves the set, so that
    the directions are chosen anew without it: another member of its group may take
    over what it must not. It is let go once if the cost pulls it back inside.
    """
    lower, upper = problem.parameters.bounds
    released: set[int] = set()
    fitted = run(problem)
    while True:
        held, x = fitted.problem, fitted.theta
        excess = np.maximum(lower - x, x - upper) / held.parameters.scales
        excess[~held.parameters.free] = 0.0
        if excess.max(initial=0.0) > 0.0:
            # The worst ones together: the others may come back inside without them.
            worst = np.flatnonzero(excess > 0.5 * excess.max())
            bounds = np.clip(x, lower, upper)
            more = {int(k): float(bounds[k]) for k in worst}
            fitted = run(replace(held, held_at={**held.held_at, **more}))
            continue
        pulls = _pulls(fitted)
        inward = {
            k
            for k, value in held.held_at.items()
            if k not in released
            and (pulls[k] if value == upper[k] else -pulls[k]) > PULL
        }
        if not inward:
            return fitted
        released |= inward
        kept = {k: v for k, v in held.held_at.items() if k not in inward}
        fitted = run(replace(held, held_at=kept))


def _pulls(fitted: Fit) -> dict[int, float]:
    """How far the cost wants held parameters to fall, in their posterior deviations.

    With the moved directions projected out of its column, a parameter let go would
    move by gradient / curvature, and would have the deviation sigma0 / curvature^0.5.
    """
    problem, result = fitted.problem, fitted.result
    held = list(problem.held_at)
    basis = fitted.directions.basis
    moved = result.jac @ half_covariance(result.jac, basis, problem.parameters)
    columns = result.jac[:, held]
    alone = columns - moved @ (moved.T @ columns)
    size = np.linalg.norm(alone, axis=0)
    # Where the moved directions can do what it does, rounding is left.
    seen = size > rounding(result.jac) * np.linalg.norm(columns, axis=0)
    unit = size * max(np.nan_to_num(fitted.sigma0), 1e-300)
    pulls = np.where(seen, result.fun @ alone / np.where(seen, unit, 1.0), 0.0)
    return dict(zip(held, pulls.tolist(), strict=True))


def _shrunk(
    problem: Problem, last: Solution, unit: float
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
        last.directions, problem.parameters, found.x, found.fun, found.jac, unit
    )
    # A search that was cut short, or met far from a minimum, stays what it is.
    led = Status.CONVERGED, Status.ITERATIONS, Status.STALLED
    if not evidence.matters or found.status not in led:
        return replace(evidence, matters=False), found
    # Whitened like the rows, whose unit weight is not in their standard deviations.
    expected = replace(evidence.expected, size=evidence.expected.size / unit)
    basis = problem.parameters.scales[:, None] * last.directions.every
    shrunk = refine(expecting(problem, expected), found.x, basis)
    return evidence, replace(
        _without_prior(problem, expected, shrunk),
        nit=found.nit + shrunk.nit,
        nfev=found.nfev + shrunk.nfev,
    )
