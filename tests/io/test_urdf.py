"""Robots in and out: every URDF of example-robot-data, encodings, and bad files."""

from __future__ import annotations

import importlib.metadata
import logging
import os
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib_pin.errors import InputError, OptionError, OutputError, RobotError
from calib_pin.io import urdf, urdf_tree
from calib_pin.io.files import read_bytes, write_atomically
from calib_pin.io.urdf import (
    bundled_robots,
    corrected_urdf,
    load_robot,
    locate_robot,
)
from calib_pin.io.urdf_origins import edit_origins
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_space import Mimic
from calib_pin.kinematics.robot import Robot

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


def joint_elements(source: bytes) -> dict[str, Any]:
    root = ElementTree.fromstring(source)
    return {joint.get("name", ""): joint for joint in root.findall("joint")}


def floats(element: Any, attribute: str, default: str) -> Any:
    text = default if element is None else element.get(attribute, default)
    return np.array([float(word) for word in text.split()])


def origin_of(joint: Any) -> pin.SE3:
    origin = joint.find("origin")
    rotation = pin.rpy.rpyToMatrix(floats(origin, "rpy", "0 0 0"))
    return pin.SE3(rotation, floats(origin, "xyz", "0 0 0"))


def forward_kinematics(
    source: bytes, q: dict[str, float], corrections: dict[str, pin.SE3]
) -> dict[str, pin.SE3]:
    """Placements of all links that hang on a joint, from the XML alone."""
    joints = joint_elements(source).values()
    carriers = {joint.find("child").get("link"): joint for joint in joints}
    placements: dict[str, pin.SE3] = {}

    def place(link: str) -> pin.SE3:
        if link not in carriers:
            return pin.SE3.Identity()
        if link not in placements:
            joint = carriers[link]
            motion = np.zeros(6)
            if joint.get("type") != "fixed":
                axis = floats(joint.find("axis"), "xyz", "1 0 0")
                part = slice(0, 3) if joint.get("type") == "prismatic" else slice(3, 6)
                motion[part] = q[joint.get("name")] * axis / np.linalg.norm(axis)
            placement = place(joint.find("parent").get("link")) * origin_of(joint)
            placement = placement * corrections[joint.get("name")]
            placements[link] = placement * pin.exp6(motion)
        return placements[link]

    for link in carriers:
        place(link)
    return placements


def configuration(model: pin.Model, q: dict[str, float]) -> Any:
    result = pin.neutral(model)
    for name, value in q.items():
        joint = model.getJointId(name)
        start = model.idx_qs[joint]
        if model.nqs[joint] == 2:
            result[start : start + 2] = np.cos(value), np.sin(value)
        else:
            result[start] = value
    return result


def random_q(robot: Robot, rng: np.random.Generator) -> dict[str, float]:
    return {name: rng.uniform(-1, 1) for name in list(robot.model.names)[1:]}


def changed_lines(old: bytes, new: bytes) -> tuple[list[bytes], list[bytes]]:
    """The lines between the common beginning and the common end of two files."""
    before, after = old.splitlines(), new.splitlines()
    for at in (0, -1):
        while before and after and before[at] == after[at]:
            del before[at], after[at]
    return before, after


@pytest.fixture
def bad(
    refused: Callable[..., Any], capfd: pytest.CaptureFixture[str]
) -> Callable[..., None]:
    """A robot that cannot be used: `bad(source, line=3, ...)`, see `refused`.

    Nothing is printed, not even by Pinocchio.
    """

    def bad(source: bytes, **fields: Any) -> None:
        with refused(RobotError, file="arm.urdf", **fields):
            parse_robot(source, "arm.urdf")
        assert capfd.readouterr() == ("", "")

    return bad


def listing(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# Every URDF of example-robot-data.


def test_corpus(example_robot: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path, robot = example_robot, load_robot(example_robot)
    assert capfd.readouterr() == ("", "")
    joints = joint_elements(robot.source)
    links = ElementTree.fromstring(robot.source).findall("link")
    assert robot.file == str(path)
    assert robot.source == path.read_bytes()
    assert robot.links == tuple(link.get("name") for link in links)
    fixed = {name for name, j in joints.items() if j.get("type") == "fixed"}
    mimics = {
        name: mimic.get("joint")
        for name, joint in joints.items()
        if name not in fixed and (mimic := joint.find("mimic")) is not None
    }
    # The leaders in the hands of Alex do not exist.
    assert {*robot.refused, *robot.mimics} == set(mimics)
    assert set(robot.refused) == {k for k, v in mimics.items() if v not in joints}
    assert set(robot.fixed_parents.values()) == fixed

    unit = {name: pin.SE3.Identity() for name in joints}
    assert edit_origins(robot.source, unit) == robot.source

    rng = np.random.default_rng(len(robot.source))
    corrections = {name: random_motion(rng) for name in joints}
    edited = edit_origins(robot.source, corrections)
    model = pin.buildModelFromXML(edited.decode())
    capfd.readouterr()  # Pinocchio's own complaints about meshes and inertias.
    data = model.createData()
    q = random_q(robot, rng)
    pin.framesForwardKinematics(model, data, configuration(model, q))
    expected = forward_kinematics(robot.source, q, corrections)
    assert set(expected) == set(robot.links) - {robot.root}
    for link, placement in expected.items():
        actual = data.oMf[model.getFrameId(link, pin.FrameType.BODY)]
        np.testing.assert_allclose(
            actual.homogeneous, placement.homogeneous, rtol=0, atol=1e-12
        )

    for name in list(joints)[:3]:
        edited = edit_origins(robot.source, {name: corrections[name]})
        before, after = changed_lines(robot.source, edited)
        # Some files give xyz and rpy a line each.
        assert len(before) in ((0,) if joints[name].find("origin") is None else (1, 2))
        assert len(after) == max(len(before), 1)
        assert all(b"xyz=" in line or b"rpy=" in line for line in before + after)


def test_corpus_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    source = ARM.replace(
        b'<link name="c"/>',
        b'<link name="c"><visual><geometry><blob/></geometry></visual></link>',
    )
    parse_robot(source, "arm.urdf")
    assert capfd.readouterr() == ("", "")


# Continuous joints, which others write in another way, are among those of the kinova.
@pytest.mark.parametrize(
    "name",
    [
        "kinova",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("ur5_robot", "xarm7", "tiago_no_hand")
        ),
    ],
)
def test_yourdfpy_agrees(name: str, tmp_path: Path) -> None:
    robot = load_robot(f"example:{name}")
    rng = np.random.default_rng(7)
    joints = joint_elements(robot.source)
    corrections = {joint: random_motion(rng) for joint in joints}
    path = tmp_path / "edited.urdf"
    write_corrected_urdf(path, robot, corrections, check=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import yourdfpy

        logging.getLogger("yourdfpy").setLevel(logging.ERROR)
        other = yourdfpy.URDF.load(str(path), load_meshes=False)
        q = random_q(robot, rng)
        other.update_cfg(q)
    expected = forward_kinematics(robot.source, q, corrections)
    for link, placement in expected.items():
        np.testing.assert_allclose(
            other.get_transform(link, robot.root),
            placement.homogeneous,
            rtol=0,
            atol=1e-12,
        )


# What the editor keeps.


def test_pure_translation_keeps_other_text() -> None:
    new = edit_origins(ARM, {"j": SHIFT})
    translation = origin_of(joint_elements(ARM)["j"]).act(SHIFT.translation)
    numbers = " ".join(map(repr, translation.tolist()))
    assert new == ARM.replace(b"1 2 3", numbers.encode())


def test_pure_rotation_keeps_xyz() -> None:
    new = edit_origins(ARM, {"j": TURN})
    assert b'xyz="1 2 3" rpy="0.1' in new
    assert [len(lines) for lines in changed_lines(ARM, new)] == [1, 1]


def test_numbers_that_stay_keep_their_text() -> None:
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


def test_missing_origin_after_comment_and_on_one_line() -> None:
    source = ARM.replace(b'"fixed">\n', b'"fixed"> <!-- <origin/> -->\r\n\r\n')
    new = edit_origins(source, {"f": SHIFT})
    assert b'-->\r\n\r\n    <origin xyz="0.25 0.0 0.0"/>\n    <parent' not in new
    assert b'-->\r\n\r\n    <origin xyz="0.25 0.0 0.0"/>\r\n    <parent' in new
    flat = re.sub(rb"\n *", b"", ARM)
    assert edit_origins(flat, {"f": SHIFT}) == flat.replace(
        b'"fixed"><parent', b'"fixed"><origin xyz="0.25 0.0 0.0"/><parent'
    )


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"<origin/>", b'<origin xyz="0.25 0.0 0.0"/>'),
        (b"<origin />", b'<origin xyz="0.25 0.0 0.0" />'),
        (b"<origin></origin>", b'<origin xyz="0.25 0.0 0.0"></origin>'),
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
    np.testing.assert_allclose(
        both.model.jointPlacements[1].homogeneous,
        (SHIFT * TURN).homogeneous,
        rtol=0,
        atol=1e-15,
    )


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
    name = 'é & "<j>"'
    written = b"&#233; &amp; &quot;&lt;j>&quot;"
    source = ARM.replace(b'name="j"', b'name="' + written + b'"')
    robot = parse_robot(source, "arm.urdf")
    assert list(robot.model.names)[1:] == [name]
    new = edit_origins(source, {name: SHIFT})
    assert new == edit_origins(ARM, {"j": SHIFT}).replace(
        b'name="j"', b'name="' + written + b'"'
    )


def test_quaternion_of_urdf_1_1(bad: Callable[..., None]) -> None:
    place = b'rpy="0.1 0.2 0.3"'
    source = ARM.replace(b'"arm"', b'"arm" version="1.1"').replace(
        place, b'quat_xyzw="0 0 2 2"'
    )
    old = parse_robot(source, "arm.urdf").model.jointPlacements[1]
    new = edit_origins(source, {"j": SHIFT * TURN})
    assert b"rpy" not in new
    placement = parse_robot(new, "arm.urdf").model.jointPlacements[1]
    np.testing.assert_allclose(
        placement.homogeneous, (old * SHIFT * TURN).homogeneous, atol=1e-15
    )
    bad(source.replace(b"2 2", b"0 0"), reason="quat_xyzw of joint 'j' is zero")
    # Version 1.0 does not know the attribute, so its rotation does not count.
    plain = source.replace(b' version="1.1"', b"")
    again = parse_robot(edit_origins(plain, {"j": TURN}), "arm.urdf")
    np.testing.assert_allclose(
        again.model.jointPlacements[1].rotation, TURN.rotation, atol=1e-15
    )


ENCODINGS = [
    ("utf-8", b"", "UTF-8"),
    ("utf-8", b"\xef\xbb\xbf", "UTF-8"),
    ("utf-8", b"\xef\xbb\xbf", "UTF-16"),
    ("utf-8", b"", "utf8"),
    ("utf-16-le", b"\xff\xfe", "UTF-16"),
    ("utf-16-be", b"\xfe\xff", "UTF-16"),
    ("utf-16-le", b"", "UTF-16LE"),
    ("utf-16-be", b"", "UTF-16"),
    ("latin-1", b"", "ISO-8859-1"),
    ("cp1252", b"", "windows-1252"),
    ("shift_jis", b"", "Shift_JIS"),
]


@pytest.mark.parametrize(("codec", "mark", "declared"), ENCODINGS)
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_encodings(codec: str, mark: bytes, declared: str, line_end: str) -> None:
    # The second byte of each of these Shift_JIS letters is an ASCII backslash.
    name = "ソ表" if codec == "shift_jis" else "é"
    text = ARM.decode().replace('"1.0"', f'"1.0" encoding="{declared}"')
    text = text.replace('"b"', f'"{name}"').replace("<link", f"<!--{name}--><link")
    text = text.replace('rpy="0.1 0.2 0.3"', 'rpy="0 0 0"').replace("\n", line_end)

    def write(content: str) -> bytes:
        return mark + content.encode(codec)

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


@settings(max_examples=100, deadline=None)
@given(xyz=triples, rpy=st.tuples(angles, angles, angles), seed=st.integers(0, 2**32))
def test_any_origin_and_correction(
    xyz: tuple[float, ...], rpy: tuple[float, ...], seed: int
) -> None:
    texts = [" ".join(map(repr, values)) for values in (xyz, rpy)]
    source = ARM.replace(b"1 2 3", texts[0].encode())
    source = source.replace(b"0.1 0.2 0.3", texts[1].encode())
    rng = np.random.default_rng(seed)
    correction = random_motion(rng, size=10.0 ** rng.uniform(-18, 0))
    old = parse_robot(source, "arm.urdf").model.jointPlacements[1]
    new = parse_robot(edit_origins(source, {"j": correction}), "arm.urdf")
    difference = new.model.jointPlacements[1].homogeneous
    difference = difference - (old * correction).homogeneous
    np.testing.assert_allclose(difference[:3, :3], 0.0, atol=1e-14)
    np.testing.assert_allclose(difference[:3, 3], 0.0, atol=1e-13)


def test_corrections_that_cannot_be_made(refused: Callable[..., Any]) -> None:
    with refused(RobotError, reason="no joint 'elbow'"):
        edit_origins(ARM, {"elbow": SHIFT})
    bad = pin.SE3(np.eye(3), np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(OutputError, match="correction of joint 'j' is not finite"):
        edit_origins(ARM, {"j": bad})
    with refused(RobotError, line=1, reason="names no parent link"):
        edit_origins(b'<robot><joint name="j"/></robot>', {"j": SHIFT})


# What the loader fills in.


def test_robot_fields(refused: Callable[..., Any]) -> None:
    source = ARM.replace(
        b"</robot>",
        b"""
  <link name="m"/><link name="w"/><link name="p"/>
  <joint name="mimicking" type="prismatic"><parent link="b"/><child link="m"/>
    <mimic joint="j"/><limit effort="1" velocity="1"/></joint>
  <joint name="free" type="floating"><parent link="b"/><child link="w"/></joint>
  <joint name="flat" type="planar"><parent link="c"/><child link="p"/></joint>
</robot>""",
    )
    robot = parse_robot(source, "arm.urdf")
    assert robot.name == "arm"
    assert robot.root == "a"
    assert robot.links == ("a", "b", "c", "m", "w", "p")
    assert robot.leaves == ("m", "w", "p")
    assert robot.fixed_parents == {"c": "f"}
    assert robot.refused == {"free": "a floating joint", "flat": "a planar joint"}
    with refused(RobotError, reason="'free' between 'a' and 'w' is a floating joint"):
        Chain(robot, tip="w")


def mimicking(*joints: tuple[str, str]) -> bytes:
    """A robot whose joints, one behind another, have what is written inside."""
    lines = ['<robot name="r">', *(f'<link name="l{k}"/>' for k in range(9))]
    for k, (name, inside) in enumerate(joints):
        lines.append(
            f'<joint name="{name}" type="continuous"><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/>{inside}</joint>'
        )
    for k in range(len(joints) + 1, 9):
        lines.append(
            f'<joint name="f{k}" type="fixed"><parent link="l0"/><child link="l{k}"/>'
            "</joint>"
        )
    return "\n".join([*lines, "</robot>"]).encode()


def test_mimic_joints() -> None:
    source = mimicking(
        ("third", '<mimic joint="second" multiplier="-0.5" offset="1"/>'),
        ("second", '<mimic joint="first" multiplier="2" offset="0.25"/>'),
        ("first", ""),
        ("plain", '<mimic joint="first"/>'),
        ("round", '<mimic joint="about"/>'),
        ("about", '<mimic joint="round"/>'),
        ("onto", '<mimic joint="round"/>'),
        ("stuck", '<mimic joint="f8"/>'),
    )
    robot = parse_robot(source, "r.urdf")
    # -0.5 (2 q + 0.25) + 1: a mimic of a mimic follows the joint with the drive.
    assert robot.mimics == {
        "third": Mimic("first", -1.0, 0.875),
        "second": Mimic("first", 2.0, 0.25),
        "plain": Mimic("first"),
    }
    assert set(robot.refused) == {"round", "about", "onto", "stuck"}


@pytest.mark.parametrize("key", ["multiplier", "offset"])
def test_mimic_joints_that_cannot_be_read(key: str, bad: Callable[..., None]) -> None:
    source = mimicking(("a", ""), ("b", f'<mimic joint="a" {key}="two"/>'))
    bad(source, line=12, value="two", reason=f"{key} in the <mimic> of joint 'b'")


def test_bundled_robots_load() -> None:
    for name, path in bundled_robots().items():
        robot = load_robot(name)
        assert robot.file == name
        assert robot.source == path.read_bytes()


def test_resolution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "robots" / "threelink" / "robot.urdf"
    write_atomically(home, ARM, force=False)
    monkeypatch.setattr(urdf, "bundled_robots", lambda: {"threelink": home})
    monkeypatch.chdir(tmp_path)
    assert load_robot("threelink").name == "arm"
    Path("threelink").mkdir()  # A folder of that name is no URDF.
    assert load_robot("threelink").file == "threelink"
    Path("threelink").rmdir()
    Path("threelink").write_bytes(ARM.replace(b'"arm"', b'"mine"'))
    assert load_robot("threelink").name == "mine"
    assert load_robot(Path("threelink")).file == "threelink"
    assert load_robot("example:panda").name == "panda"
    assert load_robot("example:panda.urdf").file == "example:panda.urdf"
    ambiguous = "example:anymal_c_simple_description/urdf/anymal"
    assert load_robot(ambiguous).name == "anymal"


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        (
            "no/such.urdf",
            dict(reason="no such file", allowed="a bundled robot (threelink)"),
        ),
        ("threlink", dict()),
        ("arm.udrf", dict()),
        (".", dict()),
        ("arm.urdf/x", dict()),
        ("a\0b", dict(reason=("cannot be read: ", "embedded null"))),
        ("a" * 300, dict(reason="cannot be read: File name too long")),
        ("", dict()),
        (
            "example:ur5",
            dict(reason="has no robot 'ur5'", allowed="example:ur5_gripper, "),
        ),
        ("example:pandaa", dict(reason="no robot 'pandaa' (did you mean 'panda'?)")),
        ("example:", dict(reason="example-robot-data has no robot ''")),
        ("example:ur3", dict(line=6)),
        (
            "example:anymal",
            dict(
                reason="2 example robots",
                allowed="example:anymal_c_simple_description/urdf/anymal",
            ),
        ),
    ],
)
def test_robots_that_are_not_there(
    name: str,
    fields: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    refused: Callable[..., Any],
) -> None:
    Path(tmp_path, "arm.urdf").write_bytes(ARM)
    monkeypatch.setattr(urdf, "bundled_robots", lambda: {"threelink": tmp_path})
    monkeypatch.chdir(tmp_path)
    with refused(RobotError, **fields):
        load_robot(name)


def test_example_robots_not_installed(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., Any]
) -> None:
    def missing(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    with refused(RobotError, reason="pip install 'example-robot-data>=4.4'"):
        load_robot("example:panda")


# URDFs that cannot be used.


@pytest.mark.parametrize(
    ("source", "fields"),
    [
        (b"", dict(reason="the file is empty")),
        (b"\xef\xbb\xbf \r\n", dict(reason="the file is empty")),
        (
            b"\x89PNG\r\n\x1a\n\0\0",
            dict(value=b"\x89PNG\r\n\x1a\n\x00\x00", reason="is not XML"),
        ),
        (b"solid cube\n", dict(value=b"solid cube\n", reason="is not XML")),
        (
            b"<robot>\n<link>\n</robot>",
            dict(line=3, reason="is not well-formed XML: mismatched tag"),
        ),
        (b"<robot\n", dict(line=1, reason="is not well-formed XML: unclosed token")),
        (
            b"<!-- x -->",
            dict(line=1, reason="is not well-formed XML: no element found"),
        ),
        (b"<a\0b/>", dict(line=1, reason="is not well-formed XML")),
        (b"<robot>\n<!-- \xe9 --></robot>", dict(line=2)),
        (
            b'<?xml version="1.0" encoding="klingon"?><r/>',
            dict(line=1, reason="the encoding 'klingon'"),
        ),
        (
            b'<?xml version="1.0" encoding="base64"?><r/>',
            dict(line=1, reason="the encoding 'base64'"),
        ),
        (b'<?xml version="1.0" encoding="UTF-16"?><r/>', dict(line=1, reason="UTF-16")),
        (b"\xff\xfe<\0r\0/", dict(line=1, reason="the byte 0x2f is not utf-16-le")),
        (
            b'<!DOCTYPE r [<!ENTITY a "aaa"><!ENTITY b "&a;&a;">]>\n<r>&b;</r>',
            dict(line=1, reason="a DOCTYPE with its entities is not accepted"),
        ),
        (
            b'\n<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n<r>&x;</r>',
            dict(line=2),
        ),
        (
            b"<sdf/>",
            dict(line=1, reason="the outermost element is <sdf>", allowed="<robot>"),
        ),
        (
            b'<r:robot xmlns:r="u" name="r"/>',
            dict(line=1, reason="the outermost element is <r:robot>"),
        ),
        (
            b"<robot><link name='a'/></robot>",
            dict(line=1, reason="the robot has no name"),
        ),
        (
            b"<robot name=''><link name='a'/></robot>",
            dict(line=1, reason="the robot has no name"),
        ),
        (b"<robot name='r'/>", dict(line=1, reason="the robot has no links")),
        (
            b"<robot name='r'>\n<link/></robot>",
            dict(line=2, reason="a link has no name"),
        ),
        (
            b'<robot name="r" xmlns:xacro="x">\n<xacro:include filename="b"/></robot>',
            dict(
                line=2,
                value="<xacro:include>",
                reason="is a xacro file; let its name end in .xacro",
            ),
        ),
    ],
)
def test_files_that_are_no_urdf(
    source: bytes, fields: dict[str, Any], bad: Callable[..., None]
) -> None:
    bad(source, **fields)


@pytest.mark.parametrize(
    ("kind", "count", "fields"),
    [
        (
            "revolute",
            201,
            dict(
                line=1,
                reason="the robot has 201 degrees of freedom",
                allowed="at most 200",
            ),
        ),
        ("floating", 34, dict(line=1, reason="the robot has 204 degrees of freedom")),
        ("revolute", 2000, dict(reason="'l1000' is too far from the root")),
    ],
)
def test_robots_that_are_too_large(
    kind: str, count: int, fields: dict[str, Any], bad: Callable[..., None]
) -> None:
    joint = (
        f'<link name="l%d"/><joint name="j%d" type="{kind}"><parent link="l%d"/>'
        '<child link="l%d"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        "</joint>"
    )
    rows = [joint % (k, k, k - 1, k) for k in range(1, count + 1)]
    text = '<robot name="r"><link name="l0"/>%s</robot>'
    bad((text % "".join(rows)).encode(), **fields)


ALLOWED_TYPES = "revolute, continuous, prismatic, fixed, floating, planar"


@pytest.mark.parametrize(
    ("old", "new", "fields"),
    [
        (
            '"1 2 3"',
            '"1 2"',
            dict(
                line=7,
                value="1 2",
                reason="xyz in the <origin> of joint 'j' cannot be read",
            ),
        ),
        ('"1 2 3"', '"1 2"', dict(line=7, value="1 2", allowed="3 finite numbers")),
        (
            '"1 2 3"',
            '"1 2 3 4"',
            dict(line=7, value="1 2 3 4", allowed="3 finite numbers"),
        ),
        ('"1 2 3"', '""', dict(line=7, value="", allowed="3 finite numbers")),
        ('"1 2 3"', '"nan 2 3"', dict(line=7, value="nan 2 3")),
        (
            '"1 2 3"',
            '"1 2 -inf"',
            dict(line=7, value="1 2 -inf", allowed="3 finite numbers"),
        ),
        (
            '"1 2 3"',
            '"1 2 1e999"',
            dict(line=7, value="1 2 1e999", allowed="3 finite numbers"),
        ),
        (
            '"1 2 3"',
            '"1,5 2 3"',
            dict(line=7, value="1,5 2 3", allowed="3 finite numbers"),
        ),
        (
            '"1 2 3"',
            '"1_0 2 3"',
            dict(line=7, value="1_0 2 3", allowed="3 finite numbers"),
        ),
        (
            '"1 2 3"',
            '"\u0661 2 3"',
            dict(line=7, value="\u0661 2 3", allowed="3 finite numbers"),
        ),
        (
            '"1 2 3"',
            '"1\t2 3"',
            dict(line=7, reason="xyz in the <origin> of joint 'j' has a tab or"),
        ),
        (
            '"1 2 3"',
            '"${x} 2 3"',
            dict(line=7, value="${x} 2 3", reason="is a xacro file; let its name"),
        ),
        (
            '"1 2 3"',
            '"$(arg x) 2 3"',
            dict(line=7, value="$(arg x) 2 3", reason="is a xacro file; let its name"),
        ),
        (
            '"0.1 0.2 0.3"',
            '"a b c"',
            dict(
                line=7,
                value="a b c",
                reason="rpy in the <origin> of joint 'j' cannot be",
            ),
        ),
        ('"0 0 1"', '"0 0 0"', dict(line=10, reason="the axis of joint 'j' is zero")),
        (
            '"0 0 1"',
            '"0 0"',
            dict(
                line=10,
                value="0 0",
                reason="xyz in the <axis> of joint 'j' cannot be read",
            ),
        ),
        (
            '<axis xyz="0 0 1"/>',
            "<axis/>",
            dict(line=10, reason="the <axis> of joint 'j' has no xyz"),
        ),
        (
            'lower="-1"',
            'lower="x"',
            dict(
                line=11, value="x", reason="lower in the <limit> of joint 'j' cannot be"
            ),
        ),
        (
            'lower="-1"',
            'lower="-inf"',
            dict(line=11, value="-inf", allowed="a finite number"),
        ),
        (
            'lower="-1"',
            'lower=" -1"',
            dict(line=11, value=" -1", allowed="a finite number"),
        ),
        *(
            (
                'xyz="0 0 1"/>',
                f'xyz="0 0 1"/>\n<{tag} {key}="{text}"/>',
                dict(
                    line=11, value=text, reason=f"{key} in the <{tag}> of joint 'j' can"
                ),
            )
            for tag, key, text in (
                ("mimic", "multiplier", "1_000"),
                ("mimic", "offset", "\uff11"),
                ("dynamics", "damping", "0.1 Nm"),
            )
        ),
        (
            'velocity="1"',
            "",
            dict(line=6, reason="Pinocchio cannot read it: joint [j]: limit has no v"),
        ),
        (
            '"revolute"',
            '"revolut"',
            dict(line=6, reason="joint 'j' has the unknown type 'revolut'"),
        ),
        (
            '"revolute"',
            '"revolut"',
            dict(line=6, reason="(did you mean 'revolute'?", allowed="revolute, "),
        ),
        (
            '"revolute"',
            '"spherical"',
            dict(
                line=6,
                allowed="revolute, continuous, prismatic, fixed, floating, planar",
            ),
        ),
        (' type="revolute"', "", dict(line=6, reason="joint 'j' has no type")),
        ('name="j" ', "", dict(line=6, reason="a joint has no name")),
        (
            'name="j"',
            'name="universe"',
            dict(line=6, reason="a joint cannot be called 'universe'"),
        ),
        (
            '<parent link="a"/>',
            "",
            dict(line=6, reason="joint 'j' names no parent link"),
        ),
        (
            '<parent link="a"/>',
            "<parent/>",
            dict(line=6, reason="joint 'j' names no parent link"),
        ),
        ('<child link="b"/>', "", dict(line=6, reason="joint 'j' names no child link")),
        (
            '<parent link="a"/>',
            '<parent link="aa"/>',
            dict(
                line=6,
                reason=("parent link 'aa' of joint 'j'", "did you mean 'a'"),
            ),
        ),
        (
            '<link name="c"/>',
            "",
            dict(line=13, reason="the child link 'c' of joint 'f' does not exist"),
        ),
        (
            '<link name="c"/>',
            '<link name="c"/><link name="a"/>',
            dict(
                line=5,
                reason="link 'a' is here for the second time, the first is in line 3",
            ),
        ),
        (
            '"f"',
            '"j"',
            dict(
                line=13, reason="joint 'j' is here for the second time, the first is in"
            ),
        ),
        (
            '<child link="c"/>',
            '<child link="b"/>',
            dict(line=13, reason="link 'b' is the child of two joints, 'j' and 'f'"),
        ),
        (
            '<link name="c"/>',
            '<link name="c"/><link name="d"/>',
            dict(
                line=5,
                reason="the links 'a', 'd' all have no parent joint",
            ),
        ),
        (
            '<child link="c"/>',
            '<child link="a"/>',
            dict(
                line=13, reason="the links a > b > a form a loop, and a URDF is a tree"
            ),
        ),
        (
            'name="arm"',
            'name="arm" version="3.0"',
            dict(line=2, reason="Invalid 'version' specified"),
        ),
        (
            '<robot name="arm">',
            '<robot name="arm">' + "<x>" * 900 + "</x>" * 900,
            dict(line=2, reason="d"),
        ),
    ],
)
def test_urdfs_with_a_mistake(
    old: str, new: str, fields: dict[str, Any], bad: Callable[..., None]
) -> None:
    assert old in ARM.decode()
    bad(ARM.decode().replace(old, new).encode(), **fields)


def test_loop_away_from_the_root(bad: Callable[..., None]) -> None:
    loop = b"""<link name="d"/><link name="e"/>
<joint name="x" type="fixed"><parent link="d"/><child link="e"/></joint>
<joint name="y" type="fixed"><parent link="e"/><child link="d"/></joint></robot>"""
    bad(ARM.replace(b"</robot>", loop), reason="the links d > e > d form a loop")


def chain(count: int, closing: bytes = b"") -> bytes:
    """A robot of fixed joints, one after the other; its last link comes first."""
    links = (b'<link name="l%d"/>' % k for k in range(count, -1, -1))
    joints = (
        b'<joint name="j%d" type="fixed"><parent link="l%d"/><child link="l%d"/>'
        b"</joint>" % (k, k, k + 1)
        for k in range(count)
    )
    return b"\n".join([b'<robot name="r">', *links, *joints, closing, b"</robot>"])


def test_limits(bad: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    assert parse_robot(chain(999), "arm.urdf").leaves == ("l999",)
    reason = "link 'l1000' is too far from the root"
    bad(chain(1000), line=2, reason=reason, allowed="at most 1000 links one after")
    many = b"".join(b' a%d=""' % k for k in range(1000))
    parse_robot(chain(1, b"<gazebo%b/>" % many), "arm.urdf")
    reason = "<gazebo> has too many attributes"
    bad(chain(1, b'<gazebo b=""%b/>' % many), line=5, value=1001, reason=reason)
    monkeypatch.setattr(urdf_tree, "JOINTS", 3)
    parse_robot(chain(3), "arm.urdf")
    bad(chain(4), line=1, value=4, reason="the robot has too many joints")


# Writing.


def write_corrected_urdf(
    path: Path, *about: Any, check: Callable[[Robot], None] | None, force: bool = False
) -> None:
    write_atomically(path, corrected_urdf(path, *about, check), force=force)


def test_write_and_read_back(tmp_path: Path, refused: Callable[..., Any]) -> None:
    robot = parse_robot(ARM, "arm.urdf")
    seen: list[Robot] = []
    path = tmp_path / "new" / "out.urdf"
    write_corrected_urdf(path, robot, {"j": SHIFT}, check=seen.append)
    assert path.read_bytes() == edit_origins(ARM, {"j": SHIFT}) == seen[0].source
    assert seen[0].file == str(path)
    umask = os.umask(0)
    os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask
    with refused(OptionError, file=str(path), reason="--force"):
        write_corrected_urdf(path, robot, {}, check=None)
    write_corrected_urdf(path, robot, {}, check=None, force=True)
    assert path.read_bytes() == ARM
    assert listing(path.parent) == ["out.urdf"]


def test_never_over_the_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., Any]
) -> None:
    source = tmp_path / "arm.urdf"
    source.write_bytes(ARM)
    link = tmp_path / "link.urdf"
    link.symlink_to(source)
    monkeypatch.chdir(tmp_path)
    robot = load_robot("arm.urdf")
    for path in (source, link, tmp_path / ".." / tmp_path.name / "arm.urdf"):
        with refused(OptionError, file=str(path), reason="own URDF"):
            write_corrected_urdf(path, robot, {"j": SHIFT}, check=None, force=True)
    panda = load_robot("example:panda")
    path = locate_robot("example:panda")
    with refused(OptionError, file=str(path), reason="own URDF"):
        write_corrected_urdf(path, panda, {}, check=None, force=True)
    assert source.read_bytes() == ARM


def test_nothing_is_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., Any]
) -> None:
    robot = parse_robot(ARM, "arm.urdf")
    path = tmp_path / "out.urdf"

    def refuse(_: Robot) -> None:
        raise OutputError("the tip is 3 mm off")

    with pytest.raises(OutputError, match="3 mm off"):
        write_corrected_urdf(path, robot, {"j": SHIFT}, check=refuse)
    with refused(RobotError, file="arm.urdf", reason="no joint 'jj'"):
        write_corrected_urdf(path, robot, {"jj": SHIFT}, check=None)
    monkeypatch.setattr(urdf, "edit_origins", lambda *_: b"<robot/>")
    with pytest.raises(OutputError, match=r"corrected URDF does not read back: .*name"):
        write_corrected_urdf(path, robot, {"j": SHIFT}, check=None)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    path.write_bytes(b"old")
    with pytest.raises(OutputError, match=r"out.urdf: cannot be written: No space le"):
        write_atomically(path, b"new", force=True)
    assert path.read_bytes() == b"old"
    assert listing(tmp_path) == ["out.urdf"]


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    Path(tmp_path, "file").write_bytes(b"x")
    Path(tmp_path, "folder").mkdir()
    for name, words in {
        "folder": "cannot be written: it is a directory",
        "file/x.csv": "cannot be written: a file stands in the place of its folder",
        "file/y/x.csv": "cannot be written: Not a directory",
        "a\0b": "cannot be written: .*embedded null",
        "x" * 300: "cannot be written: File name too long",
    }.items():
        with pytest.raises(OutputError, match=words):
            write_atomically(tmp_path / name, b"y", force=True)
    if os.geteuid():  # Root may write everywhere.
        Path(tmp_path, "folder").chmod(0o500)
        with pytest.raises(OutputError, match="cannot be written: Permission denied"):
            write_atomically(tmp_path / "folder" / "x", b"y", force=False)
    assert listing(tmp_path) == ["file", "folder"]


def test_read_bytes(tmp_path: Path, refused: Callable[..., Any]) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(b"x\r\n")
    assert read_bytes(path) == b"x\r\n"
    with refused(InputError, reason=("no such file", "did you mean 'data.csv'")):
        read_bytes(tmp_path / "dat.csv")
    with refused(InputError, file=str(tmp_path), reason="is a directory"):
        read_bytes(tmp_path)


INERTIAL = """<inertial>
<origin xyz="0 0 0.1" rpy="0 0 0"/>
<mass value="4"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
</inertial>
<collision>
<geometry><box size="1 1 1"/></geometry>
</collision>"""


@pytest.mark.parametrize(
    ("old", "new", "line", "value"),
    [
        ('value="4"', 'value="4 kg"', 3, "4 kg"),
        ('value="4"', 'value=" 4"', 3, " 4"),
        ('value="4"', 'value="\uff14"', 3, "\uff14"),
        ('value="4"', 'value="-4"', 3, "-4"),
        ('value="4"', 'value="1e9"', 3, "1e9"),
        ('value="4"', "", 1, None),
        ('<mass value="4"/>', "", 1, None),
        ('ixx="1"', 'ixx="1,0"', 4, "1,0"),
        ('xyz="0 0 0.1"', 'xyz="0 0"', 2, "0 0"),
        ('xyz="0 0 0.1"', 'xyz="0 0 1e9"', 2, "0 0 1e9"),
        ('rpy="0 0 0"', 'rpy="0 0 nan"', 2, "0 0 nan"),
        ('size="1 1 1"', 'size="1 1 \u0661"', 7, "1 1 \u0661"),
    ],
)
def test_numbers_of_links_that_would_be_dropped(old, new, line, value, bad, urdf_of):
    """Pinocchio took such a link for one without a mass, or left its shape out."""
    assert old in INERTIAL
    text = INERTIAL.replace(old, new)
    source = f'<robot name="r"><link name="a">{text}</link></robot>'.encode()
    bad(source, line=line, value=value, reason="of link 'a'")


def test_wide_text_is_no_xml(bad):
    bad('<robot name="r"><link name="a"/></robot>'.encode("utf-32"), reason="utf-16-le")


@pytest.mark.parametrize(
    "before", [b"\n", b"<!-- by a generator -->\n", b" <!-- a --> "]
)
def test_a_declaration_that_comes_late_is_no_fault(before):
    chain = Chain(parse_robot(ARM, "arm"), "a", "c")
    late = before + ARM
    written = edit_origins(late, {"j": pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))})
    assert written.startswith(before + b"<?xml")
    q = np.zeros((1, 1))
    moved = Chain(parse_robot(written, "arm"), "a", "c").poses(q) - chain.poses(q)
    assert np.linalg.norm(moved[0, :3, 3]) == pytest.approx(0.5, abs=1e-12)


def test_many_comments_take_no_time():
    with pytest.raises(RobotError, match="not well-formed"):
        parse_robot(b"<!-- a -->" * 100_000 + b"<!-- x", "arm")
