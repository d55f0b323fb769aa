"""Fits of measurements: robust, balanced, bounded, least squares; then learning.

The parameters of a setup are fitted first. Where it names a residual model, that learns
from what they leave.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, require_known
from calib_pin.estimation.directions import nuisance_basis, visible_nuisances
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robust.weights import robustly
from calib_pin.estimation.solve import Solver, refine
from calib_pin.estimation.stages import without_prior
from calib_pin.estimation.statistics.systematic import systematic
from calib_pin.estimation.system import Part, System
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import Observations
from calib_pin.progress import Progress, portion
from calib_pin.residual_models import (
    RESIDUAL_MODELS,
    LearnedCorrection,
    Linearized,
    Space,
    TrainingRows,
)
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


def require_learnable(name: str, setup: Setup, measurements: Observations) -> None:
    """Refuse a residual model that does not exist or has nothing to learn from.

    Raises:
        OptionError: If there is no such model, or the measurements are relative or of
            several chains.
    """
    require_known("residual model", name, RESIDUAL_MODELS)
    if any(declared(model).relative for model in measurements.models):
        raise OptionError(
            "nothing can be learned from distances between two configurations",
            file=setup.file or None,
            value=name,
            allowed="measurements of another model",
        )
    if len({key.chain for key in measurements.keys}) > 1:
        raise OptionError(
            "nothing can be learned from measurements of several chains",
            file=setup.file or None,
            value=name,
            allowed="measurements of one chain",
        )


def with_learned(problem: _System, learned: LearnedCorrection) -> _System:
    """A problem or a model about its solution, with a learned correction.

    Args:
        problem: The problem.
        learned: The correction, with a shift of all parameters, shape (P,); a motion
            of the tool is one of the first tool.
    """
    parts = {}
    for key, part in problem.parts.items():
        shift = learned.shift[part.of_error]
        own = replace(learned, shift=shift, carried=_carried(problem, part))
        parts[key] = replace(part, error=replace(part.error, learned=own))
    return problem.with_parts(parts)


def _carried(problem: System, part: Part) -> Floats | None:
    """Adjoint from the first tool to that of a part; None where it is the same."""
    first, tool = problem.only.error.tool, part.error.tool
    if tool == first:
        return None
    return np.asarray((tool.inverse() * first).toActionMatrix())


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
    q = np.concatenate([block.data.q for block in problem.blocks])
    if not (found.shift.any() or found(q).any()):
        # Nothing held on the validation measurements.
        return None
    return LearnedCorrection(found, directions @ found.shift)


def training_rows(problem: Problem, theta: Floats, directions: Floats) -> TrainingRows:
    """Residuals as functions of a correction, for a residual model to learn.

    Args:
        problem: The problem about the solution of a fit.
        theta: Parameter values there, shape (P,).
        directions: Directions of the parameters that may shift along with the
            correction, shape (P, k).
    """
    layout = problem.layout
    shape = len(problem.data), layout.width
    basis = {
        block.part.key: block.part.error.basis(block.data.q, block.data.conditions)
        for block in problem.blocks
    }

    def linearize(space: Space, values: Floats, shift: Floats) -> Linearized:
        result = Linearized(
            np.zeros(shape),
            np.zeros((*shape, values.shape[1])),
            np.zeros((*shape, len(shift))),
        )
        moved = directions @ shift
        for part, data, rows, flat in problem.blocks:
            own, error = part.index, part.error
            of_robot, instrument = part.split(theta[own])
            count = len(of_robot)
            corrections, carried = values[rows], None
            if space == "tip":
                carried = _carried(problem, part)
                corrections = (
                    corrections if carried is None else corrections @ carried.T
                )
            given = _Given(space, corrections, moved[own[:count]])
            poses = replace(error, learned=given).linearize(
                data.q, of_robot, basis[part.key]
            )
            linear = part.measurement.linearize(poses.T, instrument, data)
            sigma = problem.sigma[flat].reshape(len(data), -1)
            J_pose = linear.J_pose / sigma[:, :, None]
            columns = layout.column[flat][: sigma.shape[1]]
            result.residual[rows, columns] = linear.residual / sigma
            by_correction = J_pose if carried is None else J_pose @ carried
            if space == "joint":
                by_correction = J_pose @ poses.joint_twists()
            result.by_correction[rows, columns] = by_correction
            by_shift = poses.derivative(J_pose) @ directions[own[:count]]
            result.by_shift[rows, columns] = by_shift
        return result

    return TrainingRows(
        q=np.concatenate([block.data.q for block in problem.blocks]),
        groups=problem.data.groups(),
        revolute=problem.only.error.chain.revolute,
        by_joint=partial(linearize, "joint"),
        by_tip=partial(linearize, "tip"),
        values=layout.width,
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
    """Directions that the fit could tell, in the scales of parameters, (P, k).

    Those of the robot and the frames; the instruments stay as they were fitted.
    """
    parameters = problem.parameters
    _, J = problem.linearize(theta)
    basis = np.column_stack([visible_nuisances(J, parameters), fitted.directions.robot])
    basis = parameters.scales[:, None] * basis
    for part in problem.parts.values():
        basis[part.of_instrument] = 0.0
    return basis[:, basis.any(axis=0)]
