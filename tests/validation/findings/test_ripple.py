"""Ripples of gears are found with their frequency, and none in noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
from calib_pin.validation.findings.joint_motions import periodogram, ripples

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


def test_two_joints_are_told_apart() -> None:
    one = job(1, joint_2_motor_sin2=2e-4, joint_4_motor_cos=2e-4)
    (finding,) = ripples(one.case)
    assert set(finding.setup["gear_ratios"]) == {"joint_2", "joint_4"}
    assert finding.setup["gear_ratios"]["joint_4"] == 101.0


def test_low_waves_are_none() -> None:
    """Eccentric wheels have parameters of their own."""
    low = {f"joint_{k}_sin1": 2e-4 for k in range(1, 7)}
    assert not list(ripples(job(0, **low).case))


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
