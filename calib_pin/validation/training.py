"""Train a model on rows, and look at rows it has not seen.

First the parameters are fitted, then, if the setup wants it, a residual model learns
what they leave. A cross-validation does both anew without each part of the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, require_known
from calib_pin.estimation.directions import visible_nuisances
from calib_pin.estimation.fit import fit, refitted, with_effects
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem, restricted
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.parameterizations import beyond_geometry
from calib_pin.progress import Progress, Stages, named, portion
from calib_pin.residual_models import (
    RESIDUAL_MODELS,
    LearnedCorrection,
    Linearized,
    Space,
    TrainingRows,
)
from calib_pin.setup import Setup
from calib_pin.validation.predicted import predicted_variance
from calib_pin.validation.result import FoundDistance
from calib_pin.validation.unseen import Unseen, found_distances, placed

__all__ = [
    "Trained",
    "cross_validate",
    "geometry_alone",
    "parameter_names",
    "shifts",
    "train",
    "training_rows",
    "with_parameters",
]

FIT_PART = 0.2
"""Part of the time of a training that the parameters take where more is learned."""


@dataclass(frozen=True)
class Trained:
    """A fit, with what was learned on top of it.

    Attributes:
        fit: The fit of the parameters.
        problem: Its problem about the solution, with what was learned.
        theta: Parameter values about that, shape (P,).
        rejected: Name of the residual model that found nothing to correct, if one did.
    """

    fit: Fit
    problem: Problem
    theta: Floats
    rejected: str = ""

    @serial_blas
    def unseen(
        self,
        rows: Measurements,
        positions: NDArray[np.intp] | None = None,
        *,
        predict: bool = True,
    ) -> Unseen:
        """Errors of rows, and the distances that the model finds between new places.

        A place that only these rows name, a socket say, is where they put it.

        Args:
            rows: The N rows.
            positions: Where they stand among all rows, shape (N,).
            predict: Whether to predict the variances of the errors.
        """
        nominal = placed(self.fit.problem, self.fit.before, rows)
        found = placed(self.problem, self.theta, rows)
        return self.seen(nominal, found, positions, predict=predict)

    def seen(
        self,
        before: tuple[Problem, Floats],
        after: tuple[Problem, Floats],
        positions: NDArray[np.intp] | None = None,
        registered: Sequence[int] = (),
        *,
        predict: bool = True,
    ) -> Unseen:
        """Errors of rows by problems of these rows.

        Args:
            before: The problem of the nominal robot, and its parameter values.
            after: That of the calibrated robot.
            positions: Where the rows stand among all rows, shape (N,).
            registered: Positions of parameters, beside those of new places, that were
                estimated from these rows.
            predict: Whether to predict the variances of the errors.
        """
        rows = after[0].data
        known = {feature.name for feature in self.problem.measurement.features}
        names = set(self.problem.parameters.names)
        own = [k for k, n in enumerate(after[0].parameters.names) if n not in names]
        variance = np.full(after[0].sigma.shape, np.nan)
        if predict:
            there = replace(self.fit.problem, data=rows), self.fit.theta
            if own or registered:
                there = after
            variance = predicted_variance(self.fit, *there, [*registered, *own])
        return Unseen(
            np.arange(len(rows)) if positions is None else positions,
            before[0].shown(before[1]),
            after[0].shown(after[1]),
            variance,
            found_distances(before, after, known),
            tuple(f.name for f in after[0].measurement.features if f.name not in known),
            self._reason,
        )

    @property
    def _reason(self) -> str:
        if not self.fit.structure.scaled:
            return "the scale is unobservable"
        return "" if self.fit.result.status.success else "it did not converge"

    @property
    def distances(self) -> tuple[FoundDistance, ...]:
        """The known distances that were fitted."""
        fitted = self.fit.problem, self.fit.before
        return found_distances(fitted, (self.problem, self.theta), None)


@serial_blas
def train(
    chain: Chain,
    rows: Measurements,
    setup: Setup,
    seed: int,
    progress: Progress | None = None,
    *,
    part_of: tuple[Fit, NDArray[np.bool_]] | None = None,
) -> Trained:
    """Fit the parameters of a setup, and let its residual model learn the rest.

    Args:
        chain: The nominal chain.
        rows: The rows to fit.
        setup: What is estimated, what is known, what is learned.
        seed: Seed of random configurations, searches and starts.
        progress: Told how much is done, 0 to 1.
        part_of: A fit of more rows with the same setup, and which of them these are.
            It knows what gears and compliance do to the robot, and the fit goes on
            from it where it can.

    Raises:
        OptionError: If a name in the setup does not exist.
        InputError: If the rows are too few for what is to be learned.
    """
    part = 1.0
    if setup.learned is not None:
        require_known("residual model", setup.learned, RESIDUAL_MODELS)
        if "relative-distance" in rows.parts:
            raise OptionError(
                "nothing can be learned from distances between two configurations",
                file=setup.file or None,
                value=setup.learned,
                allowed="measurements of another model",
            )
        part = FIT_PART
    rng = np.random.default_rng(seed)
    tell = portion(progress, 0.0, part)
    fitted = None if part_of is None else refitted(*part_of)
    if fitted is None:
        fitted = fit(make_problem(chain, rows, setup), rng, progress=tell)
        if part_of is None:
            fitted = with_effects(fitted)
        else:
            fitted = replace(fitted, effects=part_of[0].effects)
    problem, theta = fitted.problem.at(fitted.theta)
    if setup.learned is None:
        return Trained(fitted, problem, theta)
    # A generator of its own: what a search drew must not change what is learned.
    rng = np.random.default_rng(seed)
    directions = shifts(fitted, problem, theta)
    found = RESIDUAL_MODELS[setup.learned](
        training_rows(problem, theta, directions),
        rng,
        progress=portion(progress, part, 1.0 - part),
    )
    if not (found.shift.any() or found(problem.data.q).any()):
        # Nothing held on rows that it had not seen.
        nothing = replace(problem, setup=replace(setup, learned=None))
        return Trained(fitted, nothing, theta, rejected=setup.learned)
    learned = LearnedCorrection(found, directions @ found.shift)
    error = replace(problem.error, learned=learned)
    return Trained(fitted, replace(problem, error=error), theta)


def geometry_alone(chain: Chain, rows: Measurements, setup: Setup) -> Setup:
    """The setup of what a URDF can hold; without parameters where that is nothing.

    What a fit with gears and compliance leaves to the geometry is no use without them:
    a gear ratio and an offset that nearly cancel, say. It needs a fit of its own.

    Args:
        chain: The nominal chain.
        rows: The rows to fit.
        setup: What is estimated, what is known.
    """
    plain = replace(setup, learned=None)
    beyond = beyond_geometry()
    names = tuple(name for name in setup.parameters if name not in beyond)
    if names == setup.parameters:
        return plain
    return with_parameters(chain, rows, plain, names)


def with_parameters(
    chain: Chain, rows: Measurements, setup: Setup, parameters: tuple[str, ...]
) -> Setup:
    """A setup for other parameterizations.

    It says nothing of parameters that these do not have.
    """
    names = parameter_names(chain, rows, setup, parameters)
    return restricted(replace(setup, parameters=parameters), names)


def parameter_names(
    chain: Chain, rows: Measurements, setup: Setup, parameters: tuple[str, ...]
) -> tuple[str, ...]:
    """Names of the parameters of some parameterizations, frames and instrument."""
    plain = replace(setup, parameters=parameters, fixed=(), bounds={}, prior={})
    return make_problem(chain, rows, plain).parameters.names


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


def shifts(fitted: Fit, problem: Problem, theta: Floats) -> Floats:
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


def cross_validate(
    chain: Chain,
    rows: Measurements,
    setup: Setup,
    masks: Sequence[NDArray[np.bool_]],
    seed: int,
    alike: Fit,
    progress: Stages | None = None,
) -> Iterator[Unseen]:
    """Train without each part of the rows and look at the errors of that part.

    Args:
        chain: The nominal chain.
        rows: The N rows.
        setup: As for `train`.
        masks: The parts, each of shape (N,).
        seed: As for `train`.
        alike: The fit of all rows.
        progress: Told the stage and how much of all is done.
    """
    for k, mask in enumerate(masks):
        stage = f"check {k + 1} of {len(masks)}"
        tell = portion(named(progress, stage), k / len(masks), 1.0 / len(masks))
        # What the fit of all rows has set aside stays there.
        kept = ~mask & (rows.weight > 0.0)
        some = rows.rows(kept)
        trained = train(chain, some, setup, seed, tell, part_of=(alike, kept))
        try:
            found = trained.unseen(rows.rows(mask), np.flatnonzero(mask))
        except InputError as error:
            # Of a place all else may be set aside.
            found = Unseen.empty(trained.problem.components, error.reason)
        yield found
