"""Robots in and out: every URDF of example-robot-data, encodings, and bad files."""

from __future__ import annotations

import importlib.metadata
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st

from calib_pin.errors import CalibPinError, OutputError, RobotError
from calib_pin.io import urdf
from calib_pin.io.urdf import load_robot
from calib_pin.io.urdf_tree import edit_origins, parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_space import Mimic
from tests.shared import refused, urdf_of

ARM = b"""<?xml version="1.0"?>
<robot name="arm">
  <link name="a"/>
  <link name="b"/>
  <link name="c"/>
  <joint name="j" type="revolute">
    <origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>
    <parent link="a"/>
    <child link="b"/>
    <axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="f" type="fixed">
    <parent link="b"/>
    <child link="c"/>
  </joint>
</robot>
"""
SHIFT = pin.SE3(np.eye(3), np.array([0.25, 0.0, 0.0]))
TURN = pin.SE3(pin.rpy.rpyToMatrix(0.01, -0.02, 0.03), np.zeros(3))


def random_motion(rng: np.random.Generator, size: float = 1e-3) -> pin.SE3:
    return pin.exp6(rng.normal(scale=size, size=6))


def read(source: bytes) -> yourdfpy.URDF:
    """A robot as others read it."""
    return yourdfpy.URDF.load(
        io.BytesIO(source), build_scene_graph=False, load_meshes=False
    )


def origin_of(joint: yourdfpy.Joint) -> pin.SE3:
    return pin.SE3(np.eye(4) if joint.origin is None else joint.origin)


def changed_lines(old: bytes, new: bytes) -> tuple[list[bytes], list[bytes]]:
    """The lines between the common beginning and the common end of two files."""
    before, after = old.splitlines(), new.splitlines()
    for at in (0, -1):
        while before and after and before[at] == after[at]:
            del before[at], after[at]
    return before, after


@pytest.fixture
def bad(capfd: pytest.CaptureFixture[str]) -> Callable[..., None]:
    """A robot that cannot be used: `bad(source, line=3, ...)`, see `refused`.

    Nothing is printed, not even by Pinocchio.
    """

    def bad(source: bytes, **fields: Any) -> None:
        with refused(RobotError, file="arm.urdf", **fields):
            parse_robot(source, "arm.urdf")
        assert capfd.readouterr() == ("", "")

    return bad


# Every URDF of example-robot-data.


def test_corpus(example_robot: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path, robot = example_robot, load_robot(example_robot)
    assert capfd.readouterr() == ("", "")
    joints = read(robot.source).joint_map
    assert robot.file == str(path)
    assert robot.source == path.read_bytes()
    assert robot.links == tuple(read(robot.source).link_map)
    fixed = {name for name, joint in joints.items() if joint.type == "fixed"}
    mimics = {
        name: joint.mimic.joint
        for name, joint in joints.items()
        if name not in fixed and joint.mimic is not None
    }
    # The leaders in the hands of Alex do not exist.
    assert {*robot.refused, *robot.mimics} == set(mimics)
    assert set(robot.refused) == {k for k, v in mimics.items() if v not in joints}
    assert set(robot.fixed_parents.values()) == fixed

    unit = {name: pin.SE3.Identity() for name in joints}
    assert edit_origins(robot.source, unit) == robot.source

    rng = np.random.default_rng(len(robot.source))
    corrections = {name: random_motion(rng) for name in joints}
    edited = read(edit_origins(robot.source, corrections)).joint_map
    assert edited.keys() == joints.keys()
    for name, joint in joints.items():
        expected = origin_of(joint) * corrections[name]
        difference = expected.actInv(origin_of(edited[name])).homogeneous - np.eye(4)
        assert np.abs(difference).max() < 1e-12
    for name in list(joints)[:3]:
        new = edit_origins(robot.source, {name: corrections[name]})
        before, after = changed_lines(robot.source, new)
        # Some files give xyz and rpy a line each.
        assert len(before) in ((0,) if joints[name].origin is None else (1, 2))
        assert len(after) == max(len(before), 1)
        assert all(b"xyz=" in line or b"rpy=" in line for line in before + after)


# What the editor keeps.


def test_what_does_not_change_keeps_its_text() -> None:
    new = edit_origins(ARM, {"j": SHIFT})
    translation = origin_of(read(ARM).joint_map["j"]).act(SHIFT.translation)
    numbers = " ".join(map(repr, translation.tolist()))
    assert new == ARM.replace(b"1 2 3", numbers.encode())
    new = edit_origins(ARM, {"j": TURN})
    assert b'xyz="1 2 3" rpy="0.1' in new
    assert [len(lines) for lines in changed_lines(ARM, new)] == [1, 1]
    source = ARM.replace(b'rpy="0.1 0.2 0.3"', b'rpy="0 0 0.0"').replace(
        b"1 2 3", b"1e0 +2. 3.00"
    )
    new = edit_origins(source, {"j": SHIFT})
    assert new == source.replace(b"1e0 +2. 3.00", b"1.25 +2. 3.00")


def test_missing_origin_is_inserted_indented() -> None:
    new = edit_origins(ARM, {"f": SHIFT})
    old = b'type="fixed">\n    <parent'
    assert new == ARM.replace(
        old, b'type="fixed">\n    <origin xyz="0.25 0.0 0.0"/>\n    <parent'
    )
    assert edit_origins(ARM, {"f": pin.SE3.Identity()}) == ARM
    # After a comment, and on one line.
    source = ARM.replace(b'"fixed">\n', b'"fixed"> <!-- <origin/> -->\r\n\r\n')
    new = edit_origins(source, {"f": SHIFT})
    assert b'-->\r\n\r\n    <origin xyz="0.25 0.0 0.0"/>\r\n    <parent' in new
    flat = re.sub(rb"\n *", b"", ARM)
    assert edit_origins(flat, {"f": SHIFT}) == flat.replace(
        b'"fixed"><parent', b'"fixed"><origin xyz="0.25 0.0 0.0"/><parent'
    )


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"<origin/>", b'<origin xyz="0.25 0.0 0.0"/>'),
        (b'<origin rpy="0 0 0"/>', b'<origin rpy="0 0 0" xyz="0.25 0.0 0.0"/>'),
        (b"<origin  xyz = '0 0 0'\n/>", b"<origin  xyz = '0.25 0 0'\n/>"),
        (
            b"<origin\r\n\tnote='a > b \"xyz\" rpy='\r\n\txyz='0 0 0'>x</origin>",
            b"<origin\r\n\tnote='a > b \"xyz\" rpy='\r\n\txyz='0.25 0 0'>x</origin>",
        ),
        (
            b'<origin my.xyz="9 9 9" xyzw="8" xyz="&#48; 0&#x20;0.0"/>',
            b'<origin my.xyz="9 9 9" xyzw="8" xyz="0.25 0 0.0"/>',
        ),
        (
            b'<!-- <origin xyz="7 7 7"/> --><x><origin xyz="6 6 6"/></x>'
            b'<origin xyz="0 0 0"/><origin xyz="5 5 5"/>',
            b'<!-- <origin xyz="7 7 7"/> --><x><origin xyz="6 6 6"/></x>'
            b'<origin xyz="0.25 0 0"/><origin xyz="5 5 5"/>',
        ),
    ],
)
def test_ways_to_write_an_origin(before: bytes, after: bytes) -> None:
    place = b'<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>'
    new = edit_origins(ARM.replace(place, before), {"j": SHIFT})
    assert new == ARM.replace(place, after)
    both = parse_robot(
        edit_origins(ARM.replace(place, before), {"j": SHIFT * TURN}), "arm.urdf"
    )
    assert both.model.jointPlacements[1].isApprox(SHIFT * TURN, 1e-14)


def test_only_joints_of_the_robot_are_joints() -> None:
    decoys = b"""
  <!-- <joint name="j"><origin xyz="0 0 0"/></joint> -->
  <![CDATA[<joint name="j"><origin xyz="0 0 0"/></joint>]]>
  <transmission name="t"><joint name="j"><origin xyz="0 0 0"/></joint></transmission>
  <gazebo reference="j"><joint name="j"><origin xyz="${x} 0 0"/></joint></gazebo>
  <my:thing xmlns:my="urn:x" my:joint="j"><my:origin xyz="0 0 0"/></my:thing>
  <joint name="j1" type="fixed">
    <origin xyz="0 0 0"/><parent link="c"/><child link="d"/>
  </joint>
  <link name="d">
    <visual><origin xyz="0 0 0"/><geometry><sphere radius="1"/></geometry></visual>
    <inertial><origin xyz="0 0 0"/><mass value="1"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
"""
    source = ARM.replace(b'<link name="a"/>', decoys + b'<link name="a"/>')
    assert parse_robot(source, "arm.urdf").links == ("d", "a", "b", "c")
    new = edit_origins(source, {"j": SHIFT})
    assert new == edit_origins(ARM, {"j": SHIFT}).replace(
        b'<link name="a"/>', decoys + b'<link name="a"/>'
    )


def test_escaped_names() -> None:
    name, written = 'é & "<j>"', b'name="&#233; &amp; &quot;&lt;j>&quot;"'
    source = ARM.replace(b'name="j"', written)
    assert list(parse_robot(source, "arm.urdf").model.names)[1:] == [name]
    new = edit_origins(ARM, {"j": SHIFT}).replace(b'name="j"', written)
    assert edit_origins(source, {name: SHIFT}) == new


def test_a_quaternion_of_urdf_1_1_is_refused(bad: Callable[..., None]) -> None:
    source = ARM.replace(b'"arm"', b'"arm" version="1.1"')
    quaternion = source.replace(b'rpy="0.1 0.2 0.3"', b'quat_xyzw="0 0 2 2"')
    bad(quaternion, line=7, allowed="rpy, the angles of URDF 1.0")


ENCODINGS = [
    (b"", "UTF-8", "\n"),
    (b"\xef\xbb\xbf", "UTF-16", "\r\n"),
    (b"", "windows-1252", "\r"),
]


@pytest.mark.parametrize(("mark", "declared", "line_end"), ENCODINGS)
def test_utf_8_whatever_is_declared(mark: bytes, declared: str, line_end: str) -> None:
    name = "é"
    text = ARM.decode().replace('"1.0"', f'"1.0" encoding="{declared}"')
    text = text.replace('"b"', f'"{name}"').replace("<link", f"<!--{name}--><link")
    text = text.replace('rpy="0.1 0.2 0.3"', 'rpy="0 0 0"').replace("\n", line_end)

    def write(content: str) -> bytes:
        return mark + content.encode()

    robot = parse_robot(write(text), "arm.urdf")
    assert robot.links == ("a", name, "c")
    assert edit_origins(robot.source, {}) == robot.source
    expected = text.replace('"1 2 3"', '"1.25 2 3"').replace(
        f'"fixed">{line_end}    ',
        f'"fixed">{line_end}    <origin xyz="0.25 0.0 0.0"/>{line_end}    ',
    )
    new = edit_origins(robot.source, {"j": SHIFT, "f": SHIFT})
    assert new == write(expected)
    assert parse_robot(new, "arm.urdf").links == robot.links


angles = st.one_of(
    st.floats(-4, 4),
    st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi, 1.5708, 1.57079632]),
)
lengths = st.floats(-100, 100)
triples = st.tuples(lengths, lengths, lengths)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(xyz=triples, rpy=st.tuples(angles, angles, angles), seed=st.integers(0, 2**32))
def test_any_origin_and_correction(xyz, rpy, seed):
    texts = [" ".join(map(repr, values)) for values in (xyz, rpy)]
    source = ARM.replace(b"1 2 3", texts[0].encode())
    source = source.replace(b"0.1 0.2 0.3", texts[1].encode())
    rng = np.random.default_rng(seed)
    correction = random_motion(rng, size=10.0 ** rng.uniform(-18, 0))
    old = parse_robot(source, "arm.urdf").model.jointPlacements[1]
    new = parse_robot(edit_origins(source, {"j": correction}), "arm.urdf")
    difference = new.model.jointPlacements[1].homogeneous
    difference = difference - (old * correction).homogeneous
    assert np.abs(difference[:3, :3]).max() < 1e-14
    # Numbers of up to 100 m are added.
    assert np.abs(difference[:3, 3]).max() < 1e-13


def test_corrections_that_cannot_be_made() -> None:
    with refused(RobotError):
        edit_origins(ARM, {"elbow": SHIFT})
    bad = pin.SE3(np.eye(3), np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(OutputError):
        edit_origins(ARM, {"j": bad})


# What the loader fills in.


def test_robot_fields() -> None:
    more = b"""<link name="w"/><link name="p"/>
  <joint name="free" type="floating"><parent link="b"/><child link="w"/></joint>
  <joint name="flat" type="planar"><parent link="c"/><child link="p"/></joint>
</robot>"""
    robot = parse_robot(ARM.replace(b"</robot>", more), "arm.urdf")
    assert (robot.name, robot.root) == ("arm", "a")
    assert robot.links == ("a", "b", "c", "w", "p")
    assert robot.leaves == ("w", "p")
    assert robot.fixed_parents == {"c": "f"}
    assert list(robot.refused) == ["free", "flat"]
    with refused(RobotError):
        Chain(robot, tip="w")


def test_mimic_joints() -> None:
    mimics = {
        "third": 'second" multiplier="-0.5" offset="1',
        "second": 'first" multiplier="2" offset="0.25',
        "plain": "first",
        "round": "about",
        "about": "round",
        "onto": "round",
        "stuck": "fixed",
    }
    kinds = dict.fromkeys([*mimics, "first"], "continuous") | {"fixed": "fixed"}
    joints = [
        {"name": name, "type": kind, "parent": f"l{k}", "child": f"l{k + 1}"}
        | {"more": f'<mimic joint="{mimics[name]}"/>' if name in mimics else ""}
        for k, (name, kind) in enumerate(kinds.items())
    ]
    robot = parse_robot(urdf_of(*joints).encode(), "r.urdf")
    # -0.5 (2 q + 0.25) + 1: a mimic of a mimic follows the joint with the drive.
    assert robot.mimics == {
        "third": Mimic("first", -1.0, 0.875),
        "second": Mimic("first", 2.0, 0.25),
        "plain": Mimic("first"),
    }
    assert set(robot.refused) == {"round", "about", "onto", "stuck"}


def test_resolution(tmp_path, monkeypatch):
    home = tmp_path / "robot.urdf"
    home.write_bytes(ARM)
    monkeypatch.setattr(urdf, "bundled_robots", lambda: {"threelink": home})
    monkeypatch.chdir(tmp_path)
    assert load_robot("threelink").name == "arm"
    Path("threelink").mkdir()  # A folder of that name is no URDF.
    assert load_robot("threelink").file == "threelink"
    Path("threelink").rmdir()
    Path("threelink").write_bytes(ARM.replace(b'"arm"', b'"mine"'))
    assert load_robot(Path("threelink")).name == "mine"
    assert load_robot("example:panda.urdf").file == "example:panda.urdf"
    ambiguous = "example:anymal_c_simple_description/urdf/anymal"
    assert load_robot(ambiguous).name == "anymal"


def test_robots_that_are_not_there(tmp_path, monkeypatch):
    Path(tmp_path, "arm.urdf").write_bytes(ARM)
    monkeypatch.setattr(urdf, "bundled_robots", lambda: {"threelink": tmp_path})
    monkeypatch.chdir(tmp_path)
    names = ["no/such.urdf", "threlink", ".", "arm.urdf/x", "a\0b", "a" * 300, ""]
    names += ["example:ur5", "example:", "example:anymal"]
    for name in names:
        with refused(RobotError):
            load_robot(name)
    with refused(RobotError, line=6):
        load_robot("example:ur3")

    def missing(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    with refused(RobotError, reason="example-robot-data"):
        load_robot("example:panda")


# URDFs that cannot be used.


@pytest.mark.parametrize(
    ("source", "line"),
    [
        (b"", 1),
        (b"\x89PNG\r\n\x1a\n\0\0", 1),
        (b"<robot>\n<link>\n</robot>", 3),
        (b"<robot\n", 1),
        (b"<robot>\n<!-- \xe9 --></robot>", 2),
        (ARM.decode().encode("utf-16-le"), 2),
        ('<robot name="r"><link name="a"/></robot>'.encode("utf-32"), ...),
        (b'<!DOCTYPE r [<!ENTITY a "aaa"><!ENTITY b "&a;&a;">]>\n<r>&b;</r>', 1),
        (b'\n<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n<r>&x;</r>', 2),
        (b'<r:robot xmlns:r="u" name="r"/>', 1),
        (b"<robot><link name='a'/></robot>", 1),
        (b"<robot name='r'/>", 1),
        (b"<robot name='r'>\n<link/></robot>", 2),
        (b'<robot name="r" xmlns:xacro="x">\n<xacro:if value="b"/></robot>', 2),
        # In no time.
        (b"<!-- a -->" * 100_000 + b"<!-- x", 1),
    ],
)
def test_files_that_are_no_urdf(source, line, bad):
    bad(source, **({} if line is ... else {"line": line}))


CARRIED = (
    '<link name="b"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="4"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    '<collision><geometry><box size="1 1 1"/></geometry></collision></link>'
)
"""A link in one line; Pinocchio drops parts that hold no numbers without a word."""

LOOP = """<link name="d"/><link name="e"/>
<joint name="x" type="fixed"><parent link="d"/><child link="e"/></joint>
<joint name="y" type="fixed"><parent link="e"/><child link="d"/></joint></robot>"""


@pytest.mark.parametrize(
    ("old", "new", "line", "value"),
    [
        *(
            ('"1 2 3"', f'"{text}"', 7, text)
            for text in (
                *("1 2", "1 2 3 4", "", "nan 2 3", "1 2 -inf", "1 2 1e999", "1,5 2 3"),
                *("1_0 2 3", "\u0661 2 3", "${x} 2 3", "$(arg x) 2 3"),
            )
        ),
        ('"0.1 0.2 0.3"', '"a b c"', 7, "a b c"),
        ('"0 0 1"', '"0 0 0"', 10, ...),
        ('"0 0 1"', '"0 0"', 10, "0 0"),
        ('<axis xyz="0 0 1"/>', "<axis/>", 10, ...),
        *(('lower="-1"', f'lower="{text}"', 11, text) for text in ("x", "-inf", " -1")),
        *(
            ('xyz="0 0 1"/>', f'xyz="0 0 1"/>\n<{tag}="{text}"/>', 11, text)
            for tag, text in (
                ("mimic multiplier", "1_000"),
                ("mimic offset", "\uff11"),
                ("dynamics damping", "0.1 Nm"),
            )
        ),
        ('velocity="1"', "", 6, ...),
        ('"revolute"', '"revolut"', 6, ...),
        (' type="revolute"', "", 6, ...),
        ('name="j"', 'name="universe"', 6, ...),
        ('<child link="b"/>', "", 6, ...),
        ('<link name="c"/>', "", 13, ...),
        ('<link name="c"/>', '<link name="c"/><link name="a"/>', 5, ...),
        ('"f"', '"j"', 13, ...),
        ('<child link="c"/>', '<child link="b"/>', 13, ...),
        ('<link name="c"/>', '<link name="c"/><link name="d"/>', 5, ...),
        ('<child link="c"/>', '<child link="a"/>', 13, ...),
        ("</robot>", LOOP, ..., ...),
        ('name="arm"', 'name="arm" version="3.0"', 2, ...),
        *(
            (old, f'{key}="{text}"', 4, text)
            for old, key, text in (
                ('value="4"', "value", "4 kg"),
                ('value="4"', "value", "-4"),
                ('xyz="0 0 0.1"', "xyz", "0 0 1e9"),
                ('rpy="0 0 0"', "rpy", "0 0 nan"),
                ('size="1 1 1"', "size", "1 1 \u0661"),
            )
        ),
        ('value="4"', "", 4, None),
        ('<mass value="4"/>', "", 4, None),
        ("</robot>", f"{'<x>' * 900}{'</x>' * 900}</robot>", ..., ...),
    ],
)
def test_urdfs_with_a_mistake(old, new, line, value, bad):
    text = ARM.decode().replace('<link name="b"/>', CARRIED)
    assert old in text
    fields = {"line": line, "value": value}
    known = {name: field for name, field in fields.items() if field is not ...}
    bad(text.replace(old, new).encode(), **known)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(where=st.integers(0, len(ARM) - 1), byte=st.integers(0, 255))
def test_any_damaged_byte_costs_one_line(where: int, byte: int) -> None:
    try:
        parse_robot(ARM[:where] + bytes([byte]) + ARM[where + 1 :], "arm.urdf")
    except CalibPinError as error:
        assert "\n" not in str(error)


def chain(count: int, kind: str = "fixed", closing: str = "") -> bytes:
    """A robot of joints one after the other; its last link comes first."""
    links = [f'<link name="l{k}"/>' for k in range(count, -1, -1)]
    joints = [
        f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/></joint>'
        for k in range(count)
    ]
    lines = ['<robot name="r">', *links, *joints, closing, "</robot>"]
    return "\n".join(lines).encode()


def test_limits(bad: Callable[..., None]) -> None:
    assert parse_robot(chain(999), "arm.urdf").leaves == ("l999",)
    for kind in ("fixed", "continuous"):
        bad(chain(1000, kind), reason="1001 links", line=1)
    for kind, count in (("continuous", 201), ("floating", 34)):
        bad(chain(count, kind), line=1)


# Writing.


@pytest.mark.parametrize("mark", [b"\t", b"\n", b"\r\n"])
def test_a_line_break_between_numbers_is_a_space(mark):
    """To XML, and so to the editor; Pinocchio's reader stumbles over it."""
    source = ARM.replace(b"1 2 3", b"1%s2 3" % mark)
    found = parse_robot(source, "arm.urdf").model.jointPlacements[1]
    assert found.translation.tolist() == [1.0, 2.0, 3.0]
    assert edit_origins(source, {"j": pin.SE3.Identity()}) == source


@pytest.mark.parametrize(
    "before", [b"\n", b"<!-- by a generator -->\n", b" <!-- a --> "]
)
def test_a_declaration_that_comes_late_is_no_fault(before):
    written = edit_origins(before + ARM, {"j": SHIFT})
    assert written == before + edit_origins(ARM, {"j": SHIFT})
    assert parse_robot(written, "arm").links == ("a", "b", "c")
