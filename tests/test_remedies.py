"""What would tell more of a robot: counts by the structure, and what they promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.formulation import nominal_problem
from calib_pin.parameterizations import frame_pose
from calib_pin.remedies import remedies
from calib_pin.setup import FrameSetup, PlaneSetup, Setup

CHAIN = calib_pin.load_chain("space6")
BASE = FrameSetup((0, 0, 0), (0, 0, 0), estimate=False)
TOOL = FrameSetup((0.1, 0.05, 0.2), (0.1, 0.2, 0.3), estimate=False)


def found(model: str, setup: Setup, tool: pin.SE3 | None = None) -> dict[str, int]:
    if tool is not None:
        placed = replace(TOOL, xyz=tuple(tool.translation), rpy=(0, 0, 0))
        setup = replace(setup, tool_frame=replace(placed, estimate=None))
    known = calib_pin.identify(CHAIN, model, setup)
    plain = replace(setup, tool_frame=FrameSetup())
    stated = setup if tool is None else plain
    return {r.change: r.count for r in remedies(CHAIN, model, stated, known, tool=tool)}


def test_positions_of_an_arm() -> None:
    """A target on the last axis hides two errors, full poses show two as well."""
    known = calib_pin.identify(CHAIN, "position")
    assert known.identifiability.robot_rank == 16
    gains = found("position", Setup())
    assert [*gains.values()] == [18, 18, 22, 17, 26]
    beside, poses, base, tool, last = gains
    assert "beside the last axis" in beside and "poses" in poses
    assert "frames.base" in base and "frames.tool" in tool
    assert last == "all of these"


def test_a_target_beside_the_last_axis() -> None:
    """Where it sits there already, a fit says so, poses show no more of the robot."""
    gains = found("position", Setup(), pin.SE3(np.eye(3), np.array([0.1, 0.05, 0.2])))
    assert [*gains.values()] == [24, 20, 26]
    assert not any("beside" in change or "poses" in change for change in gains)


def test_what_becomes_identifiable() -> None:
    """The names are those of an analysis in which the frame is known."""
    setup = Setup()
    now = calib_pin.identify(CHAIN, "pose", setup)
    base = next(
        r for r in remedies(CHAIN, "pose", setup, now) if "frames.base" in r.change
    )
    then = calib_pin.identify(CHAIN, "pose", Setup(base_frame=BASE))
    known = {p.name for p in now.parameters if p.status == "identifiable"}
    gained = {p.name for p in then.parameters if p.status == "identifiable"} - known
    assert set(base.parameters) == gained
    assert any(name.startswith("joint_1.placement") for name in gained)


def test_nothing_is_left_to_gain_where_all_is_known() -> None:
    assert found("pose", Setup(base_frame=BASE, tool_frame=TOOL)) == {}


def test_what_is_held_stays_held() -> None:
    """Globs of the setup hold here too, those of the instrument name nothing."""
    setup = Setup(
        planes={"wall": PlaneSetup((0.1, 0.2, 1.0), -3.0)},
        tool_frame=TOOL,
        fixed=("wall.plane.*", "joint_[1-5].placement.*"),
    )
    gains = found("plane-distance", setup)
    assert all(count <= 6 for count in gains.values())


def test_distances_gain_by_a_tracker() -> None:
    setup = Setup(planes={"wall": PlaneSetup((0.1, 0.2, 1.0), -3.0)})
    known = calib_pin.identify(CHAIN, "plane-distance", setup)
    gains = found("plane-distance", setup)
    assert all(count > known.identifiability.robot_rank for count in gains.values())
    assert not any("all of" in change for change in gains)


@pytest.mark.parametrize("model", ["position", "pose"])
def test_the_promise_is_kept_by_a_fit(model: str) -> None:
    """Rows with a known base estimate as many errors of the robot as was said."""
    setup = Setup(base_frame=BASE)
    tool = frame_pose(TOOL)
    gains = found(model, Setup(), tool)
    promised = next(count for change, count in gains.items() if "base" in change)
    problem = nominal_problem(CHAIN, model, replace(setup, tool_frame=TOOL))
    rng = np.random.default_rng(1)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=40, noise=1e-6)
    result = calib_pin.calibrate(CHAIN, rows, setup, validate=False)
    assert result.identifiability.robot_rank == promised
    assert len(result.identifiability.singular_values) == promised
