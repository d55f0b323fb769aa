"""Gears, couplings and lag of joints are found in any fit, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Explanation, read_so, setup_lines
from calib_pin.validation.findings.joint_motions import joint_motion
from calib_pin.validation.findings.joint_offsets import joint_offset

ARM = calib_pin.load_chain("space6")
CHAINS = Chains.of(ARM)
TOOL = FrameSetup((0.05, 0.08, 0.12))
SETUP = Setup()


def simulated(
    model: str = "position", count: int = 50, setup: Setup = SETUP
) -> Measurements:
    problem = nominal_problem(ARM, model, replace(setup, tool_frame=TOOL))
    rng = np.random.default_rng(3)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=count, noise=1e-4).only
    return replace(
        rows, lines=np.arange(2, len(rows) + 2), files=("a.csv",) * len(rows)
    )


ROWS = simulated()


def case_of(rows: Measurements, setup: Setup = SETUP) -> Case:
    data = Observations.of(rows)
    return Case.of(fit_model(ARM, data, setup, 0).fit, CHAINS)


def lagging(rows: Measurements, parts: np.ndarray) -> Measurements:
    """What is read if the joints have still a part of their last motion before them."""
    q = rows.q.copy()
    for k in range(1, len(q)):
        q[k] = (rows.q[k] - parts * q[k - 1]) / (1.0 - parts)
    return replace(rows, q=q)


def code_of(found: Explanation | None) -> str:
    return "" if found is None else found.faults[0].code


def test_a_coupling() -> None:
    q = ROWS.q.copy()
    q[:, 2] -= 0.01 * q[:, 1]
    case = case_of(replace(ROWS, q=q))
    found = joint_motion(case)
    lines = setup_lines(case, found.faults)["joints"][ARM.joints[2]]
    assert lines["coupled"][ARM.joints[1]] == pytest.approx(0.01, abs=2e-4)


def test_a_lag_of_all_joints() -> None:
    wrong = lagging(ROWS, np.full(6, 0.004))
    case = case_of(wrong)
    found = joint_motion(case)
    lag = setup_lines(case, found.faults)["reading"]["lag"]
    assert lag == dict.fromkeys(ARM.joints, pytest.approx(0.004, abs=2e-4))
    read = read_so(Observations.of(wrong), found.faults)
    np.testing.assert_allclose(read.q, ROWS.q, atol=5e-4)


def test_starts_of_relative_distances_have_the_gear() -> None:
    rows = simulated("relative-distance", 80)
    q, start = rows.q.copy(), rows.start.copy()
    q[:, 2] /= 1.02
    start[:, 2] /= 1.02
    found = joint_motion(case_of(replace(rows, q=q, start=start)))
    assert code_of(found) == "joint-gear"


def test_a_gear_that_the_fit_has_is_no_fault() -> None:
    q = ROWS.q.copy()
    q[:, 2] /= 1.01
    setup = replace(SETUP, parameters=("placement", "transmission"))
    assert joint_motion(case_of(replace(ROWS, q=q), setup)) is None


def test_an_offset_that_the_fit_has_found_is_a_round_angle() -> None:
    q = ROWS.q.copy()
    q[:, 2] -= np.radians(5.0)
    found = joint_offset(case_of(replace(ROWS, q=q)))
    lines = setup_lines(case_of(replace(ROWS, q=q)), found.faults)["joints"]
    # The rest is an error of the robot.
    assert lines[ARM.joints[2]]["offset"] == pytest.approx(np.radians(5.0))
    q[:, 2] += np.radians(3.0)
    assert joint_offset(case_of(replace(ROWS, q=q))) is None
