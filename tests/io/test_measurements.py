"""Measurement files: what reads how, what is refused with which line."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from calib_pin.chain import Chain, Robot
from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.measured_columns import COMPONENTS, VALUES
from calib_pin.io.measurements import (
    read_configurations,
    read_measurements,
    write_measurements,
)
from calib_pin.measurement_models import MEASUREMENT_MODELS, measurement_model
from calib_pin.measurements import Measurements
from calib_pin.setup import JointMap, Setup

URDF = """<robot name="r">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
  <joint name="lift" type="prismatic">
    <parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <origin xyz="0.4 0 0"/>
    <limit lower="-2.9" upper="2.9" effort="1" velocity="1"/>
  </joint>
  <joint name="wrist" type="continuous">
    <parent link="b"/><child link="c"/><axis xyz="1 0 0"/><origin xyz="0.3 0 0"/>
  </joint>
  <joint name="gripper" type="prismatic">
    <parent link="c"/><child link="d"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.05" effort="1" velocity="1"/>
  </joint>
</robot>"""


def robot(xml: str, file: str = "r.urdf") -> Robot:
    root = ElementTree.fromstring(xml)
    links = tuple(link.attrib["name"] for link in root.findall("link"))
    joints = [
        joint for joint in root.findall("joint") if joint.find("child") is not None
    ]
    children = {joint.find("child").attrib["link"] for joint in joints}
    parents = {joint.find("parent").attrib["link"] for joint in joints}
    return Robot(
        name=root.attrib["name"],
        file=file,
        source=xml.encode(),
        model=pin.buildModelFromXML(xml),
        root=next(link for link in links if link not in children),
        links=links,
        leaves=tuple(link for link in links if link not in parents),
    )


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Chain(robot(URDF), tip="c")


@pytest.fixture
def write(tmp_path):
    def write(text: str | bytes, name: str = "m.csv") -> Path:
        file = tmp_path / name
        file.write_bytes(text.encode() if isinstance(text, str) else text)
        return file

    return write


@pytest.fixture
def message(write, chain):
    """The one line about a file that cannot be used, without the folder."""

    def message(text: str | bytes, **options) -> str:
        file = write(text)
        with pytest.raises(InputError) as caught:
            read_measurements(file, chain, **options)
        result = str(caught.value)
        assert "\n" not in result
        return result.replace(str(file), "m.csv")

    return message


# --- files that read ---------------------------------------------------------------


def test_position(write, chain):
    file = write("lift,elbow,wrist,x,y,z\n0.1,0.2,0.3,1,2,3\n0.4,0.5,7,-1,-2,-3e-1\n")
    data = read_measurements(file, chain)
    assert data.joints == ("lift", "elbow", "wrist")
    assert data.model == "position"
    assert data.q.tolist() == [[0.1, 0.2, 0.3], [0.4, 0.5, 7.0]]
    assert data.values.tolist() == [[1, 2, 3], [-1, -2, -0.3]]
    assert data.sigma is None
    assert data.target == ("", "")
    assert not data.validate.any()
    assert data.lines.tolist() == [2, 3]
    assert data.files == (str(file), str(file))
    assert data.place(1) == f"{file}:3"


def test_columns_in_any_order_with_units(write, chain):
    data = read_measurements(
        write(
            "target, z [um] ,wrist [deg],lift [mm],x[mm],y [ in ],elbow [mrad],"
            "sigma [mm],set\n"
            "ball,3000000,90,100,1000,2,500,0.1,train\n"
            ",3,-90,0,1,1,-500,0.2,validate\n"
        ),
        chain,
    )
    half_turn = np.pi / 2
    np.testing.assert_allclose(data.q, [[0.1, 0.5, half_turn], [0, -0.5, -half_turn]])
    np.testing.assert_allclose(
        data.values, [[1.0, 0.0508, 3.0], [0.001, 0.0254, 3e-6]], rtol=1e-15
    )
    np.testing.assert_allclose(data.sigma, [[1e-4] * 3, [2e-4] * 3], rtol=1e-15)
    assert data.target == ("ball", "")
    assert data.validate.tolist() == [False, True]


def test_comments_blank_lines_quotes_and_spaces(write, chain):
    data = read_measurements(
        write(
            '# made by hand\n\n "lift" ,elbow , wrist,distance,target\n'.replace(
                '" ,', '",'
            )
            + "  # a comment, with commas\n"
            ' 0 , "0.5", 1 , 2.5 , "wall, left"\n'
            "   \n"
            '0,0,0,1," say ""hi"" "\n'
            "#0,0,0,1,commented out\n"
        ),
        chain,
    )
    assert data.model == "plane-distance"
    assert data.q.tolist() == [[0, 0.5, 1], [0, 0, 0]]
    assert data.values.tolist() == [[2.5], [1.0]]
    assert data.target == ("wall, left", 'say "hi"')
    assert data.lines.tolist() == [5, 7]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_line_ends_and_byte_order_mark(write, chain, end, mark):
    lines = ["lift,elbow,wrist,distance,target", "0,0,0,1,Wände", "", "0,0,0,2,b"]
    data = read_measurements(write(mark + end.join(lines).encode()), chain)
    assert data.target == ("Wände", "b")
    assert data.lines.tolist() == [2, 4]


def test_names_match_exactly(write):
    xml = URDF.replace('"elbow"', '"joint1"').replace('"wrist"', '"joint11"')
    chain = Chain(robot(xml), tip="c")
    file = write("joint11,lift,joint1,distance\n0.1,0.2,0.3,1\n")
    assert read_measurements(file, chain).q.tolist() == [[0.2, 0.3, 0.1]]
    with pytest.raises(InputError, match="joint 'joint1' of the chain is missing"):
        read_measurements(write("joint11,lift,distance\n0.1,0.2,1\n"), chain)


def test_sigma_by_component(write, chain):
    header = "lift,elbow,wrist,x,y,z,sigma,sigma_y [um]\n"
    data = read_measurements(write(header + "0,0,0,1,2,3,0.001,50\n"), chain)
    np.testing.assert_allclose(data.sigma, [[1e-3, 5e-5, 1e-3]])

    names = "sigma_rz [mrad],sigma_x,sigma_y,sigma_z,sigma_rx [deg],sigma_ry"
    header = f"lift,elbow,wrist,x,y,z,rx,ry,rz,{names}\n"
    data = read_measurements(
        write(header + "0,0,0,1,2,3,0,0,0,6,0.1,0.2,0.3,4,0.5"), chain
    )
    np.testing.assert_allclose(data.sigma, [[0.1, 0.2, 0.3, np.pi / 45, 0.5, 0.006]])

    header = "lift,elbow,wrist,distance,sigma_distance [mm]\n"
    data = read_measurements(write(header + "0,0,0,1,2"), chain)
    assert data.sigma.tolist() == [[0.002]]


def test_model_asked_for_takes_its_columns_only(write, chain):
    header = "lift,elbow,wrist,x,y,z,qx,qy,qz,qw,distance,sigma_distance,sigma_rx\n"
    file = write(header + "0,0,0,1,2,3,0,0,0,1,4,0.1,0.1\n")
    notices: list[str] = []
    data = read_measurements(file, chain, model="position", notice=notices.append)
    assert (data.model, data.values.tolist()) == ("position", [[1, 2, 3]])
    assert data.sigma is None
    assert notices == [
        f"{file}: columns ignored: qx, qy, qz, qw, distance, sigma_distance, sigma_rx"
    ]
    data = read_measurements(file, chain, model="plane-distance")
    assert (data.values.tolist(), data.sigma.tolist()) == ([[4.0]], [[0.1]])


def test_columns_without_a_meaning_are_reported_once(write, chain):
    rows = "0,0,0,0,front left,1,abc\n" * 3
    header = "lift,elbow,wrist,gripper,tool_position,distance,time [s]\n"
    notices: list[str] = []
    second = write(",lift,elbow,wrist,distance\n1,0,0,0,1", "n.csv")
    first = write(header + rows)
    read_measurements([first, second], chain, notice=notices.append)
    assert notices == [
        f"{first}: columns ignored: tool_position, time [s]",
        f"{second}: columns ignored: (unnamed)",
    ]
    notices.clear()
    clean = write("lift,elbow,wrist,gripper,distance\n0,0,0,0,1\n")
    read_measurements(clean, chain, notice=notices.append)
    assert notices == []


def test_several_files_are_joined_in_order(write, chain):
    a = write("lift,elbow,wrist,distance\n0,0,0,1\n0,0,0,2\n", "a.csv")
    b = write(
        "# b\ndistance [mm],wrist,elbow,lift,set\n3000,3,2,0.1,validate\n", "b.csv"
    )
    data = read_measurements([b, str(a)], chain)
    assert data.values.tolist() == [[3.0], [1.0], [2.0]]
    assert data.files == (str(b), str(a), str(a))
    assert data.lines.tolist() == [3, 2, 3]
    assert data.validate.tolist() == [True, False, False]
    assert data.q[0].tolist() == [0.1, 2.0, 3.0]


# --- orientations ------------------------------------------------------------------


def rotations() -> np.ndarray:
    """Random rotations, and those that are hard to write down."""
    rng = np.random.default_rng(1)
    result = [pin.exp3(v) for v in rng.normal(size=(40, 3))]
    for angle in (np.pi - 1e-9, np.pi - 1e-4, np.pi, 1e-9, 0.0):
        for axis in np.vstack([np.eye(3), rng.normal(size=(5, 3))]):
            result.append(pin.exp3(axis / np.linalg.norm(axis) * angle))
    for pitch in (np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9):
        for roll, yaw in rng.uniform(-3, 3, (5, 2)):
            result.append(pin.rpy.rpyToMatrix(roll, pitch, yaw))
    return np.array(result)


def matrices(quaternions: np.ndarray) -> np.ndarray:
    return np.array([pin.Quaternion(q).toRotationMatrix() for q in quaternions])


@pytest.mark.parametrize(
    ("header", "write_down"),
    [
        ("qx,qy,qz,qw", lambda R: pin.Quaternion(R).coeffs()),
        ("qx,qy,qz,qw", lambda R: -pin.Quaternion(R).coeffs()),
        ("qx,qy,qz,qw", lambda R: 1.009 * pin.Quaternion(R).coeffs()),
        ("rx,ry,rz", pin.log3),
        ("rx [deg],ry [deg],rz [deg]", lambda R: np.rad2deg(pin.log3(R))),
        ("roll,pitch,yaw", pin.rpy.matrixToRpy),
        ("yaw [mrad],pitch,roll", lambda R: [1e3, 1, 1] * pin.rpy.matrixToRpy(R)[::-1]),
    ],
)
def test_orientations(write, chain, header, write_down):
    R = rotations()
    rows = [",".join(map(repr, np.asarray(write_down(M)).tolist())) for M in R]
    text = f"lift,elbow,wrist,x,y,z,{header}\n"
    text += "".join(f"0,0,0,1,2,3,{row}\n" for row in rows)
    data = read_measurements(write(text), chain)
    assert data.model == "pose"
    assert data.values[:, :3].tolist() == [[1, 2, 3]] * len(R)
    quaternions = data.values[:, 3:]
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, rtol=1e-14)
    assert (quaternions[:, 3] >= 0).all()
    np.testing.assert_allclose(matrices(quaternions), R, atol=2e-8)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("rx,ry,rz\n0,0,0,0,0,0,0,0,0", [0, 0, 0, 1]),
        # More than half a turn about x is less than half a turn about -x.
        ("rx,ry,rz\n0,0,0,0,0,0,4,0,0", [-np.sin(2), 0, 0, -np.cos(2)]),
        ("roll [deg],pitch,yaw\n0,0,0,0,0,0,90,0,0", [0.5**0.5, 0, 0, 0.5**0.5]),
        ("roll,pitch [deg],yaw\n0,0,0,0,0,0,0,90,0", [0, 0.5**0.5, 0, 0.5**0.5]),
        ("roll,pitch,yaw [deg]\n0,0,0,0,0,0,0,0,90", [0, 0, 0.5**0.5, 0.5**0.5]),
        # Fixed axes: first roll about x, then yaw about the fixed z.
        ("roll [deg],pitch,yaw [deg]\n0,0,0,0,0,0,90,0,90", [0.5, 0.5, 0.5, 0.5]),
        ("qx,qy,qz,qw\n0,0,0,0,0,0,0,0,-1,0", [0, 0, -1, 0]),
    ],
)
def test_known_orientations(write, chain, row, expected):
    data = read_measurements(write("lift,elbow,wrist,x,y,z," + row), chain)
    np.testing.assert_allclose(data.values[0, 3:], expected, atol=1e-16)


# --- joint maps --------------------------------------------------------------------


def test_joint_maps(write, chain):
    joints = {
        "J2": JointMap("elbow", sign=-1, gear=0.01, offset=0.5),
        "J3": JointMap("wrist", gear=2.0, coupled={"J2": 0.5, "extra": -1.0}),
        "hand": JointMap("gripper"),
    }
    file = write("J3,J2 [deg],lift,extra [mrad],hand,distance\n0.1,180,0.2,10,x,1\n")
    notices: list[str] = []
    data = read_measurements(file, chain, joints=joints, notice=notices.append)
    assert data.joints == ("lift", "elbow", "wrist")
    expected = [0.2, 0.5 - 0.01 * np.pi, 2 * (0.1 + 0.5 * np.pi - 0.01)]
    np.testing.assert_allclose(data.q, [expected])
    assert notices == []
    np.testing.assert_allclose(read_configurations(file, chain, joints), [expected])


def test_joints_may_be_exchanged_by_a_map(write, chain):
    joints = {"wrist": JointMap("elbow"), "elbow": JointMap("wrist", sign=-1)}
    file = write("lift,elbow,wrist\n0.1,0.2,0.3\n")
    assert read_configurations(file, chain, joints).tolist() == [[0.1, 0.3, -0.2]]


def test_own_column_of_a_mapped_joint_is_reported(write, chain):
    notices: list[str] = []
    file = write("lift,elbow,wrist,J2,distance\n0,1,0,2,1\n")
    joints = {"J2": JointMap("elbow")}
    data = read_measurements(file, chain, joints=joints, notice=notices.append)
    assert data.q.tolist() == [[0, 2, 0]]
    assert notices == [f"{file}: columns ignored: elbow"]


@pytest.mark.parametrize(
    ("joints", "header", "parts"),
    [
        ({"J": JointMap("elbov")}, "J", ["'J'", "'elbov'", "mean 'elbow'", "lift"]),
        ({"J": JointMap("universe")}, "J", ["'universe'", "lift, elbow, wrist"]),
        (
            {"J": JointMap("elbow"), "K": JointMap("elbow")},
            "J,K",
            ["two columns, 'J' and 'K'", "'elbow'"],
        ),
        (
            {"J22": JointMap("elbow")},
            "lift,wrist,J2",
            ["m.csv:1: column 'J22' for joint 'elbow'", "missing", "mean 'J2'"],
        ),
        (
            {"J2": JointMap("elbow", coupled={"J1_": 1})},
            "lift,wrist,J2,J1",
            ["m.csv:1: column 'J1_' for joint 'elbow'", "mean 'J1'"],
        ),
        (
            {"wrist": JointMap("elbow")},
            "lift,wrist",
            [
                "column 'wrist' is mapped to joint 'elbow'",
                "joint 'wrist' has no column",
            ],
        ),
        ({"x": JointMap("elbow")}, "lift", ["'x'", "meaning of its own", "'joints'"]),
        (
            {"J2": JointMap("elbow")},
            "lift,wrist,J2 [mm]",
            ["m.csv:1", "'mm'", "'J2'", "rad, deg, mrad"],
        ),
    ],
)
def test_joint_map_errors(message, joints, header, parts):
    columns = f"{header},distance"
    row = ",".join("0" for _ in columns.split(","))
    result = message(f"{columns}\n{row}\n", joints=joints)
    for part in parts:
        assert part in result


def test_joint_with_the_name_of_a_measured_column(write):
    chain = Chain(robot(URDF.replace('"lift"', '"x"')), tip="c")
    file = write("x,elbow,wrist,distance\n0,0,0,1\n")
    with pytest.raises(InputError, match=r"'x' has a meaning of its own.*'joints'"):
        read_measurements(file, chain)
    file = write("rail,elbow,wrist,x,y,z\n0.1,0,0,1,2,3\n")
    data = read_measurements(file, chain, joints={"rail": JointMap("x")})
    assert (data.q[0, 0], data.values[0, 0]) == (0.1, 1.0)


# --- configurations ----------------------------------------------------------------


def test_configurations_ignore_everything_else(write, chain):
    text = "x,wrist,elbow [deg],lift,sigma,set,qx,note\nfar,3,90,0.2,-1,both,,é\n"
    q = read_configurations(write(text), chain)
    assert q.tolist() == [[0.2, np.pi / 2, 3.0]]


def test_configurations_lack_a_joint(write, chain):
    with pytest.raises(InputError, match=r"m\.csv:1: joint 'wrist' of the chain"):
        read_configurations(write("lift,elbow\n0,0\n"), chain)


# --- writing -----------------------------------------------------------------------

FINITE = st.floats(-10, 10, width=64)
SIGMA = st.floats(1e-12, 1.0, exclude_min=True)
TEXT = st.text(
    st.characters(blacklist_categories=("Cs",), blacklist_characters="\r\n\0"),
    max_size=8,
).map(str.strip)


@st.composite
def measurements(draw):
    model, width, components = draw(
        st.sampled_from([("position", 3, 3), ("pose", 7, 6), ("plane-distance", 1, 1)])
    )
    count = draw(st.integers(1, 5))
    # Within the unit checks of the reader: 0 to 0.5 m, about a turn.
    q = draw(arrays(float, (count, 3), elements=st.floats(-0.4, 0.4)))
    values = draw(arrays(float, (count, width), elements=st.floats(-2, 2)))
    if model == "pose":
        quaternion = draw(arrays(float, (count, 4), elements=st.floats(0.1, 1)))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        values[:, 3:] = quaternion * [-1, 1, -1, 1]
    sigma = draw(st.none() | arrays(float, (count, components), elements=SIGMA))
    return Measurements(
        joints=("lift", "elbow", "wrist"),
        q=q,
        model=model,
        values=values,
        sigma=sigma,
        target=tuple(draw(st.lists(TEXT, min_size=count, max_size=count))),
        validate=draw(arrays(bool, count)),
    )


@settings(
    max_examples=80,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=measurements(), comments=st.lists(TEXT, max_size=3))
def test_written_files_read_back_bit_by_bit(tmp_path, chain, data, comments):
    file = tmp_path / "written.csv"
    write_measurements(file, data, comments, force=True)
    again = read_measurements(file, chain, notice=pytest.fail)
    for name in ("q", "values", "sigma", "validate"):
        written, read = getattr(data, name), getattr(again, name)
        assert (written is None) == (read is None)
        assert written is None or written.tobytes() == read.tobytes()
    assert (again.model, again.joints) == (data.model, data.joints)
    assert again.target == data.target
    first = file.read_bytes()
    write_measurements(file, again, comments, force=True)
    assert file.read_bytes() == first
    assert b"\r" not in first


def test_what_is_written(tmp_path, chain):
    data = Measurements(
        joints=("lift", "elbow", "wrist"),
        q=np.array([[0.1, -0.0, 1e-7], [0.25, 2.0, 3.0]]),
        model="pose",
        values=np.array([[1, 2, 3, 0, 0, 0, 1], [0.1, 0.2, 0.3, 0, 0.6, 0, 0.8]]),
        sigma=np.full((2, 6), 1e-4),
        target=("ball", 'a, "b"'),
        validate=np.array([False, True]),
    )
    file = tmp_path / "out.csv"
    write_measurements(file, data, ["made by a test", "", "two\nlines"])
    assert file.read_text(encoding="utf-8") == (
        "# made by a test\n#\n# two\n# lines\n"
        "lift,elbow,wrist,x,y,z,qx,qy,qz,qw,sigma_x,sigma_y,sigma_z,"
        "sigma_rx,sigma_ry,sigma_rz,target,set\n"
        "0.1,-0.0,1e-07,1.0,2.0,3.0,0.0,0.0,0.0,1.0,"
        + "0.0001," * 6
        + "ball,train\n0.25,2.0,3.0,0.1,0.2,0.3,0.0,0.6,0.0,0.8,"
        + "0.0001," * 6
        + '"a, ""b""",validate\n'
    )
    again = read_measurements(file, chain)
    assert again.target == data.target
    assert again.q.tobytes() == data.q.tobytes()


def test_normalized_quaternions_stay_as_they_are(write, tmp_path, chain):
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(2000, 4))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True) * rng.uniform(0.991, 1.009)
    text = "lift,elbow,wrist,x,y,z,qx,qy,qz,qw\n" + "".join(
        f"0,0,0,1,2,3,{','.join(map(repr, row.tolist()))}\n" for row in rows
    )
    data = read_measurements(write(text), chain)
    file = tmp_path / "again.csv"
    write_measurements(file, data)
    assert read_measurements(file, chain).values.tobytes() == data.values.tobytes()


def test_an_existing_file_needs_force(tmp_path):
    data = Measurements(("j",), np.zeros((1, 1)), "plane-distance", np.ones((1, 1)))
    file = tmp_path / "out.csv"
    file.write_text("mine")
    with pytest.raises(OptionError, match=r"out\.csv"):
        write_measurements(file, data)
    assert file.read_text() == "mine"
    write_measurements(file, data, force=True)
    assert file.read_text() == "j,distance\n0.0,1.0\n"


@pytest.mark.parametrize(
    ("joint", "target"),
    [("x", ""), ("j [mm]", ""), (" j", ""), ("j", " a"), ("j", "a\nb")],
)
def test_what_would_not_read_back_is_not_written(tmp_path, joint, target):
    data = Measurements(
        (joint,), np.zeros((1, 1)), "plane-distance", np.ones((1, 1)), target=(target,)
    )
    with pytest.raises(OutputError):
        write_measurements(tmp_path / "out.csv", data)
    assert not list(tmp_path.iterdir())


def test_a_model_without_a_format_is_not_written(tmp_path):
    data = Measurements(("j",), np.zeros((1, 1)), "camera", np.ones((1, 2)))
    with pytest.raises(OptionError, match="'camera' is not available"):
        write_measurements(tmp_path / "out.csv", data)


# --- files that are refused --------------------------------------------------------

J = "lift,elbow,wrist"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        # Not such a file at all.
        ("", ["m.csv: the file is empty"]),
        ("# only\n\n# comments\n", ["m.csv: the file is empty"]),
        (f"# c\n{J},distance\n# c\n", ["m.csv: ", "header but no rows"]),
        (b"lift,\xff\n0,0\n", ["m.csv:1: not UTF-8"]),
        (b"lift,elbow\n0,0\n0,\xe9", ["m.csv:3: not UTF-8"]),
        (b"lift\x00,elbow\n0,0\n", ["m.csv: not a text file"]),
        (
            "# c\nlift;elbow;wrist;x\n0,1;2;3;4\n",
            ["m.csv:2:", "semicolons", "separator must be a comma", "decimal mark"],
        ),
        ("lift\telbow\n0\t0\n", ["m.csv:1:", "tabs", "must be a comma"]),
        ("lift elbow [deg] wrist\n0 0 0\n", ["m.csv:1:", "spaces", "must be a comma"]),
        ("0.1,0.2,0.3,1\n0,0,0,1\n", ["m.csv:1:", "a header", "is missing"]),
        # Rows that do not fit.
        (
            f"{J},distance\n0,0,0,1\n\n0,0,0\n",
            ["m.csv:4:", "3 cells", "4 columns", "column 'distance'"],
        ),
        (
            f"{J},distance\n0,0,0,1\n0,0,0,1,abc\n",
            ["m.csv:3:", "5 cells", "4 columns", "value 'abc'"],
        ),
        (
            f"{J},distance\n0,0,0,0,0,0,1,5\n",
            ["m.csv:2:", "8 cells", "decimal mark must be a point"],
        ),
        (f'{J},distance\n0,0,0,"1\n0,0,0,1\n', ["m.csv:2:", "quotes"]),
        (f'{J},distance,target\n0,0,0,1,"a"b\n', ["m.csv:2:", "quotes"]),
        # Cells that are not numbers.
        *(
            (
                f"{J},distance\n0,0,0,1\n# c\n0,{cell},0,1\n",
                ["m.csv:4:", "column 'elbow'", f"value '{value}'", what, "finite"],
            )
            for cell, value, what in (
                ("abc", "abc", "not a number"),
                (" ", "", "the cell is empty"),
                ("nan", "nan", "not a finite number"),
                ("-Inf", "-Inf", "not a finite number"),
                ("1e999", "1e999", "not a finite number"),
                ("1_0", "1_0", "not a number"),
                ('"1,5"', "1,5", "decimal mark must be a point"),
                ("90deg", "90deg", "not a number"),
            )
        ),
        # Columns that are missing, doubled or have a wrong unit.
        (
            "lift,elbow_joint,wrist,distance\n0,0,0,1\n",
            ["m.csv:1: joint 'elbow'", "mean 'elbow_joint'", "column 'elbow'"],
        ),
        (
            "lift,elbow (deg),distance\n0,0,1\n",
            ["joint 'elbow'", "mean 'elbow (deg)'", "missing as well: wrist"],
        ),
        (f"{J},elbow,distance\n0,0,0,0,1\n", ["m.csv:1:", "two columns are 'elbow'"]),
        (
            f"{J},x,x [mm],y,z\n0,0,0,0,1,0,0\n",
            ["m.csv:1:", "two columns are 'x'", "'x [mm]'"],
        ),
        (
            "lift,elbow [mm],wrist,distance\n0,0,0,1\n",
            ["m.csv:1:", "'mm'", "column 'elbow'", "allowed: rad, deg, mrad"],
        ),
        (
            "lift [deg],elbow,wrist,distance\n0,0,0,1\n",
            ["'deg'", "column 'lift'", "allowed: m, mm, um, in"],
        ),
        (
            f"{J},distance [cm]\n0,0,0,1\n",
            ["'cm'", "column 'distance'", "allowed: m, mm, um, in"],
        ),
        (f"{J},distance []\n0,0,0,1\n", ["unit ''", "allowed: m, mm, um, in"]),
        (f"{J},x,y,z,qx [m],qy,qz,qw\n0,0,0,0,0,0,0,0,0,1", ["'qx'", "no unit"]),
        (f"{J},distance,sigma [deg]\n0,0,0,1,1\n", ["'deg'", "'sigma'", "m, mm"]),
        (f"{J},distance,target [m]\n0,0,0,1,1\n", ["'target'", "takes no unit"]),
        # Which model?
        (f"{J},target\n0,0,0,a\n", ["m.csv:1: no measured columns", "x, y, z", "dist"]),
        (f"{J},x,y\n0,0,0,1,2\n", ["model 'position' needs the missing z"]),
        (f"{J},x,y,z (mm)\n0,0,0,1,2,3\n", ["missing z", "mean 'z (mm)'"]),
        (
            f"{J},x,y,z,distance\n0,0,0,1,2,3,4\n",
            ["both a position and a distance", "--model", "position, pose, plane-dist"],
        ),
        (f"{J},rx,ry,rz\n0,0,0,0,0,0\n", ["model 'pose' needs the missing x, y, z"]),
        (
            f"{J},x,y,z,qx,qy,qz\n0,0,0,1,2,3,0,0,0\n",
            ["qx, qy, qz, qw", "lacks qw", "column 'qw'"],
        ),
        (f"{J},x,y,z,yaw\n0,0,0,1,2,3,0\n", ["roll, pitch, yaw", "lacks roll, pitch"]),
        (
            f"{J},x,y,z,rx,ry,rz,yaw\n0,0,0,1,2,3,0,0,0,0\n",
            ["more than once", "rx and by yaw", "qx,qy,qz,qw or rx,ry,rz or roll"],
        ),
        # Quaternions.
        (
            f"{J},x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0,0,1\n0,0,0,1,2,3,0,0,1,1\n",
            ["m.csv:3:", "norm 1.41421", "'qx, qy, qz, qw'", "0, 0, 1, 1", "0.99 to"],
        ),
        (f"{J},x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0,0,0\n", ["m.csv:2:", "norm 0"]),
        (f"{J},x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0,0,1.011\n", ["norm 1.011"]),
        # Sigmas.
        *(
            (
                f"{J},distance,sigma\n0,0,0,1,1\n0,0,0,1,{cell}\n",
                ["m.csv:3:", "column 'sigma'", f"value '{cell}'", "positive"],
            )
            for cell in ("0", "-0.1", "nan", "inf", "", "small")
        ),
        (
            f"{J},x,y,z,sigma_x,sigma_z\n0,0,0,1,2,3,1,1\n",
            ["m.csv:1:", "every component", "missing: sigma_y"],
        ),
        (
            f"{J},x,y,z,rx,ry,rz,sigma_x,sigma_y,sigma_z\n0,0,0,1,2,3,0,0,0,1,1,1\n",
            ["missing: sigma_rx, sigma_ry, sigma_rz"],
        ),
        (
            f"{J},x,y,z,rx,ry,rz,sigma\n0,0,0,1,2,3,0,0,0,1\n",
            [
                "column 'sigma'",
                "lengths and angles",
                "sigma_x, sigma_y, sigma_z, sigma_r",
            ],
        ),
        *(
            (
                f"{J},x,y,z,rx,ry,rz,sigma_{name}\n0,0,0,1,2,3,0,0,0,1\n",
                [f"column 'sigma_{name}'", "rotation vector", "sigma_rx, sigma_ry"],
            )
            for name in ("qx", "qw", "roll", "yaw")
        ),
        # Sets.
        (
            f"{J},distance,set\n0,0,0,1,train\n0,0,0,1,test\n",
            ["m.csv:3:", "column 'set'", "value 'test'", "allowed: train, validate"],
        ),
        (f"{J},distance,set\n0,0,0,1,\n", ["m.csv:2:", "allowed: train, validate"]),
        (f"{J},distance,set\n0,0,0,1,Train\n", ["m.csv:2:", "value 'Train'"]),
    ],
)
def test_errors(message, text, parts):
    result = message(text)
    assert result.startswith("m.csv:")
    for part in parts:
        assert part in result


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        # Angles in degrees.
        (
            f"{J},distance\n0,1,0,1\n0,90,0,1\n0,45,0,1\n",
            ["m.csv:3:", "column 'elbow'", "value '90'", "'elbow [deg]'", "90 rad"],
        ),
        (f"{J},distance\n0,0,-13,1\n", ["m.csv:2:", "value '-13'", "'wrist [deg]'"]),
        # Within four half turns, but neither in the limits nor near.
        (
            f"{J},distance\n0,0,0,1\n0,-9,0,1\n",
            ["m.csv:3:", "value '-9'", "'elbow [deg]'", "limits are -2.9 to 2.9"],
        ),
        (f"{J.replace('elbow', 'elbow [deg]')},distance\n0,2000,0,1\n", ["[mrad]'"]),
        # Lengths in millimeters.
        (f"{J},distance\n250,0,0,1\n", ["m.csv:2:", "'250'", "'lift [mm]'"]),
        (f"{J},distance\n15,0,0,1\n", ["'lift [mm]'", "limits are 0 to 0.5"]),
        (f"{J},distance\n0,0,0,101\n", ["'101'", "'distance [mm]'", "m, mm, um, in"]),
        (f"{J},x,y,z\n0,0,0,1,-900,2\n", ["column 'y'", "-900 m", "'y [mm]'"]),
        (
            f"{J},x [mm],y,z\n0,0,0,900000,1,2\n",
            ["value '900000'", "900 m", "'x [um]'"],
        ),
        (
            f"{J},x,y,z\n0,0,0,1,1,2\n0,0,0,1,2,2\n0,0,0,1,30,2\n",
            ["m.csv:4:", "column 'y'", "value '30'", "span 29 m", "'y [mm]'"],
        ),
        # Orientations in degrees.
        (f"{J},x,y,z,rx,ry,rz\n0,0,0,1,1,2,0,90,0\n", ["value '90'", "'ry [deg]'"]),
        (f"{J},x,y,z,roll,pitch,yaw\n0,0,0,1,1,2,0,0,180\n", ["'yaw [deg]'"]),
        # Sigmas.
        (f"{J},distance,sigma\n0,0,0,1,1.5\n", ["value '1.5'", "'sigma [mm]'"]),
        (
            f"{J},x,y,z,rx,ry,rz,sigma_x,sigma_y,sigma_z,sigma_rx,sigma_ry,sigma_rz\n"
            "0,0,0,1,1,2,0,0,0,1,1,1,1,1,1.1\n",
            ["'sigma_rz [deg]'"],
        ),
    ],
)
def test_values_in_the_wrong_unit(message, text, parts):
    result = message(text)
    assert "looks like the wrong unit" in result
    for part in parts:
        assert part in result


def test_the_wrong_unit_of_a_mapped_joint(message):
    joints = {"J2": JointMap("elbow", offset=1.0)}
    result = message("lift,J2,wrist,distance\n0,90,0,1\n", joints=joints)
    assert "91 rad looks like the wrong unit" in result
    assert "mapped to joint 'elbow' with an offset of 1 rad" in result
    assert "value '90'" in result
    assert "'J2 [deg]'" in result


@pytest.mark.parametrize(
    "text",
    [
        # A bit over the limits, several turns, a motor's angle before its gear.
        f"{J},distance\n0.6,3.1,0,1\n",
        f"{J},distance\n0,8,12.5,1\n",
        f"{J},distance\n0,0,0,-99\n",
        # A robot that moves within its reach, far from the tracker.
        f"{J},x,y,z\n0,0,0,80,90,2\n0,0,0,81,91,2\n",
    ],
)
def test_plausible_values_pass(write, chain, text):
    read_measurements(write(text), chain)


def test_a_gear_makes_large_motor_angles_plausible(write, chain):
    joints = {"motor": JointMap("elbow", gear=0.01)}
    file = write("lift,motor,wrist,distance\n0,200,0,1\n")
    assert read_measurements(file, chain, joints=joints).q[0, 1] == 2.0


def test_limits_of_many_turns_are_believed(write):
    xml = URDF.replace('lower="-2.9" upper="2.9"', 'lower="-60" upper="60"')
    file = write("lift,elbow,wrist,distance\n0,59,0,1\n")
    assert read_measurements(file, Chain(robot(xml), tip="c")).q[0, 1] == 59.0


@pytest.mark.parametrize(
    ("model", "parts"),
    [
        *(
            (name, [f"'{name}' is not available in this version", "plane-distance"])
            for name in ("point-distance", "fixed-point", "plane-contact", "camera")
        ),
        ("positon", ["'positon'", "mean 'position'", "position, pose, plane-distance"]),
    ],
)
def test_model_names(write, chain, model, parts):
    with pytest.raises(OptionError) as caught:
        read_measurements(write("lift\n0\n"), chain, model=model)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("model", "part"),
    [
        ("position", "model 'position' needs the missing x, y, z"),
        ("pose", "model 'pose' needs the missing x, y, z"),
    ],
)
def test_model_asked_for_lacks_columns(message, model, part):
    result = message(f"{J},distance\n0,0,0,1\n", model=model)
    assert result.startswith("m.csv:1: ")
    assert part in result


def test_pose_asked_for_lacks_the_orientation(message):
    result = message(f"{J},x,y,z\n0,0,0,1,2,3\n", model="pose")
    assert "'pose' needs an orientation" in result
    assert "qx,qy,qz,qw or rx,ry,rz or roll,pitch,yaw" in result


def test_several_near_columns_give_no_hint(message):
    result = message("lift,elbow_1,elbow_2,wrist,distance\n0,0,0,0,1\n")
    assert "joint 'elbow'" in result
    assert "did you mean" not in result


def test_files_that_cannot_be_joined(write, chain):
    distance = write(f"{J},distance\n0,0,0,1\n", "d.csv")
    position = write(f"{J},x,y,z\n0,0,0,1,2,3\n", "p.csv")
    sigma = write(f"{J},distance,sigma\n0,0,0,1,1\n", "s.csv")
    with pytest.raises(InputError, match=r"p\.csv: .*'position'.*'plane-dist.*--model"):
        read_measurements([distance, position], chain)
    with pytest.raises(InputError, match=r"s\.csv: .*standard deviations"):
        read_measurements([distance, sigma], chain)
    with pytest.raises(InputError, match="no measurement file"):
        read_measurements([], chain)


def test_missing_file(tmp_path, chain):
    with pytest.raises(InputError, match=r"none\.csv: no such file"):
        read_measurements(tmp_path / "none.csv", chain)


def test_every_measurement_model_has_a_file_format():
    assert list(COMPONENTS) == list(VALUES) == list(MEASUREMENT_MODELS)
    for name, components in COMPONENTS.items():
        model = measurement_model(name, Setup())
        units = {}
        for quantity in model.quantities:
            indices = range(*quantity.columns.indices(len(components)))
            units.update(dict.fromkeys(indices, quantity.unit))
        assert [kind.si for kind in components.values()] == [
            units[i] for i in range(len(components))
        ]


# --- size and speed ----------------------------------------------------------------


def test_many_rows_read_in_little_time(write, chain):
    count = 20_000
    rows = np.random.default_rng(3).uniform(0, 0.4, (count, 9))
    text = f"{J},x,y,z,rx,ry,rz\n"
    text += "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    file = write(text)
    start = time.perf_counter()
    assert len(read_measurements(file, chain)) == count
    # About 0.15 s here; the bound only catches a loop in Python per cell.
    assert time.perf_counter() - start < 2.0
    bad = write(text + "\n" + "0," * 8 + "x")
    with pytest.raises(InputError, match=rf"m\.csv:{count + 2}: .*'rz'"):
        read_measurements(bad, chain)


def test_importing_does_not_load_scipy():
    code = (
        "import sys, calib_pin.io.measurements; "
        "sys.exit(not {'scipy', 'pandas', 'yaml', 'pydantic'}.isdisjoint(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- real files --------------------------------------------------------------------

DATA = Path(
    os.environ.get("CALIB_PIN_DATA", Path(__file__).parents[3] / "shared" / "data")
)
ROBOTS = Path("cmeel.prefix/share/example-robot-data/robots")


def real_chain(urdf: str, tip: str) -> Chain:
    if not DATA.is_dir():
        pytest.skip(f"no real measurements at {DATA}, see CALIB_PIN_DATA")
    try:
        distribution = importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    file = Path(str(distribution.locate_file(ROBOTS / urdf)))
    return Chain(robot(file.read_text(), str(file)), tip=tip)


@pytest.mark.parametrize(
    ("urdf", "tip", "files", "model", "counts", "ignored"),
    [
        (
            "ur_description/urdf/ur10_robot.urdf",
            "tool0",
            ["ur10_tmac/train.csv", "ur10_tmac/validate.csv"],
            "pose",
            [500, 2000],
            "temperature_C",
        ),
        (
            "tiago_description/robots/tiago_no_hand.urdf",
            "wrist_ft_tool_link",
            ["tiago/train.csv", "tiago/validate.csv"],
            "position",
            [37, 62],
            "",
        ),
        (
            "talos_data/robots/talos_reduced.urdf",
            "arm_left_7_link",
            ["talos_left_arm/measurements.csv"],
            "position",
            [61],
            "time_s",
        ),
    ],
)
def test_real_files(tmp_path, urdf, tip, files, model, counts, ignored):
    chain = real_chain(urdf, tip)
    paths = [DATA / file for file in files]
    notices: list[str] = []
    data = read_measurements(paths, chain, notice=notices.append)
    assert data.model == model
    assert len(data) == sum(counts)
    assert data.files == sum(
        ((str(path),) * n for path, n in zip(paths, counts, strict=True)), ()
    )
    assert notices == [f"{p}: columns ignored: {ignored}" for p in paths if ignored]
    # Millimeters became meters: no target is farther than a room.
    assert np.abs(data.values[:, :3]).max() < 3.0
    written = tmp_path / "again.csv"
    write_measurements(written, data)
    again = read_measurements(written, chain)
    assert again.q.tobytes() == data.q.tobytes()
    assert again.values.tobytes() == data.values.tobytes()


def test_real_configurations():
    chain = real_chain("panda_description/urdf/panda.urdf", "panda_link8")
    file = DATA / "mukca_panda" / "panda_1.csv"
    assert read_configurations(file, chain).shape == (182, 7)
    with pytest.raises(InputError, match="no measured columns"):
        read_measurements(file, chain)
