"""Robots in MuJoCo's files, as a URDF: where MuJoCo has them, and Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import RobotError
from calib_pin.io.urdf import load_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from tests.shared import refused

REMARK = "read from MJCF: bodies and sites are links, shapes are not taken over"

pytestmark = pytest.mark.needs("mujoco")

HEAD = """<mujoco model="arm">
  <compiler angle="degree" autolimits="true"/>
  <default>
    <joint axis="0 1 0" range="-100 100"/>
    <default class="tilt"><joint axis="1 0 0" range="-10 10"/></default>
  </default>
"""

BODIES = """<body name="one" pos="0 0 0.3" euler="0 0 30">
  <joint name="j1" axis="0 0 1" ref="20"/>
  <inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.2 0.15"/>
  <body name="two" pos="0.5 0 0.1" quat="0.8 0.6 0 0">
    <joint name="j2" pos="0 0.1 0.05"/>
    <joint name="j3" class="tilt" pos="0.02 0 0"/>
    <geom type="capsule" size="0.05 0.2"/>
    <body pos="0.4 0 0">
      <joint name="slide" type="slide" axis="1 1 0" range="0 0.3"/>
      <geom type="box" size=".1 .1 .1"/>
      <site name="tip" pos="0 0 0.1"/>
      <body name="tool" pos="0.1 0 0"/>
    </body>
  </body>
</body>"""

BASE = f'<body name="base"><geom type="box" size=".1 .1 .1"/>{BODIES}</body>'


def written(folder: Path, bodies: str, head: str = HEAD) -> Path:
    file = folder / "arm.xml"
    file.write_text(f"{head}<worldbody>{bodies}</worldbody></mujoco>")
    return file


def read(file: Path) -> Robot:
    """The robot, without a process of its own."""
    from calib_pin.io.mjcf_child import read

    urdf, remark = read(str(file))
    return replace(parse_robot(urdf.encode(), str(file)), remarks=(remark,))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(written(tmp_path_factory.mktemp("plain"), BASE))


def test_what_stands_in_the_file(plain: Robot) -> None:
    model, robot = pin.buildModelFromMJCF(plain.file), plain
    assert Chain(robot, "base", "two").joints == ("j1", "j2", "j3")
    chain = Chain(robot, "base", "tool")
    assert chain.joints == ("j1", "j2", "j3", "slide")
    q = chain.random_configurations(5, np.random.default_rng(1))
    tip, tool = Chain(robot, "base", "tip").poses(q), chain.poses(q)
    assert np.allclose(np.linalg.solve(tip, tool)[:, :3, 3], [0.1, 0.0, -0.1])
    # Degrees, but those of a slide are meters.
    limits = np.deg2rad([100.0, 100.0, 10.0])
    assert np.allclose(chain.upper, [*limits, 0.3]) and chain.lower[3] == 0.0
    assert robot.links[0] == robot.root == "world" and robot.remarks == (REMARK,)
    assert robot.model.inertias[1] == model.inertias[1]
    assert robot.source.startswith(b'<robot name="arm">')


def test_a_free_body_is_carried_but_no_chain_contains_it(tmp_path):
    free = f'<body name="torso" pos="0 0 1"><freejoint name="fly"/>{BODIES}</body>'
    robot = read(written(tmp_path, free))
    assert len(Chain(robot, "torso", "tool").joints) == 4
    with refused(RobotError):
        Chain(robot, tip="tool")


def test_files_that_are_included(tmp_path: Path, plain: Robot) -> None:
    """A part among the bodies, and one with settings and bodies of its own."""
    (tmp_path / "parts").mkdir()
    part, defaults = (tmp_path / "parts" / name for name in ("a.xml", "b.xml"))
    part.write_text(f"<mujocoinclude>{BODIES}</mujocoinclude>")
    worldbody = '<worldbody><geom type="plane" size="1 1 1"/></worldbody>'
    defaults.write_text(f"{HEAD}{worldbody}</mujoco>")
    bodies = '<body name="base"><include file="parts/a.xml"/></body>'
    head = '<mujoco model="arm"><include file="parts/b.xml"/>'
    found = Chain(read(written(tmp_path, bodies, head)), tip="tip")
    expected = Chain(plain, tip="tip")
    q = expected.random_configurations(5, np.random.default_rng(0))
    assert found.joints == ("j1", "j2", "j3", "slide")
    assert np.array_equal(found.poses(q), expected.poses(q))
    assert np.array_equal(found.upper, expected.upper)


def test_what_has_no_name_or_is_in_a_frame(tmp_path: Path) -> None:
    nameless = BODIES.replace('name="j2"', "").replace('name="j3"', "")
    inner = '<body name="inner"><joint name="j9"/><geom size="1"/></body>'
    part = f'<frame pos="0 0 1">{inner}</frame><site name="tip"'
    bodies = nameless.replace('<site name="tip"', part)
    chain = Chain(read(written(tmp_path, bodies)), tip="tool")
    robot = chain.robot
    assert robot.remarks == (REMARK,)
    assert len({*robot.model.names}) == 6
    # Without a body that stands still, the world is the base.
    assert chain.base == "world" and len(chain.joints) == 4
    assert Chain(robot, tip="inner").joints[-1] == "j9"


def test_meshes_that_are_not_there(tmp_path: Path) -> None:
    bodies = '<body name="a"><joint/><geom type="mesh" mesh="m"/></body>'
    assets = '<asset><mesh name="m" file="no.stl"/></asset>'
    file = written(tmp_path, bodies, f"{HEAD}{assets}")
    with refused(RobotError, "no.stl"):
        read(file)


def test_couplings_are_those_of_mujoco(tmp_path: Path) -> None:
    """Of joints with reference positions, and those that no URDF can hold."""
    import mujoco

    equal = '<equality><joint joint1="j3" joint2="j1" polycoef="0.1 -2 0 0 0"/>'
    equal += '<joint joint1="slide" joint2="j2" polycoef="0 0 1 0 0"/>'
    equal += '<joint joint1="j2" polycoef="0.2 0 0 0 0"/></equality>'
    file = written(tmp_path, BASE, f"{HEAD}{equal}")
    robot = read(file)
    assert {*robot.mimics} == {"j3"} and "slide, j2 moves freely" in robot.remarks[0]
    chain = Chain(robot, tip="tool")
    q = chain.random_configurations(5, np.random.default_rng(2))
    model = mujoco.MjModel.from_xml_path(str(file))
    zero = {n: model.qpos0[model.joint(n).qposadr[0]] for n in ("j1", "j3")}
    j1, j3 = (q[:, chain.joints.index(n)] - zero[n] for n in ("j1", "j3"))
    assert np.allclose(j3, 0.1 - 2.0 * j1, atol=1e-12)


def test_warnings_leave_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = written(tmp_path, BASE.replace('pos="0 0 0.3"', 'pos="nan 0 0.3"'))
    with refused(RobotError, file=str(file)):
        load_robot(file)
    assert [*tmp_path.iterdir()] == [file]


WRONG = [
    '<body name="a"><joint type="ball" name="b"/><geom size="1"/></body>',
    '<include file="arm.xml"/>',
    '<body name="a"><joint name="j" class="no"/><geom size="1"/></body>',
]


@pytest.mark.parametrize("bodies", WRONG)
def test_wrong_files(tmp_path: Path, bodies: str) -> None:
    file = written(tmp_path, bodies)
    with refused(RobotError):
        read(file)


def test_other_xml_files(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text('<robot name="arm"><link name="a"/></robot>')
    assert load_robot(file).name == "arm" and load_robot(file).remarks == ()
    for text in (
        f"<!DOCTYPE a [<!ENTITY b 'c'>]>{HEAD}</mujoco>",
        "<sdf version='1.9'/>",
    ):
        file.write_text(text)
        with refused(RobotError, file=str(file)):
            load_robot(file)


def test_all_its_bodies_are_where_mujoco_has_them(tmp_path):
    import mujoco

    table = '<body name="table" pos="1 2 3"><joint ref="5"/><geom size="1"/></body>'
    turned = BASE.replace('name="slide"', 'name="slide" ref="0.1" pos="0 0 0.2"')
    turned = turned.replace('class="tilt"', 'class="tilt" ref="-30"')
    file = written(tmp_path, turned + table)
    robot = read(file)
    model = mujoco.MjModel.from_xml_path(str(file))
    state = mujoco.MjData(model)
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 5)):
        state.qpos[:] = q
        mujoco.mj_kinematics(model, state)
        for name in ("one", "two", "tool", "table"):
            chain, body = Chain(robot, tip=name), state.body(name)
            own = q[-1:] if name == "table" else q[: len(chain.joints)]
            pose = chain.poses(own[None])[0]
            # Some dozen products of numbers up to 4.
            assert np.abs(pose[:3, 3] - body.xpos).max() < 1e-13
            assert np.abs(pose[:3, :3].ravel() - body.xmat).max() < 1e-13
