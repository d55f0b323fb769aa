"""Errors of the robot as people name them: each direction once, and right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.identifiability import visible_directions
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.kinematics.chain import Chain
from calib_pin.report.identification import corrections, error_table, held
from calib_pin.report.terminal import plain_text
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.assessment import identify, robot_errors
from calib_pin.validation.result import CalibrationResult, Coefficient, RobotError
from tests.shared import simulated

ARM = "example:so101"
TIP = "gripper_frame_link"


@pytest.fixture(scope="module")
def chain() -> Chain:
    return calib_pin.load_chain(ARM, tip=TIP)


def measured(chain: Chain) -> tuple[Any, Any]:
    """Full poses of the printed arm, and its errors."""
    return simulated("pose", None, 60, 1.0, 3, robot=chain, noise=None)


@pytest.fixture(scope="module")
def result(chain: Chain) -> CalibrationResult:
    return calib_pin.calibrate(chain, measured(chain)[0].data, validate=False)


def known(errors: tuple[RobotError, ...]) -> list[RobotError]:
    return [error for error in errors if error.status == "identifiable"]


def test_lengths_of_a_link_with_two_branches_are_told_apart():
    lengths = [
        RobotError("link length", ("torso",), "m", 1e-3, 1e-5, "identifiable", terms=of)
        for of in ((Coefficient(f"{side}.1.placement.x", 1.0),) for side in "lr")
    ]
    text = plain_text([error_table(lengths, "Errors", ())])
    assert "torso to l.1\n" in text and "torso to r.1\n" in text
    assert " to " not in plain_text([error_table(lengths[:1], "Errors", ())])


def test_what_a_denavit_hartenberg_table_says(result):
    """Length and twist of every link, offsets of the inner joints, parallel axes."""
    assert len(known(result.robot_errors)) == result.identifiability.robot_rank == 14
    found = {}
    for error in known(result.robot_errors):
        found.setdefault(error.kind, []).append(error.of)
    links = [(f"{name}_link",) for name in ("shoulder", "upper_arm", "lower_arm")]
    links.append(("wrist_link",))
    inner = ("shoulder_lift", "elbow_flex", "wrist_flex")
    assert found == {
        "joint offset": [(joint,) for joint in inner],
        "link length": links,
        "link offset": [inner],
        "link twist": links,
        "axis tilt": [("elbow_flex",), ("wrist_flex",)],
    }


def test_values_and_deviations_are_those_of_the_full_sum(chain, result):
    """Nearly all lie within two standard deviations of the truth."""
    problem, theta = measured(chain)
    structure, _ = analyze_structure(
        problem, np.zeros(len(theta)), np.random.default_rng(0)
    )
    exact = {(e.kind, e.of): e.terms for e in robot_errors(problem, structure)}
    misses = []
    for error in known(result.robot_errors):
        terms = exact[error.kind, error.of]
        true = sum(theta[problem.parameters.index(n)] * c for n, c in terms)
        misses.append((error.value - true) / error.sigma)
    # Second-order terms of the errors add to the noise.
    assert np.sqrt(np.mean(np.square(misses))) < 2.0


def test_frames_take_what_they_can(result):
    absorbed = [e for e in result.robot_errors if e.status == "absorbed"]
    assert {(e.of, e.within) for e in absorbed} == {
        (("shoulder_pan",), ("base.frame",)),
        (("wrist_roll",), ("tool.frame",)),
    }
    base, tool = plain_text(held(result.robot_errors)).splitlines()[-2:]
    assert "shoulder_pan" in base and "wrist_roll" in tool


def test_no_frame_hides_the_ends_of_the_arm_when_both_are_known(chain):
    known_frame = FrameSetup((0, 0, 0), (0, 0, 0), estimate=False)
    setup = Setup(base_frame=known_frame, tool_frame=known_frame)
    found = identify(chain, "pose", setup)
    assert all(e.status == "identifiable" for e in found.robot_errors)
    offsets = [e.of[0] for e in found.robot_errors if e.kind == "joint offset"]
    assert offsets == list(chain.joints)


@pytest.mark.parametrize(
    ("robot", "model", "parameters"),
    [
        ("space6", "position", ("placement",)),
        ("heavy6", "pose", ("dh",)),
        ("space7", "pose", ("link-transform",)),
        ("pa10", "pose", ("placement", "transmission")),
    ],
)
def test_as_many_errors_as_the_robot_has(robot, model, parameters):
    setup = Setup(parameters=parameters)
    chain = calib_pin.load_chain(robot)
    problem = nominal_problem(chain, model, setup)
    zero = np.zeros(len(problem.parameters))
    found, J = analyze_structure(problem, zero, np.random.default_rng(0))
    errors = robot_errors(problem, found)
    assert len(known(errors)) == visible_directions(J, problem.parameters).shape[1]
    # All of them lie in what can be known.
    free = problem.parameters.free
    _, _, Vt = np.linalg.svd(found.relations, full_matrices=False)
    for error in known(errors):
        row = problem.parameters.vector(dict(error.terms)) * problem.parameters.scales
        row = row[free] / np.linalg.norm(row)
        assert np.linalg.norm(row - Vt.T @ (Vt @ row)) < 0.01


def test_small_corrections_are_counted_and_not_listed(result):
    errors = tuple(
        replace(e, value=0.5 * e.sigma) if e.kind == "link length" else e
        for e in result.robot_errors
    )
    text = plain_text(corrections(replace(result, robot_errors=errors)))
    assert "link twist" in text and "link length" not in text
    small = sum(abs(e.value) < 2.0 * e.sigma for e in known(errors))
    assert f"{small} more" in text
