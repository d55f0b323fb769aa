"""A correction that a residual model learns from what the parameters of a fit leave."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib_pin.errors import OptionError, require_known
from calib_pin.estimation.directions import visible_nuisances
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import Measurements
from calib_pin.progress import Progress
from calib_pin.residual_models import (
    RESIDUAL_MODELS,
    LearnedCorrection,
    Linearized,
    Space,
    TrainingRows,
)
from calib_pin.setup import Setup


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
    of_robot, instrument = problem.split(theta)
    factors = problem.error.basis(problem.data.q, problem.data.payload)

    def linearize(space: Space, values: Floats, shift: Floats) -> Linearized:
        given = _Given(space, values, directions @ shift)
        error = replace(problem.error, learned=given)
        poses = error.linearize(problem.data.q, of_robot, factors)
        linear = problem.measurement.linearize(poses.T, instrument, problem.data)
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
