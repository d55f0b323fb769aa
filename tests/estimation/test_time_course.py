"""A robot that grows warm: how fast is found, and the geometry is that of the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.time_course import with_warm_up
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Payload, Setup, ThermalSetup
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
    problem: Problem, theta: Floats, seed: int, count: int = 80
) -> Observations:
    """Positions within an hour, with a noise of 20 um."""
    rng = np.random.default_rng(seed)
    time = Conditions(time=np.linspace(0.0, HOUR, count))
    q = CHAIN.random_configurations(count, rng)
    return simulate(problem, theta, rng, q=q, conditions=time, noise=2e-5)


@pytest.mark.parametrize("constant", [400.0, 1500.0])
def test_its_time_constant_is_found(constant: float) -> None:
    data = measured(*job(constant, 1), 1)
    found = with_warm_up(Chains.of(CHAIN), data, SETUP, 0).thermal
    assert found.switched_on == (0.0,)
    assert found.warm_up_time == pytest.approx(constant, rel=0.3)


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
    q = CHAIN.random_configurations(100, np.random.default_rng(9))
    warm = problem.only.error.poses(q, theta[: len(problem.only.error.screws)])
    errors = []
    for setup in (SETUP, plain):
        result = calib_pin.calibrate(CHAIN, data, setup, validate=False)
        off = (result.model.of().poses(q) - warm)[:, :3, 3]
        errors.append(float(np.sqrt(np.mean(np.sum((off - off.mean(0)) ** 2, axis=1)))))
        told = [f for f in result.findings if f.code == "modeled-warm-up"]
        assert len(told) == ("warm-up" in setup.parameters)
        if told:
            # Six links that are 0.6 per mille shorter when cold.
            cold = Conditions(time=np.zeros(len(q)))
            basis = problem.only.error.basis(q, cold)
            own = theta[: len(problem.only.error.screws)]
            moved = (problem.only.error.poses(q, own, basis) - warm)[:, :3, 3]
            size = np.sqrt(np.mean(np.sum(moved**2, axis=1)))
            assert told[0].evidence["cold"] == pytest.approx(size, rel=0.3)
    with_it, without = errors
    assert with_it < 0.4 * without


def test_it_is_told_of_a_robot_that_carries_one_thing_or_another() -> None:
    loads = {"light": Payload(1.0, (0.0, 0.0, 0.1)), "heavy": Payload(5.0, (0.0,) * 3)}
    thermal = ThermalSetup(switched_on=(0.0,), warm_up_time=900.0)
    parameters = ("joint-offset", "compliance", "warm-up")
    setup = replace(SETUP, parameters=parameters, thermal=thermal, payloads=loads)
    problem, rng = nominal_problem(CHAIN, "position", setup), np.random.default_rng(4)
    theta = draw_errors(problem.parameters, rng)
    held = Conditions(payload=("light", "heavy") * 40, time=np.linspace(0.0, HOUR, 80))
    q = CHAIN.random_configurations(80, rng)
    data = simulate(problem, theta, rng, q=q, conditions=held, noise=2e-5)
    result = calib_pin.calibrate(CHAIN, data, setup, validate=False)
    (told,) = [f for f in result.findings if f.code == "modeled-warm-up"]
    assert told.evidence["cold"] > 0.0


def test_each_morning_anew() -> None:
    """A robot that is switched on twice is cold twice."""
    thermal = ThermalSetup(switched_on=(0.0, 1e5), warm_up_time=600.0)
    problem = nominal_problem(CHAIN, "position", replace(SETUP, thermal=thermal))
    error = problem.only.error
    q = np.zeros((3, len(CHAIN.joints)))
    values = error.basis(q, Conditions(time=np.array([0.0, 1e5 - 1.0, 1e5])))
    np.testing.assert_allclose(values[0], values[2])
    assert np.abs(values[0]).min() == 1.0 and np.abs(values[1]).max() < 1e-6
