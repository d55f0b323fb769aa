"""Programs of joint commands say the same as the commands."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.io.exchange.motions import (
    joint_trajectory,
    paced,
    speed_limits,
    urscript,
)
from calib_pin.kinematics.joint_columns import JointColumns


def test_a_program_of_moves():
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    q = chain.random_configurations(5, np.random.default_rng(0))
    columns = JointColumns.of(chain)
    text = urscript(chain, columns, q, 0.25, ["commands"]).decode()
    moves = re.findall(r"^  movej\(\[(.*)\], a=1.2, v=(.*)\)$", text, re.MULTILINE)
    read = [[*map(float, m[0].split(","))] for m in moves]
    np.testing.assert_allclose(read, q, rtol=0.0, atol=1e-9)
    assert {float(m[1]) for m in moves} == {round(0.25 * 2.16, 6)}
    assert text.startswith("# commands\ndef commands():\n")
    assert text.endswith("end\ncommands()\n")


def test_times_of_a_trajectory_go_on():
    """Where a target stands twice, too: controllers refuse the whole message."""
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    q = np.array([[0.0] * 6, [0.1] * 6, [0.1] * 6, [0.3] * 6])
    text = joint_trajectory(chain, JointColumns.of(chain), q, 0.5, [])
    points = yaml.safe_load(text)["points"]
    assert [point["positions"][0] for point in points] == [0.0, 0.1, 0.3]
    stamps = [point["time_from_start"] for point in points]
    times = [stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps]
    assert times[0] == 0.0 and np.diff(times).min() > 0.0


def slow_arm(*speeds):
    """A UR10 whose joints have other largest speeds."""
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    model = chain.robot.model.copy()
    model.velocityLimit = np.array(speeds)
    object.__setattr__(chain.robot, "model", model)
    return chain


def test_joints_without_a_speed():
    still = slow_arm(1.0, 0.0, 1e9, 1.0, 1.0, 1.0)
    with pytest.raises(OptionError, match="shoulder_lift_joint, elbow"):
        speed_limits(still, 1.0)
    with pytest.raises(OptionError):
        joint_trajectory(still, JointColumns.of(still), np.zeros((1, 6)), 1.0, [])


def test_moves_take_the_times_that_a_motion_has():
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    q = np.array([[0.0] * 6, [0.1] * 6, [0.3] * 6])
    rows = np.array([0, 1, 3])
    times, fast = paced(chain, q, rows, np.array([5.0, 6.0, 7.0, 8.0]))
    np.testing.assert_allclose(times, [5.0, 6.0, 8.0])
    assert fast.tolist() == []
    columns = JointColumns.of(chain)
    moves = urscript(chain, columns, q, 0.25, [], times).decode().splitlines()[1:4]
    assert [line.rpartition("], ")[2] for line in moves[1:]] == [
        "t=1.000000)",
        "t=2.000000)",
    ]
    assert "a=1.2, v=" in moves[0]
    short = np.array([5.0, 6.0, 6.0, 6.01])
    _, fast = paced(chain, q, rows, short)
    assert fast.tolist() == [3]
    # A robot without speeds is not judged.
    still = slow_arm(*[0.0] * 6)
    _, fast = paced(still, q, rows, short)
    assert fast.tolist() == []
