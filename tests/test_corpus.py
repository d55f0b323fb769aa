"""Every arm and leg of example-robot-data: random errors into the URDF and back.

A corrected URDF is read again and its kinematics compared with the error model; the
bytes outside the `<origin>` elements of the chain are those of the original.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import RobotError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedModel

ORIGIN = re.compile(rb"<origin\b[^>]*>")


def arms_and_legs(robot: Robot) -> list[Chain]:
    """Chains from the root to the leaves, but those whose joints others contain."""
    chains = []
    for leaf in robot.leaves:
        try:
            chain = Chain(robot, tip=leaf)
        except RobotError as error:
            assert "no moving joint" in error.reason or "cannot contain" in error.reason
            continue
        if len(chain.joints) >= 2:
            chains.append(chain)
    # A finger shares the arm, a camera hangs on a link in the middle of it.
    chosen: list[Chain] = []
    for chain in sorted(chains, key=lambda chain: -len(chain.joints)):
        if not any(set(chain.joints) <= set(other.joints) for other in chosen):
            chosen.append(chain)
    return chosen


def disturbed(
    chain: Chain, parameterizations: Sequence[str], rng: np.random.Generator
) -> CalibratedModel:
    """The chain with random errors of 1e-3 m and rad, in frames at random."""
    setup = Setup(parameters=tuple(parameterizations))
    problem = nominal_problem(chain, "position", setup)
    frames = problem.parameters.nuisance
    size = np.where(frames, 1.0, 1e-3)
    return CalibratedModel.create(problem, size * rng.normal(size=len(frames)))


def changed_lines(old: bytes, new: bytes) -> list[bytes]:
    """The lines of the new file that are not in the old one."""
    before = old.decode().splitlines()
    after = new.decode().splitlines()
    if len(before) == len(after):
        pairs = zip(before, after, strict=True)
        return [b.encode() for a, b in pairs if a != b]
    lines = difflib.unified_diff(before, after, n=0, lineterm="")
    return [line[1:].encode() for line in lines if line[:1] == "+"][1:]


def assert_written(model: CalibratedModel, path: Path, q: Floats) -> None:
    calib_pin.write_urdf(model, path)
    calibrated = model.of()
    chain = calibrated.chain
    source, written = chain.robot.source, path.read_bytes()
    robot = load_robot(path)
    # The tip poses that the model predicts, in the base link.
    expected = calibrated.error.tip_poses(q, calibrated.theta)
    if chain.tip_joint is None:
        # Errors behind the last joint are carried by the tool.
        tail = calibrated.error.tool * calibrated.tool.inverse()
        expected = expected @ tail.homogeneous
    found = Chain(robot, chain.base, chain.tip).poses(q)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)

    changed = changed_lines(source, written)
    corrected = model.urdf_corrections()
    assert corrected
    assert all(re.search(rb"\b(xyz|rpy)\s*=", line) for line in changed)
    # Some files give xyz and rpy a line each.
    two_lines = any(b"<origin" not in line for line in changed)
    assert len(changed) <= len(corrected) * (2 if two_lines else 1)
    # Without the origins nothing differs; a missing one is added on a line of its own.
    added = len(ORIGIN.findall(written)) - len(ORIGIN.findall(source))
    assert 0 <= added <= len(corrected)
    if added == 0:
        assert ORIGIN.split(source) == ORIGIN.split(written)


def test_every_arm_and_leg(example_robot: Path, tmp_path: Path) -> None:
    robot = load_robot(example_robot)
    rng = np.random.default_rng(len(robot.source))
    for k, chain in enumerate(arms_and_legs(robot)):
        model = disturbed(chain, ["placement"], rng)
        q = chain.random_configurations(3, rng)
        # The error is there at all.
        calibrated = model.of()
        moved = calibrated.error.tip_poses(q, calibrated.theta) - chain.poses(q)
        assert np.abs(moved).max() > 1e-4
        assert_written(model, tmp_path / f"{k}.urdf", q)


TIAGO = ("example:tiago_no_hand", "torso_fixed_link", "arm_7_link")
"""A lift, and a tip without a fixed joint."""

TALOS = ("example:talos_reduced", "gripper_right_base_link", "gripper_left_base_link")
"""Two limbs, one of them from its end to the root."""

SPACE = ("space6", "base_link", "")
UR10 = ("example:ur10_robot", "world", "wrist_3_link")


@pytest.mark.parametrize(
    ("ends", "parameterizations"),
    [
        (SPACE, ["placement"]),
        (TIAGO, ["link-transform"]),
        (TALOS, ["dh"]),
        (TIAGO, ["dh-full"]),
        (UR10, ["joint-offset"]),
        (TALOS, ["joint-offset", "placement", "dh"]),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "+".join(value),
)
@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_every_parameterization_both_ways(
    ends: tuple[str, str, str],
    parameterizations: list[str],
    direction: str,
    tmp_path: Path,
    independent_poses: Callable[..., Any],
) -> None:
    name, base, tip = ends
    robot = load_robot(name)
    links = (base, tip or robot.leaves[0])
    chain = Chain(robot, *(links if direction == "forward" else links[::-1]))
    rng = np.random.default_rng(1)
    model = disturbed(chain, parameterizations, rng)
    q = chain.random_configurations(3, rng)
    path = tmp_path / "corrected.urdf"
    assert_written(model, path, q)
    # What another library makes of the file.
    calibrated = model.of()
    to_base = calibrated.error.base.homogeneous
    tool = calibrated.tool.homogeneous
    named = dict(zip(chain.joints, q[0], strict=True))
    frames = [(chain.base, chain.tip)]
    (pose,) = independent_poses(path.read_bytes(), named, frames)
    expected = calibrated.poses(q)[0]
    np.testing.assert_allclose(to_base @ pose @ tool, expected, rtol=0, atol=1e-9)


def test_zero_errors_change_nothing(tmp_path: Path) -> None:
    chain = calib_pin.load_chain("example:talos_reduced", tip="left_sole_link")
    model = disturbed(chain, ["placement"], np.random.default_rng(0))
    still = replace(model, theta=0.0 * model.theta)
    calib_pin.write_urdf(still, tmp_path / "same.urdf")
    assert (tmp_path / "same.urdf").read_bytes() == chain.robot.source
