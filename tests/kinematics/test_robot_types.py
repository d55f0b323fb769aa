"""Robots are of one type by their geometry, not by their files."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.setup.population import RobotType
from tests.shared import chain_of, joint, urdf_of


def arm(
    name: str = "arm",
    mount: str = "0 0 0",
    height: float = 0.3,
    length: float = 0.1,
    axis: str = "0 1 0",
    end: float = 0.1,
) -> RobotType:
    urdf = urdf_of(
        joint("mount", "world base", mount, kind="fixed"),
        joint("a", "base x", f"0 0 {height}"),
        joint("b", "x y", f"{length} 0 0.2", axis),
        joint("end", "y tip", f"{end} 0 0", kind="fixed"),
        name=name,
    )
    return robot_type(Chains.of(chain_of(urdf)))


@pytest.mark.parametrize(
    ("changes", "differing"),
    [
        # Mounts, tools and names do not matter, nor does the eighth digit.
        ({"name": "arm_17", "end": 0.5, "length": 0.10000001}, ()),
        ({"mount": "1 2 3", "height": 0.4}, ()),
        ({"length": 0.101}, ("'b'", "placement")),
        ({"axis": "1 0 0"}, ("'b'", "axis")),
    ],
)
def test_of_one_type(changes, differing) -> None:
    told = arm().difference(arm(**changes))
    assert bool(told) == bool(differing) and all(word in told for word in differing)


def test_of_other_joints() -> None:
    own, other = arm(), robot_type(Chains.of(load_chain("space6")))
    name = other.joints[0].name
    assert f"'{name}'" in own.difference(other)
    assert own.difference(replace(own, joints=own.joints[:1]))
    assert own.difference(replace(own, joints=own.joints[::-1]))
