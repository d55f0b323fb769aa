"""What is wrong with joint readings: reversed, offset, coupled, or nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import AnchorSetup, FrameSetup, JointMap, Setup
from calib_pin.validation.findings.joint_columns import (
    Reading,
    Suggestion,
    suggest_conventions,
)

KNOWN = FrameSetup((0.4, -0.2, 0.3), (0.1, 0.2, 0.3), estimate=False)
TOOL = FrameSetup((0.05, 0.08, 0.12))
SETUP = Setup(parameters=("joint-offset",), base_frame=KNOWN, tool_frame=TOOL)


@pytest.fixture(scope="module")
def arm(urdf_of: Callable[..., str], chain_of: Callable[..., Chain]) -> Chains:
    """Three joints that turn and one that slides."""
    twists = [(0, 0, 0.4, 0, 0, 0), (0.1, 0, 0, 0.4, 0, 0.2), (0.5, 0, 0, 0, 0.3, 0)]
    joints = [
        {
            "name": f"j{k}",
            "parent": f"l{k}",
            "child": f"l{k + 1}",
            "axis": axis,
            "placement": pin.exp6(np.array(twist)),
            "type": "prismatic" if k == 3 else "revolute",
            "limits": (-0.3, 0.3) if k == 3 else (-2.0, 2.0),
        }
        for k, (axis, twist) in enumerate(
            zip(
                [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0)],
                [*twists, (0.3, 0, 0.1, 0, 0, 0.1)],
                strict=True,
            )
        )
    ]
    return Chains.of(chain_of(urdf_of(*joints)))


@pytest.fixture(scope="module")
def rows(arm: Chains) -> Observations:
    """Positions of a robot with errors."""
    problem = nominal_problem(arm, "position", SETUP)
    rng = np.random.default_rng(7)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    return calib_pin.simulate(problem, truth, rng, count=30, noise=5e-5)


def misread(rows: Observations, change: Callable[[Floats], None]) -> Observations:
    q = rows.q.copy()
    change(q)
    return Observations.of(replace(rows.only, q=q))


def reverse(q: Floats) -> None:
    q[:, 1] *= -1.0


def slide(q: Floats) -> None:
    q[:, 3] *= -1.0


def offset(q: Floats) -> None:
    q[:, 2] += np.pi / 2.0


def couple(q: Floats) -> None:
    q[:, 2] -= q[:, 1]


def couple_and_reverse(q: Floats) -> None:
    q[:, 2] = -(q[:, 2] + q[:, 1])


def couple_one_and_reverse_another(q: Floats) -> None:
    q[:, 2] -= q[:, 1]
    q[:, 0] *= -1.0


@pytest.mark.parametrize(
    ("change", "readings"),
    [
        (reverse, (Reading(1, sign=-1),)),
        (slide, (Reading(3, sign=-1),)),
        (offset, (Reading(2, offset=-np.pi / 2.0),)),
        (couple, (Reading(2, coupled=1),)),
        (couple_and_reverse, (Reading(2, sign=-1, coupled=1),)),
        (
            couple_one_and_reverse_another,
            (Reading(0, sign=-1), Reading(2, coupled=1)),
        ),
    ],
)
def test_what_is_wrong_is_found(
    change: Callable[[Floats], None],
    readings: tuple[Reading, ...],
    arm: Chains,
    rows: Observations,
) -> None:
    wrong = misread(rows, change)
    found = suggest_conventions(arm, wrong, SETUP)
    assert found is not None
    assert found.readings == readings
    assert found.after < 0.05 * found.before and found.before > 1e3
    for reading in found.readings:
        np.testing.assert_allclose(
            reading.position(wrong.q), rows.q[:, reading.joint], atol=1e-12
        )


def test_an_unknown_base_as_well(arm: Chains, rows: Observations) -> None:
    found = suggest_conventions(arm, misread(rows, couple), Setup())
    assert found is not None
    assert found.readings == (Reading(2, coupled=1),)


def test_readings_that_are_right(arm: Chains, rows: Observations) -> None:
    assert suggest_conventions(arm, rows, SETUP) is None


def test_rows_of_something_else(arm: Chains, rows: Observations) -> None:
    """Nothing helps decisively: better no advice than a wrong one."""
    order = np.random.default_rng(0).permutation(len(rows))
    mixed = Observations.of(replace(rows.only, q=rows.q[order]))
    assert suggest_conventions(arm, mixed, SETUP) is None


def test_without_a_measuring_frame(arm: Chains) -> None:
    """Closed forms are poor there; the registration is fitted."""
    wire = {"w": AnchorSetup((1.5, 0.2, 0.4), estimate=False)}
    setup = Setup(anchors=wire, tool_frame=TOOL)
    problem = nominal_problem(arm, "point-distance", setup)
    rng = np.random.default_rng(7)
    zero = np.zeros(len(problem.parameters))
    exact = calib_pin.simulate(problem, zero, rng, count=40, noise=5e-5)
    wrong = misread(exact, reverse)
    found = suggest_conventions(arm, wrong, replace(setup, tool_frame=FrameSetup()))
    assert found is not None
    np.testing.assert_allclose(
        found.readings[0].position(wrong.q), exact.q[:, found.readings[0].joint]
    )


def test_starts_are_read_like_the_rows(arm: Chains) -> None:
    problem = nominal_problem(arm, "relative-distance", Setup(tool_frame=TOOL))
    rng = np.random.default_rng(7)
    zero = np.zeros(len(problem.parameters))
    rows = calib_pin.simulate(problem, zero, rng, count=40, noise=5e-5)
    q, start = rows.q.copy(), rows.only.start.copy()
    couple(q), couple(start)
    wrong = Observations.of(replace(rows.only, q=q, start=start))
    known = Setup(tool_frame=replace(TOOL, estimate=False))
    found = suggest_conventions(arm, wrong, known)
    assert found is not None and found.after < 10.0
    assert found.readings == (Reading(2, coupled=1),)


def test_progress(arm: Chains, rows: Observations) -> None:
    told: list[float] = []
    suggest_conventions(arm, misread(rows, reverse), SETUP, told.append)
    assert told and told == sorted(told) and min(told) >= 0.0 and told[-1] < 1.0


# What is said of it.


def test_a_position_by_hand() -> None:
    q = np.array([[1.0, 0.25]])
    assert Reading(0).position(q) == [1.0]
    assert Reading(1, sign=-1, offset=0.5).position(q) == [0.25]
    assert Reading(1, sign=-1, coupled=0, factor=-1).position(q) == [0.75]


def test_the_message_is_a_setup_file() -> None:
    joints = ("base", "elbow")
    found = Suggestion(
        (Reading(0, offset=np.pi / 2.0), Reading(1, sign=-1, coupled=0)), 2000.0, 10.0
    )
    assert found.text(joints, {}) == (
        "they fall to 0.5 % before any fit if joint 'base' is offset by 90 deg and "
        "joint 'elbow' is coupled to 'base' and reversed; state it in the setup file, "
        "joints: {base: {joint: base, offset: 1.57079633}, "
        "elbow: {joint: elbow, coupled: {base: 1}, sign: -1}}"
    )
    # Under the names of the columns.
    maps = {"A1": JointMap("base"), "A2": JointMap("elbow")}
    assert "A2: {joint: elbow, coupled: {A1: 1}, sign: -1}" in found.text(joints, maps)
    # What is mapped already would change the entries.
    maps["A2"] = JointMap("elbow", sign=-1)
    text = found.text(joints, maps)
    assert text.endswith("reversed; state it under 'joints' in the setup file")
