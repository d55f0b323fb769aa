"""One fit of one set of measurements: robust, balanced, bounded, least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.directions import nuisance_basis
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robust.weights import robustly
from calib_pin.estimation.solve import Solver, refine
from calib_pin.estimation.stages import without_prior
from calib_pin.estimation.statistics.systematic import systematic
from calib_pin.kinematics.spatial import Floats
from calib_pin.progress import Progress
from calib_pin.solvers import LeastSquaresResult

CLOSE = 1e-9
"""Part of the cost that a step must promise where a fit only checks another one: of
thousands of measurements a thousandth of a standard deviation."""


@serial_blas
def fit(
    problem: Problem,
    rng: np.random.Generator,
    *,
    progress: Progress | None = None,
) -> Fit:
    """Fit a problem with the solver and the loss of its setup.

    Args:
        problem: The problem; its frames are registered here.
        rng: Random generator for the configurations of the structural analysis, for
            the search of a solver that has one, and for robust registration.
        progress: Told how far such a search is.

    Raises:
        OptionError: If the setup names a solver, an option or a loss that does not
            exist.
    """
    return robustly(problem, Solver(problem, rng, progress))


@serial_blas
def refitted(fitted: Fit, kept: NDArray[np.bool_]) -> Fit | None:
    """A fit of some of the measurements of another, from where that stands.

    What all of them say of noise, directions and the size of errors holds for it.

    Args:
        fitted: The fit.
        kept: The measurements to fit, shape (N,), none of them set aside.

    Returns:
        The fit; None where it takes a fit from the start: without some target, with
        bounds, after a search.
    """
    whole, parameters = fitted.problem, fitted.problem.parameters
    rows = whole.data.rows(kept)
    complete = set(rows.target) == set(whole.data.target)
    bounded = np.isfinite(parameters.bounds).any() or whole.many
    plain = whole.setup.solver.name == "gauss-newton" and fitted.result.status.success
    if not (complete and plain and fitted.noise) or bounded:
        return None
    problem, (held, result, moved) = replace(whole, data=rows), fitted.held

    def again(
        some: Problem, x: Floats, known: tuple[Floats, Floats], basis: Floats
    ) -> LeastSquaresResult:
        # The first step is known from the residual rows of the whole.
        count = len(kept) * whole.components
        own = np.ones(len(known[0]), bool)
        own[:count] = np.repeat(kept, whole.components)
        r, J = (part[own] for part in known)
        start = x - basis @ np.linalg.lstsq(J @ basis, r, rcond=None)[0]
        return refine(some, start, basis, CLOSE)

    frames = nuisance_basis(parameters)
    before = again(problem, fitted.before, fitted.registered, frames)
    found = again(
        replace(held, data=rows),
        fitted.theta,
        (result.fun, result.jac),
        parameters.scales[:, None] * moved,
    )
    return replace(
        fitted,
        problem=problem,
        before=before.x,
        solution=replace(
            fitted.solution, result=without_prior(problem, held.expected, found)
        ),
        effects=None,
        robust=replace(fitted.robust, outliers=(), squared=None),
    )


@serial_blas
def with_effects(fitted: Fit) -> Fit:
    """A fit that knows what gears and compliance left in its residuals."""
    if not fitted.noise:
        return fitted
    effects = systematic(fitted.problem, fitted.theta, fitted.directions)
    return replace(fitted, effects=effects)
