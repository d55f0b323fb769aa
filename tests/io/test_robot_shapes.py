"""What links look like, and what stands in where a mesh is missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.stand_ins import JOINT

ARM = """<robot name="arm">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="base">{base}</link><link name="upper">{upper}</link>
  <link name="tool">{tool}</link>
  <joint name="shoulder" type="revolute"><origin xyz="0 0 0.2"/>
    <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="flange" type="fixed"><origin xyz="0.3 0 0"/>
    <parent link="upper"/><child link="tool"/></joint>
</robot>"""

TETRAHEDRON = """v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.2
f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"""


def visual(geometry: str, more: str = "", kind: str = "visual") -> str:
    return f"<{kind}>{more}<geometry>{geometry}</geometry></{kind}>"


def arm(base: str = "", upper: str = "", tool: str = "") -> str:
    return ARM.format(base=base, upper=upper, tool=tool)


def test_visuals_come_before_collisions(write: Callable[..., Path]) -> None:
    ball_, cube = '<sphere radius="0.1"/>', '<box size="0.2 0.2 0.4"/>'
    placed = '<origin xyz="0 0 0.1" rpy="0 0 1.5"/><material name="red"/>'
    first = visual(cube, placed) + visual(ball_, kind="collision")
    file = write(arm(first, visual(ball_, kind="collision")), "arm.urdf")
    shapes = robot_shapes(load_robot(file))
    assert shapes.missing == ()
    first, second = shapes.parts
    assert (first.link, first.color) == ("base", (1.0, 0.0, 0.0))
    assert first.placement[:3, 3].tolist() == [0.0, 0.0, 0.1]
    assert first.placement[:2, 0] == pytest.approx([np.cos(1.5), np.sin(1.5)])
    assert np.ptp(first.surface.vertices, axis=0).tolist() == [0.2, 0.2, 0.4]
    assert (second.link, second.color) == ("upper", None)
    assert np.ptp(second.surface.vertices, axis=0) == pytest.approx(0.2, rel=0.01)


@pytest.mark.parametrize(
    "bad",
    [
        '<mesh filename="broken.obj"/>',
        '<mesh filename="a.obj" scale="1e308 1 1"/>',
        "<heap/>",
    ],
)
def test_solids_stand_in_for_what_is_missing(write, capfd, bad):
    write("v 0 0\nf 1 2 9\n", "broken.obj")
    write(TETRAHEDRON, "a.obj")
    good = visual('<sphere radius="0.1"/>')
    file = write(arm(good, good + visual(bad), visual(bad)), "arm.urdf")
    shapes = robot_shapes(load_robot(file))
    assert len(shapes.missing) == 1
    links = [shape.link for shape in shapes.parts]
    assert links == ["base", "upper", "upper", "tool"]
    _, joint, upper, tool = shapes.parts
    assert joint.color == JOINT
    # From the shoulder to the flange, along x of the link.
    points = upper.surface.vertices @ upper.placement[:3, :3].T + upper.placement[:3, 3]
    radius = np.ptp(upper.surface.vertices[:, 0]) / 2.0
    assert 0.006 <= radius < 0.03
    assert points.min(axis=0) == pytest.approx([-radius] * 3, rel=0.02)
    assert points.max(axis=0) == pytest.approx([0.3 + radius, radius, radius], rel=0.02)
    assert np.ptp(tool.surface.vertices, axis=0).max() < 0.06
    assert capfd.readouterr() == ("", "")


def test_a_robot_without_any_shapes(write: Callable[..., Path]) -> None:
    shapes = robot_shapes(load_robot(write(arm(), "arm.urdf")))
    assert shapes.missing == ()
    assert {shape.link for shape in shapes.parts} == {"base", "upper", "tool"}
