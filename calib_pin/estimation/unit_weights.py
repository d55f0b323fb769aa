"""Fits under bounds, alternating with estimates of their unit weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.estimation.directions import half_covariance, rounding
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import EXACT, Problem
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.stages import fit_in_stages, fit_in_units
from calib_pin.estimation.statistics.variance_components import (
    current_units,
    variance_components,
)
from calib_pin.solvers import Status

STANDS = 0.01
"""Change of the ratios of unit weights at which they stand: a third of the deviation
with which five hundred values tell one, and a change of no weight that matters."""

LIKE = 1.5
"""Logarithm of the change of a ratio up to which a fit goes on where it stands, in the
directions that it has chosen."""

ROUNDS = 6
"""Most fits of an alternation; two are usual."""

PULL = 0.01
"""Posterior deviations by which a parameter must want to leave its bound inwards: less
than anyone sees, and more than rounding or an unfinished iteration leaves."""


def balanced(problem: Problem, solver: Solver) -> Fit:
    """Alternate fits and estimates of unit weights until their ratios stand.

    A common factor of all measurements changes no solution where nothing else is known;
    then the fit is converted, not repeated.

    Args:
        problem: The problem, not registered.
        solver: The solver.

    Returns:
        The fit, with the noise of its quantities.
    """
    fitted = bounded(problem, solver)
    for _ in range(ROUNDS):
        if not (fitted.dof > 0 and fitted.sigma0 > EXACT):
            break
        current = current_units(fitted.problem)
        noise = variance_components(*fitted.held)
        change = np.array([one.factor for one in noise]) / current
        common = 1.0
        if len(fitted.problem.further) == 0:
            common = float(np.exp(np.mean(np.log(change))))
        relative = np.abs(np.log(change / common)).max()
        # A search that was cut short, or told when to end, is not carried on.
        if relative < STANDS or fitted.result.status is not Status.CONVERGED:
            fitted = _converted(fitted, common)
            break
        if relative < LIKE:
            fitted = fit_in_units(fitted, current * change)
        else:
            fitted = bounded(replace(problem, units=current * change), solver)
    if fitted.dof > 0 and fitted.unit > EXACT:
        fitted = replace(fitted, noise=variance_components(*fitted.held))
    return fitted


def _converted(fitted: Fit, factor: float) -> Fit:
    """A fit in units that are all multiplied by one factor."""
    result = fitted.result
    result = replace(
        result,
        fun=result.fun / factor,
        jac=result.jac / factor,
        cost=result.cost / factor**2,
    )
    return replace(
        fitted,
        problem=replace(fitted.problem, units=factor * current_units(fitted.problem)),
        solution=replace(fitted.solution, result=result),
        sigma0=fitted.sigma0 / factor,
        unit=1.0,
        singular_values=fitted.singular_values / factor,
    )


def bounded(problem: Problem, solver: Solver) -> Fit:
    """Register a problem and fit it under the bounds of its parameters.

    A parameter that runs out of its bounds is held there and leaves the set, so that
    the directions are chosen anew without it: another member of its group may take
    over what it must not. It is let go once if the cost pulls it back inside.
    """
    problem, before = register(problem, np.zeros(len(problem.parameters)))
    lower, upper = problem.parameters.bounds
    released: set[int] = set()
    fitted = fit_in_stages(problem, before, solver)
    while True:
        held, x = fitted.problem, fitted.theta
        excess = np.maximum(lower - x, x - upper) / held.parameters.scales
        excess[~held.parameters.free] = 0.0
        if excess.max(initial=0.0) > 0.0:
            # The worst ones together: the others may come back inside without them.
            worst = np.flatnonzero(excess > 0.5 * excess.max())
            bounds = np.clip(x, lower, upper)
            more = {int(k): float(bounds[k]) for k in worst}
            held = replace(held, held_at={**held.held_at, **more})
            fitted = fit_in_stages(held, before, solver)
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
        fitted = fit_in_stages(replace(held, held_at=kept), before, solver)


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
