"""Simulated robots of one type, each measured, calibrated and compared with its truth.

The numbers of a robot come from its number and the seed of the study alone, so that
robots can be drawn in any order, and anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, in_file, nearest
from calib_pin.estimation.evidence import rms
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import Term
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.parameters import ParameterSet, matching
from calib_pin.setup import MonteCarloSetup, Setup
from calib_pin.simulation import simulate
from calib_pin.validation.tip_drift import absorbed, apart
from calib_pin.validation.tool_accuracy import ToolErrors

TESTS = 100
"""Configurations of the workspace at which every robot is compared with its truth."""

SHARE = 0.95
"""Part of the workspace in which a robot has to be within its limit."""

DRAWN, MEASURED, PREDICTED = range(3)
"""Purposes of random numbers, which do not disturb each other."""


@dataclass(frozen=True)
class Study:
    """The model, plan and seed that all robots of a study share.

    Attributes:
        chains: The nominal chains.
        truth: The model by which robots err, with instruments where they truly stand.
        sizes: Standard deviations of the true errors, shape (P,).
        setup: The setup of the fits.
        counts: Numbers of configurations that are measured, ascending.
        plan: Configurations, of which the first ones are measured, shape (K, n); None
            for random ones.
        repeats: Readings per configuration.
        seed: Seed of everything.
    """

    chains: Chains
    truth: Problem
    sizes: Floats
    setup: Setup
    counts: tuple[int, ...]
    plan: Floats | None
    repeats: int
    seed: int

    def stream(self, robot: int, purpose: int, *more: int) -> np.random.Generator:
        """Random numbers of a robot for a purpose."""
        return np.random.default_rng([self.seed, robot, purpose, *more])


@dataclass(frozen=True)
class Trial:
    """A simulated robot after a calibration with a number of configurations.

    Errors are those of the tool over the workspace, displacements of base and tool left
    aside; of several chains those of the worst.

    Attributes:
        robot: Number of the robot, from 0.
        configurations: Number of configurations that were measured.
        nominal: Position error of the nominal robot, root mean square [m].
        position: That of the calibrated one.
        position_share: What it keeps within in `SHARE` of the workspace [m].
        orientation: Orientation error of the calibrated one, root mean square [rad].
        orientation_share: What it keeps within in that part [rad].
        expected: Position error that the fit expects, root mean square [m]; NaN where
            the fit has no redundancy.
        bound: Upper bound of that with 95 % confidence [m].
        reason: Why there is no calibration; empty where there is one.
    """

    robot: int
    configurations: int
    nominal: float = np.nan
    position: float = np.nan
    position_share: float = np.nan
    orientation: float = np.nan
    orientation_share: float = np.nan
    expected: float = np.nan
    bound: float = np.nan
    reason: str = ""


def study_of(
    chains: Chains,
    keys: Sequence[BlockKey],
    setup: Setup,
    plan: Floats | None = None,
    seed: int = 0,
) -> Study:
    """The study that a setup asks for.

    Args:
        chains: The nominal chains.
        keys: The blocks that are measured.
        setup: The setup with its section `monte_carlo`.
        plan: Configurations to measure, shape (K, n) [rad, m].
        seed: Seed of the study.

    Raises:
        OptionError: If an error is one of no parameter, or the plan is too short.
    """
    asked = setup.monte_carlo
    counts = tuple(sorted(asked.configurations))
    if plan is not None and counts[-1] > len(plan):
        allowed = f"'monte_carlo.configurations' up to {len(plan)}, those of the plan"
        reason, file = "the plan has fewer configurations", setup.file or None
        raise OptionError(reason, file=file, value=counts[-1], allowed=allowed)
    plain = replace(setup, monte_carlo=MonteCarloSetup())
    errs = replace(plain, parameters=asked.parameters or setup.parameters, learned=None)
    with in_file(setup.file):
        # What is fixed or bounded in the fit may err all the same.
        free = replace(errs, fixed=(), bounds={}, prior={})
        truth = nominal_problem(chains, keys, free)
        sizes = _sizes(truth.parameters, asked)
    return Study(chains, truth, sizes, plain, counts, plan, asked.repeats, seed)


def _sizes(parameters: ParameterSet, asked: MonteCarloSetup) -> Floats:
    """Standard deviations of true errors; base, tool and instrument have none."""
    moved = parameters.free & ~parameters.nuisance
    sizes = np.where(moved, parameters.scales, 0.0)
    for pattern, size in asked.errors.items():
        if not (index := matching(pattern, parameters.names)):
            like = nearest(pattern, parameters.names)
            raise OptionError(f"no parameter matches '{pattern}'{like}")
        sizes[index] = np.where(moved[index], size, 0.0)
    return sizes


@serial_blas
def try_robot(study: Study, robot: int) -> tuple[Trial, ...]:
    """Draw a robot, and calibrate it with every number of configurations.

    Args:
        study: The study.
        robot: Number of the robot.
    """
    parameters = study.truth.parameters
    theta = study.sizes * study.stream(robot, DRAWN).normal(size=len(parameters))
    # A joint does not rise under its load.
    loaded = np.array([p.unit in ("rad/Nm", "m/N") for p in parameters], bool)
    theta = np.where(loaded, np.abs(theta), theta)
    trials = []
    for count in study.counts:
        trial, rng = Trial(robot, count), study.stream(robot, PREDICTED, count)
        try:
            fitted = _calibrated(study, theta, robot, count)
        except InputError as error:
            trials.append(replace(trial, reason=str(error)))
            continue
        terms = fitted.solved.problem.by_chain.values()
        each = [_with_errors(study, theta, fitted, term, rng, trial) for term in terms]
        trials.append(max(each, key=lambda t: t.position))
    return tuple(trials)


def _calibrated(study: Study, theta: Floats, robot: int, count: int) -> Fit:
    """The calibration of a robot."""
    q = None if study.plan is None else study.plan[:count]
    rows = simulate(
        study.truth,
        theta,
        study.stream(robot, MEASURED, count),
        q=q,
        count=count if q is None else None,
        # An image shows all corners of a board.
        per_configuration=study.setup.board is not None,
        repeats=study.repeats,
    )
    # A file of measurements seldom states what they are worth.
    blocks = tuple(replace(block, sigma=None) for block in rows.blocks)
    return fit_model(study.chains, Observations(blocks), study.setup, study.seed)


def _with_errors(
    study: Study,
    theta: Floats,
    fitted: Fit,
    term: Term,
    rng: np.random.Generator,
    trial: Trial,
) -> Trial:
    """A trial with the errors of a chain."""
    heaviest = fitted.problem.setup.heaviest
    true = study.truth.by_chain[term.key.chain]
    true = replace(true, error=true.error.carrying(heaviest))
    term = replace(term, error=term.error.carrying(heaviest))
    # The same configurations for all, so that robots can be compared.
    q = term.error.chain.random_configurations(TESTS, np.random.default_rng(study.seed))
    errors = true.values(theta)[0]
    A, nominal = (true.error.poses(q, values) for values in (errors, 0.0 * errors))
    calibrated = term.error.poses(q, term.values(fitted.solved.theta)[0])
    before, _ = apart(A, absorbed(A, nominal))
    names = ("position", "orientation")
    deviations = dict(zip(names, apart(A, absorbed(A, calibrated)), strict=True))
    sizes: dict[str, Any] = {name: rms(size) for name, size in deviations.items()}
    for name, size in deviations.items():
        sizes[f"{name}_share"] = float(np.quantile(size, SHARE))
    expected = bound = np.nan
    if fitted.noise:
        tool = ToolErrors.of(fitted, term, q).expected(rng)
        expected, bound = tool.calibrated.position, tool.bound.position
    return replace(trial, nominal=rms(before), **sizes, expected=expected, bound=bound)
