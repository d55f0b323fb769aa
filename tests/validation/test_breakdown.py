"""Stations, tools and chains of a calibration, and what they have in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import FrameSetup, Setup, ToolSetup


@pytest.fixture(scope="module")
def job(moved_job):
    return moved_job((30, 60), (45,))


@pytest.fixture(scope="module")
def result(job):
    return calib_pin.calibrate(job.chain, job.named)


def test_numbers_and_names(result) -> None:
    assert [(f.name, f.link, f.measurements) for f in result.stations] == [
        (f"s{k}", result.model.chains[""].base, 30) for k in range(3)
    ]
    assert [(f.name, f.measurements) for f in result.tools] == [("t0", 45), ("t1", 45)]
    (chain,) = result.chains
    assert chain.measurements == 90 and chain.still == ()
    assert chain.errors == tuple(
        replace(e, validation_before=None, validation_after=None) for e in result.errors
    )


def test_frames_are_the_true_ones_within_their_deviations(result, job) -> None:
    """Of positions, and of what positions tell of orientations."""
    for frames, stated in (
        (result.stations, job.truth.stations),
        (result.tools, job.truth.tools),
    ):
        for frame in frames:
            truth = frame_pose(stated[frame.name])
            R = pin.rpy.rpyToMatrix(*frame.rpy)
            error = np.append(
                np.array(frame.xyz) - truth.translation, pin.log3(R @ truth.rotation.T)
            )
            sigma = np.array(frame.sigma)
            known = np.isfinite(sigma)
            assert (sigma[known] > 0.0).all()
            # Of 24 components one in 160 such comparisons is beyond four.
            assert (np.abs(error)[known] < 4.0 * sigma[known]).all()
    assert all(np.isfinite(frame.sigma).all() for frame in result.stations)
    # Nobody knows how a point is turned.
    assert all(np.isnan(frame.sigma[3:]).all() for frame in result.tools)


def test_a_tool_on_another_has_its_own_place(moved_job) -> None:
    job = moved_job((), (45,))
    first, second = (frame_pose(job.truth.tools[name]) for name in ("t0", "t1"))
    between = first.inverse() * second
    rpy = pin.rpy.matrixToRpy(between.rotation)
    stated = ToolSetup(tuple(between.translation), tuple(rpy), on="t0")
    setup = Setup(tools={"t1": stated})
    result = calib_pin.calibrate(job.chain, job.named, setup)
    for frame, truth in zip(result.tools, (first, second), strict=True):
        assert frame.xyz == pytest.approx(tuple(truth.translation), abs=2e-3)
    assert [frame.name for frame in result.tools] == ["t0", "t1"]


FRAMES = Setup(
    base_frame=FrameSetup((0.3, -0.2, 0.5), (0.1, -0.05, 0.4)),
    tool_frame=FrameSetup((0.1, 0.05, 0.2)),
)


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_frames_of_which_only_the_sum_is_known(scara, calibrated_robot, size) -> None:
    """Without errors nothing shows which is which; errors that tilt axes do, hardly."""
    found = calibrated_robot("pose", FRAMES, 40, size, 1, robot=scara, noise=5e-5)
    (base,), (tool,) = found.stations, found.tools
    assert tool.unknown == ("z",) and "z" in base.unknown
    assert {*base.unknown} <= {*"xyz"}
    assert {"base.frame.z", "tool.frame.z"} <= {*found.unknown}
    # What is known is right: of 8 components one in 2000 is beyond four.
    truth = frame_pose(FRAMES.tool_frame).translation
    for axis in (0, 1):
        assert abs(tool.xyz[axis] - truth[axis]) < 4.0 * tool.sigma[axis]


def test_a_value_that_is_held_has_no_deviation(scara, calibrated_robot) -> None:
    """With the height of the tool given, that of the base is known as well."""
    held = replace(FRAMES, fixed=("tool.frame.z",))
    found = calibrated_robot("pose", held, 40, 1.0, 1, robot=scara, noise=5e-5)
    (base,), (tool,) = found.stations, found.tools
    assert (base.unknown, tool.unknown, found.unknown) == ((), (), ())
    assert tool.sigma[2] == 0.0
