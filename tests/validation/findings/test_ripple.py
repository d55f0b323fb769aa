"""Ripples of gears are found with their frequency, and none in noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.ripple import periodogram, ripples

TOOL = FrameSetup((0.0, 0.0, 0.1), estimate=True)
PLAIN = Setup(tool_frame=TOOL)


@dataclass(frozen=True)
class Job:
    chain: Chain
    data: Observations
    problem: Problem
    theta: Floats

    @property
    def case(self) -> Case:
        fitted = fit_model(self.chain, self.data, PLAIN, 0).fit
        return Case.of(fitted, fitted.problem.chains)


def job(seed: int, count: int = 120, **waves: float) -> Job:
    """A robot with waves of some joints, by joint and component; noise of 20 um."""
    ratios = {"joint_2": 80.0, "joint_4": 101.0}
    setup = Setup(
        parameters=("placement", "transmission"), gear_ratios=ratios, tool_frame=TOOL
    )
    chain = calib_pin.load_chain("space6")
    problem, rng = (
        nominal_problem(chain, "position", setup),
        np.random.default_rng(seed),
    )
    theta = draw_errors(problem.parameters, rng)
    for k, name in enumerate(problem.parameters.names):
        if ".transmission." in name:
            joint, _, component = name.split(".")
            theta[k] = waves.get(f"{joint}_{component}", 0.0)
    data = simulate(problem, theta, rng, count=count, noise=2e-5)
    return Job(chain, data, problem, theta)


def test_a_strain_wave_gear_and_the_lines_that_describe_it() -> None:
    one = job(0, joint_2_motor_sin2=1e-4, joint_2_motor_cos=1e-4)
    (finding,) = ripples(one.case)
    assert (finding.code, finding.severity) == ("gear-ripple", "info")
    assert finding.evidence["joint"] == "joint_2"
    assert finding.evidence["frequency"] in (80.0, 160.0)
    assert finding.evidence["amplitude"] == pytest.approx(1e-4, abs=2e-5)
    ratio = finding.setup["gear_ratios"]["joint_2"]
    assert ratio in (80.0, 160.0)
    lines = finding.setup
    assert lines["parameters"] == ["placement", "motor-ripple"]
    stated = replace(
        PLAIN, parameters=tuple(lines["parameters"]), gear_ratios=lines["gear_ratios"]
    )
    fitted = fit_model(one.chain, one.data, stated, 0).fit
    parameters = fitted.problem.parameters
    wave = "motor_sin2" if ratio == 80.0 else "motor_sin"
    found = fitted.theta[parameters.index(f"joint_2.transmission.{wave}")]
    assert found == pytest.approx(1e-4, abs=2e-5)


def test_half_the_frequency_is_the_motor_of_a_strain_wave_gear() -> None:
    one = job(3, joint_2_motor_sin2=2e-4, joint_2_motor_cos=5e-5)
    (finding,) = ripples(one.case)
    assert finding.evidence["frequency"] == 160.0
    assert finding.setup["gear_ratios"] == {"joint_2": 80.0}


def test_two_joints_are_told_apart() -> None:
    one = job(1, joint_2_motor_sin2=2e-4, joint_4_motor_cos=2e-4)
    (finding,) = ripples(one.case)
    assert set(finding.setup["gear_ratios"]) == {"joint_2", "joint_4"}
    assert finding.setup["gear_ratios"]["joint_4"] == 101.0


def test_noise_and_low_waves_are_none() -> None:
    """Eccentric wheels have parameters of their own."""
    for seed in range(4):
        assert not list(ripples(job(seed).case))
        low = {f"joint_{k}_sin1": 2e-4 for k in range(1, 7)}
        assert not list(ripples(job(seed, **low).case))


def test_the_periodogram_is_least_squares() -> None:
    rng = np.random.default_rng(0)
    q, motion, r = rng.uniform(-2.0, 2.0, 40), rng.normal(size=40), rng.normal(size=40)
    frequencies = 5.0 + 0.37 * np.arange(150)
    expected = []
    for frequency in frequencies:
        waves = np.column_stack([np.sin(frequency * q), np.cos(frequency * q)])
        A = motion[:, None] * waves
        expected.append(float(r @ A @ np.linalg.lstsq(A, r, rcond=None)[0]))
    found = periodogram(q, motion, r, frequencies)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.slow
def test_false_alarms_are_rarer_than_their_bound() -> None:
    """60 jobs of noise, and as many with wheels that no model has."""
    assert not sum(bool(list(ripples(job(500 + seed).case))) for seed in range(60))
    low = {f"joint_{k}_{w}": 2e-4 for k in range(1, 7) for w in ("sin1", "cos2")}
    met = sum(bool(list(ripples(job(600 + seed, **low).case))) for seed in range(60))
    assert met <= 1


@pytest.mark.slow
def test_a_ripple_that_is_modeled_costs_no_accuracy() -> None:
    """Lines of the finding against the true gear, on other configurations."""
    ratios = []
    for seed in range(4):
        one = job(100 + seed, joint_2_motor_sin2=2e-4, joint_2_motor_cos=5e-5)
        (finding,) = ripples(one.case)
        rng = np.random.default_rng(seed)
        exact = (one.problem, one.theta, rng)
        at = simulate(*exact, count=200, noise=0.0).only
        errors = []
        for stated in (finding.setup["gear_ratios"], {"joint_2": 80.0}):
            setup = replace(
                PLAIN, parameters=("placement", "motor-ripple"), gear_ratios=stated
            )
            fit = calib_pin.calibrate(one.chain, one.data, setup, validate=False).model
            off = fit.predict(fit.theta, at) - at.values
            errors.append(float(np.sqrt(np.mean(off**2))))
        ratios.append(errors[0] / errors[1])
    assert max(ratios) < 1.2
