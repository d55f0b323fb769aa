"""Robots in xacro files, as ROS packages have them; nothing in one is executed."""

from __future__ import annotations

import math
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xacro

from calib_pin.errors import OptionError, RobotError
from calib_pin.io.packages import locate_mesh
from calib_pin.io.robot_shapes import STL, robot_shapes
from calib_pin.io.urdf import load_chain, load_robot
from calib_pin.io.xacro_child import FUNCTIONS, Refused, evaluate
from tests.shared import refused

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


def test_a_package_as_ros_has_it(package, monkeypatch):
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
    # The same robot from elsewhere is the same, byte for byte. A file named by the
    # user is in the working folder.
    monkeypatch.chdir(package)
    (package / "mine.yaml").write_text(KINEMATICS.format(length=0.5))
    again = load_robot(f"{file} kinematics:=mine.yaml")
    assert again.source == chain.robot.source
    assert again.file == f"{file} kinematics:=mine.yaml"
    file.write_text(TOP.replace("$(find arm_description)/urdf", "$(dirname)"))
    assert load_robot(file).links == again.links


def test_packages_are_where_one_says(package, tmp_path, monkeypatch):
    file = tmp_path / "own.xacro"
    file.write_text(TOP)
    package.joinpath("package.xml").unlink()
    with refused(RobotError, "arm_description"):
        load_robot(str(file))
    share = tmp_path / "install" / "share"
    share.mkdir(parents=True)
    package.rename(share / "arm_description")
    assert len(load_robot(str(file), [share]).links) == 4
    for name, place in (
        ("AMENT_PREFIX_PATH", str(share.parent)),
        ("ROS_PACKAGE_PATH", f"/nowhere:{share}"),
    ):
        with monkeypatch.context() as patch:
            patch.setenv(name, place)
            assert len(load_robot(str(file)).links) == 4


LINK = '<link name="a"/>'

VALUES = [
    "$(arg nowhere)",
    "${1 / 0}",
    "$(find nowhere)",
    "$(eval 1 + 2)",
    "${xacro.load_yaml('nowhere.yaml')}",
]

WRONG = [
    *(f'{HEAD}<link name="{value}"/></robot>' for value in VALUES),
    HEAD + LINK,
    f"<!DOCTYPE a [<!ENTITY b 'c'>]>{HEAD}{LINK}</robot>",
    f'{HEAD}<xacro:include filename="arm.xacro"/></robot>',
    f'{HEAD}<xacro:property name="a" value="${{a}}"/><link name="${{a}}"/></robot>',
    f'{HEAD}{LINK}<joint name="j" type="round"/></robot>',
]


@pytest.mark.parametrize("text", WRONG)
def test_wrong_files(tmp_path: Path, text: str) -> None:
    file = tmp_path / "arm.xacro"
    file.write_text(text)
    with refused(RobotError, file=str(file), line=None):
        load_robot(str(file))


def test_the_place_that_is_wrong_is_named(package):
    folder = package / "urdf"
    file, macro = folder / "arm.urdf.xacro", folder / "macro.xacro"
    for words, said in (("sise:=10", ["'sise'", "'size'"]), ("size:=7", "arm7.yaml")):
        with refused(RobotError, said):
            load_robot(f"{file} {words}")
    with refused(OptionError, file="space6"):
        load_robot("space6 size:=10")
    macro.write_text(MACRO.replace("stated.first", "stated.frist"))
    with refused(RobotError, ["'frist'", "'joint' (macro.xacro)"]):
        load_robot(str(file))
    macro.write_text("<robot>")
    with refused(RobotError, file=str(macro)):
        load_robot(str(file))


LAUGHS = "".join(
    f'<xacro:property name="a{k + 1}" value="{4 * ("${a" + str(k) + "}")}"/>'
    for k in range(40)
)

GROWING = [
    pytest.param(
        f'<xacro:property name="a0" value="ha"/>{LAUGHS}<link name="${{a40}}"/>',
        marks=pytest.mark.slow,
    ),
    "<link name=\"${'%9999999999d' % 1}\"/>",
    "<link name=\"${xacro.load_yaml('/dev/zero')}\"/>",
]


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of memory")
@pytest.mark.parametrize("text", GROWING)
def test_what_grows_without_end(tmp_path, text):
    file = tmp_path / "arm.xacro"
    file.write_text(f"{HEAD}{text}</robot>")
    with refused(RobotError, file=str(file)):
        load_robot(str(file))


def test_nothing_is_executed(tmp_path: Path) -> None:
    file, proof = tmp_path / "arm.xacro", tmp_path / "proof"
    escape = (
        "(x for x in [1]).gi_frame.f_back.f_back.f_builtins['__imp' + 'ort__']('os')"
        f".mkdir('{proof}')"
    )
    (tmp_path / "a.yaml").write_text(f"!!python/object/apply:os.mkdir ['{proof}']\n")
    (tmp_path / "b.yaml").write_text(f'a: !radians "{escape}"\n')
    names = [f"${{{escape}}}"]
    names += [f"${{xacro.load_yaml('{x}.yaml')}}" for x in "ab"]
    for name in names:
        file.write_text(f'{HEAD}<link name="{name}"/></robot>')
        with refused(RobotError, file=str(file)):
            load_robot(str(file))
    assert not proof.exists()


# Expressions.

SYMBOLS: dict[str, Any] = {
    "x": 3,
    "_y": 4,
    "name": "left_arm",
    "xyz": [0.1, 0.2, 0.3],
    "limits": xacro.YamlDictWrapper(
        {"elbow": {"lower": -1.5, "list": [1, 2]}, "items": 5}
    ),
    "list_of_links": ["a", "b"],
}

MEANT = """
2 ** 10 - x ** -1
'left' in name
name if x > 2 else 'no'
limits.elbow.lower * 2
math.sqrt(2) * math.fabs(-1)
max(1, x, 2) + min([4, 5])
dict(a=1, b=2)['b']
name.replace('left', 'right').upper()
' '.join([str(value) for value in xyz])
list(map(float, '1 2'.split()))
'%03d_%s' % (x, name)
1./12 * (3 * x**2 + _y**2)
'elbow' in limits and 'list' in limits.elbow
"""


def symbols() -> Any:
    """The symbols, as xacro holds those of a file."""
    table = xacro.Table(xacro.create_global_symbols())
    for name, value in SYMBOLS.items():
        table._setitem(name, value, unevaluated=False)
    return table


def test_it_means_what_xacro_makes_of_it() -> None:
    known = {**vars(math), "math": math, **SYMBOLS}
    for text in filter(None, MEANT.splitlines()):
        assert evaluate(text, symbols(), FUNCTIONS) == eval(text, known), text


HOSTILE = """
(y for y in [1]).gi_frame.f_back.f_builtins['__imp' + 'ort__']('os')
[].__class__.__base__.__subclasses__()
getattr(name, '__class__')
type(name)
python.vars(name)
'{0.__class__}'.format(name)
f'{name.__class__}'
xacro.load_yaml.__globals__
xacro.load_yaml
math.sin.__self__
[print for y in [1]]
list(map(print, xyz))
limits.items.__self__
limits.pop('elbow')
xyz.append(1)
9 ** 9 ** 9
'a' * 10 ** 9
[0] * 10 ** 9
[y for y in range(9999) if [z for z in range(9999) if True]]
dict(**limits)
1 << 10 ** 9
limits.__missing
"""


DEEP = ("-" * 9000 + "1", "(" * 4000 + ")" * 4000)


@pytest.mark.parametrize("text", [*filter(None, HOSTILE.splitlines()), *DEEP])
def test_what_is_refused(text: str) -> None:
    with pytest.raises((Refused, RecursionError, MemoryError)):
        evaluate(text, symbols(), FUNCTIONS)
    assert SYMBOLS["xyz"] == [0.1, 0.2, 0.3]
