"""Fits of measurements: robust, balanced, bounded, least squares; then learning.

The parameters of a setup are fitted first. Where it names a residual model, that learns
from what they leave.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.directions import nuisance_basis
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.learning import (
    learned_correction,
    require_learnable,
    with_learned,
)
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robust.weights import robustly
from calib_pin.estimation.solve import Solver, refine
from calib_pin.estimation.stages import without_prior
from calib_pin.estimation.statistics.systematic import systematic
from calib_pin.estimation.system import System
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.progress import Progress, portion
from calib_pin.residual_models import LearnedCorrection
from calib_pin.setup import Setup
from calib_pin.solvers import LeastSquaresResult
from calib_pin.solvers.status import Status

_System = TypeVar("_System", bound=System)

FIT_PART = 0.2
"""Part of the time that the parameters take where a correction is learned as well."""


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

    Noise, directions and sizes of errors are taken from the fit of all of them.

    Args:
        fitted: The fit.
        kept: The measurements to fit, shape (N,), none of them set aside.

    Returns:
        The fit; None where it takes a fit from the start: without some target, with
        bounds, after a search.
    """
    whole, parameters = fitted.problem, fitted.problem.parameters
    rows = whole.data.rows(kept)
    complete = len(np.unique(whole.data.things()[kept])) == len(
        np.unique(whole.data.things())
    )
    bounded = np.isfinite(parameters.bounds).any() or whole.many
    plain = whole.setup.solver.name == "gauss-newton" and fitted.result.status.success
    if not (complete and plain and fitted.noise) or bounded:
        return None
    problem, (held, result, moved) = replace(whole, data=rows), fitted.held

    def again(
        some: Problem, x: Floats, known: tuple[Floats, Floats], basis: Floats
    ) -> LeastSquaresResult:
        # The first step is known from the residual rows of the whole.
        of_row = kept[whole.layout.row]
        own = np.ones(len(known[0]), bool)
        own[: len(of_row)] = of_row
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


@dataclass(frozen=True)
class FittedModel:
    """A fit, with the correction that was learned on top of it.

    Attributes:
        fit: The fit of the parameters.
        problem: Its problem about the solution, with the learned correction.
        theta: Parameter values about that, shape (P,).
        rejected: Name of the residual model that found nothing to correct, if one did.
    """

    fit: Fit
    problem: Problem
    theta: Floats
    rejected: str = ""

    @property
    def learned(self) -> LearnedCorrection | None:
        """The correction; None without one."""
        learned = self.problem.only.error.learned
        return learned if isinstance(learned, LearnedCorrection) else None

    def weighted(self, measurements: Observations) -> Observations:
        """The fitted measurements, with no weight where the fit has set them aside."""
        aside = self.fit.problem.data.weight == 0.0
        return measurements.weighted(np.where(aside, 0.0, measurements.weight))


@serial_blas
def fit_model(
    chains: Chain | Chains,
    measurements: Observations,
    setup: Setup,
    seed: int,
    progress: Progress | None = None,
    *,
    part_of: tuple[Fit, NDArray[np.bool_]] | None = None,
) -> FittedModel:
    """Fit the parameters of a setup, and let its residual model learn the rest.

    Args:
        chains: The nominal chains.
        measurements: The measurements to fit.
        setup: Estimated, known and learned quantities.
        seed: Seed of random configurations, searches and starts.
        progress: Told how much is done, 0 to 1.
        part_of: A fit of more measurements with the same setup, and which of them these
            are. It knows the effects of gears and compliance, and the fit goes on from
            it where it can.

    Raises:
        OptionError: If a name in the setup does not exist.
        InputError: If the measurements are too few to learn from, or no measurement
            could come from where the fit ends.
    """
    part = 1.0
    if setup.learned is not None:
        require_learnable(setup.learned, setup, measurements)
        part = FIT_PART
    fitted = None if part_of is None else refitted(*part_of)
    if fitted is None:
        problem = make_problem(chains, measurements, setup)
        tell = portion(progress, 0.0, part)
        fitted = fit(problem, np.random.default_rng(seed), progress=tell)
        if part_of is None:
            fitted = with_effects(fitted)
        else:
            fitted = replace(fitted, effects=part_of[0].effects)
    if part_of is None and fitted.result.status is Status.NOT_FINITE:
        raise InputError(
            "no fit to these measurements is possible from where the nominal robot is: "
            "some points are behind the camera, say, or beams miss their plane"
        )
    problem, theta = fitted.problem.rebased(fitted.theta)
    if setup.learned is None:
        return FittedModel(fitted, problem, theta)
    # A generator of its own: what a search drew must not change what is learned.
    rng = np.random.default_rng(seed)
    tell = portion(progress, part, 1.0 - part)
    learned = learned_correction(setup.learned, fitted, problem, theta, rng, tell)
    if learned is None:
        plain = replace(problem, setup=replace(setup, learned=None))
        return FittedModel(fitted, plain, theta, rejected=setup.learned)
    return FittedModel(fitted, with_learned(problem, learned), theta)
