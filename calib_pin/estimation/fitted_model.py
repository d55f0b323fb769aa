"""A model fitted to measurements: the parameters of a setup, and a learned correction.

The parameters are fitted first. Where the setup names a residual model, it learns from
what they leave.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.fit import fit, refitted, with_effects
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.learning import learned_correction, require_learnable
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.progress import Progress, portion
from calib_pin.setup import Setup

FIT_PART = 0.2
"""Part of the time that the parameters take where a correction is learned as well."""


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

    def weighted(self, measurements: Measurements) -> Measurements:
        """The fitted measurements, with no weight where the fit has set them aside."""
        aside = self.fit.problem.data.weight == 0.0
        return replace(measurements, weight=np.where(aside, 0.0, measurements.weight))


@serial_blas
def fit_model(
    chain: Chain,
    measurements: Measurements,
    setup: Setup,
    seed: int,
    progress: Progress | None = None,
    *,
    part_of: tuple[Fit, NDArray[np.bool_]] | None = None,
) -> FittedModel:
    """Fit the parameters of a setup, and let its residual model learn the rest.

    Args:
        chain: The nominal chain.
        measurements: The measurements to fit.
        setup: What is estimated, what is known, what is learned.
        seed: Seed of random configurations, searches and starts.
        progress: Told how much is done, 0 to 1.
        part_of: A fit of more measurements with the same setup, and which of them these
            are. It knows the effects of gears and compliance, and the fit goes on from
            it where it can.

    Raises:
        OptionError: If a name in the setup does not exist.
        InputError: If the measurements are too few to learn from.
    """
    part = 1.0
    if setup.learned is not None:
        require_learnable(setup.learned, setup, measurements)
        part = FIT_PART
    fitted = None if part_of is None else refitted(*part_of)
    if fitted is None:
        problem = make_problem(chain, measurements, setup)
        tell = portion(progress, 0.0, part)
        fitted = fit(problem, np.random.default_rng(seed), progress=tell)
        if part_of is None:
            fitted = with_effects(fitted)
        else:
            fitted = replace(fitted, effects=part_of[0].effects)
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
    error = replace(problem.error, learned=learned)
    return FittedModel(fitted, replace(problem, error=error), theta)
