"""Beginners with a servo arm: their arms are those of the URDFs, the judge is one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yourdfpy

from benchmarks.servo import ARMS, Arm, Beginner, _judged, desk4, run
from calib_pin.io.urdf import locate_robot


@pytest.mark.parametrize("robot", ARMS)
def test_kinematics_are_those_of_the_urdf(robot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tip = ARMS[robot]
    if robot == "desk4":
        robot = "desk4.urdf"
        Path(robot).write_text(desk4())
    file = Path(locate_robot(robot))
    arm = Arm.read(file, tip)
    other = yourdfpy.URDF.load(str(file), load_meshes=False, mesh_dir="")
    q = np.random.default_rng(0).uniform(*arm.limits.T)
    at_zero = dict.fromkeys(other.actuated_joint_names, 0.0)
    other.update_cfg(at_zero | dict(zip(arm.names, q, strict=True)))
    T, point = other.get_transform(tip, other.base_link), np.array([0.01, 0.02, 0.03])
    assert np.allclose(arm.tip(q, point), T[:3, :3] @ point + T[:3, 3], atol=1e-9)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("a,-1,2.1,0.1", "right"),
        ("a,+1,2.1,0.1", "wrong: sign of a"),
        ("a,-1,-2.1,0.1", "wrong: a "),
        ("a,-1,,", "right, 1 not known"),
    ],
)
def test_the_judge(row: str, said: str) -> None:
    one = Beginner("arm", "tip", True, {"a": np.radians(-2.0)}, {"a": -1}, "", {})
    assert _judged(one, f"# a\njoint,sign,offset,sigma\n{row}\n", "GOOD").startswith(
        said
    )


@pytest.mark.slow
def test_a_beginner_with_a_mirrored_arm(tmp_path: Path) -> None:
    assert run(41, tmp_path)[2].startswith("right")
