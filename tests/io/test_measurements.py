"""Measurement files: what reads how, what is refused with which line."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.measured_columns import components as components_of
from calib_pin.io.measurements import (
    read_configurations,
    read_measurements,
    write_measurements,
)
from calib_pin.io.table import read_table
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared, measurement_model
from calib_pin.observations import BlockKey, Conditions, Measurements, Observations
from calib_pin.setup import CameraSetup, JointMap, Setup

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


CHAINS = ("", "left_hand", "touch", "world")


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


def read(*about, **options) -> Measurements:
    """The measurements of files of one block."""
    return read_measurements(*about, **options).only


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Chain(robot(URDF), tip="c")


@pytest.fixture
def bad(write, chain, refused):
    """A file that cannot be used: `bad(text, line=3, reason="...")`, see `refused`.

    Options of the reader may stand beside the fields of the error.
    """

    def bad(text: str | bytes, **fields) -> None:
        file = write(text)
        options = {k: fields.pop(k) for k in ("model", "joints") if k in fields}
        with refused(InputError, **{"file": str(file), **fields}):
            read(file, chain, **options)

    return bad


# --- files that read ---------------------------------------------------------------


def test_position(write, chain):
    file = write("lift,elbow,wrist,x,y,z\n0.1,0.2,0.3,1,2,3\n0.4,0.5,7,-1,-2,-3e-1\n")
    data = read(file, chain)
    assert data.joints == ("lift", "elbow", "wrist")
    assert data.model == "position"
    assert data.q.tolist() == [[0.1, 0.2, 0.3], [0.4, 0.5, 7.0]]
    assert data.values.tolist() == [[1, 2, 3], [-1, -2, -0.3]]
    assert data.sigma is None
    assert data.target == ("", "")
    assert not data.validate.any()
    assert data.lines.tolist() == [2, 3]
    assert data.files == (str(file), str(file))
    assert data.source(1) == f"{file}:3"


def test_columns_in_any_order_with_units(write, chain):
    data = read(
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
    data = read(
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
    data = read(write(mark + end.join(lines).encode()), chain)
    assert data.target == ("Wände", "b")
    assert data.lines.tolist() == [2, 4]


def test_names_match_exactly(write, refused):
    xml = URDF.replace('"elbow"', '"joint1"').replace('"wrist"', '"joint11"')
    chain = Chain(robot(xml), tip="c")
    file = write("joint11,lift,joint1,distance\n0.1,0.2,0.3,1\n")
    assert read(file, chain).q.tolist() == [[0.2, 0.3, 0.1]]
    with refused(InputError, line=1, column="joint1", reason="joint 'joint1'"):
        read(write("joint11,lift,distance\n0.1,0.2,1\n"), chain)


def test_sigma_by_component(write, chain):
    header = "lift,elbow,wrist,x,y,z,sigma,sigma_y [um]\n"
    data = read(write(header + "0,0,0,1,2,3,0.001,50\n"), chain)
    np.testing.assert_allclose(data.sigma, [[1e-3, 5e-5, 1e-3]])

    names = "sigma_rz [mrad],sigma_x,sigma_y,sigma_z,sigma_rx [deg],sigma_ry"
    header = f"lift,elbow,wrist,x,y,z,rx,ry,rz,{names}\n"
    data = read(write(header + "0,0,0,1,2,3,0,0,0,6,0.1,0.2,0.3,4,0.5"), chain)
    np.testing.assert_allclose(data.sigma, [[0.1, 0.2, 0.3, np.pi / 45, 0.5, 0.006]])

    header = "lift,elbow,wrist,distance,sigma_distance [mm]\n"
    data = read(write(header + "0,0,0,1,2"), chain)
    assert data.sigma.tolist() == [[0.002]]


def test_model_asked_for_takes_its_columns_only(write, chain):
    header = "lift,elbow,wrist,x,y,z,qx,qy,qz,qw,distance,sigma_distance,sigma_rx\n"
    file = write(header + "0,0,0,1,2,3,0,0,0,1,4,0.1,0.1\n")
    notices: list[str] = []
    data = read(file, chain, model="position", notice=notices.append)
    assert (data.model, data.values.tolist()) == ("position", [[1, 2, 3]])
    assert data.sigma is None
    assert notices == [
        f"{file}: columns ignored: qx, qy, qz, qw, distance, sigma_distance, sigma_rx"
    ]
    data = read(file, chain, model="plane-distance")
    assert (data.values.tolist(), data.sigma.tolist()) == ([[4.0]], [[0.1]])


def test_columns_without_a_meaning_are_reported_once(write, chain):
    rows = "0,0,0,0,front left,1,abc\n" * 3
    header = "lift,elbow,wrist,gripper,tool_position,distance,time [s]\n"
    notices: list[str] = []
    second = write(",lift,elbow,wrist,distance\n1,0,0,0,1", "n.csv")
    first = write(header + rows)
    read([first, second], chain, notice=notices.append)
    assert notices == [
        f"{first}: columns ignored: tool_position, time [s]",
        f"{second}: columns ignored: (unnamed)",
    ]
    notices.clear()
    clean = write("lift,elbow,wrist,gripper,distance\n0,0,0,0,1\n")
    read(clean, chain, notice=notices.append)
    assert notices == []


def test_several_files_are_joined_in_order(write, chain):
    a = write("lift,elbow,wrist,distance\n0,0,0,1\n0,0,0,2\n", "a.csv")
    b = write(
        "# b\ndistance [mm],wrist,elbow,lift,set\n3000,3,2,0.1,validate\n", "b.csv"
    )
    data = read([b, str(a)], chain)
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
    data = read(write(text), chain)
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
    data = read(write("lift,elbow,wrist,x,y,z," + row), chain)
    # The cosine of the number next to pi/2 is 6e-17; four such terms are added.
    np.testing.assert_allclose(data.values[0, 3:], expected, atol=4e-16)


# --- joint maps --------------------------------------------------------------------


def test_joint_maps(write, chain):
    joints = {
        "J2": JointMap("elbow", sign=-1, gear=0.01, offset=0.5),
        "J3": JointMap("wrist", gear=2.0, coupled={"J2": 0.5, "extra": -1.0}),
        "hand": JointMap("gripper"),
    }
    file = write("J3,J2 [deg],lift,extra [mrad],hand,distance\n0.1,180,0.2,10,x,1\n")
    notices: list[str] = []
    data = read(file, chain, joints=joints, notice=notices.append)
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
    data = read(file, chain, joints=joints, notice=notices.append)
    assert data.q.tolist() == [[0, 2, 0]]
    assert notices == [f"{file}: columns ignored: elbow"]


@pytest.mark.parametrize(
    ("joints", "header", "fields"),
    [
        (
            {"J": JointMap("elbov")},
            "J",
            dict(file=None, reason=("'J'", "'elbov'", "mean 'elbow'"), allowed="lift"),
        ),
        (
            {"J": JointMap("universe")},
            "J",
            dict(file=None, reason="'universe'", allowed="lift, elbow, wrist"),
        ),
        (
            {"J": JointMap("elbow"), "K": JointMap("elbow")},
            "J,K",
            dict(file=None, reason=("two columns, 'J' and 'K'", "'elbow'")),
        ),
        (
            {"J22": JointMap("elbow")},
            "lift,wrist,J2",
            dict(
                line=1,
                column="J22",
                reason=("column 'J22' for joint 'elbow'", "missing", "mean 'J2'"),
            ),
        ),
        (
            {"J2": JointMap("elbow", coupled={"J1_": 1})},
            "lift,wrist,J2,J1",
            dict(
                line=1,
                column="J1_",
                reason=("column 'J1_' for joint 'elbow'", "mean 'J1'"),
            ),
        ),
        (
            {"wrist": JointMap("elbow")},
            "lift,wrist",
            dict(
                file=None,
                reason=(
                    "column 'wrist' is mapped to joint 'elbow'",
                    "joint 'wrist' has no column",
                ),
            ),
        ),
        (
            {"x": JointMap("elbow")},
            "lift",
            dict(file=None, reason=("'x'", "meaning of its own", "'joints'")),
        ),
        (
            {"J2": JointMap("elbow")},
            "lift,wrist,J2 [mm]",
            dict(line=1, column="J2", reason="'mm'", allowed="rad, deg, mrad"),
        ),
    ],
)
def test_joint_map_errors(bad, joints, header, fields):
    columns = f"{header},distance"
    row = ",".join("0" for _ in columns.split(","))
    bad(f"{columns}\n{row}\n", joints=joints, **fields)


def test_joint_with_the_name_of_a_measured_column(write, refused):
    chain = Chain(robot(URDF.replace('"lift"', '"x"')), tip="c")
    file = write("x,elbow,wrist,distance\n0,0,0,1\n")
    with refused(InputError, reason=("'x' has a meaning of its own", "'joints'")):
        read(file, chain)
    file = write("rail,elbow,wrist,x,y,z\n0.1,0,0,1,2,3\n")
    data = read(file, chain, joints={"rail": JointMap("x")})
    assert (data.q[0, 0], data.values[0, 0]) == (0.1, 1.0)


# --- configurations ----------------------------------------------------------------


def test_configurations_ignore_everything_else(write, chain):
    text = "x,wrist,elbow [deg],lift,sigma,set,qx,note\nfar,3,90,0.2,-1,both,,é\n"
    q = read_configurations(write(text), chain)
    assert q.tolist() == [[0.2, np.pi / 2, 3.0]]


def test_configurations_lack_a_joint(write, chain, refused):
    with refused(InputError, line=1, column="wrist", reason="missing"):
        read_configurations(write("lift,elbow\n0,0\n"), chain)


# --- writing -----------------------------------------------------------------------

FINITE = st.floats(-10, 10, width=64)
SIGMA = st.floats(1e-12, 1.0, exclude_min=True)
TEXT = st.text(
    st.characters(blacklist_categories=("Cs",), blacklist_characters="\r\n\0"),
    max_size=8,
).map(str.strip)


# What a target has to be so that a row of the model can be read.
NAMED = TEXT.filter(lambda name: name.rpartition("@")[2] != "")


@st.composite
def measurements(draw, key=None, chains=None):
    """Measurements of one block, which keep to what the reader checks."""
    key = key or BlockKey(draw(st.sampled_from(list(MEASUREMENT_MODELS))))
    joints = chains.joints if chains else ("lift", "elbow", "wrist")
    model, n = key.model, len(joints)
    stated = declared(model)
    width, components = len(stated.values), len(stated.components)
    count = draw(st.integers(1, 5))
    # Within the unit checks of the reader: 0 to 0.5 m, about a turn.
    q = draw(arrays(float, (count, n), elements=st.floats(-0.4, 0.4)))
    values = draw(arrays(float, (count, width), elements=st.floats(-2, 2)))
    if model == "pose":
        quaternion = draw(arrays(float, (count, 4), elements=st.floats(0.1, 1)))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        values[:, 3:] = quaternion * [-1, 1, -1, 1]
    sizes = st.floats(1e-8, 1e3) if model == "camera" else SIGMA
    sigma = draw(st.none() | arrays(float, (count, components), elements=sizes))
    named = model not in ("position", "pose", "plane-distance", "relative-distance")
    named |= key.chain == "world"
    names = st.lists(NAMED if named else TEXT, min_size=count, max_size=count)
    if model in ("point-distance", "plane-contact", "sphere-contact"):
        # Those of one model and station name all of their targets, or none.
        names = st.just([""] * count) if key.chain != "world" and not chains else names
    target = draw(names)
    payload = draw(st.lists(TEXT, min_size=count, max_size=count))
    start = np.zeros((0, 0))
    if model == "relative-distance":
        values = np.abs(values) + 1e-6
        size = 0.4 if chains else 3.0
        begins = [0.45, *draw(arrays(float, n - 1, elements=st.floats(-size, size)))]
        first = [target.index(name) for name in target]
        payload = [payload[k] for k in first]
        start = np.array([begins] * count) - 0.01 * np.array(first)[:, None]
    return Measurements(
        joints=joints,
        q=chains.follow(q) if chains else q,
        values=values,
        sigma=sigma,
        target=target,
        conditions=Conditions(payload),
        start=chains.follow(start) if chains and start.size else start,
        validate=draw(arrays(bool, count)),
        **key._asdict(),
    )


@st.composite
def mixtures(draw, tree):
    """Measurements of several blocks, in any order within a file."""
    # Of a model and a chain either all measurements name a station, or none.
    models = draw(
        st.lists(
            st.sampled_from(list(MEASUREMENT_MODELS)),
            min_size=2,
            max_size=4,
            unique=True,
        )
    )
    places = st.sampled_from([("", ""), ("", "probe"), ("day 1", ""), ("2", "1")])
    keys = {}
    for model in models:
        for chain in draw(st.sets(st.sampled_from(CHAINS), min_size=1, max_size=2)):
            if (model, chain) == ("relative-distance", "world"):
                continue
            station, tool = draw(places)
            keys[BlockKey(model, chain, station, tool)] = None
            if station and draw(st.booleans()):
                keys[BlockKey(model, chain, "b", tool)] = None
    chains = tree.named(tuple({key.chain for key in keys} or {""}))
    blocks = [draw(measurements(key, chains)) for key in keys]
    if not blocks:
        blocks = [draw(measurements(BlockKey("pose"), chains))]
    order = draw(st.permutations(range(sum(map(len, blocks)))))
    lines = np.split(np.array(order), np.cumsum([len(b) for b in blocks])[:-1])
    blocks = [
        replace(block, lines=np.sort(own) + 1, files=["m.csv"] * len(block))
        for block, own in zip(blocks, lines, strict=True)
    ]
    return Observations(tuple(sorted(blocks, key=lambda block: block.lines[0])))


def same(data, again):
    """Whether measurements are the same, bit by bit."""
    blocks = (Observations.of(part).blocks for part in (data, again))
    for one, other in zip(*blocks, strict=True):
        for name in ("q", "values", "sigma", "start", "validate"):
            here, there = getattr(one, name), getattr(other, name)
            assert (here is None) == (there is None), name
            assert here is None or (here.shape, here.tobytes()) == (
                there.shape,
                there.tobytes(),
            ), name
        assert (other.key, other.joints) == (one.key, one.joints)
        assert (other.target, other.payload) == (one.target, one.payload)
    return True


@settings(
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(drawn=st.data(), comments=st.lists(TEXT, max_size=3))
def test_written_files_read_back_bit_by_bit(tmp_path, chain, tree, drawn, comments):
    data = drawn.draw(measurements() | mixtures(tree))
    file = tmp_path / "written.csv"
    write_measurements(file, data, comments, force=True)
    several = isinstance(data, Observations)
    options = {"notice": pytest.fail, "sockets": sockets(data)}
    (model, *others) = Observations.of(data).models
    if not others and model not in ("position", "pose", "plane-distance", "camera"):
        options["model"] = model
    again = read_measurements(file, tree if several else chain, **options)
    assert same(data, again)
    first = file.read_bytes()
    write_measurements(file, again, comments, force=True)
    assert file.read_bytes() == first
    assert b"\r" not in first


def sockets(data):
    """All of them, so that one row is enough for each."""
    return {name.rpartition("@")[2] for name in Observations.of(data).target}


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
    again = read(file, chain)
    assert again.target == data.target
    assert again.q.tobytes() == data.q.tobytes()


def test_normalized_quaternions_stay_as_they_are(write, tmp_path, chain):
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(2000, 4))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True) * rng.uniform(0.991, 1.009)
    text = "lift,elbow,wrist,x,y,z,qx,qy,qz,qw\n" + "".join(
        f"0,0,0,1,2,3,{','.join(map(repr, row.tolist()))}\n" for row in rows
    )
    data = read(write(text), chain)
    file = tmp_path / "again.csv"
    write_measurements(file, data)
    assert read(file, chain).values.tobytes() == data.values.tobytes()


def test_an_existing_file_needs_force(tmp_path, refused):
    data = Measurements(("j",), np.zeros((1, 1)), "plane-distance", np.ones((1, 1)))
    file = tmp_path / "out.csv"
    file.write_text("mine")
    with refused(OptionError, file=str(file), reason="exists"):
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


def test_a_model_without_a_format_is_not_written(tmp_path, refused):
    data = Measurements(("j",), np.zeros((1, 1)), "camra", np.ones((1, 2)))
    with refused(OptionError, reason=("'camra'", "did you mean 'camera'")):
        write_measurements(tmp_path / "out.csv", data)


# --- files that are refused --------------------------------------------------------

J = "lift,elbow,wrist"


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        # Not such a file at all.
        ("", dict(reason="the file is empty")),
        ("# only\n\n# comments\n", dict(reason="the file is empty")),
        (f"# c\n{J},distance\n# c\n", dict(reason="header but no rows")),
        (b"lift,\xff\n0,0\n", dict(line=1, reason="not UTF-8")),
        (b"lift,elbow\n0,0\n0,\xe9", dict(line=3, reason="not UTF-8")),
        (b"lift\x00,elbow\n0,0\n", dict(reason="not a text file")),
        (
            "# c\nlift;elbow;wrist;distance\n0,1;2;3;4,5\n0;2;3;1.5\n",
            dict(
                line=4,
                column="distance",
                reason=("decimal point here", "comma in line 3"),
                allowed="one decimal mark",
            ),
        ),
        ("lift;elbow;wrist;x\n0,1;2;3,4\n", dict(line=2, reason="3 cells")),
        (
            "lift elbow [deg] wrist\n0 0 0\n",
            dict(line=1, reason=("spaces", "must be a comma")),
        ),
        ("0.1,0.2,0.3,1\n0,0,0,1\n", dict(line=1, reason=("a header", "is missing"))),
        # Rows that do not fit.
        (
            f"{J},distance\n0,0,0,1\n\n0,0,0\n",
            dict(line=4, column="distance", reason=("3 cells", "4 columns")),
        ),
        (
            f"{J},distance\n0,0,0,1\n0,0,0,1,abc\n",
            dict(line=3, value="abc", reason=("5 cells", "4 columns")),
        ),
        (
            f"{J},distance\n0,0,0,0,0,0,1,5\n",
            dict(line=2, value="0", reason=("8 cells", "decimal mark must be a point")),
        ),
        (f'{J},distance\n0,0,0,"1\n0,0,0,1\n', dict(line=2, reason="quotes")),
        (f'{J},distance,target\n0,0,0,1,"a"b\n', dict(line=2, reason="quotes")),
        # Cells that are not numbers.
        *(
            (
                f"{J},distance\n0,0,0,1\n# c\n0,{cell},0,1\n",
                dict(
                    line=4, column="elbow", value=value, reason=what, allowed="finite"
                ),
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
            dict(
                line=1, column="elbow", reason=("joint 'elbow'", "mean 'elbow_joint'")
            ),
        ),
        (
            "lift,elbow (deg),distance\n0,0,1\n",
            dict(
                line=1,
                column="elbow",
                reason=(
                    "joint 'elbow'",
                    "mean 'elbow (deg)'",
                    "missing as well: wrist",
                ),
            ),
        ),
        (
            f"{J},elbow,distance\n0,0,0,0,1\n",
            dict(line=1, column="elbow", reason="two columns are 'elbow'"),
        ),
        (
            f"{J},x,x [mm],y,z\n0,0,0,0,1,0,0\n",
            dict(line=1, column="x", reason=("two columns are 'x'", "'x [mm]'")),
        ),
        (
            "lift,elbow [mm],wrist,distance\n0,0,0,1\n",
            dict(line=1, column="elbow", reason="'mm'", allowed="rad, deg, mrad"),
        ),
        (
            "lift [deg],elbow,wrist,distance\n0,0,0,1\n",
            dict(line=1, column="lift", reason="'deg'", allowed="m, mm, um, in"),
        ),
        (
            f"{J},distance [cm]\n0,0,0,1\n",
            dict(line=1, column="distance", reason="'cm'", allowed="m, mm, um, in"),
        ),
        (
            f"{J},distance []\n0,0,0,1\n",
            dict(line=1, column="distance", reason="unit ''", allowed="m, mm, um, in"),
        ),
        (
            f"{J},x,y,z,qx [m],qy,qz,qw\n0,0,0,0,0,0,0,0,0,1",
            dict(line=1, column="qx", allowed="no unit"),
        ),
        (
            f"{J},distance,sigma [deg]\n0,0,0,1,1\n",
            dict(line=1, column="sigma", reason="'deg'", allowed="m, mm"),
        ),
        (
            f"{J},distance,target [m]\n0,0,0,1,1\n",
            dict(line=1, column="target", reason="takes no unit"),
        ),
        # Which model?
        (
            f"{J},note\n0,0,0,a\n",
            dict(line=1, reason=("no measured columns", "x, y, z", "dist")),
        ),
        (
            f"{J},target\n0,0,0,a\n",
            dict(
                line=1,
                reason=(
                    "no measured columns",
                    "only name targets; say what is measured with --model",
                ),
                allowed="fixed-point, plane-contact, sphere-contact",
            ),
        ),
        (
            f"{J},x,y\n0,0,0,1,2\n",
            dict(line=1, column="z", reason="model 'position' needs the missing z"),
        ),
        (
            f"{J},x,y,z (mm)\n0,0,0,1,2,3\n",
            dict(line=1, column="z", reason=("missing z", "mean 'z (mm)'")),
        ),
        (
            f"{J},x,y,z,distance\n0,0,0,1,2,3,4\n",
            dict(
                line=1,
                reason=("both a position and a distance", "--model"),
                allowed="position, pose, plane-dist",
            ),
        ),
        (
            f"{J},rx,ry,rz\n0,0,0,0,0,0\n",
            dict(line=1, column="x", reason="model 'pose' needs the missing x, y, z"),
        ),
        (
            f"{J},x,y,z,qx,qy,qz\n0,0,0,1,2,3,0,0,0\n",
            dict(line=1, column="qw", reason=("qx, qy, qz, qw", "lacks qw")),
        ),
        (
            f"{J},x,y,z,yaw\n0,0,0,1,2,3,0\n",
            dict(
                line=1, column="roll", reason=("roll, pitch, yaw", "lacks roll, pitch")
            ),
        ),
        (
            f"{J},x,y,z,rx,ry,rz,yaw\n0,0,0,1,2,3,0,0,0,0\n",
            dict(
                line=1,
                column="yaw",
                reason=("more than once", "rx and by yaw"),
                allowed="qx,qy,qz,qw or rx,ry,rz or roll",
            ),
        ),
        # Quaternions.
        (
            f"{J},x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0,0,1\n0,0,0,1,2,3,0,0,1,1\n",
            dict(
                line=3,
                column="qx, qy, qz, qw",
                value="0, 0, 1, 1",
                reason="norm 1.41421",
                allowed="0.99 to",
            ),
        ),
        (
            f"{J},x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0,0,0\n",
            dict(line=2, column="qx, qy, qz, qw", value="0, 0, 0, 0", reason="norm 0"),
        ),
        (
            f"{J},x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0,0,1.011\n",
            dict(
                line=2,
                column="qx, qy, qz, qw",
                value="0, 0, 0, 1.011",
                reason="norm 1.011",
            ),
        ),
        # Sigmas.
        *(
            (
                f"{J},distance,sigma\n0,0,0,1,1\n0,0,0,1,{cell}\n",
                dict(line=3, column="sigma", value=cell, allowed="positive"),
            )
            for cell in ("0", "-0.1", "nan", "inf", "", "small")
        ),
        (
            f"{J},x,y,z,sigma_x,sigma_z\n0,0,0,1,2,3,1,1\n",
            dict(
                line=1, column="sigma_y", reason=("every component", "missing: sigma_y")
            ),
        ),
        (
            f"{J},x,y,z,rx,ry,rz,sigma_x,sigma_y,sigma_z\n0,0,0,1,2,3,0,0,0,1,1,1\n",
            dict(
                line=1,
                column="sigma_rx",
                reason="missing: sigma_rx, sigma_ry, sigma_rz",
            ),
        ),
        (
            f"{J},x,y,z,rx,ry,rz,sigma\n0,0,0,1,2,3,0,0,0,1\n",
            dict(
                line=1,
                column="sigma",
                reason="lengths and angles",
                allowed="sigma_x, sigma_y, sigma_z, sigma_r",
            ),
        ),
        *(
            (
                f"{J},x,y,z,rx,ry,rz,sigma_{name}\n0,0,0,1,2,3,0,0,0,1\n",
                dict(
                    line=1,
                    column=f"sigma_{name}",
                    reason="rotation vector",
                    allowed="sigma_rx, sigma_ry",
                ),
            )
            for name in ("qx", "qw", "roll", "yaw")
        ),
        # Sets.
        (
            f"{J},distance,set\n0,0,0,1,train\n0,0,0,1,test\n",
            dict(line=3, column="set", value="test", allowed="train, validate"),
        ),
        (
            f"{J},distance,set\n0,0,0,1,\n",
            dict(line=2, column="set", value="", allowed="train, validate"),
        ),
        (
            f"{J},distance,set\n0,0,0,1,Train\n",
            dict(line=2, column="set", value="Train"),
        ),
    ],
)
def test_errors(bad, text, fields):
    bad(text, **fields)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        # Angles in degrees.
        (
            f"{J},distance\n0,1,0,1\n0,90,0,1\n0,45,0,1\n",
            dict(
                line=3, column="elbow", value="90", reason=("'elbow [deg]'", "90 rad")
            ),
        ),
        (
            f"{J},distance\n0,0,-13,1\n",
            dict(line=2, column="wrist", value="-13", reason="'wrist [deg]'"),
        ),
        # Within four half turns, but neither in the limits nor near.
        (
            f"{J},distance\n0,0,0,1\n0,-9,0,1\n",
            dict(
                line=3,
                column="elbow",
                value="-9",
                reason=("'elbow [deg]'", "limits are -2.9 to 2.9"),
            ),
        ),
        (
            f"{J.replace('elbow', 'elbow [deg]')},distance\n0,2000,0,1\n",
            dict(line=2, column="elbow", value="2000", reason="[mrad]'"),
        ),
        # Lengths in millimeters.
        (
            f"{J},distance\n250,0,0,1\n",
            dict(line=2, column="lift", value="250", reason="'lift [mm]'"),
        ),
        (
            f"{J},distance\n15,0,0,1\n",
            dict(
                line=2,
                column="lift",
                value="15",
                reason=("'lift [mm]'", "limits are 0 to 0.5"),
            ),
        ),
        (
            f"{J},distance\n0,0,0,101\n",
            dict(
                line=2,
                column="distance",
                value="101",
                reason="'distance [mm]'",
                allowed="m, mm, um, in",
            ),
        ),
        (
            f"{J},x,y,z\n0,0,0,1,-900,2\n",
            dict(line=2, column="y", value="-900", reason=("-900 m", "'y [mm]'")),
        ),
        (
            f"{J},x [mm],y,z\n0,0,0,900000,1,2\n",
            dict(line=2, column="x", value="900000", reason=("900 m", "'x [um]'")),
        ),
        (
            f"{J},x,y,z\n0,0,0,1,1,2\n0,0,0,1,2,2\n0,0,0,1,30,2\n",
            dict(line=4, column="y", value="30", reason=("span 29 m", "'y [mm]'")),
        ),
        # Orientations in degrees.
        (
            f"{J},x,y,z,rx,ry,rz\n0,0,0,1,1,2,0,90,0\n",
            dict(line=2, column="ry", value="90", reason="'ry [deg]'"),
        ),
        (
            f"{J},x,y,z,roll,pitch,yaw\n0,0,0,1,1,2,0,0,180\n",
            dict(line=2, column="yaw", value="180", reason="'yaw [deg]'"),
        ),
        # Sigmas.
        (
            f"{J},distance,sigma\n0,0,0,1,1.5\n",
            dict(line=2, column="sigma", value="1.5", reason="'sigma [mm]'"),
        ),
        (
            f"{J},x,y,z,rx,ry,rz,sigma_x,sigma_y,sigma_z,sigma_rx,sigma_ry,sigma_rz\n"
            "0,0,0,1,1,2,0,0,0,1,1,1,1,1,1.1\n",
            dict(line=2, column="sigma_rz", value="1.1", reason="'sigma_rz [deg]'"),
        ),
    ],
)
def test_values_in_the_wrong_unit(bad, text, fields):
    bad(text, **fields)


def test_the_wrong_unit_of_a_mapped_joint(bad):
    bad(
        "lift,J2,wrist,distance\n0,90,0,1\n",
        joints={"J2": JointMap("elbow", offset=1.0)},
        line=2,
        column="J2",
        value="90",
        reason=("91 rad", "joint 'elbow' with an offset of 1 rad", "'J2 [deg]'"),
        allowed="deg",
    )


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
    read(write(text), chain)


def test_a_gear_makes_large_motor_angles_plausible(write, chain):
    joints = {"motor": JointMap("elbow", gear=0.01)}
    file = write("lift,motor,wrist,distance\n0,200,0,1\n")
    assert read(file, chain, joints=joints).q[0, 1] == 2.0


def test_limits_of_many_turns_are_believed(write):
    xml = URDF.replace('lower="-2.9" upper="2.9"', 'lower="-60" upper="60"')
    file = write("lift,elbow,wrist,distance\n0,59,0,1\n")
    assert read(file, Chain(robot(xml), tip="c")).q[0, 1] == 59.0


@pytest.mark.parametrize(
    ("model", "fields"),
    [
        (
            "positon",
            dict(
                reason=("'positon'", "mean 'position'"),
                allowed="position, pose, plane-distance",
            ),
        ),
        ("position+camra", dict(reason=("'camra'", "mean 'camera'"))),
        ("position+", dict(reason="unknown measurement model ''")),
        (
            "camera+position+camera",
            dict(value="camera+position+camera", reason="named twice"),
        ),
    ],
)
def test_model_names(write, chain, refused, model, fields):
    with refused(OptionError, **fields):
        read(write("lift\n0\n"), chain, model=model)


@pytest.mark.parametrize(
    ("model", "fields"),
    [
        (
            "position",
            dict(
                line=1, column="x", reason="model 'position' needs the missing x, y, z"
            ),
        ),
        (
            "pose",
            dict(line=1, column="x", reason="model 'pose' needs the missing x, y, z"),
        ),
    ],
)
def test_model_asked_for_lacks_columns(bad, model, fields):
    bad(f"{J},distance\n0,0,0,1\n", model=model, **fields)


def test_pose_asked_for_lacks_the_orientation(bad):
    bad(
        f"{J},x,y,z\n0,0,0,1,2,3\n",
        model="pose",
        line=1,
        reason="'pose' needs an orientation",
        allowed="qx,qy,qz,qw or rx,ry,rz or roll,pitch,yaw",
    )


def test_several_near_columns_give_no_hint(write, chain):
    file = write("lift,elbow_1,elbow_2,wrist,distance\n0,0,0,0,1\n")
    with pytest.raises(InputError) as caught:
        read(file, chain)
    assert caught.value.column == "elbow"
    assert "did you mean" not in caught.value.reason


def test_files_that_cannot_be_joined(write, chain, refused):
    distance = write(f"{J},distance\n0,0,0,1\n", "d.csv")
    sigma = write(f"{J},distance,sigma\n0,0,0,1,1\n", "s.csv")
    with refused(InputError, file=str(sigma), reason="standard deviations"):
        read([distance, sigma], chain)
    with refused(InputError, reason="no measurement file"):
        read([], chain)


def test_missing_file(tmp_path, chain, refused):
    with refused(InputError, file=str(tmp_path / "none.csv"), reason="no such file"):
        read(tmp_path / "none.csv", chain)


def test_every_measurement_model_has_a_file_format():
    setup = Setup(camera=CameraSetup("hand", (500.0, 500.0), (320.0, 240.0)))
    for name in MEASUREMENT_MODELS:
        components = components_of(name)
        assert tuple(components) == declared(name).components
        model = measurement_model(name, setup)
        units = {}
        for quantity in model.quantities:
            indices = range(*quantity.columns.indices(len(components)))
            units.update(dict.fromkeys(indices, quantity.unit))
        assert [kind.si for kind in components.values()] == [
            units[i] for i in range(len(components))
        ]
        assert model.width == len(declared(name).values)


# --- models without a tracker ------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "text", "values", "sigma", "target"),
    [
        (
            "camera",
            "v,u [px],target,sigma\n20.5,10,m1,0.5\n-1,1e5,m2,0.25\n",
            [[10.0, 20.5], [1e5, -1.0]],
            [[0.5, 0.5], [0.25, 0.25]],
            ("m1", "m2"),
        ),
        (
            "camera",
            "u,v,target,sigma_v,sigma_u [px]\n1,2,m,0.5,0.1\n3,4,m,0.5,0.2\n",
            [[1.0, 2.0], [3.0, 4.0]],
            [[0.1, 0.5], [0.2, 0.5]],
            ("m", "m"),
        ),
        ("fixed-point", "target\nfront/0\nfront/0\n", [[], []], None, ("front/0",) * 2),
        (
            "fixed-point",
            "target,sigma [mm]\nball@a,1\nother@a,2\n",
            [[], []],
            [[1e-3] * 3, [2e-3] * 3],
            ("ball@a", "other@a"),
        ),
        (
            "fixed-point",
            "target,sigma_z,sigma_x,sigma_y [mm]\na,0.3,0.1,2\na,0.3,0.1,2\n",
            [[], []],
            [[0.1, 0.002, 0.3]] * 2,
            ("a", "a"),
        ),
        ("plane-contact", "note\na\nb\n", [[], []], None, ("", "")),
        (
            "plane-contact",
            "target,sigma [um]\ntip@table,5\ntable,5\n",
            [[], []],
            [[5e-6], [5e-6]],
            ("tip@table", "table"),
        ),
        (
            "sphere-contact",
            "sigma_contact [mm]\n1\n2\n",
            [[], []],
            [[1e-3], [2e-3]],
            ("", ""),
        ),
        (
            "point-distance",
            "distance [mm],sigma_distance\n1500,0.1\n2,0.1\n",
            [[1.5], [0.002]],
            [[0.1], [0.1]],
            ("", ""),
        ),
    ],
)
def test_columns_of_models(write, chain, model, text, values, sigma, target):
    header, *rows = text.splitlines()
    q = ["0,0,0,", "0.1,0.2,0.3,"]
    lines = [f"lift,elbow,wrist,{header}", *map("".join, zip(q, rows, strict=True))]
    data = read(write("\n".join(lines)), chain, model=model)
    assert data.model == model
    assert data.values.tolist() == values
    assert data.values.shape == (2, len(declared(model).values))
    assert (data.sigma is None) == (sigma is None)
    assert sigma is None or np.allclose(data.sigma, sigma, rtol=1e-15, atol=0.0)
    assert (data.target, data.payload) == (target, ("", ""))


@pytest.mark.parametrize(
    ("columns", "model"),
    [
        ("u,v,target", "camera"),
        ("u,x,y,z", "position"),
        ("v,distance", "plane-distance"),
        ("distance,target", "plane-distance"),
        ("x,y,z,rx,ry,rz,target", "pose"),
    ],
)
def test_models_are_inferred(write, chain, columns, model):
    row = ",".join("a" if name == "target" else "0" for name in columns.split(","))
    data = read(write(f"{J},{columns}\n0,0,0,{row}\n"), chain)
    assert data.model == model


def test_payload(write, chain):
    file = write(f"{J},distance,payload\n0,0,0,1, gripper \n0,0,0,1,\n")
    assert read(file, chain, notice=pytest.fail).payload == ("gripper", "")


# --- relative distances ------------------------------------------------------------


def test_relative_distances_start_at_the_first_row_of_a_target(write, chain):
    data = read(
        write(
            "lift [mm],elbow,wrist,distance [mm],target,sigma [mm],set,payload\n"
            "100,0,0,0,a,,,p\n"
            "200,0,0,100,a,1,train,p\n"
            "0,1,0,0,ball@2,far,neither,\n"
            "300,0,0,200,a,2,validate,p\n"
            "0,1,1,20,ball@2,3,train,\n"
        ),
        chain,
        model="relative-distance",
        notice=pytest.fail,
    )
    assert data.values.tolist() == [[0.1], [0.2], [0.02]]
    assert data.q[:, 0].tolist() == [0.2, 0.3, 0.0]
    assert data.start.tolist() == [[0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 1.0, 0.0]]
    np.testing.assert_allclose(data.sigma, [[1e-3], [2e-3], [3e-3]])
    assert data.target == ("a", "a", "ball@2")
    assert data.payload == ("p", "p", "")
    assert data.validate.tolist() == [False, True, False]
    assert data.lines.tolist() == [3, 5, 6]


def test_without_targets_all_start_at_the_first_row(write, chain):
    file = write(f"{J},distance\n0,0,0,0\n0.1,0,0,0.1\n0.2,0,0,0.2\n")
    again = write(f"{J},distance\n0.4,0,0,0\n0.3,0,0,0.1\n", "n.csv")
    data = read([file, again], chain, model="relative-distance")
    assert data.start[:, 0].tolist() == [0.0, 0.0, 0.4]
    assert data.values[:, 0].tolist() == [0.1, 0.2, 0.1]


@pytest.mark.parametrize(
    ("rows", "fields"),
    [
        (
            "0,0,0,0.5,a,\n0.1,0,0,1,a,\n",
            dict(
                line=2,
                column="distance",
                value="0.5",
                reason="first row of a target is its start",
            ),
        ),
        (
            "0,0,0,0,a,\n0.1,0,0,1,a,\n0,0,0,0,b,\n",
            dict(
                line=4,
                column="target",
                value="b",
                reason="no other row is measured from it",
            ),
        ),
        (
            "0,0,0,0,a,\n0.1,0,0,1,a,\n0.2,0,0,0.0,a,\n",
            dict(
                line=4,
                column="distance",
                value="0.0",
                reason="a new start needs a target of its own",
            ),
        ),
        (
            "0,0,0,0,a,\n0.1,0,0,-1,a,\n",
            dict(line=3, column="distance", value="-1", allowed="more than 0"),
        ),
        (
            "0,0,0.5,0,a,\n0.1,0,0,1,a,\n0,0,0.5,1e-6,a,\n",
            dict(
                line=4,
                column="distance",
                value="1e-6",
                reason="positions are those of the start",
            ),
        ),
        (
            "0,0,0,0,a,\n0.1,0,0,1,a,\n0.2,0,0,1,a,p\n",
            dict(
                line=4,
                column="payload",
                value="p",
                reason="payload is not that of the start",
            ),
        ),
        (
            "0,0,0,,a,\n0.1,0,0,1,a,\n",
            dict(line=2, column="distance", value="", reason="the cell is empty"),
        ),
    ],
)
def test_starts_that_are_none(bad, rows, fields):
    text = f"{J},distance,target,payload\n{rows}"
    bad(text, model="relative-distance", **fields)


def relative(**changes):
    fields = {
        "joints": ("lift", "elbow", "wrist"),
        "q": np.array([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]]),
        "model": "relative-distance",
        "values": np.array([[0.1], [0.2], [0.3]]),
        "start": np.zeros((3, 3)),
    }
    return Measurements(**{**fields, **changes})


def test_starts_are_written_before_their_rows(tmp_path):
    file = tmp_path / "out.csv"
    write_measurements(
        file, relative(target=("a", "b", "a"), start=np.eye(3)[[0, 1, 0]])
    )
    assert file.read_text() == (
        "lift,elbow,wrist,distance,target\n"
        "1.0,0.0,0.0,0.0,a\n0.1,0.0,0.0,0.1,a\n"
        "0.0,1.0,0.0,0.0,b\n0.2,0.0,0.0,0.2,b\n"
        "0.3,0.0,0.0,0.3,a\n"
    )


def test_starts_are_written_before_the_first_in_the_file(tmp_path):
    file = tmp_path / "out.csv"
    lines = np.array([7, 3, 5])
    write_measurements(file, relative(lines=lines, files=["m.csv"] * 3))
    assert [row.split(",")[0] for row in file.read_text().splitlines()] == [
        *("lift", "0.0", "0.2", "0.3", "0.1")
    ]


@pytest.mark.parametrize(
    ("target", "names"),
    [
        ("a", ("a", "a/2", "a/4")),
        ("", ("", "start/2", "start/3")),
        ("ball@", ("ball@", "ball@start/2", "ball@start/3")),
    ],
)
def test_starts_of_one_target_are_told_apart(tmp_path, chain, target, names):
    """As in rows that are joined from several files, or each have their own start."""
    start = 0.01 * np.arange(3)[:, None] + np.zeros(3)
    data = relative(target=(target,) * 3, start=start)
    if target == "a":
        # A name that others have is not taken.
        data = Measurements.concatenate(
            [data, relative(target=("a/3",) * 3, start=np.full((3, 3), 0.05))]
        )
        names += ("a/3",) * 3
    file = tmp_path / "out.csv"
    write_measurements(file, data)
    again = read(file, chain, model="relative-distance")
    assert again.target == names
    assert again.start.tobytes() == data.start.tobytes()
    assert again.values.tobytes() == data.values.tobytes()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"start": np.zeros((0, 0))}, "row 0: the relative distance has no start"),
        ({"values": np.array([[1.0], [0.0], [1.0]])}, "row 1: .* not more than 0"),
        ({"q": np.eye(3) - np.eye(3)[0]}, "row 0: .* is taken at its start"),
    ],
)
def test_relative_distances_that_would_not_read_back(tmp_path, changes, reason):
    with pytest.raises(OutputError, match=reason):
        write_measurements(tmp_path / "out.csv", relative(**changes))
    assert not list(tmp_path.iterdir())


# --- several models ----------------------------------------------------------------

MIXED = f"""{J},model,x,y,z,u,v,distance,target,sigma,payload
0,0,0,camera,,,,1,2,,m1,,p
0.1,0,0,position,1,2,3,,,,,,
0.2,0,0,camera,,,,3,4,,m2,,
0.3,0,0,relative-distance,,,,,,0,a,,
0.4,0,0,relative-distance,,,,,,0.1,a,0.001,
"""


def test_a_file_of_several_models(write, chain):
    file = write(MIXED)
    data = read_measurements(file, chain, notice=pytest.fail)
    assert data.models == ("camera", "position", "relative-distance")
    camera, position, distance = data.blocks
    assert (camera.target, position.target) == (("m1", "m2"), ("",))
    assert distance.target == ("a",)
    assert data.lines.tolist() == [2, 4, 3, 6]
    assert data.q[:, 0].tolist() == [0.0, 0.2, 0.1, 0.4]
    assert camera.values.tolist() == [[1, 2], [3, 4]]
    assert position.values.tolist() == [[1, 2, 3]]
    assert distance.values.tolist() == [[0.1]]
    # Blocks state their standard deviations or leave them open, each for itself.
    assert (camera.sigma, position.sigma) == (None, None)
    assert distance.sigma.tolist() == [[0.001]]
    assert data.payload == ("p", "", "", "")
    assert (camera.start.size, distance.start.tolist()) == (0, [[0.3, 0, 0]])
    assert data.files == (str(file),) * 4


def test_what_is_written_of_several_models(tmp_path, write, chain):
    data = read_measurements(write(MIXED), chain)
    file = tmp_path / "out.csv"
    write_measurements(file, data)
    # In the order of the file that was read.
    assert file.read_text() == (
        "lift,elbow,wrist,model,u,v,x,y,z,distance,sigma_distance,target,payload\n"
        "0.0,0.0,0.0,camera,1.0,2.0,,,,,,m1,p\n"
        "0.1,0.0,0.0,position,,,1.0,2.0,3.0,,,,\n"
        "0.2,0.0,0.0,camera,3.0,4.0,,,,,,m2,\n"
        "0.3,0.0,0.0,relative-distance,,,,,,0.0,0.001,a,\n"
        "0.4,0.0,0.0,relative-distance,,,,,,0.1,0.001,a,\n"
    )
    assert same(data, read_measurements(file, chain))
    # A model that is left without rows is not in the file.
    write_measurements(file, data.rows(np.array([2])), force=True)
    assert read(file, chain).model == "position"
    two = (" p",) * 2
    bad = {"payload": {"conditions": Conditions(two)}, "target": {"target": two}}
    bad |= {name: {name: " p"} for name in ("station", "tool", "chain")}
    for name, change in bad.items():
        camera = replace(data.blocks[0], **change)
        with pytest.raises(OutputError, match=f"{name} ' p' would not read back"):
            write_measurements(file, camera, force=True)


def test_a_model_column_of_one_model_is_a_plain_file(write, chain):
    file = write(
        f"{J},distance,model\n0,0,0,1,point-distance\n1,0,0,1,point-distance\n"
    )
    data = read(file, chain, model="position", notice=pytest.fail)
    assert (data.model, data.target) == ("point-distance", ("", ""))


def test_several_files_of_different_models(write, chain, refused):
    distance = write(f"{J},distance,target\n0,0,0,1,wall\n0,0,0,2,\n", "d.csv")
    position = write(f"{J},x,y,z,sigma\n0,0,0,1,2,3,0.1\n", "p.csv")
    mixed = write(MIXED, "m.csv")
    data = read_measurements([distance, position], chain)
    assert data.models == ("plane-distance", "position")
    assert [block.values.tolist() for block in data.blocks] == [[[1], [2]], [[1, 2, 3]]]
    assert data.target == ("wall", "", "")
    assert data.files == (str(distance), str(distance), str(position))
    assert [block.sigma is None for block in data.blocks] == [True, False]
    # The column wins over what is asked for.
    data = read_measurements([distance, mixed], chain, model="plane-distance")
    assert data.models == ("plane-distance", "camera", "position", "relative-distance")
    # All rows of a model stand together.
    plain = write(f"{J},x,y,z\n0,0,0,1,2,3\n", "q.csv")
    data = read_measurements([mixed, plain], chain)
    assert list(map(len, data.blocks)) == [2, 2, 1]
    assert data.lines.tolist() == [2, 4, 3, 2, 6]
    with refused(
        InputError, file=str(position), reason="with and without standard dev"
    ):
        read_measurements([mixed, position], chain)


def test_each_file_is_the_one_model_that_its_columns_allow(write, chain, refused):
    sockets = write(f"{J},target\n0,0,0,a\n1,0,0,a\n".replace("1,0", "0.1,0"), "s.csv")
    position = write(f"{J},x,y,z,target\n0,0,0,1,2,3,a\n", "p.csv")
    pose = write(f"{J},x,y,z,rx,ry,rz\n0,0,0,1,2,3,0,0,0\n", "o.csv")
    touched = write(f"{J},note\n0,0,0,1\n", "t.csv")

    def models(files, model):
        return "+".join(read_measurements(files, chain, model=model).models)

    # Those that are asked for decide on the order.
    both = "fixed-point+position"
    assert models([position, sockets], both) == both
    assert models([sockets], both) == "fixed-point"
    assert models([pose, position], "position+pose") == "position+pose"
    assert models([pose], "position+camera") == "position"
    assert models([touched, position], "position+plane-contact+fixed-point") == (
        "position+plane-contact"
    )
    for file, model, fields in (
        (
            position,
            "camera+plane-distance",
            dict(reason=("none of", "camera needs u, v")),
        ),
        (position, "pose+fixed-point", dict(reason="needs x, y, z and an orientation")),
        (
            touched,
            "fixed-point+camera",
            dict(reason="needs nothing measured and a target"),
        ),
        (
            touched,
            "plane-contact+sphere-contact",
            dict(reason="allow plane-contact and sphere"),
        ),
        (sockets, "fixed-point+plane-contact", dict(reason="'model'")),
    ):
        with refused(InputError, file=str(file), line=1, **fields):
            read(file, chain, model=model)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        (
            "distance,model\n0,0,0,1,plane-distance\n0,0,0,1,plane-distanse\n",
            dict(
                line=3,
                column="model",
                value="plane-distanse",
                reason=("unknown", "mean 'plane-distance'"),
            ),
        ),
        (
            "distance,model\n0,0,0,1,\n",
            dict(line=2, column="model", value="", reason="names no measurement model"),
        ),
        (
            "distance,model [m]\n0,0,0,1,pose\n",
            dict(line=1, column="model", reason="takes no unit"),
        ),
        (
            "x,y,z,distance,model\n0,0,0,1,2,3,4,position\n0,0,0,,,,1,plane-distance\n",
            dict(
                line=2,
                column="distance",
                value="4",
                reason="measures 'position', which has no distance",
                allowed="blank",
            ),
        ),
        (
            "u,v,distance,sigma_u,sigma_v,target,model\n"
            "0,0,0,,,1,0.5,,,plane-distance\n0,0,0,1,2,,1,1,m,camera\n",
            dict(line=2, column="sigma_u", value="0.5", reason="which has no sigma_u"),
        ),
        (
            "u,v,distance,target,model\n"
            "0,0,0,,,1,,plane-distance\n0,0,0,1,,,m,camera\n",
            dict(line=3, column="v", value="", reason="the cell is empty"),
        ),
        (
            "u,distance,target,model\n0,0,0,,1,,plane-distance\n0,0,0,1,,m,camera\n",
            dict(line=1, column="v", reason="model 'camera' needs the missing v"),
        ),
        (
            "u,v,distance,target,model,sigma\n"
            "0,0,0,,,1,,plane-distance,\n0,0,0,1,1,,m,camera,1\n0,0,0,1,1,,m,camera,\n",
            dict(line=4, column="sigma", value="", reason="the cell is empty"),
        ),
        (
            "x,y,z,rx,ry,rz,model,sigma\n"
            "0,0,0,1,2,3,,,,position,1\n0,0,0,1,2,3,0,0,0,pose,1\n",
            dict(line=1, column="sigma", reason="lengths and angles at once"),
        ),
    ],
)
def test_bad_rows_of_several_models(bad, text, fields):
    bad(f"{J},{text}", **fields)


def test_only_columns_that_nobody_reads_are_reported(write, chain):
    text = "x,y,z,distance,qx,sigma_u,note,model\n"
    text += "0,0,0,1,2,3,,a,b,c,position\n0,0,0,,,,1,d,e,f,plane-distance\n"
    notices: list[str] = []
    file = write(f"{J},{text}")
    read_measurements(file, chain, notice=notices.append)
    assert notices == [f"{file}: columns ignored: qx, sigma_u, note"]


# --- what rows have to name --------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "text", "fields"),
    [
        (
            "camera",
            "u,v\n0,0,0,1,2\n",
            dict(line=1, column="target", reason="the point of each"),
        ),
        (
            "fixed-point",
            "n\n0,0,0,1\n",
            dict(line=1, column="target", reason="the socket of each"),
        ),
        (
            "camera",
            "u,v,target\n0,0,0,1,2,m\n0,0,0,1,2,\n",
            dict(line=3, column="target", value="", reason="the row names no point"),
        ),
        (
            "fixed-point",
            "target\n0,0,0,a\n0.1,0,0,ball@\n0.2,0,0,a\n",
            dict(
                line=3, column="target", value="ball@", reason="the row names no socket"
            ),
        ),
        (
            "plane-contact",
            "target\n0,0,0,wall\n0.1,0,0,ball@\n",
            dict(
                line=3,
                column="target",
                value="ball@",
                reason="the row names no plane, others do",
            ),
        ),
        (
            "sphere-contact",
            "target\n0,0,0,a\n0,0,0,\n",
            dict(line=3, column="target", value="", reason="no sphere"),
        ),
        (
            "point-distance",
            "distance,target\n0,0,0,1,\n0,0,0,1,a\n",
            dict(line=2, column="target", value="", reason="the row names no anchor"),
        ),
        # A ball that is in a socket once tells nothing.
        (
            "fixed-point",
            "target\n0,0,0,a\n0,0,0,b\n0.1,0,0,a\n",
            dict(
                line=3,
                column="target",
                value="b",
                reason="the socket 'b' has one configuration only",
                allowed="two configurations or more",
            ),
        ),
        (
            "fixed-point",
            "target\n0,0,0,x@a\n1e-9,0,0,y@a\n",
            dict(
                line=2,
                column="target",
                value="x@a",
                reason="the socket 'a' has one configuration only",
            ),
        ),
        # Numbers that cannot be.
        (
            "camera",
            "u,target\n0,0,0,1,m\n",
            dict(line=1, column="v", reason="model 'camera' needs the missing v"),
        ),
        (
            "camera",
            "u,v,target\n0,0,0,1,-2e5,m\n",
            dict(
                line=2,
                column="v",
                value="-2e5",
                reason="-200000 px is too large",
                allowed="100000 px or less",
            ),
        ),
        (
            "camera",
            "u [m],v,target\n0,0,0,1,1,m\n",
            dict(line=1, column="u", reason="'m'", allowed="px"),
        ),
        (
            "camera",
            "u,v,target,sigma\n0,0,0,1,1,m,0\n",
            dict(line=2, column="sigma", value="0", reason="not positive"),
        ),
        (
            "camera",
            "u,v,target,sigma\n0,0,0,1,1,m,1e-10\n",
            dict(
                line=2,
                column="sigma",
                value="1e-10",
                reason="too small",
                allowed="1e-09 px or more",
            ),
        ),
        (
            "camera",
            "u,v,target,sigma_u,sigma_v\n0,0,0,1,1,m,1,1001\n",
            dict(
                line=2,
                column="sigma_v",
                value="1001",
                reason="1001 px is too large",
                allowed="1000 px or less",
            ),
        ),
        (
            "camera",
            "u,v,target,sigma_u\n0,0,0,1,1,m,1\n",
            dict(line=1, column="sigma_v", reason="missing: sigma_v"),
        ),
        (
            "camera",
            "u,v,target,sigma [mm]\n0,0,0,1,1,m,1\n",
            dict(line=1, column="sigma", reason="'mm'", allowed="px"),
        ),
        (
            "plane-contact",
            "sigma_x,sigma_y,sigma_z\n0,0,0,1,1,1\n",
            dict(
                line=1,
                column="sigma_x",
                reason="one direction only",
                allowed="sigma, sigma_contact",
            ),
        ),
        (
            "sphere-contact",
            "sigma_contact [rad]\n0,0,0,1\n",
            dict(
                line=1, column="sigma_contact", reason="'rad'", allowed="m, mm, um, in"
            ),
        ),
        (
            "fixed-point",
            "target,sigma_x\n0,0,0,a,1\n0.1,0,0,a,1\n",
            dict(line=1, column="sigma_y", reason="missing: sigma_y, sigma_z"),
        ),
        (
            "plane-contact",
            "payload [kg]\n0,0,0,1\n",
            dict(line=1, column="payload", reason="takes no unit"),
        ),
        # Nothing but guesses.
        (
            None,
            "u\n0,0,0,1\n",
            dict(line=1, column="v", reason="model 'camera' needs the missing v"),
        ),
        (
            None,
            "u,v,x,y,z,target\n0,0,0,1,2,3,4,5,m\n",
            dict(
                line=1,
                reason=("both a position and pixels", "--model", "'model'"),
                allowed="camera",
            ),
        ),
    ],
)
def test_errors_of_models(bad, model, text, fields):
    bad(f"{J},{text}", model=model, **fields)


def test_sockets_count_over_all_files(write, chain, refused):
    files = [
        write(f"{J},target,set\n{row}\n", f"{name}.csv")
        for name, row in (("a", "0,0,0,s,train"), ("b", "0.1,0,0,s,validate"))
    ]
    assert len(read(files, chain, model="fixed-point")) == 2
    with refused(
        InputError, file=str(files[1]), line=2, reason="the socket 's' has one"
    ):
        read(files[1], chain, model="fixed-point")
    data = read(files[1], chain, model="fixed-point", sockets=["s"])
    assert len(data) == 1


def test_contacts_ignore_the_sigma_of_what_they_do_not_read(write, chain):
    notices: list[str] = []
    file = write(f"{J},x,sigma_x\n0,0,0,1,1\n")
    data = read(file, chain, model="plane-contact", notice=notices.append)
    assert data.sigma is None
    assert notices == [f"{file}: columns ignored: x, sigma_x"]


@pytest.mark.parametrize("name", ["u", "model", "payload", "sigma_contact"])
def test_joints_with_reserved_names(write, name, refused):
    chain = Chain(robot(URDF.replace('"lift"', f'"{name}"')), tip="c")
    file = write(f"{name},elbow,wrist,distance\n0,0,0,1\n")
    with refused(InputError, reason=f"'{name}' has a meaning of its own"):
        read(file, chain)
    file = write("rail,elbow,wrist,distance\n0.1,0,0,1\n")
    joints = {"rail": JointMap(name)}
    data = read(file, chain, joints=joints, notice=pytest.fail)
    assert data.q[0, 0] == 0.1
    file = write(f"{name},rail,elbow,wrist,distance\n,0.1,0,0,1\n")
    if name not in ("model", "payload"):
        notices: list[str] = []
        read(file, chain, joints=joints, notice=notices.append)
        assert notices == [f"{file}: columns ignored: {name}"]


# --- size ----------------------------------------------------------------


def test_many_rows(write, bad, chain):
    """Of a file that is read in several stretches every row stands where it stood."""
    rows = np.random.default_rng(3).uniform(0.0, 0.4, (4_000, 9))
    text = f"{J},x,y,z,rx,ry,rz\n"
    text += "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    data = read(write(text), chain)
    assert data.q.tobytes() == rows[:, :3].tobytes()
    assert data.values[:, :3].tobytes() == rows[:, 3:6].tobytes()
    assert data.lines.tolist() == list(range(2, 4_002))
    bad(text + "\n" + "0," * 8 + "x", line=4_002, column="rz", value="x")


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
    data = read(paths, chain, notice=notices.append)
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
    again = read(written, chain)
    assert again.q.tobytes() == data.q.tobytes()
    assert again.values.tobytes() == data.values.tobytes()


def test_real_configurations(refused):
    chain = real_chain("panda_description/urdf/panda.urdf", "panda_link8")
    file = DATA / "mukca_panda" / "panda_1.csv"
    assert read_configurations(file, chain).shape == (182, 7)
    with refused(InputError, line=1, reason="no measured columns"):
        read(file, chain)


@pytest.mark.parametrize(("number", "count"), [(1, 182), (2, 559)])
def test_real_sockets(tmp_path, number, count):
    chain = real_chain("panda_description/urdf/panda.urdf", "panda_link8")
    file = DATA / "mukca_panda" / f"panda_{number}.csv"
    notices: list[str] = []
    data = read(file, chain, model="fixed-point", notice=notices.append)
    assert len(data) == count
    assert notices == [f"{file}: columns ignored: tool_position"]
    written = tmp_path / "again.csv"
    write_measurements(written, data)
    assert same(data, read(written, chain, model="fixed-point"))


def test_progress_of_reading_and_writing(tmp_path):
    """It grows to all, in parts of thousands of lines, and changes no byte."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, (12_000, 1))
    rows = Measurements(("lift",), q, "plane-distance", rng.uniform(0.5, 2.0, q.shape))
    written: list[float] = []
    write_measurements(tmp_path / "a.csv", rows, progress=written.append)
    write_measurements(tmp_path / "b.csv", rows)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert written == sorted(written) and len(written) == 3
    assert written[0] >= 0.0 and written[-1] <= 1.0
    seen: list[float] = []
    read_table(tmp_path / "a.csv", seen.append)
    assert seen == sorted(seen) and len(seen) == 4 and seen[-1] == 1.0
