"""A robot that grows warm: how fast is found, and the geometry is that of the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.time_course import with_warm_up
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Setup, ThermalSetup
from calib_pin.simulation import draw_errors, simulate

HOUR = 3600.0
CHAIN = calib_pin.load_chain("space6")
SETUP = Setup(
    parameters=("placement", "warm-up"),
    tool_frame=FrameSetup((0.0, 0.0, 0.1), estimate=True),
)


def job(constant: float, seed: int) -> tuple[Problem, Floats]:
    """A robot with errors of its geometry that grows warm."""
    thermal = ThermalSetup(switched_on=(0.0,), warm_up_time=constant)
    true = replace(SETUP, thermal=thermal)
    problem = nominal_problem(CHAIN, "position", true)
    theta = draw_errors(problem.parameters, np.random.default_rng(seed))
    for k, name in enumerate(problem.parameters.names):
        if ".warm-up." in name:
            theta[k] = 6e-4
    return problem, theta


def measured(
    problem: Problem, theta: Floats, seed: int, count: int = 40
) -> Observations:
    """Positions within an hour, with a noise of 20 um."""
    rng = np.random.default_rng(seed)
    time = Conditions(time=np.linspace(0.0, HOUR, count))
    q = CHAIN.random_configurations(count, rng)
    return simulate(problem, theta, rng, q=q, conditions=time, noise=2e-5)


def test_its_time_constant_is_found() -> None:
    data = measured(*job(400.0, 1), 1)
    found = with_warm_up(Chains.of(CHAIN), data, SETUP, 0).thermal
    assert found.switched_on == (0.0,)
    assert found.warm_up_time == pytest.approx(400.0, rel=0.3)


def test_what_is_stated_stands() -> None:
    data = measured(*job(600.0, 2), 2)
    stated = replace(SETUP, thermal=ThermalSetup(warm_up_time=900.0))
    assert with_warm_up(Chains.of(CHAIN), data, stated, 0) == stated
    plain = replace(SETUP, parameters=("placement",))
    assert with_warm_up(Chains.of(CHAIN), data, plain, 0) == plain


def test_the_geometry_is_that_of_the_warm_robot() -> None:
    problem, theta = job(900.0, 3)
    data = measured(problem, theta, 3)
    plain = replace(SETUP, parameters=("placement",))
    result = calib_pin.calibrate(CHAIN, data, problem.setup, validate=False)
    still = fit(make_problem(CHAIN, data, plain), np.random.default_rng(0))
    q = CHAIN.random_configurations(100, np.random.default_rng(9))
    error, own = problem.only.error, problem.only.split(theta)[0]
    warm, errors = error.poses(q, own)[:, :3, 3], []
    part = still.problem.only
    for found in (
        result.model.of().poses(q),
        part.error.poses(q, part.split(still.theta)[0]),
    ):
        off = found[:, :3, 3] - warm
        errors.append(rms(off - off.mean(0)))
    assert errors[0] < 0.4 * errors[1]
    # Six links that are 0.6 per mille shorter when cold.
    (told,) = [f for f in result.findings if f.code == "modeled-warm-up"]
    basis = error.basis(q, Conditions(time=np.zeros(len(q))))
    cold = error.poses(q, own, basis)[:, :3, 3] - warm
    assert told.evidence["cold"] == pytest.approx(rms(cold), rel=0.3)


def rms(vectors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def test_each_morning_anew() -> None:
    """A robot that is switched on twice is cold twice."""
    thermal = ThermalSetup(switched_on=(0.0, 1e5), warm_up_time=600.0)
    problem = nominal_problem(CHAIN, "position", replace(SETUP, thermal=thermal))
    error = problem.only.error
    q = np.zeros((3, len(CHAIN.joints)))
    values = error.basis(q, Conditions(time=np.array([0.0, 1e5 - 1.0, 1e5])))
    np.testing.assert_allclose(values[0], values[2])
    assert np.abs(values[0]).min() == 1.0 and np.abs(values[1]).max() < 1e-6
