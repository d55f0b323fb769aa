"""A model fitted to measurements: the parameters of a setup, and a learned correction.

The parameters are fitted first. Where the setup names a residual model, it learns from
what they leave.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import OptionError, require_known
from calib_pin.estimation.directions import visible_nuisances
from calib_pin.estimation.fit import fit, refitted, with_effects
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import Measurements
from calib_pin.progress import Progress, portion
from calib_pin.residual_models import (
    RESIDUAL_MODELS,
    LearnedCorrection,
    Linearized,
    Space,
    TrainingRows,
)
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


def require_learnable(name: str, setup: Setup, measurements: Measurements) -> None:
    """Refuse a residual model that does not exist or has nothing to learn from.

    Raises:
        OptionError: If there is no such model, or the measurements are relative.
    """
    require_known("residual model", name, RESIDUAL_MODELS)
    if any(declared(name).relative for name in measurements.parts):
        raise OptionError(
            "nothing can be learned from distances between two configurations",
            file=setup.file or None,
            value=name,
            allowed="measurements of another model",
        )


def learned_correction(
    name: str,
    fitted: Fit,
    problem: Problem,
    theta: Floats,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> LearnedCorrection | None:
    """The correction that a residual model learns; None without a gain.

    Args:
        name: Name of the residual model.
        fitted: The fit.
        problem: Its problem, about the solution.
        theta: Parameter values about that, shape (P,).
        rng: Random generator of the residual model.
        progress: Told how much is done, 0 to 1.

    Raises:
        InputError: If the measurements are too few to learn from.
    """
    directions = _shifts(fitted, problem, theta)
    found = RESIDUAL_MODELS[name](
        training_rows(problem, theta, directions), rng, progress=progress
    )
    if not (found.shift.any() or found(problem.data.q).any()):
        # Nothing held on measurements that it had not seen.
        return None
    return LearnedCorrection(found, directions @ found.shift)


def training_rows(problem: Problem, theta: Floats, directions: Floats) -> TrainingRows:
    """What a residual model learns from: residuals as functions of a correction.

    Args:
        problem: The problem about the solution of a fit.
        theta: Parameter values there, shape (P,).
        directions: Directions in the parameters of the error model that may shift
            along with the correction, shape (P', k).
    """
    of_robot, own = problem.split(theta)
    factors = problem.error.basis(problem.data.q, problem.data.payload)

    def linearize(space: Space, values: Floats, shift: Floats) -> Linearized:
        given = _Given(space, values, directions @ shift)
        error = replace(problem.error, learned=given)
        poses = error.linearize(problem.data.q, of_robot, factors)
        linear = problem.measurement.linearize(poses.T, own, problem.data)
        J_pose = linear.J_pose / problem.sigma[:, :, None]
        by_correction = J_pose
        if space == "joint":
            by_correction = J_pose @ poses.joint_twists()
        return Linearized(
            residual=linear.residual / problem.sigma,
            by_correction=by_correction,
            by_shift=poses.derivative(J_pose) @ directions,
        )

    return TrainingRows(
        q=problem.data.q,
        groups=problem.data.groups(),
        revolute=problem.error.chain.revolute,
        by_joint=partial(linearize, "joint"),
        by_tip=partial(linearize, "tip"),
        shifts=directions.shape[1],
    )


@dataclass(frozen=True)
class _Given:
    """Corrections of certain rows, in the place of those a model predicts."""

    space: Space
    values: Floats
    shift: Floats

    def __call__(self, q: Floats) -> Floats:
        return self.values

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))


def _shifts(fitted: Fit, problem: Problem, theta: Floats) -> Floats:
    """Directions of the error model that the fit could tell, in its scales, (P', k).

    Those of the robot and the frames; the instrument stays as it was fitted.

    Args:
        fitted: The fit.
        problem: Its problem about the references that the directions are for.
        theta: The solution about these, shape (P,).
    """
    parameters = problem.parameters
    _, J = problem.linearize(theta)
    basis = np.column_stack([visible_nuisances(J, parameters), fitted.directions.robot])
    basis = (parameters.scales[:, None] * basis)[: len(problem.error.screws)]
    return basis[:, basis.any(axis=0)]
