"""Displacements of instrument and tool, whatever the robot and its parameters do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.comparison import compare

HERE = (1.0, 0.2, 0.3), (0.1, 0.2, 0.3)
HELD = FrameSetup((0.05, 0.08, 0.12), (0.0, 0.0, 0.0), estimate=True)


def at(shift=0.0, tool=0.0) -> Setup:
    """The tracker and the tool, each moved along an axis."""
    (x, y, z), rpy = HERE
    base = FrameSetup((x, y + shift, z), rpy, estimate=True)
    held = replace(HELD, xyz=(0.05 + tool, 0.08, 0.12))
    return Setup(base_frame=base, tool_frame=held)


@pytest.fixture(scope="module")
def chain():
    return calib_pin.load_chain("space6")


@pytest.fixture(scope="module")
def measured(recorded, chain):
    """Calibrations by tracker, tool and robot that were changed."""

    def make(seed, truth=None, changes=(), parameters=("placement",)):
        setup, truth = Setup(parameters=parameters), truth or at()
        return recorded(chain, "pose", seed, dict(changes), setup=setup, truth=truth)

    return make


@pytest.fixture(scope="module")
def first(measured):
    return measured(0)


def displaced(found):
    return {moved.frame: moved for moved in found.displacements}


def test_a_tracker_that_moved_alone(first, measured) -> None:
    found = compare(first, measured(1, at(shift=1.2e-3)))
    base, tool = displaced(found)["base"], displaced(found)["tool"]
    assert base.shift == pytest.approx(1.2e-3, abs=4.0 * base.sigma[0])
    assert base.chance < 1e-6 and 1e-6 < base.sigma[0] < 2e-4
    # All tool points move along with it.
    assert base.motion == pytest.approx(1.2e-3, rel=0.2)
    assert tool.chance > 1e-3 and not found.drifted


def test_a_tool_that_was_exchanged(first, measured) -> None:
    found = compare(first, measured(1, at(tool=2e-3)))
    moved = displaced(found)
    assert moved["tool"].shift == pytest.approx(2e-3, abs=4 * moved["tool"].sigma[0])
    assert moved["tool"].chance < 1e-6 < moved["base"].chance
    assert not found.drifted


def test_a_robot_that_changed_is_no_displacement(first, measured) -> None:
    """As much as a frame could absorb of it may be one, and is not told as such."""
    change = {"joint_4.placement.rz": 2e-3}
    found = compare(first, measured(1, changes=change))
    assert found.drifted
    assert all(moved.chance > 0.01 for moved in found.displacements)
    both = compare(first, measured(1, at(shift=0.05), change))
    assert both.drifted and displaced(both)["base"].chance < 1e-3
    # The same change of the robot, wherever the tracker stands.
    assert both.drift.position.rms == pytest.approx(found.drift.position.rms, rel=1e-3)


def test_what_a_frame_absorbs_is_none_of_the_robot(first, measured) -> None:
    """An offset of the first joint is a tracker that was turned."""
    found = compare(first, measured(1, changes={"joint_1.placement.rz": 3e-3}))
    assert not found.drifted and found.moved == ()
    base = displaced(found)["base"]
    assert base.turn == pytest.approx(3e-3, abs=5.0 * base.sigma[1])
    assert base.chance < 1e-6


def test_noise_displaces_by_as_much_as_is_said(measured) -> None:
    pairs = [(measured(2 * k), measured(2 * k + 1)) for k in range(8)]
    found = [displaced(compare(*pair)) for pair in pairs]
    squares = [
        moved.shift**2 / (3.0 * moved.sigma[0] ** 2)
        for pair in found
        for moved in pair.values()
    ]
    # The mean of sixteen chi-squares with up to three degrees of freedom each.
    assert 0.3 < np.mean(squares) < 1.8
    chances = [moved.chance for pair in found for moved in pair.values()]
    assert min(chances) > 1e-4 and max(chances) > 0.2


def test_other_parameters_do_not_matter(first, measured) -> None:
    dh = measured(1, at(shift=1.2e-3), parameters=("dh",))
    base = displaced(compare(first, dh))["base"]
    assert base.shift == pytest.approx(1.2e-3, abs=5.0 * base.sigma[0])


def test_without_a_covariance_nobody_knows(first, measured) -> None:
    later = measured(1, at(shift=1.2e-3))
    unknown = replace(later, covariance=later.covariance * np.nan)
    base = displaced(compare(first, unknown))["base"]
    assert math.isnan(base.chance) and math.isnan(base.sigma[0])
    assert base.shift == pytest.approx(1.2e-3, rel=0.1)
