"""A calibration that goes on from an older one.

The older estimate is the mean of a joint prior of the robot's errors, with the
covariance that it had, what the robot drifts between two calibrations, and sudden
changes where the new measurements show any. Frames and instrument are free: a tracker
that is set up anew stands elsewhere, and a tool that is known has to be stated.

The new measurements are compared with what the older calibration predicts, before
anything is fitted to them. How far robots drift is told by these innovations, week by
week better; noise and drift of a size that was never seen are something else, and so
is a single joint that accounts for nearly all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import OptionError
from calib_pin.estimation.directions import nuisance_basis
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.estimation.registration import registered
from calib_pin.estimation.solve import least_squares
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import JointPrior, Setup
from calib_pin.validation.accuracy import Accuracy
from calib_pin.validation.joint_changes import changes, drifts
from calib_pin.validation.older_calibration import (
    expected_drifts,
    older_prior,
    pooled_noise,
    require_usable,
    wider,
)
from calib_pin.validation.older_predictions import Comparison
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Recalibration, RecalibrationStep

SELDOM = 0.01
"""Chance that the offset of a joint changes at once between two calibrations, for which
measurements are planned."""

SOME = 300
"""Measurements that are compared; more do not make it clearer."""


CALM = float(np.log(10.0))
"""Logarithm of the evidence that a robot does not drift which the first calibration
after another one is thought to have; later ones have that of all before them. Without
it one in ten robots that do not drift seems to (months of `scripts/benchmark`)."""


@serial_blas
def started(
    chains: Chains,
    data: Observations,
    setup: Setup,
    start: CalibrationResult | None,
    process_noise: float | None = None,
    ladder: bool = False,
) -> tuple[Setup, Recalibration]:
    """Begin a calibration with an older one.

    Args:
        chains: The nominal chains.
        data: The new measurements to fit.
        setup: Estimated and known quantities.
        start: The older calibration.
        process_noise: Standard deviation of the drift of each error of the geometry
            since then [m, rad], of other errors by their expected sizes; default as the
            measurements show it.
        ladder: Whether the model is to be selected, which the older one has fixed.

    Returns:
        The setup with the older calibration as prior, and how that has predicted the
        new measurements.

    Raises:
        OptionError: If there is no older calibration, or it is of another robot or of
            other parameters, or must not be trusted.
    """
    if start is None:
        raise OptionError("a process noise belongs to an older calibration, 'start'")
    if ladder:
        raise OptionError(
            "the model of an older calibration is kept; it is not selected anew",
            allowed="an older calibration, or the selection of a model",
        )
    require_usable(chains, setup, start)
    noise = pooled_noise(start)
    known = {one.quantity: one.sigma for one in noise}
    stated = replace(setup, prior={}, noise={**known, **setup.noise})
    problem = make_problem(chains, data.sample(SOME), stated)
    older = older_prior(problem.given, problem.parameters.free, start, known)
    there, theta = _registered(problem, older)
    compared = Comparison(there, theta, older, start, noise)
    last = None if start.recalibration is None else start.recalibration.last
    still = CALM if last is None else last.still
    found = compared.explained(expected_drifts(start, process_noise), still)
    step = RecalibrationStep(
        start=start.provenance.file,
        created=start.provenance.created,
        measurements=len(data),
        chi2=found.square,
        dof=len(compared.values),
        noise=noise,
        drifts=found.drifts,
        jumps=tuple(found.jumps.values()),
        still=found.still - (CALM if last is None else 0.0),
    )
    steps = () if start.recalibration is None else start.recalibration.steps
    table = error_table(there, theta)
    recalibration = Recalibration(
        tuple(
            (quantity.name, quantity.unit, Accuracy.of(sizes))
            for quantity in there.layout.quantities
            if len(sizes := quantity.errors(table))
        ),
        (*steps, step),
    )
    return replace(setup, prior=compared.prior(found)), recalibration


def expected_setup(
    chains: Chains,
    setup: Setup,
    start: CalibrationResult,
    process_noise: float | None = None,
) -> Setup:
    """A setup that knows beforehand what a calibration will, to plan for it.

    Args:
        chains: The nominal chains.
        setup: Estimated and known quantities.
        start: The older calibration that it will begin with.
        process_noise: As for `started`.

    Raises:
        OptionError: As for `started`.
    """
    require_usable(chains, setup, start)
    given = start.model.given
    fixed = {p.name for p in start.parameters if p.status == "fixed"}
    free = np.array([p.name not in fixed for p in given])
    known = {one.quantity: one.sigma for one in pooled_noise(start)}
    older = older_prior(given, free, start, known)
    robot = free & ~given.nuisance
    directions = drifts(start.model, robot)
    drifted = [
        (d.size, directions[d.name][robot])
        for d in expected_drifts(start, process_noise)
    ]
    # Which joint was hit, if one was, must show as well.
    hit = [c for c in changes(start.model, robot).values() if c.kind == "offset"]
    drifted += [(SELDOM**0.5, change.directions[robot]) for change in hit]
    return replace(setup, prior=wider(older, given.scales[robot], drifted))


def _registered(problem: Problem, older: JointPrior) -> tuple[Problem, Floats]:
    """A problem about frames and instrument that suit the older robot, and values."""
    values = {p.name: p.mean for p in older.parameters}
    theta = problem.parameters.vector(values)
    there = registered(problem, theta)
    # Stations are not eliminated here: what they absorb is projected out later.
    return there, least_squares(there, theta, nuisance_basis(there.parameters)).x
