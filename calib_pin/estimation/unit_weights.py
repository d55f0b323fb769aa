"""Fits and estimates of their unit weights, alternated until these stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import EXACT, Problem
from calib_pin.estimation.statistics.variance_components import (
    component_units,
    units,
    variance_components,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import Status

STANDS = 0.01
"""Change of the ratios of unit weights at which they stand: a third of the deviation
with which five hundred values tell one, and a change of no weight that matters."""

LIKE = 1.5
"""Logarithm of the change of a ratio up to which a fit goes on where it stands, in the
directions that it has chosen."""

ROUNDS = 6
"""Most fits of an alternation; two are usual."""


def balanced(
    problem: Problem,
    solve: Callable[[Problem], Fit],
    solve_again: Callable[[Fit, Floats], Fit],
) -> Fit:
    """Alternate fits and estimates of unit weights until their ratios stand.

    A common factor of all rows changes no solution where nothing else is known; then
    the fit is converted, not repeated.

    Args:
        problem: The problem.
        solve: Fits a problem with given units; is called once where there is one
            quantity and there are neither known distances nor priors.
        solve_again: Fits the problem of a fit in other units, shape (d,), that are
            `LIKE` its own.
    """
    fitted = solve(problem)
    for _ in range(ROUNDS):
        if not (fitted.dof > 0 and fitted.sigma0 > EXACT):
            return fitted
        components = variance_components(*fitted.held)
        current = component_units(fitted.problem)
        change = units(components, problem) / current
        common = 1.0
        if len(fitted.problem.further) == 0:
            common = float(np.exp(np.mean(np.log(change))))
        relative = np.abs(np.log(change / common)).max()
        # A search that was cut short, or told when to end, is not carried on.
        if relative < STANDS or fitted.result.status is not Status.CONVERGED:
            return _converted(fitted, common)
        if relative < LIKE:
            fitted = solve_again(fitted, current * change)
        else:
            fitted = solve(replace(problem, units=current * change))
    return fitted


def _converted(fitted: Fit, factor: float) -> Fit:
    """A fit in units that are all multiplied by one factor."""
    result = fitted.result
    return replace(
        fitted,
        problem=replace(fitted.problem, units=factor * component_units(fitted.problem)),
        result=replace(
            result,
            fun=result.fun / factor,
            jac=result.jac / factor,
            cost=result.cost / factor**2,
        ),
        sigma0=fitted.sigma0 / factor,
        unit=1.0,
        singular_values=fitted.singular_values / factor,
    )
