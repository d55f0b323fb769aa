"""Robots in xacro files, as ROS packages have them, and what is wrong with some."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError, OptionError, RobotError
from calib_pin.io import children, xacro_files
from calib_pin.io.meshes import STL
from calib_pin.io.packages import locate_mesh
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.io.urdf import load_chain, load_robot

HEAD = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'

TOP = f"""<?xml version="1.0"?>
{HEAD}
  <xacro:arg name="size" default="5"/>
  <xacro:arg name="prefix" default=""/>
  <xacro:arg name="kinematics" default="$(find arm_description)/arm$(arg size).yaml"/>
  <xacro:include filename="$(find arm_description)/urdf/macro.xacro"/>
  <link name="world"/>
  <xacro:arm prefix="$(arg prefix)" parent="world" kinematics="$(arg kinematics)">
    <origin xyz="0 0 ${{0.1 if '$(arg size)' == '5' else 0.2}}" rpy="0 0 0"/>
  </xacro:arm>
</robot>
"""

MACRO = f"""<?xml version="1.0"?>
{HEAD}
  <xacro:macro name="joint" params="number origin prefix:=^ limit:=${{radians(170)}}">
    <link name="${{prefix}}link${{number}}">
      <visual><geometry>
        <mesh filename="package://arm_description/meshes/${{number}}.stl"/>
      </geometry></visual>
    </link>
    <joint name="${{prefix}}joint${{number}}" type="revolute">
      <parent link="${{prefix}}link${{number - 1}}"/>
      <child link="${{prefix}}link${{number}}"/>
      <origin xyz="${{origin.x}} ${{origin['y']}} ${{origin.z}}"
              rpy="${{origin['roll']}} 0 0"/>
      <axis xyz="0 0 1"/>
      <limit lower="${{-limit}}" upper="${{limit}}" effort="1" velocity="1"/>
    </joint>
  </xacro:macro>
  <xacro:macro name="arm" params="prefix parent kinematics *origin">
    <xacro:property name="stated"
                    value="${{xacro.load_yaml(kinematics)['kinematics']}}"/>
    <link name="${{prefix}}link0"/>
    <joint name="${{prefix}}base" type="fixed">
      <xacro:insert_block name="origin"/>
      <parent link="${{parent}}"/><child link="${{prefix}}link0"/>
    </joint>
    <xacro:joint number="1" origin="${{stated.first}}"/>
    <xacro:joint number="2" origin="${{stated['second']}}"/>
  </xacro:macro>
</robot>
"""

KINEMATICS = """kinematics:
  first: {{x: 0, y: 0, z: 0.4, roll: 0}}
  second: {{x: {length}, y: 0, z: 0, roll: !degrees 90}}
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package in a folder that is called like the repository, not like it."""
    folder = tmp_path / "ws" / "ROS2_Description"
    (folder / "urdf").mkdir(parents=True)
    (folder / "meshes").mkdir()
    triangle = np.zeros(1, STL)
    triangle["corners"] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    data = bytes(80) + struct.pack("<I", 1) + triangle.tobytes()
    (folder / "meshes" / "1.stl").write_bytes(data)
    (folder / "package.xml").write_text(
        "<package><name>arm_description</name></package>"
    )
    (folder / "urdf" / "arm.urdf.xacro").write_text(TOP)
    (folder / "urdf" / "macro.xacro").write_text(MACRO)
    for size, length in (("5", 0.5), ("10", 1.25)):
        text = KINEMATICS.format(length=length)
        (folder / f"arm{size}.yaml").write_text(text)
    return folder


@pytest.fixture(autouse=True)
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)


def test_a_package_as_ros_has_it(package: Path) -> None:
    file = package / "urdf" / "arm.urdf.xacro"
    chain = load_chain(str(file))
    assert chain.joints == ("joint1", "joint2")
    assert chain.placements[0].translation.tolist() == [0.0, 0.0, 0.5]
    assert chain.placements[1].translation[0] == 0.5
    assert chain.placements[1].rotation[2, 1] == 1.0
    robot = load_robot(f"{file} size:=10 prefix:=left_")
    assert robot.links[-1] == "left_link2"
    assert robot.model.jointPlacements[2].translation[0] == 1.25
    mesh = locate_mesh("package://arm_description/meshes/1.stl", file)
    assert mesh == package / "meshes" / "1.stl"
    assert robot_shapes(robot).missing == ("package://arm_description/meshes/2.stl",)
    # The same robot from elsewhere is the same, byte for byte.
    assert load_robot(str(file)).source == chain.robot.source


def test_packages_are_where_one_says(
    package: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    refused: Callable[..., Any],
) -> None:
    file = tmp_path / "own.xacro"
    file.write_text(TOP)
    package.joinpath("package.xml").unlink()
    with refused(RobotError, ["package 'arm_description' is not found"]):
        load_robot(str(file))
    share = tmp_path / "install" / "share"
    share.mkdir(parents=True)
    package.rename(share / "arm_description")
    for folder in (share, share / "arm_description"):
        assert len(load_robot(str(file), [folder]).links) == 4
    with monkeypatch.context() as patch:
        patch.setenv("AMENT_PREFIX_PATH", str(share.parent))
        assert len(load_robot(str(file)).links) == 4
    with monkeypatch.context() as patch:
        patch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{share}")
        assert len(load_robot(str(file)).links) == 4


def test_a_file_named_by_the_user_is_in_the_working_folder(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.yaml").write_text(KINEMATICS.format(length=0.75))
    monkeypatch.chdir(tmp_path)
    file = package / "urdf" / "arm.urdf.xacro"
    robot = load_robot(f"{file} kinematics:=mine.yaml")
    assert robot.model.jointPlacements[2].translation[0] == 0.75
    assert robot.file == f"{file} kinematics:=mine.yaml"


LINK = '<link name="a"/>'

WRONG = {
    "$(arg nowhere)": ["'nowhere' is missing", "nowhere:=VALUE"],
    "${nowhere}": ["'nowhere'", "not defined"],
    "${1 / 0}": ["cannot evaluate '1 / 0'", "zero"],
    "$(find nowhere)": ["package 'nowhere' is not found", "--package-dir"],
    "$(env NOWHERE_AT_ALL)": ["NOWHERE_AT_ALL"],
    "$(anon a)": ["anon"],
    "$(eval ().__class__)": ["cannot evaluate"],
    "$(eval (y for y in [1]).gi_frame)": ["cannot evaluate"],
    "${xacro.load_yaml('nowhere.yaml')}": ["nowhere.yaml", "No such file"],
    "${xacro.load_yaml('/dev/zero')}": ["/dev/zero"],
    "${(y for y in [1]).gi_frame.f_back}": ["gi_frame"],
}


@pytest.mark.parametrize("text", WRONG)
def test_wrong_values(tmp_path: Path, refused: Callable[..., Any], text: str) -> None:
    file = tmp_path / "arm.xacro"
    file.write_text(f'{HEAD}<link name="{text}"/></robot>')
    with refused(RobotError, WRONG[text], file=str(file)):
        load_robot(str(file))


WRONG_FILES = {
    "": ["XML"],
    "no XML at all": ["XML", "line 1"],
    HEAD + LINK: ["not well-formed XML"],
    f"<!DOCTYPE a [<!ENTITY b 'c'>]>{HEAD}{LINK}</robot>": ["DOCTYPE"],
    f'{HEAD}<xacro:include filename="no.xacro"/></robot>': ["no.xacro", "No such file"],
    f"{HEAD}<xacro:nothing/></robot>": ["unknown macro name: xacro:nothing"],
    f'{HEAD}<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/></robot>': [
        "without end"
    ],
    f'{HEAD}<xacro:property name="a" value="${{a}}"/><link name="${{a}}"/></robot>': [
        "circular"
    ],
    f'{HEAD}<xacro:property name="a" value="${{b}}"/>'
    '<xacro:property name="b" value="x"/><link/></robot>': ["link has no name"],
    f'{HEAD}<xacro:macro name="arm" params="a"/></robot>': ["no links"],
    f'{HEAD}<xacro:macro name="m" params="a"/><xacro:m/></robot>': ["Undefined", "a"],
    f'{HEAD}<xacro:macro name="m"/><xacro:m b="1"/></robot>': ["Invalid parameter"],
    f'{HEAD}<xacro:insert_block name="b"/></robot>': ["Undefined block"],
    f'{HEAD}<xacro:if value="perhaps">{LINK}</xacro:if></robot>': ["perhaps"],
    f'{HEAD}{LINK}<joint name="j" type="round"/></robot>': ["unknown type 'round'"],
    f"{HEAD}${{xacro.fatal('not', 'like this')}}</robot>": ["not like this"],
    "<sdf/>": ["outermost element is <sdf>"],
}


@pytest.mark.parametrize("text", WRONG_FILES)
def test_wrong_files(tmp_path: Path, refused: Callable[..., Any], text: str) -> None:
    file = tmp_path / "arm.xacro"
    file.write_text(text)
    with refused(RobotError, WRONG_FILES[text], file=str(file), line=None):
        load_robot(str(file))


def test_the_place_that_is_wrong_is_named(
    package: Path, refused: Callable[..., Any]
) -> None:
    file, macro = (
        package / "urdf" / name for name in ("arm.urdf.xacro", "macro.xacro")
    )
    macro.write_text(MACRO.replace("stated.first", "stated.frist"))
    with refused(RobotError, ["no 'frist'", "in macro 'joint' (macro.xacro)"]):
        load_robot(str(file))
    macro.write_text("<robot>")
    with refused(RobotError, "not well-formed XML", file=str(macro)):
        load_robot(str(file))


def test_wrong_arguments(package: Path, refused: Callable[..., Any]) -> None:
    file = package / "urdf" / "arm.urdf.xacro"
    with refused(RobotError, ["no argument 'sise'", "'size'", "kinematics"]):
        load_robot(f"{file} sise:=10")
    with refused(RobotError, ["arm7.yaml", "No such file"]):
        load_robot(f"{file} size:=7")
    with refused(OptionError, "argument for a xacro file", file="space6"):
        load_robot("space6 size:=10")
    with refused(InputError, "no such file"):
        load_robot(f"{file}o.xacro size:=10")


def test_what_grows_without_end(
    tmp_path: Path, refused: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    laughs = "".join(
        f'<xacro:property name="a{k + 1}" value="{4 * ("${a" + str(k) + "}")}"/>'
        for k in range(40)
    )
    bombs = {
        f'<xacro:property name="a0" value="ha"/>{laughs}<link name="${{a40}}"/>': [
            "text is too long"
        ],
        '<xacro:include filename="arm.xacro"/>': ["without end"],
        '<xacro:macro name="m" params="d"><xacro:if value="${d}"><link name="a"/>'
        '<xacro:m d="${d - 1}"/><xacro:m d="${d - 1}"/></xacro:if></xacro:macro>'
        '<xacro:m d="60"/>': ["takes more than 2 s"],
    }
    file = tmp_path / "arm.xacro"
    for text, reason in bombs.items():
        seconds = 2.0 if "2 s" in reason[0] else 60.0
        monkeypatch.setattr(children, "SECONDS", seconds)
        file.write_text(f"{HEAD}{text}</robot>")
        with refused(RobotError, reason):
            load_robot(str(file))


def test_nothing_is_executed(tmp_path: Path) -> None:
    file, proof = tmp_path / "arm.xacro", tmp_path / "proof"
    escape = (
        "(x for x in [1]).gi_frame.f_back.f_back.f_builtins['__imp' + 'ort__']('os')"
        f".mkdir('{proof}')"
    )
    for text in (f"${{{escape}}}", f"$(eval {escape.replace('__', '_' + '_')})"):
        file.write_text(f'{HEAD}<link name="{text}"/></robot>')
        with pytest.raises(RobotError):
            load_robot(str(file))
    yaml = tmp_path / "a.yaml"
    yaml.write_text(f"a: !!python/object/apply:os.mkdir ['{proof}']\n")
    name = "${xacro.load_yaml('a.yaml')}"
    file.write_text(f'{HEAD}<link name="{name}"/></robot>')
    with pytest.raises(RobotError, match=r"a\.yaml cannot be read"):
        load_robot(str(file))
    yaml.write_text(f'a: !radians "{escape}"\n')
    with pytest.raises(RobotError, match="cannot evaluate"):
        load_robot(str(file))
    assert not proof.exists()


def test_without_the_extra(
    tmp_path: Path, refused: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "arm.xacro"
    file.write_text(f"{HEAD}{LINK}</robot>")
    assert load_robot(str(file)).links == ("a",)
    monkeypatch.setattr(xacro_files, "find_spec", lambda _: None)
    with refused(OptionError, "pip install 'calib-pin[ros]'"):
        load_robot(str(file))
