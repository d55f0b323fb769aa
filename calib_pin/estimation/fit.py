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

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import (
    at_conditions,
    make_problem,
    require_conditions,
)
from calib_pin.estimation.learning import (
    learned_correction,
    require_learnable,
    with_learned,
)
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robust import robustly
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.statistics.variance_components import (
    candidates,
    rows_with_effects,
    sampled,
    systematic,
)
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations.drift import USUAL, InstrumentDrift
from calib_pin.parameterizations.thermal import WarmUp, passed
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
    known = None if effects_of is None else replace(fitted, effects=effects_of.effects)
    fitted = known or with_effects(fitted)
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


SHORTEST, LONGEST = 0.03, 2.0
"""Time constants that are tried, by the time of the measurements; one that is longer
passes for a straight line, and a shorter one for nothing."""

CLOSE = 0.03
"""Relative difference of time constants that no measurements tell apart."""

SIGNIFICANT = 6.63
"""Twice the gain in log-likelihood that a drift must bring: chance brings as much once
in two hundred (half of it has none at all, Self and Liang 1987), and once in a hundred
for either of two."""

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

    require_conditions(measurements, setup)
    setup = at_conditions(chains, measurements, setup)
    span = float(passed(measurements.conditions.time, setup.thermal.switched_on).max())
    if not span > 0.0:
        return setup

    def stated(logarithm: float) -> Setup:
        # Three digits are more than anybody knows.
        time = float(f"{np.exp(logarithm):.3g}")
        return replace(setup, thermal=replace(setup.thermal, warm_up_time=time))

    def left(logarithm: float) -> float:
        noise = _fitted(chains, measurements, stated(logarithm), seed).noise
        known = [one for one in noise if one.estimate > 0.0]
        return float(sum(one.values * np.log(one.estimate) for one in known))

    ends = float(np.log(SHORTEST * span)), float(np.log(LONGEST * span))
    found = minimize_scalar(
        left, bounds=ends, method="bounded", options={"xatol": CLOSE}
    )
    return stated(float(found.x))


@serial_blas
def with_drift(
    chains: Chains, measurements: Observations, setup: Setup, seed: int
) -> Setup:
    """The setup with the drift that the measurements show.

    Arguments as for `with_time_course`.
    """
    require_conditions(measurements, setup)
    setup = at_conditions(chains, measurements, setup)
    drift, kinds = setup.drift, KINDS.values()
    unknown = [kind for kind in kinds if getattr(drift, kind) is None]
    if InstrumentDrift.name not in setup.parameters or not unknown:
        return setup
    sizes: dict[str, Any] = dict.fromkeys(unknown, 0.0)
    some: dict[str, Any] = dict.fromkeys(unknown, USUAL)
    still, usual = replace(drift, **sizes), replace(drift, **some)
    fitted = _fitted(chains, measurements, replace(setup, drift=still), seed)
    sample = replace(fitted.problem, data=sampled(fitted.problem))
    # The problem with a drift of the usual size, about the references of the fit.
    moving, terms = replace(setup, drift=usual, learned=None), {}
    found = make_problem(chains, sample.data, moving)
    for key, term in found.terms.items():
        other = sample.terms[key]
        error = term.error.with_frames(other.error.base, other.error.tool)
        terms[key] = replace(term, error=error, measurement=other.measurement)
    found = replace(found, terms=terms, units=sample.units)
    sizes |= _drift_sizes(fitted, sample, found)
    return replace(setup, drift=replace(still, **sizes))


def _fitted(chains: Chains, data: Observations, setup: Setup, seed: int) -> Fit:
    """The fit of the parameters, without what would be learned."""
    problem = make_problem(chains, data, replace(setup, learned=None))
    return fit(problem, np.random.default_rng(seed))


def _drift_sizes(fitted: Fit, still: Problem, moving: Problem) -> dict[str, float]:
    """Standard deviations of what drifts by more than chance.

    Args:
        fitted: The fit of an instrument that stands still.
        still: Its problem, see `sampled`.
        moving: The same with a drift of the usual size.
    """
    drifting = [p for p in moving.given if p.name not in still.given.names]
    if not drifting:
        return {}
    count, theta = len(still.layout.row), fitted.theta
    values = dict(zip(still.given.names, theta, strict=True))
    _, J = moving.linearize_rows(moving.given.vector(values))
    columns = [moving.given.index(p.name) for p in drifting]
    X: Floats = J[:count, columns] * moving.given.scales[columns]
    kind_of = [KINDS[p.unit] for p in drifting]
    robot = candidates(still)
    always: list[str] = []
    if robot is not None and np.isfinite(rows := robot.rows(still, theta)).all():
        always = list(dict.fromkeys(robot.kinds))
        X, kind_of = np.hstack([rows, X]), [*robot.kinds, *kind_of]
    groups = rows_with_effects(still, theta, fitted.directions.basis, X, kind_of)
    if groups is None:
        return {}
    chosen, _ = groups.selected(KINDS.values(), SIGNIFICANT, always)
    return {kind: USUAL * variance**0.5 for kind, variance in chosen.items()}
