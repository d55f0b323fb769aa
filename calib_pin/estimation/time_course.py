"""The course of time, as the measurements tell it: a warm-up, a drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.conditions import at_conditions, require_conditions
from calib_pin.estimation.drift import with_drift
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.parameterizations.thermal import WarmUp, passed
from calib_pin.setup import Setup

SHORTEST, LONGEST = 0.03, 2.0
"""Time constants that are tried, by the time of the measurements; one that is longer
passes for a straight line, and a shorter one for nothing."""

CLOSE = 0.03
"""Relative difference of time constants that no measurements tell apart."""


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

    That is the one that leaves the least noise, each quantity by its own.

    Args:
        chains: The nominal chains.
        measurements: The measurements to fit.
        setup: The setup; what it states of the warm-up stands.
        seed: Seed of the fits.

    Raises:
        InputError: If a measurement does not state its time.
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
        plain = replace(stated(logarithm), learned=None)
        problem = make_problem(chains, measurements, plain)
        noise = fit(problem, np.random.default_rng(seed)).noise
        known = [one for one in noise if one.estimate > 0.0]
        return float(sum(one.values * np.log(one.estimate) for one in known))

    lower, upper = np.log([SHORTEST * span, LONGEST * span]).tolist()
    found = minimize_scalar(
        left, bounds=(lower, upper), method="bounded", options={"xatol": CLOSE}
    )
    return stated(float(found.x))
