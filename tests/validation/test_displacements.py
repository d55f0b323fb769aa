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


def test_noise_displaces_by_as_much_as_is_said(first, measured) -> None:
    found = displaced(compare(first, measured(2)))
    for moved in found.values():
        # Chi-squares with up to three degrees of freedom.
        assert 0.01 < moved.shift**2 / moved.sigma[0] ** 2 < 20.0
        assert moved.chance > 1e-3


def test_without_a_covariance_nobody_knows(first, measured) -> None:
    later = measured(1, at(shift=1.2e-3))
    unknown = replace(later, covariance=later.covariance * np.nan)
    base = displaced(compare(first, unknown))["base"]
    assert math.isnan(base.chance) and math.isnan(base.sigma[0])
    assert base.shift == pytest.approx(1.2e-3, rel=0.1)
