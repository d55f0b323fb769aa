"""Fits of measurements: robust, balanced, bounded, least squares; then learning.

The parameters of a setup are fitted first. Where it names a residual model, that learns
from what they leave.

The course of time, as the measurements tell it: a warm-up, a drift.

The increments of an instrument that drifts (`parameterizations/drift`) are random
effects beside the noise: all shifts have one unknown variance, all turns another. So
are gears and compliance that the model lacks (`variance_components`): where the robot
was measured along a path they are as smooth over the time as a drift. The fit of a
still instrument gives the residuals; restricted maximum likelihood gives all variances,
and the likelihood ratio says whether a drift is more than chance beside the others.
What is not is zero from then on, so that an instrument that stands still costs no
accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, require_known
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import at_conditions, make_problem
from calib_pin.estimation.identifiability import visible_nuisances
from calib_pin.estimation.problem import SAMPLE, Problem
from calib_pin.estimation.robust import robustly
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.statistics.variance_components import (
    CHANCE,
    candidates,
    rows_with_effects,
    sampled,
    systematic,
)
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import Observations
from calib_pin.parameterizations.drift import USUAL, InstrumentDrift
from calib_pin.parameterizations.thermal import WarmUp, passed
from calib_pin.progress import Progress
from calib_pin.residual_models import (
    RESIDUAL_MODELS,
    LearnedCorrection,
    Linearized,
    Shifts,
    Space,
    TrainingRows,
)
from calib_pin.setup import Setup
from calib_pin.solvers.status import Status


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
def with_effects(fitted: Fit, whole: Sequence[str] = ()) -> Fit:
    """A fit that knows what gears, compliance and more left in its residuals."""
    if not fitted.noise:
        return fitted
    effects = systematic(fitted.problem, fitted.theta, fitted.directions, whole)
    return replace(fitted, effects=effects)


@serial_blas
def fit_model(
    chains: Chain | Chains,
    measurements: Observations,
    setup: Setup,
    seed: int,
    progress: Progress | None = None,
    *,
    effects_of: Fit | None = None,
) -> Fit:
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
    problem = make_problem(chains, measurements, setup)
    # Where a correction is learned, that takes the time.
    tell = progress if setup.learned is None else None
    fitted = fit(problem, np.random.default_rng(seed), progress=tell)
    known = None if effects_of is None else replace(fitted, effects=effects_of.effects)
    fitted = known or with_effects(fitted)
    if fitted.result.status is Status.NOT_FINITE:
        raise InputError(
            "no fit to these measurements is possible from where the nominal robot is: "
            "some points are behind the camera, say, or beams miss their plane"
        )
    if setup.learned is None:
        return fitted
    # A generator of its own: what a search drew must not change what is learned.
    rng = np.random.default_rng(seed)
    learned = learned_correction(setup.learned, fitted, rng, progress)
    return replace(fitted, learned=learned)


SHORTEST, LONGEST = 0.03, 2.0
"""Time constants that are tried, by the time of the measurements; one that is longer
passes for a straight line, and a shorter one for nothing."""

CLOSE = 0.03
"""Relative difference of time constants that no measurements tell apart."""

KINDS = {"m": "shift", "rad": "turn"}
"""Names of all that may drift, as a setup states it, by their units."""


def with_time_course(
    chains: Chains, measurements: Observations, setup: Setup, seed: int
) -> Setup:
    """The setup with how a robot grows warm, and how an instrument drifts beside it.

    Args:
        chains: The nominal chains.
        measurements: The measurements to fit.
        setup: The setup; what it states of both stands.
        seed: Seed of the fits.

    Raises:
        InputError: If a measurement does not state a condition that is needed.
    """
    setup = with_warm_up(chains, measurements, setup, seed)
    return with_drift(chains, measurements, setup, seed)


def time_course(setup: Setup) -> tuple[float | None, ...]:
    """The numbers that `with_time_course` finds."""
    return setup.thermal.warm_up_time, setup.drift.shift, setup.drift.turn


@serial_blas
def with_warm_up(
    chains: Chains, measurements: Observations, setup: Setup, seed: int
) -> Setup:
    """The setup with the time constant of the warm-up that suits measurements best.

    That is the one that leaves the least noise, each quantity by its own. Arguments as
    for `with_time_course`.
    """
    if WarmUp.name not in setup.parameters or setup.thermal.warm_up_time is not None:
        return setup
    from scipy.optimize import minimize_scalar

    setup = at_conditions(chains, measurements, setup)
    span = float(passed(measurements.conditions.time, setup.thermal.switched_on).max())
    if not span > 0.0:
        return setup

    def with_constant(logarithm: float) -> Setup:
        # Three digits are more than anybody knows.
        time = float(f"{np.exp(logarithm):.3g}")
        return replace(setup, thermal=replace(setup.thermal, warm_up_time=time))

    def cost(logarithm: float) -> float:
        problem = make_problem(chains, measurements, with_constant(logarithm))
        noise = fit(problem, np.random.default_rng(seed)).noise
        known = [c for c in noise if c.estimate > 0.0]
        return float(sum(c.values * np.log(c.estimate) for c in known))

    ends = float(np.log(SHORTEST * span)), float(np.log(LONGEST * span))
    best = minimize_scalar(
        cost, bounds=ends, method="bounded", options={"xatol": CLOSE}
    )
    return with_constant(float(best.x))


@serial_blas
def with_drift(
    chains: Chains, measurements: Observations, setup: Setup, seed: int
) -> Setup:
    """The setup with the drift that the measurements show.

    Arguments as for `with_time_course`.
    """
    setup = at_conditions(chains, measurements, setup)
    unknown = [kind for kind in KINDS.values() if getattr(setup.drift, kind) is None]
    sizes: dict[str, Any] = dict.fromkeys(unknown, 0.0)
    if InstrumentDrift.name not in setup.parameters or not unknown:
        return setup
    problem = make_problem(chains, measurements, setup)
    drifting = {
        parameter.name: KINDS[parameter.unit]
        for parameter, kind in zip(problem.given, problem.given.kinds, strict=True)
        if kind == InstrumentDrift.name and KINDS[parameter.unit] in unknown
    }
    if drifting:
        sizes |= _drift_sizes(problem, drifting, seed)
    return replace(setup, drift=replace(setup.drift, **sizes))


def _drift_sizes(
    problem: Problem, drifting: Mapping[str, str], seed: int
) -> dict[str, float]:
    """Standard deviations of what drifts by more than chance.

    Args:
        problem: The problem, with increments of the usual size.
        drifting: These increments and the kind of each.
        seed: Seed of the fit of an instrument that stands still.
    """
    fixed = *problem.setup.fixed, *drifting
    still = replace(problem, setup=replace(problem.setup, fixed=fixed))
    fitted = fit(still, np.random.default_rng(seed))
    sample, theta = replace(fitted.problem, data=sampled(fitted.problem)), fitted.theta
    _, J = sample.linearize_rows(theta)
    columns = [sample.given.index(name) for name in drifting]
    X: Floats = (J * sample.given.scales)[: len(sample.layout.row), columns]
    kind_of, always = [*drifting.values()], list[str]()
    robot = candidates(sample)
    if robot is not None and np.isfinite(rows := robot.rows(sample, theta)).all():
        always = list(dict.fromkeys(robot.kinds))
        X, kind_of = np.hstack([rows, X]), [*robot.kinds, *kind_of]
    groups = rows_with_effects(sample, theta, fitted.directions.basis, X, kind_of)
    if groups is None:
        return {}
    # Either of two may pass for one by chance.
    chosen, _ = groups.selected(KINDS.values(), CHANCE / len(KINDS), always)
    return {kind: USUAL * variance**0.5 for kind, variance in chosen.items()}


# Corrections that residual models learn from what a fit leaves.


def require_learnable(name: str, setup: Setup, measurements: Observations) -> None:
    """Refuse a residual model that does not exist or has nothing to learn from.

    Raises:
        OptionError: If there is no such model, or the measurements are relative, or of
            several chains or tools.
    """
    require_known("residual model", name, RESIDUAL_MODELS)
    relative = any(declared(model).relative for model in measurements.models)
    several = len({(key.chain, key.tool) for key in measurements.keys}) > 1
    if relative or several:
        source = "distances between two configurations"
        if several:
            source = "measurements of several chains or tools"
        raise OptionError(
            f"nothing can be learned from {source}",
            file=setup.file or None,
            value=name,
            allowed="measurements of one chain with one tool, by another model",
        )


def learned_correction(
    name: str, fitted: Fit, rng: np.random.Generator, progress: Progress | None = None
) -> LearnedCorrection | None:
    """The correction that a residual model learns; None without a gain.

    Args:
        name: Name of the residual model.
        fitted: The fit.
        rng: Random generator of the residual model.
        progress: Told how much is done, 0 to 1.

    Raises:
        InputError: If the measurements are too few to learn from.
    """
    directions, rows = _learnable(fitted)
    model = RESIDUAL_MODELS[name](rows, rng, progress=progress)
    if not (model.shift.any() or model(rows.q[:SAMPLE]).any()):
        # Nothing held on the validation measurements.
        return None
    return LearnedCorrection(model, directions @ model.shift)


def learned_without(
    learned: LearnedCorrection,
    fitted: Fit,
    masks: Sequence[NDArray[np.bool_]],
    rng: np.random.Generator,
) -> list[LearnedCorrection]:
    """A correction without some of the measurements, the fit as it is.

    The geometry moves with it, as far as its shift goes; see
    `ResidualModel.left_out`.

    Args:
        learned: The correction.
        fitted: The fit.
        masks: Those to leave out, shape (N,) each.
        rng: Random generator of the residual model.
    """
    directions, rows = _learnable(fitted)
    models = learned.model.left_out(rows, masks, rng)
    return [LearnedCorrection(model, directions @ model.shift) for model in models]


def training_rows(
    problem: Problem, theta: Floats, directions: Floats, known: Shifts | None = None
) -> TrainingRows:
    """Residuals as functions of a correction, for a residual model to learn.

    Args:
        problem: The problem about the solution of a fit.
        theta: Parameter values there, shape (P,).
        directions: Directions of the parameters that may shift along with the
            correction, shape (P, k).
        known: What is known of these; default nothing.
    """
    layout = problem.layout
    shape = len(problem.data), layout.width
    basis = [b.term.error.basis(b.data.q, b.data.conditions) for b in problem.blocks]

    def linearize(space: Space, values: Floats, shift: Floats) -> Linearized:
        widths = values.shape[1], len(shift)
        by = (np.zeros((*shape, width)) for width in widths)
        result = Linearized(np.zeros(shape), *by)
        change = directions @ shift
        for known_basis, block in zip(basis, problem.blocks, strict=True):
            term, data, rows, flat = block
            robot, instrument = term.values(theta)
            given = _Given(space, values[rows], change[term.of_error])
            corrected = replace(term.error, learned=given)
            poses = corrected.linearize(data.q, robot, known_basis)
            linear = term.measurement.linearize(poses.T, instrument, data)
            sigma = block.table(problem.sigma)
            J_pose = linear.J_pose / sigma[:, :, None]
            columns = layout.column[flat][: sigma.shape[1]]
            result.residual[rows, columns] = linear.residual / sigma
            along_joints = space == "joint"
            by_correction = J_pose @ poses.joint_twists() if along_joints else J_pose
            result.by_correction[rows, columns] = by_correction
            by_shift = poses.derivative(J_pose) @ directions[term.of_error]
            result.by_shift[rows, columns] = by_shift
        return result

    def subset(index: NDArray[np.int64]) -> TrainingRows:
        few = replace(problem, data=problem.data.rows(index))
        return training_rows(few, theta, directions, known)

    return TrainingRows(
        q=np.concatenate([block.data.q for block in problem.blocks]),
        groups=problem.data.groups(),
        revolute=problem.only.error.chain.revolute,
        by_joint=partial(linearize, "joint"),
        by_tip=partial(linearize, "tip"),
        values=layout.width,
        subset=subset,
        shift=Shifts(np.zeros(directions.shape[1])) if known is None else known,
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


def _learnable(fitted: Fit) -> tuple[Floats, TrainingRows]:
    """Directions that the fit could tell, (P, k), and the rows to learn from.

    Those of the robot, in the scales of parameters, and free ones of the frames; the
    instruments stay as they were fitted.
    """
    problem, theta = fitted.problem.rebased(fitted.theta)
    parameters, robot = problem.parameters, fitted.directions.robot
    frames = visible_nuisances(problem.linearize(theta)[1], parameters)
    for term in problem.terms.values():
        frames[term.of_instrument] = 0.0
    frames = frames[:, frames.any(axis=0)]
    shown, free = robot.any(axis=1), frames.shape[1]
    kinds = tuple(
        np.vstack([np.zeros((free, mask.sum())), robot[mask].T])
        for kind in dict.fromkeys(parameters.kinds[shown].tolist())
        for mask in (shown & (parameters.kinds == kind),)
    )
    values = robot.T @ (fitted.theta / parameters.scales)
    known = Shifts(np.concatenate([np.zeros(free), values]), kinds)
    directions = parameters.scales[:, None] * np.column_stack([frames, robot])
    return directions, training_rows(problem, theta, directions, known)
