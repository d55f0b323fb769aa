"""Measurement files: what reads how, what is refused with which line."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.io.measurements import (
    read_configurations,
    read_held,
    read_measurements,
    write_measurements,
)
from calib_pin.io.not_measured import SUMMARY
from calib_pin.io.table import read_table
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.observations import BlockKey, Conditions, Measurements, Observations
from calib_pin.setup import JointMap, ReadingSetup
from tests.shared import refused

J = "lift,elbow,wrist"
STEPS = "lift,elbow [steps/4096],wrist,distance\n"
CHAINS = ("", "left_hand", "touch", "world")


def told(notices: list[str]) -> list[tuple[Path, str]]:
    """The file and the names that each notice is about."""
    parts = [notice.split(": ") for notice in notices]
    return [(Path(file), names) for file, *_, names in parts]


def read(*about, **options) -> Measurements:
    """The measurements of files of one block."""
    return read_measurements(*about, **options).only


@pytest.fixture(scope="module")
def chain(arm) -> Chain:
    return arm()


@pytest.fixture
def bad(write, chain):
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
    file = write(
        "target, z [um] ,wrist [deg],lift [mm],x[mm],y [ in ],elbow [mrad],"
        "sigma [mm],set\n"
        "ball,3000000,90,100,1000,2,500,0.1,train\n"
        ",-3e-1,-90,0,1,1,-500,0.2,validate\n"
    )
    data = read(file, chain)
    assert (data.model, data.joints) == ("position", ("lift", "elbow", "wrist"))
    half = np.pi / 2
    np.testing.assert_allclose(data.q, [[0.1, 0.5, half], [0, -0.5, -half]])
    np.testing.assert_allclose(data.values[0], [1.0, 0.0508, 3.0], rtol=1e-12)
    np.testing.assert_allclose(data.values[1], [0.001, 0.0254, -3e-7], rtol=1e-12)
    np.testing.assert_allclose(data.sigma, [[1e-4] * 3, [2e-4] * 3], rtol=1e-12)
    assert (data.target, data.payload) == (("ball", ""), ("", ""))
    assert data.validate.tolist() == [False, True]
    assert data.lines.tolist() == [2, 3] and data.files == (str(file), str(file))
    assert data.source(1) == f"{file}:3"


@pytest.mark.parametrize(
    ("unit", "steps", "turned"),
    [
        ("steps/4096", (0, 2048, 3072), (-1.0, 0.0, 0.5)),
        ("steps/1228.8@512", (204.8, 512, 1023.488), (-0.5, 0.0, 0.8325)),
        ("steps/1024@0", (-512, 0, 2048), (-1.0, 0.0, 4.0)),
    ],
)
def test_steps_of_a_servo(write, chain, unit, steps, turned):
    """A turn has so many; half of it is zero unless the unit says where zero is."""
    rows = "".join(f"0,{step},0,1\n" for step in steps)
    data = read(write(f"lift,elbow [{unit}],wrist,distance\n{rows}"), chain)
    np.testing.assert_allclose(data.q[:, 1], np.pi * np.array(turned), atol=1e-12)
    assert data.conditions.steps == {"elbow": float(unit[6:].split("@")[0])}


def test_points_of_a_sheet_have_no_height(write, chain):
    said = list[str]()
    file = write(f"{J},x [mm],y [mm]\n0,0,0,100,200\n,0,0,1,2\n")
    data = read(file, chain, notice=said.append)
    assert (data.model, data.values.tolist()) == ("position", [[0.1, 0.2, 0.0]])
    assert len(said) == 2 and "z = 0" in said[0] and "1 of 2" in said[1]


SIX = "x,y,z,rx,ry,rz,sigma_rz [mrad],sigma_x,sigma_y,sigma_z,sigma_rx [deg],sigma_ry"
SIGMAS = [0.1, 0.2, 0.3, np.pi / 45, 0.5, 0.006]


@pytest.mark.parametrize(
    ("names", "cells", "sigma"),
    [
        ("x,y,z,sigma,sigma_y [um]", "1,2,3,0.001,50", [1e-3, 5e-5, 1e-3]),
        (SIX, "1,2,3,0,0,0,6,0.1,0.2,0.3,4,0.5", SIGMAS),
    ],
)
def test_sigma_by_component(write, chain, names, cells, sigma):
    data = read(write(f"{J},{names}\n0,0,0,{cells}\n"), chain)
    np.testing.assert_allclose(data.sigma, [sigma])


MAP = {"J2": JointMap("elbow")}
MORE = "qx,qy,qz,qw,distance,sigma_distance,sigma_rx"
BLOCKS = "0,0,0,1,2,3,,a,b,c,position\n0,0,0,,,,1,d,e,f,plane-distance\n"


@pytest.mark.parametrize(
    ("names", "rows", "ignored", "options"),
    [
        ("gripper,a,distance,time [s]", "0,0,0,0,left,1,a\n" * 3, "a,time [s]", {}),
        ("J2,distance,payload", "0,1,0,2,1, p ", "elbow", {"joints": MAP}),
        (f"x,y,z,{MORE}", f"{'0,' * 9}1,4,0.1,0.1", MORE, {"model": "position"}),
        ("x,y,z,distance,qx,sigma_u,note,model", BLOCKS, "qx,sigma_u,note", {}),
        # A column without a name.
        (",distance", "0,0,0,,1", "column 4", {}),
    ],
)
def test_columns_without_a_meaning_are_reported_once(
    write, chain, names, rows, ignored, options
):
    notices, file = list[str](), write(f"{J},{names}\n{rows}")
    read_measurements(file, chain, notice=notices.append, **options)
    assert told(notices) == [(file, ignored.replace(",", ", "))]


# --- orientations ------------------------------------------------------------------

ANGLES = (np.pi, np.pi - 1e-9, 1e-9, 0.0, 1.0)
HARD = [pin.exp3(angle * axis) for angle in ANGLES for axis in np.eye(3)]
HARD += [pin.rpy.rpyToMatrix(0.3, pitch, -2.0) for pitch in (np.pi / 2, -np.pi / 2)]
"""Rotations that are hard to write down."""


@pytest.mark.parametrize(
    ("header", "write_down"),
    [
        ("qx,qy,qz,qw", lambda R: -1.009 * pin.Quaternion(R).coeffs()),
        ("rx [deg],ry [deg],rz [deg]", lambda R: np.rad2deg(pin.log3(R))),
        ("yaw [mrad],pitch,roll", lambda R: [1e3, 1, 1] * pin.rpy.matrixToRpy(R)[::-1]),
    ],
)
def test_orientations(write, chain, header, write_down):
    rows = [",".join(map(repr, np.asarray(write_down(R)).tolist())) for R in HARD]
    text = f"{J},x,y,z,{header}\n" + "".join(f"0,0,0,1,2,3,{row}\n" for row in rows)
    data = read(write(text), chain)
    assert data.model == "pose"
    quaternions = data.values[:, 3:]
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, rtol=1e-12)
    assert (quaternions[:, 3] >= 0).all()
    found = [pin.Quaternion(q).toRotationMatrix() for q in quaternions]
    np.testing.assert_allclose(found, HARD, atol=2e-8)
    # More than half a turn about x is less than half a turn about -x.
    data = read(write(f"{J},x,y,z,rx,ry,rz\n0,0,0,0,0,0,4,0,0"), chain)
    expected = [-np.sin(2), 0, 0, -np.cos(2)]
    np.testing.assert_allclose(data.values[0, 3:], expected, atol=1e-14)


# --- joint maps --------------------------------------------------------------------


def test_joint_maps(write, chain):
    """Joints may be exchanged, and other columns may hold anything."""
    joints = {"wrist": JointMap("elbow"), "elbow": JointMap("wrist", sign=-1)}
    file = write(f"x,{J},sigma,set,qx,note\nfar,0.1,0.2,0.3,-1,both,,é\n")
    assert read_configurations(file, chain, joints).tolist() == [[0.1, 0.3, -0.2]]


OFF, COUPLED = JointMap("elbow", offset=1.0), JointMap("elbow", coupled={"J1_": 1})
MAPS = [
    # A map, the columns, row, line and column of the error, and names that it is about.
    ({"J": JointMap("elbov")}, "J", "0", None, None, "'elbow'"),
    ({"J": JointMap("elbow"), "K": JointMap("elbow")}, "J,K", "0,0", None, None, "'K'"),
    ({"J22": JointMap("elbow")}, "lift,wrist,J2", "0,0,0", 1, "J22", "'J2'"),
    ({"J2": COUPLED}, "lift,wrist,J2,J1", "0,0,0,0", 1, "J1_", "'J1'"),
    ({"wrist": JointMap("elbow")}, "lift,wrist", "0,0", None, None, "'wrist'"),
    ({"x": JointMap("elbow")}, "lift", "0", None, None, "'x'"),
    ({"J2": JointMap("elbow")}, "lift,wrist,J2 [mm]", "0,0,0", 1, "J2", "'mm'"),
    ({"J2": OFF}, "lift,wrist,J2", "0,0,90", 2, "J2", ("91 rad", "'J2 [deg]'")),
]


@pytest.mark.parametrize(("joints", "header", "row", "line", "column", "name"), MAPS)
def test_joint_map_errors(bad, joints, header, row, line, column, name):
    where = {"line": line, "column": column} if line else {"file": None}
    bad(f"{header},distance\n{row},0\n", joints=joints, reason=name, **where)


# --- writing -----------------------------------------------------------------------

SIGMA = st.floats(1e-12, 1.0, exclude_min=True)
LETTERS = st.characters(blacklist_categories=("Cs",), blacklist_characters="\r\n\0")
# Words of our own source are drawn as well: that of a mean ends a file.
TEXT = st.text(LETTERS, max_size=8).map(str.strip)
TEXT = TEXT.filter(lambda name: not SUMMARY.fullmatch(name.strip(" :")))


# What a target has to be so that a row of the model can be read.
NAMED = TEXT.filter(lambda name: name.rpartition("@")[2] != "")
FREE = ("position", "pose", "plane-distance", "relative-distance")


@st.composite
def measurements(draw, key, chains):
    """Measurements of one block, which keep to what the reader checks."""
    model, n, stated = key.model, len(chains.joints), declared(key.model)
    count, width = draw(st.integers(1, 5)), len(stated.values)
    # Within the unit checks of the reader: 0 to 0.5 m, about a turn.
    q = draw(arrays(float, (count, n), elements=st.floats(-0.4, 0.4)))
    values = draw(arrays(float, (count, width), elements=st.floats(-2, 2)))
    if model == "pose":
        quaternion = draw(arrays(float, (count, 4), elements=st.floats(0.1, 1)))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        values[:, 3:] = quaternion * [-1, 1, -1, 1]
    sizes = st.floats(1e-8, 1e3) if model == "camera" else SIGMA
    shape = (count, len(stated.components))
    sigma = draw(st.none() | arrays(float, shape, elements=sizes))
    names = TEXT if model in FREE and key.chain != "world" else NAMED
    target = draw(st.lists(names, min_size=count, max_size=count))
    payload = draw(st.lists(TEXT, min_size=count, max_size=count))
    start = np.zeros((0, 0))
    if model == "relative-distance":
        values = np.abs(values) + 1e-6
        first = [target.index(name) for name in target]
        payload = [payload[k] for k in first]
        begins = [0.45, *draw(arrays(float, n - 1, elements=st.floats(-0.4, 0.4)))]
        start = chains.follow(np.array([begins] * count) - 0.01 * np.c_[first])
    return Measurements(
        joints=chains.joints,
        q=chains.follow(q),
        values=values,
        sigma=sigma,
        target=target,
        conditions=Conditions(payload),
        start=start,
        validate=draw(arrays(bool, count)),
        **key._asdict(),
    )


@st.composite
def mixtures(draw, tree):
    """Measurements of several blocks, in any order within a file."""
    # Of a model and a chain either all measurements name a station, or none.
    every = st.sampled_from(list(MEASUREMENT_MODELS))
    models = draw(st.lists(every, min_size=1, max_size=4, unique=True))
    places = st.sampled_from([("", ""), ("", "probe"), ("day 1", ""), ("2", "1")])
    keys = {}
    for model in models:
        for chain in draw(st.sets(st.sampled_from(CHAINS), min_size=1, max_size=2)):
            station, tool = draw(places)
            if (model, chain) != ("relative-distance", "world"):
                keys[BlockKey(model, chain, station, tool)] = None
    keys = keys or {BlockKey("pose"): None}
    chains = tree.named(tuple({key.chain for key in keys}))
    blocks = [draw(measurements(key, chains)) for key in keys]
    order = draw(st.permutations(range(sum(map(len, blocks)))))
    lines = np.split(np.array(order), np.cumsum([len(b) for b in blocks])[:-1])
    blocks = [
        replace(block, lines=np.sort(own) + 1, files=["m.csv"] * len(block))
        for block, own in zip(blocks, lines, strict=True)
    ]
    return Observations(tuple(sorted(blocks, key=lambda block: block.lines[0])))


def bits(array):
    return None if array is None else (array.shape, array.tobytes())


def same(data, again):
    """Whether measurements are the same, bit by bit."""
    blocks = (Observations.of(part).blocks for part in (data, again))
    for one, other in zip(*blocks, strict=True):
        for name in ("q", "values", "sigma", "start", "validate"):
            assert bits(getattr(one, name)) == bits(getattr(other, name)), name
        assert (other.key, other.joints) == (one.key, one.joints)
        assert (other.target, other.payload) == (one.target, one.payload)
    return True


@settings(max_examples=8, derandomize=True, suppress_health_check=list(HealthCheck))
@given(drawn=st.data(), comments=st.lists(TEXT, max_size=3))
def test_written_files_read_back_bit_by_bit(tmp_path, tree, drawn, comments):
    data, file = drawn.draw(mixtures(tree)), tmp_path / "written.csv"
    # One number three times, and once more, is a sign that nothing was seen.
    points = [row[:3].tolist() for b in data.blocks for row in b.values]
    assume(all(len({*p}) > 1 or points.count(p) == 1 for p in points))
    write_measurements(file, data, comments, force=True)
    # Of all sockets, so that one row is enough for each.
    sockets = {name.rpartition("@")[2] for name in data.target}
    options = {"notice": pytest.fail, "sockets": sockets}
    if len(data.models) == 1:
        (options["model"],) = data.models
    again = read_measurements(file, tree, **options)
    assert same(data, again)
    first = file.read_bytes()
    write_measurements(file, again, comments, force=True)
    assert file.read_bytes() == first
    assert b"\r" not in first


def test_what_is_written(tmp_path, chain):
    file, q = tmp_path / "out.csv", np.array([[0.1, -0.0, 1e-7], [0.25, 2.0, 3.0]])
    about = {"values": q[:, :1], "sigma": np.array(1e-4), "target": ("ball", 'a, "b"')}
    data = Measurements(
        chain.joints, q, "plane-distance", validate=np.array([False, True]), **about
    )
    write_measurements(file, data, ["made by a test", "", "two\nlines"])
    assert file.read_text(encoding="utf-8") == (
        "# made by a test\n#\n# two\n# lines\n"
        "lift,elbow,wrist,distance,sigma_distance,target,set\n"
        "0.1,-0.0,1e-7,0.1,0.0001,ball,train\n"
        '0.25,2.0,3.0,0.25,0.0001,"a, ""b""",validate\n'
    )
    assert same(data, read(file, chain))
    with refused(OptionError, file=str(file)):
        write_measurements(file, data)


@pytest.mark.parametrize("name", ["station", "tool", "chain", "payload", "target"])
@pytest.mark.parametrize("text", [" p", "a\nb", "a\0b"])
def test_names_that_would_not_read_back(tmp_path, name, text):
    own = {"conditions": Conditions((text,))} if name == "payload" else {name: text}
    own = {name: (text,)} if name == "target" else own
    data = Measurements(("j",), np.zeros((1, 1)), "plane-distance", np.ones((1, 1)))
    told = f"{name} {text!r} would"
    with pytest.raises(OutputError, match=re.escape(told)):
        write_measurements(tmp_path / "out.csv", replace(data, **own))
    for joint in ("x", " j"):
        with pytest.raises(OutputError, match=f"'{joint}'"):
            write_measurements(tmp_path / "out.csv", replace(data, joints=(joint,)))
    assert not list(tmp_path.iterdir())


# --- files that are refused ------------------------------------------------------

R = f"{J},distance\n0,0,0,1\n"
QUATERNION = f"{J},x,y,z,qx,qy,qz,qw\n0,0,0,1,2,3,0,0,0,1\n0,0,0,1,2,3,"
VECTOR = f"{J},x,y,z,rx,ry,rz"

# A file, then line, column and value of the error, and what else tells it from others.
REFUSED = [
    # Not such a file at all.
    (f"# c\n{J},distance\n# c\n", None, None, None),
    # Rows that do not fit.
    (f"{R}\n0,0,0\n", 4, None, None, "3 cells for 4"),
    (f"{J},distance\n0,0,0,0,0,0,1,5\n", 2, None, None, "decimal"),
    # Cells that are not numbers.
    *(
        (f"{R}# c\n0,{cell},0,1\n", 4, "elbow", cell.strip())
        for cell in ("abc", "1e999", "1_0")
    ),
    (f'{R}0.5,"1,5",0,1\n', 3, "elbow", "1,5", "decimal"),
    # Columns that are missing, doubled or have a wrong unit.
    ("lift,elbow_joint,wrist,distance\n0,0,0,1\n", 1, "elbow", None, "'elbow_joint'"),
    (f"{J},x,x [mm],y,z\n0,0,0,0,1,0,0\n", 1, "x", None, "'x [mm]'"),
    (f"{J},x,y,z,qx [m],qy,qz,qw\n0,0,0,0,0,0,0,0,0,1", 1, "qx", None),
    (f"{STEPS}0,9,0,1\n0,4097,0,1\n", 3, "elbow", "4097", "turn"),
    ("lift,elbow,wrist,distance\n0,2917,9,1\n", 2, "elbow", "2917", "[steps/4096]"),
    ("lift,elbow,wrist,distance\n0,-99.9,9,1\n", 2, "elbow", "-99.9", "[steps/N@0]"),
    ("lift,elbow,wrist,distance\n0,700,9,1\n", 2, "elbow", "700", "[steps/1228.8@5"),
    (f"{J},distance,target [m]\n0,0,0,1,1\n", 1, "target", None),
    # Which model?
    (f"{J},note\n0,0,0,a\n", 1, None, None, "x, y, z"),
    (f"{J},x,y,z,distance\n0,0,0,1,2,3,4\n", 1, None, None, "--model"),
    (f"{J},u\n0,0,0,1\n", 1, "v", None, "'camera'"),
    (f"{J},x,y,z,qx,qy,qz\n0,0,0,1,2,3,0,0,0\n", 1, "qw", None),
    (f"{VECTOR},yaw\n0,0,0,1,2,3,0,0,0,0\n", 1, "yaw", None, "rz and yaw"),
    # Quaternions.
    *(
        (f"{QUATERNION}{cells}\n", 3, "qw", cells.split(",")[-1], "norm")
        for cells in ("0,0,0,0.1", "0,0,0,1.011", "0,0,0,-0.989")
    ),
    # Sigmas.
    *(
        (f"{J},distance,sigma\n0,0,0,1,1\n0,0,0,1,{cell}\n", 3, "sigma", cell)
        for cell in ("0", "-0.1", "inf", "", "small")
    ),
    (f"{J},x,y,z,sigma_x,sigma_z\n0,0,0,1,2,3,1,1\n", 1, "sigma_y", None),
    (f"{VECTOR},sigma\n0,0,0,1,2,3,0,0,0,1\n", 1, "sigma", None),
    (f"{J},distance,elbow.direction\n0,0,0,1,up\n", 2, "elbow.direction", "up"),
    # Sets.
    (f"{J},distance,set\n0,0,0,1,train\n0,0,0,1,test\n", 3, "set", "test"),
    # Angles in degrees; within four half turns, but neither in the limits nor near.
    (f"{R}0,-9,0,1\n", 3, "elbow", "-9", "'elbow [deg]'"),
    # Lengths in millimeters.
    (f"{J},distance\n1,0,0,1\n27,0,0,1\n", 3, "lift", "27", "gear: 0.0174532925"),
    (f"{J},x,y,z\n0,0,0,1,1,2\n0,0,0,1,2,2\n0,0,0,1,30,2\n", 4, "y", "30", "'y [mm]'"),
]
REFUSED = [(None, *case) for case in REFUSED]

FAR = "plane-distance\n0,0,0,"
BOTH = "distance,target,model\n0,0,0,"

# The same after the model that is asked for, without the columns of the joints.
REFUSED_BY_MODEL = [
    ("pose", "x,y,z\n0,0,0,1,2,3\n", 1, None, None, "'pose'"),
    # What rows have to name.
    ("fixed-point", "n\n0,0,0,1\n", 2, "target", None, "socket"),
    ("camera", "u,v,target\n0,0,0,1,2,m\n0,0,0,1,2,\n", 3, "target", None),
    ("point-distance", "distance,target\n0,0,0,1,\n0,0,0,1,a\n", 2, "target", None),
    # A ball that is in a socket once tells nothing.
    ("fixed-point", "target\n0,0,0,a\n0,0,0,b\n0.1,0,0,a\n", 3, "target", None, "'b'"),
    ("fixed-point", "target\n0,0,0,x@a\n1e-9,0,0,y@a\n", 2, "target", None, "'a'"),
    # Numbers that cannot be.
    ("camera", "u,v,target\n0,0,0,1,-2e5,m\n", 2, "v", "-200000"),
    ("camera", "u,v,target,sigma\n0,0,0,1,1,m,1e-10\n", 2, "sigma", "1e-10"),
    # Gauges.
    ("plane-contact", "dial\n0,0,0,0.5\n", 2, "dial", "0.5", "mm"),
    ("plane-contact", "dial,deviation\n0,0,0,0,0\n", 1, "dial", None, "once"),
    ("sphere-contact", "Messuhr [mm]\n0,0,0,1\n", 1, "Messuhr", None, "dial: "),
    # Relative distances: starts that are none.
    *(
        ("relative-distance", f"distance,target,payload\n{rows}", *about)
        for rows, *about in (
            ("0,0,0,0.5,a,\n0.1,0,0,1,a,\n", 2, "distance", "0.5"),
            ("0,0,0,0,a,\n0.1,0,0,1,a,\n0,0,0,0,b,\n", 4, "target", "b"),
            ("0,0,0,0,a,\n0.1,0,0,1,a,\n0.2,0,0,0.0,a,\n", 4, "distance", "0"),
            ("0,0,0,0,a,\n0.1,0,0,-1,a,\n", 3, "distance", "-1"),
            ("0,0,0.5,0,a,\n0.1,0,0,1,a,\n0,0,0.5,1e-6,a,\n", 4, "distance", "1e-06"),
            ("0,0,0,0,a,\n0.1,0,0,1,a,\n0.2,0,0,1,a,p\n", 4, "payload", "p"),
            ("0,0,0,,a,\n0.1,0,0,1,a,\n", 3, "distance", "1"),
        )
    ),
    # Several models in a file.
    (None, "distance,model\n0,0,0,1,posee\n", 2, "model", "posee", "'pose'"),
    (None, f"x,y,z,{BOTH},,,1,,{FAR}1,2,3,4,,position", 3, "distance", "4"),
    (None, f"u,v,{BOTH},,,,{FAR}1,,,m,camera", 2, "distance", ""),
]
REFUSED_BY_MODEL = [(m, f"{J},{text}", *rest) for m, text, *rest in REFUSED_BY_MODEL]


@pytest.mark.parametrize("missing", ["", " ", "nan", "N/A", "MISSING", "*"])
@pytest.mark.parametrize("column", [0, 1, 3])
def test_measurements_without_a_reading_are_left_out(write, chain, missing, column):
    def text(cell):
        rows = [["0", f"0.{k}", "0", f"{k}"] for k in (1, 2, 3)]
        rows[1][column] = cell
        return "\n".join([f"{J},distance", *map(",".join, rows)])

    file, notices = write(text(missing)), list[str]()
    data = read(file, chain, notice=notices.append)
    assert data.values[:, 0].tolist() == [1.0, 3.0] and data.lines.tolist() == [2, 4]
    assert len(notices) == 1 and "1 of 3" in notices[0] and "line 3" in notices[0]
    # Lines that hold no number at all have to be named.
    file, other = write(text("abc")), write(f"{J},distance\n0,0,0,1\n", "n.csv")
    assert len(read(file, chain, reading=ReadingSetup(without=("3",)))) == 2
    without = ReadingSetup(without=(f"{file.name}:3",))
    assert len(read([file, other], chain, reading=without)) == 3


@pytest.mark.parametrize("turned", ["rx,ry,rz", "roll,pitch,yaw", "qx,qy,qz,qw"])
def test_an_orientation_that_never_moves_is_none(write, chain, turned):
    zeros = ",".join(["0"] * turned.count(","))
    rows = [f"0,{k / 10},0,{k},0,{k},{zeros},1" for k in range(5)]
    file, notices = write("\n".join([f"{J},x,y,z,{turned}", *rows])), list[str]()
    assert read(file, chain, notice=notices.append).model == "position"
    assert turned.split(",")[0] in notices[0]
    assert read(file, chain, model="pose").model == "pose"
    file = write("\n".join([f"{J},x,y,z,{turned}", *rows, rows[3][:-1] + "0.9999"]))
    assert read(file, chain).model == "pose"


@pytest.mark.parametrize("sign", ["-9999", "9E9", "1e30"])
def test_a_number_for_no_reading_is_told(write, chain, sign):
    rows = [f"0,{k / 10},0,{k}0,0,{k}" for k in range(1, 9)]
    rows[2] = rows[5] = f"0,0.3,0,{sign},0,1"
    file = write("\n".join([f"{J},x [mm],y [mm],z [mm]", *rows]))
    told = list[str]()
    assert len(read(file, chain, notice=told.append)) == 6
    assert f"line 4: '{repr(float(sign)).removesuffix('.0')}' in 'x'" in told[0]


@pytest.mark.parametrize("case", REFUSED + REFUSED_BY_MODEL)
def test_errors(bad, case):
    model, text, line, column, value, *words = case
    bad(text, model=model, line=line, column=column, value=value, reason=words)


@pytest.mark.parametrize(
    ("text", "joints"),
    [
        # A bit over the limits, several turns, a motor's angle before its gear.
        (f"{J},distance\n0.6,3.1,0,1\n", {}),
        (f"{J},distance\n0,8,12.5,-99\n", {}),
        ("lift,m,wrist,distance\n0,200,0,1\n", {"m": JointMap("elbow", gear=0.01)}),
        # A robot that moves within its reach, far from the tracker.
        (f"{J},x,y,z\n0,0,0,80,90,2\n0,0,0,81,91,2\n", {}),
    ],
)
def test_plausible_values_pass(write, chain, text, joints):
    read(write(text), chain, joints=joints)


def test_limits_of_many_turns_are_believed(write, arm):
    file = write("lift,elbow,wrist,distance\n0,59,0,1\n")
    assert read(file, arm(limits="-60 60")).q[0, 1] == 59.0


@pytest.mark.parametrize("model", ["position+camra", "position+", "camera+camera"])
def test_model_names(write, chain, model):
    with refused(OptionError, "'camera'" if "camra" in model else ()):
        read(write("lift\n0\n"), chain, model=model)


def test_files_that_are_not_there(write, chain, tmp_path):
    distance = write(f"{J},distance\n0,0,0,1\n", "d.csv")
    with refused(InputError, file=None):
        read([], chain)
    with refused(InputError, file=str(tmp_path / "none.csv")):
        read([distance, tmp_path / "none.csv"], chain)


# --- models without a tracker ------------------------------------------------------


AWAY, PUSHED = "deviation,sigma_deviation", "dial [mm],sigma_contact"
ALL, SEEN = "target,dial_z,deviation_x,dial_y", "0.02 0.03 -0.01|0 -0.04 0"


@pytest.mark.parametrize(
    ("model", "text", "values", "sigma"),
    [
        ("camera", "v,u [px],target,sigma|2,10,m,0.5|-1,1e5,n,1", "10 2|1e5 -1", 0.5),
        ("plane-contact", "target,sigma [um]|tip@table,5|table,10", "|", 5e-6),
        # Away from the surface, and pushed in.
        ("plane-contact", f"{AWAY}|0.01,0.1|-0.02,0.2", "0.01|-0.02", 0.1),
        ("sphere-contact", f"{PUSHED}|10,0.1|-20,0.2", "-0.01|0.02", 0.1),
        # Nobody has read it.
        ("sphere-contact", "dial|-|", "|", None),
        ("fixed-point", f"{ALL}|a,0.01,0.02,-0.03|a,0,0,0.04", SEEN, None),
    ],
)
def test_columns_of_models(write, chain, model, text, values, sigma):
    """The second sigma is twice the first."""
    values = [[float(number) for number in row.split()] for row in values.split("|")]
    header, *rows = text.split("|")
    rows = [f"0,0,0,{rows[0]}", f"0.1,0.2,0.3,{rows[1]}"]
    data = read(write("\n".join([f"{J},{header}", *rows])), chain, model=model)
    named = "target" in header
    where = header.split(",").index("target") if named else 0
    assert data.target == tuple(r.split(",")[3 + where] if named else "" for r in rows)
    assert (data.model, data.values.tolist()) == (model, values)
    assert (data.sigma is None) == (sigma is None)
    if sigma is not None:
        expected = np.outer([sigma, 2 * sigma], np.ones(data.sigma.shape[1]))
        np.testing.assert_allclose(data.sigma, expected, rtol=1e-12)


# --- conditions --------------------------------------------------------------------


def test_conditions_are_read_and_written(write, tmp_path, chain):
    text = f"{J},distance,time [min],temperature,elbow.direction\n0,0,0,1,0,20.5,1\n"
    file = write(text + "0.1,0.2,0,1,2,21,-1\n0,0.2,0,1,1,22,\n")
    data, again = read(file, chain, notice=pytest.fail), tmp_path / "again.csv"
    held = data.conditions
    assert held.time.tolist() == [0, 120, 60]
    assert held.temperature.tolist() == [20.5, 21, 22]
    # What is not stated is by time: the last line was measured second.
    assert held.direction.tolist() == [[0, 1, 0], [1, -1, 0], [0, 0, 0]]
    assert held.source == "time"
    write_measurements(again, data)
    assert again.read_text().splitlines()[0].endswith("distance,temperature,time")
    assert read(again, chain).conditions.time.tobytes() == held.time.tobytes()
    stated = read_held(read_table(file), chain.joints, data.q)
    assert stated.direction[:, 1].tolist() == [1, -1, 0]


def test_stated_directions_are_written(write, tmp_path, chain):
    ends = ",".join(f"{joint}.direction" for joint in chain.joints)
    file, again = write(f"{J},distance,{ends}\n0,0,0,1,1,-1,1\n"), tmp_path / "a.csv"
    write_measurements(again, read(file, chain, notice=pytest.fail))
    held = read(again, chain).conditions
    assert (held.direction.tolist(), held.source) == ([[1, -1, 1]], "columns")


def test_a_date_is_no_time(write, chain):
    notices, rows = list[str](), "0,0,0,1,2026-11-24,20\n0.1,0,0,1,2026-11-25,\n"
    file = write(f"{J},distance,time,temperature\n{rows}")
    held = read(file, chain, notice=notices.append).conditions
    assert (held.time.size, held.temperature.size, held.source) == (0, 0, "order")
    assert notices == [f"{file}: columns ignored: time, temperature"]


# --- relative distances ------------------------------------------------------------


def test_relative_distances_start_at_the_first_row_of_a_target(write, chain):
    file = write(
        "lift [mm],elbow,wrist,distance [mm],target,sigma [mm],set,payload\n"
        "100,0,0,0,a,,,p\n"
        "200,0,0,100,a,1,train,p\n"
        "0,1,0,0,ball@2,far,neither,\n"
        "300,0,0,200,a,2,validate,p\n"
        "0,1,1,20,ball@2,3,train,\n"
    )
    data = read(file, chain, model="relative-distance", notice=pytest.fail)
    assert data.values.tolist() == [[0.1], [0.2], [0.02]]
    assert data.q[:, 0].tolist() == [0.2, 0.3, 0.0]
    assert data.start.tolist() == [[0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 1.0, 0.0]]
    np.testing.assert_allclose(data.sigma, [[1e-3], [2e-3], [3e-3]])
    assert data.target == ("a", "a", "ball@2")
    assert data.payload == ("p", "p", "")
    assert data.validate.tolist() == [False, True, False]
    assert data.lines.tolist() == [3, 5, 6]
    # Without targets all start at the first row of their file.
    file = write(f"{J},distance\n0,0,0,0\n0.1,0,0,0.1\n0.2,0,0,0.2\n")
    again = write(f"{J},distance\n0.4,0,0,0\n0.3,0,0,0.1\n", "n.csv")
    data = read([file, again], chain, model="relative-distance")
    assert data.start[:, 0].tolist() == [0.0, 0.0, 0.4]


def relative(**changes):
    fields = {
        "joints": ("lift", "elbow", "wrist"),
        "q": np.array([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]]),
        "model": "relative-distance",
        "values": np.array([[0.1], [0.2], [0.3]]),
        "start": np.zeros((3, 3)),
    }
    return Measurements(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "row"),
    [
        ({"start": np.zeros((0, 0))}, 0),
        ({"values": np.array([[1.0], [0.0], [1.0]])}, 1),
        ({"q": np.eye(3) - np.eye(3)[1]}, 1),
        ({"start": 0.01 * np.arange(3)[:, None] + np.zeros(3)}, 1),
    ],
)
def test_relative_distances_that_would_not_read_back(tmp_path, changes, row):
    with pytest.raises(OutputError, match=f"row {row}"):
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


def test_a_file_of_several_models(tmp_path, write, chain):
    source, file = write(MIXED), tmp_path / "out.csv"
    data = read_measurements(source, chain, notice=pytest.fail)
    assert data.models == ("camera", "position", "relative-distance")
    camera, position, distance = data.blocks
    assert data.target == ("m1", "m2", "", "a")
    assert data.lines.tolist() == [2, 4, 3, 6]
    assert data.q[:, 0].tolist() == [0.0, 0.2, 0.1, 0.4]
    values = [block.values.tolist() for block in data.blocks]
    assert values == [[[1, 2], [3, 4]], [[1, 2, 3]], [[0.1]]]
    # Blocks state their standard deviations or leave them open, each for itself.
    assert (camera.sigma, position.sigma) == (None, None)
    assert distance.sigma.tolist() == [[0.001]]
    assert data.payload == ("p", "", "", "")
    assert (camera.start.size, distance.start.tolist()) == (0, [[0.3, 0, 0]])
    assert data.files == (str(source),) * 4
    # Written in the order of the file that was read.
    write_measurements(file, data)
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


def test_several_files_of_different_models(write, chain):
    header = "# c\ndistance [mm],wrist,elbow,lift,target"
    distance = write(f"{header}\n1000,3,2,0.1,wall\n2000,0,0,0,\n", "d.csv")
    position = write(f"{J},x,y,z,sigma\n0,0,0,1,2,3,0.1\n", "p.csv")
    mixed = write(MIXED, "m.csv")
    data = read_measurements([distance, position], chain)
    assert [block.values.tolist() for block in data.blocks] == [[[1], [2]], [[1, 2, 3]]]
    assert (data.target, data.lines.tolist()) == (("wall", "", ""), [3, 4, 2])
    assert data.files == (str(distance), str(distance), str(position))
    assert data.q[0].tolist() == [0.1, 2.0, 3.0]
    # The column wins over what is asked for.
    data = read_measurements([distance, mixed], chain, model="plane-distance")
    assert data.models == ("plane-distance", "camera", "position", "relative-distance")
    # All rows of a model stand together.
    plain = write(f"{J},x,y,z\n0,0,0,1,2,3\n", "q.csv")
    data = read_measurements([mixed, plain], chain)
    assert list(map(len, data.blocks)) == [2, 2, 1]
    assert data.lines.tolist() == [2, 4, 3, 2, 6]
    with refused(InputError, file=str(position), line=None):
        read_measurements([mixed, position], chain)


def test_each_file_is_the_one_model_that_its_columns_allow(write, chain):
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
    for file, model, names in (
        (position, "camera+plane-distance", "u, v"),
        (position, "pose+fixed-point", "x, y, z"),
        (touched, "fixed-point+camera", "target"),
        (touched, "plane-contact+sphere-contact", "sphere-contact"),
        (sockets, "fixed-point+plane-contact", "'model'"),
    ):
        with refused(InputError, names, file=str(file), line=1):
            read(file, chain, model=model)


# --- what rows have to name --------------------------------------------------------


def test_sockets_count_over_all_files(write, chain):
    files = [
        write(f"{J},target,set\n{row}\n", f"{name}.csv")
        for name, row in (("a", "0,0,0,s,train"), ("b", "0.1,0,0,s,validate"))
    ]
    assert len(read(files, chain, model="fixed-point")) == 2
    with refused(InputError, file=str(files[1]), line=2, reason="'s'"):
        read(files[1], chain, model="fixed-point")
    data = read(files[1], chain, model="fixed-point", sockets=["s"])
    assert len(data) == 1


def test_touches_beside_readings_are_exact(write, chain, tmp_path):
    """A row without a reading is left out, a file without any holds touches."""
    read_off = write(f"{J},dial [mm]\n0,0,0,1\n0.1,0,0,\n0.2,0,0,2\n", "a.csv")
    touched = write(f"{J}\n0.3,0,0\n", "b.csv")
    data = read([touched, read_off], chain, model="plane-contact")
    np.testing.assert_allclose(data.values[:, 0], [0.0, -1e-3, -2e-3])
    write_measurements(tmp_path / "out.csv", data)
    assert same(data, read(tmp_path / "out.csv", chain, model="plane-contact"))
    counted = write(f"{J},reading\n0,0,0,1\n0.1,0,0,2\n", "c.csv")
    assert read(counted, chain, model="plane-contact").values.shape == (2, 0)


@pytest.mark.parametrize("name", ["x", "u", "model", "payload", "sigma_contact"])
def test_joints_with_reserved_names(write, name, arm):
    chain = arm(name)
    file = write(f"{name},elbow,wrist,distance\n0,0,0,1\n")
    with refused(InputError, reason=f"'{name}'"):
        read(file, chain)
    file = write("rail,elbow,wrist,distance\n0.1,0,0,1\n")
    joints = {"rail": JointMap(name)}
    data = read(file, chain, joints=joints, notice=pytest.fail)
    assert data.q[0, 0] == 0.1


# --- real files --------------------------------------------------------------------


TOOL = "tool_position"


@pytest.mark.parametrize(
    ("name", "tip", "folder", "model", "counts", "ignored"),
    [
        ("ur10_robot", "tool0", "ur10_tmac", None, (500, 2000), "temperature_C"),
        ("tiago_no_hand", "wrist_ft_tool_link", "tiago", None, (37, 62), ""),
        ("talos_reduced", "arm_left_7_link", "talos_left_arm", None, (61,), "time_s"),
        ("panda", "panda_link8", "mukca_panda", "fixed-point", (182, 559), TOOL),
    ],
)
def test_real_files(tmp_path, data_folder, name, tip, folder, model, counts, ignored):
    chain, again = load_chain(f"example:{name}", tip=tip), tmp_path / "again.csv"
    names = ("train", "validate", "measurements", "panda_1", "panda_2")
    files = sorted(p for p in (data_folder / folder).glob("*.csv") if p.stem in names)
    notices = list[str]()
    data = read(files, chain, notice=notices.append, model=model)
    assert [data.files.count(str(file)) for file in files] == list(counts)
    assert told(notices) == [(file, ignored) for file in files if ignored]
    # Millimeters became meters: no target is farther than a room.
    assert np.abs(data.values[:, :3]).max(initial=0.0) < 3.0
    write_measurements(again, data)
    assert same(data, read(again, chain, model=model))
    assert read_configurations(files[0], chain).shape == (counts[0], len(chain.joints))
