"""Gears, couplings and lag of joints are found in any fit, and nothing else is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import Explanation, read_so, setup_lines
from calib_pin.validation.findings.joint_motions import joint_motion

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
    found = joint_motion(case_of(replace(ROWS, q=q)))
    lines = setup_lines(case_of(replace(ROWS, q=q)), found.faults)["joints"]
    # The rest is an error of the robot.
    assert lines[ARM.joints[2]]["offset"] == pytest.approx(np.radians(5.0))
    q[:, 2] += np.radians(3.0)
    assert joint_motion(case_of(replace(ROWS, q=q))) is None


@pytest.mark.parametrize("each", [False, True])
def test_joints_that_were_still_moving(each: bool) -> None:
    """All arrive 6 deg after they were read, or the farthest and the others with it."""
    angle, problem = np.radians(6.0), nominal_problem(ARM, "position", SETUP)
    rng = np.random.default_rng(5)
    arrived = ARM.random_configurations(50, rng)
    way = np.diff(arrived, axis=0, prepend=arrived[:1])
    far = np.abs(way) if each else np.abs(way).max(axis=1, keepdims=True)
    q = arrived - np.minimum(angle / np.maximum(far, 1e-9), 1.0) * way
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, q=q, noise=1e-4).only
    found = joint_motion(case_of(replace(rows, q=arrived)))
    assert code_of(found) == "lag"
    assert f"{'every joint' if each else 'the farthest'} has 6 deg to go" in (
        found.faults[0].words
    )
    assert found.after < 1e-3


def test_a_stated_base_that_is_turned_is_no_offset_of_the_first_joint() -> None:
    known = replace(SETUP, base_frame=FrameSetup(estimate=False))
    rows = simulated("pose", setup=known)
    q = rows.q - np.radians([40.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert joint_motion(case_of(replace(rows, q=q), known)) is None


def test_a_gear_that_no_robot_has() -> None:
    q = ROWS.q.copy()
    q[:, 5] /= 1.5
    found = joint_motion(case_of(replace(ROWS, q=q)))
    lines = setup_lines(case_of(ROWS), found.faults)["joints"][ARM.joints[5]]
    assert lines["gear"] == pytest.approx(1.5, rel=0.02)


RAIL = """<robot name="rail">
<link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="rail" type="prismatic"><parent link="a"/><child link="b"/>
<axis xyz="1 0 0"/><limit lower="0" upper="2" effort="1" velocity="1"/></joint>
<joint name="j1" type="revolute"><parent link="b"/><child link="c"/>
<origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="c"/><child link="d"/>
<origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("factor", [np.degrees(1.0), np.radians(1.0)])
def test_a_rail_whose_column_is_converted_as_an_angle(
    tmp_path: Path, factor: float
) -> None:
    (tmp_path / "rail.urdf").write_text(RAIL)
    chain = calib_pin.load_chain(tmp_path / "rail.urdf")
    problem, rng = nominal_problem(chain, "position", SETUP), np.random.default_rng(3)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=40, noise=1e-4).only
    q = rows.q * [factor, 1.0, 1.0]
    case = Case.of_robot(Chains.of(chain), Observations.of(replace(rows, q=q)), SETUP)
    found = joint_motion(case)
    lines = setup_lines(case, found.faults)["joints"]
    assert lines["rail"]["gear"] == pytest.approx(1.0 / factor, rel=0.02)
