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
from calib_pin.setup import AnchorSetup, FrameSetup, Setup
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


def words(found: Explanation | None) -> str:
    return "" if found is None else found.faults[0].words


@pytest.mark.parametrize("part", [0.03, -0.001])
def test_a_gear(part: float) -> None:
    q = ROWS.q.copy()
    q[:, 2] /= 1.0 + part
    wrong = replace(ROWS, q=q)
    case = case_of(wrong)
    found = joint_motion(case)
    assert found is not None and found.after < 3e-4 < 0.5 * found.before
    assert words(found).startswith(f"joint '{ARM.joints[2]}' moves ")
    read = read_so(Observations.of(wrong), found.faults)
    np.testing.assert_allclose(read.q, ROWS.q, atol=3e-4)


def test_a_coupling() -> None:
    q = ROWS.q.copy()
    q[:, 2] -= 0.01 * q[:, 1]
    case = case_of(replace(ROWS, q=q))
    found = joint_motion(case)
    assert words(found).startswith(f"joint '{ARM.joints[2]}' is coupled to ")
    lines = setup_lines(case, found.faults)["joints"][ARM.joints[2]]
    assert lines["coupled"][ARM.joints[1]] == pytest.approx(0.01, abs=2e-4)


@pytest.mark.parametrize("joints", [[1], list(range(6))])
def test_a_lag(joints: list[int]) -> None:
    parts = np.zeros(6)
    parts[joints] = 0.004
    wrong = lagging(ROWS, parts)
    case = case_of(wrong)
    found = joint_motion(case)
    whose = "all joints" if len(joints) == 6 else f"joint '{ARM.joints[1]}'"
    assert words(found) == f"errors follow the last motion of {whose}: 0.4 % of it"
    lag = setup_lines(case, found.faults)["reading"]["lag"]
    assert list(lag) == [ARM.joints[j] for j in joints]
    read = read_so(Observations.of(wrong), found.faults)
    np.testing.assert_allclose(read.q, ROWS.q, atol=5e-4)


def test_a_lag_of_lengths_with_few_left_over() -> None:
    """Fewer than twice as many values as unknowns, and a robot with errors."""
    anchors = {
        f"w{k}": AnchorSetup(tuple(1.5 * row), estimate_bias=True)
        for k, row in enumerate(np.eye(3))
    }
    setup = Setup(anchors=anchors)
    rows = simulated("point-distance", 70, setup)
    case = case_of(lagging(rows, np.array([0, 0.01, 0, 0, 0, 0])), setup)
    assert not case.fit.redundant
    assert "last motion of joint" in words(joint_motion(case))


def test_starts_of_relative_distances_have_the_gear() -> None:
    rows = simulated("relative-distance", 80)
    q, start = rows.q.copy(), rows.start.copy()
    q[:, 2] /= 1.02
    start[:, 2] /= 1.02
    found = joint_motion(case_of(replace(rows, q=q, start=start)))
    assert words(found).startswith(f"joint '{ARM.joints[2]}' moves 1.0")


def test_clean_measurements_and_a_reversed_joint_follow_nothing() -> None:
    assert joint_motion(case_of(ROWS)) is None
    q = ROWS.q.copy()
    q[:, 2] *= -1.0
    assert joint_motion(case_of(replace(ROWS, q=q))) is None


def test_a_gear_that_the_fit_has_is_no_fault() -> None:
    q = ROWS.q.copy()
    q[:, 2] /= 1.01
    setup = replace(SETUP, parameters=("placement", "transmission"))
    assert joint_motion(case_of(replace(ROWS, q=q), setup)) is None


@pytest.mark.parametrize("degrees", [5.0, -30.0])
def test_an_offset_that_the_fit_has_found_is_a_warning(degrees: float) -> None:
    q = ROWS.q.copy()
    q[:, 2] -= np.radians(degrees)
    wrong = Observations.of(replace(ROWS, q=q))
    result = calib_pin.calibrate(ARM, wrong)
    (finding,) = result.findings
    assert (finding.code, finding.severity) == ("joint-offset", "warning")
    assert result.verdict == "good"
    entry = finding.setup["joints"][ARM.joints[2]]
    # A round angle; the rest is an error of the robot.
    assert entry["offset"] == pytest.approx(np.radians(degrees))


def test_usual_offsets_are_not_told() -> None:
    assert joint_offset(case_of(ROWS)) is None
    q = ROWS.q.copy()
    q[:, 2] -= np.radians(2.0)
    assert joint_offset(case_of(replace(ROWS, q=q))) is None
