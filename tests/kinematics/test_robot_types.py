"""Robots are of one type by their geometry, not by their files."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.setup.population import RobotType
from tests.shared import chain_of

ARM = """<robot name="{name}">
  <link name="world"/><link name="base"/><link name="x"/><link name="y"/>
  <link name="tip"/>
  <joint name="mount" type="fixed"><origin xyz="{mount}"/>
    <parent link="world"/><child link="base"/></joint>
  <joint name="a" type="revolute"><origin xyz="0 0 {height}"/>
    <parent link="base"/><child link="x"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="b" type="revolute"><origin xyz="{length} 0 0.2"/>
    <parent link="x"/><child link="y"/><axis xyz="{axis}"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="end" type="fixed"><origin xyz="{end} 0 0"/>
    <parent link="y"/><child link="tip"/></joint>
</robot>"""
GIVEN = {
    "name": "arm",
    "mount": "0 0 0",
    "height": 0.3,
    "length": 0.1,
    "axis": "0 1 0",
    "end": 0.1,
}


def arm(**changes: object) -> RobotType:
    return robot_type(Chains.of(chain_of(ARM.format(**{**GIVEN, **changes}))))


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
