"""Fits of measurements: robust, balanced, bounded, least squares; then learning.

The parameters of a setup are fitted first. Where it names a residual model, that learns
from what they leave.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.learning import (
    learned_correction,
    require_learnable,
    with_learned,
)
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robust.weights import robustly
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.statistics.systematic import systematic
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.progress import Progress, portion
from calib_pin.residual_models import LearnedCorrection
from calib_pin.setup import Setup
from calib_pin.solvers.status import Status

FIT_PART = 0.2
"""Part of the time that the parameters take where a correction is learned as well."""


@serial_blas
def fit(
    problem: Problem, rng: np.random.Generator, *, progress: Progress | None = None
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
    effects_of: Fit | None = None,
) -> FittedModel:
    """Fit the parameters of a setup, and let its residual model learn the rest.

    Args:
        chains: The nominal chains.
        measurements: The measurements to fit.
        setup: Estimated, known and learned quantities.
        seed: Seed of random configurations, searches and starts.
        progress: Told how much is done, 0 to 1.
        effects_of: A fit of more measurements, which knows the effects of gears and
            compliance; None to seek them in these.

    Raises:
        OptionError: If a name in the setup does not exist.
        InputError: If the measurements are too few to learn from, or no measurement
            could come from where the fit ends.
    """
    if setup.learned is not None:
        require_learnable(setup.learned, setup, measurements)
    part = 1.0 if setup.learned is None else FIT_PART
    problem = make_problem(chains, measurements, setup)
    tell = portion(progress, 0.0, part)
    fitted = fit(problem, np.random.default_rng(seed), progress=tell)
    if effects_of is None:
        fitted = with_effects(fitted)
    else:
        fitted = replace(fitted, effects=effects_of.effects)
    if fitted.result.status is Status.NOT_FINITE:
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
