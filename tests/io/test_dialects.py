"""Foreign layouts: recognized by their columns, and read with our names and units."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.layouts import WRITERS, Job, job
from calib_pin.errors import InputError
from calib_pin.io.columns import ANGLE, LENGTH, Column
from calib_pin.io.dialects import DIALECTS, Dialect, Reading
from calib_pin.io.foreign_headers import foreign, measured, with_our_names
from calib_pin.io.measured_columns import TIME, read_quaternions
from calib_pin.io.table import read_table
from calib_pin.kinematics.spatial import from_quaternion, so3_exp, to_quaternion
from calib_pin.plugins import register
from tests.shared import refused


def test_whole_seconds_and_the_rest(table):
    """Beside an index: dialects follow one another."""
    found = table(",header.secs,header.nsecs,x\n0,5,500000000,1\n1,6,0,2\n")
    assert found.numbers("time", TIME).tolist() == [5.5, 6.0]
    assert "column 1" not in found and len(found.remarks[0].split("; ")) == 2
    assert "times" in table("sec,usec,x\n1,2,3\n").remarks[0]
    assert not table("time,sec,usec,x\n0,1,2,3\n").remarks


def poses() -> np.ndarray:
    """Three poses, whose positions are the numbers from 1 to 9."""
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3] = so3_exp(np.random.default_rng(0).normal(size=(3, 3)))
    T[:, :3, 3] = np.arange(1.0, 10.0).reshape(3, 3)
    return T


def lines(names: list[str], cells: np.ndarray) -> str:
    rows = (",".join(map(repr, row)) for row in cells.reshape(3, -1).tolist())
    return "\n".join([",".join(names), *rows])


NAMES = [
    *([f"T{i + k}{j + k}" for i in range(4) for j in range(4)] for k in (0, 1)),
    *([f"T[{k}]" for k in range(count)] for count in (12, 16)),
]


@pytest.mark.parametrize(
    ("names", "by_columns"),
    [*((names, False) for names in NAMES), *((names, True) for names in NAMES[2:])],
)
def test_matrices_are_orientations(table, names, by_columns):
    """With a fourth column they are poses; what is not orthonormal is no matrix.

    Of elements that have one number each, as Franka's O_T_EE, the order is looked for.
    """
    T = poses()
    cells = T[:, : len(names) // 4]
    cells = np.swapaxes(cells, 1, 2) if by_columns else cells
    found, expected = table(lines(names, cells)), to_quaternion(T[:, :3, :3])
    assert np.allclose(read_quaternions(found, "quaternion"), expected, atol=1e-12)
    for axis, column in zip("xyz", T[:, :3, 3].T, strict=True):
        assert found.columns[axis].numbers.tolist() == column.tolist()
    assert "qx" not in table(lines(names, 2.0 * cells)).columns


def test_several_matrices_keep_their_names(table):
    """Nine numbers are a rotation by rows; a position is that of its matrix."""
    T = poses()
    R = T[:, :3, :3]
    names = [*(f"a[{k}]" for k in range(16)), *(f"b_{k}" for k in range(9))]
    cells = np.hstack([T.reshape(3, 16), R.swapaxes(1, 2).reshape(3, 9)])
    found = table(lines(names, cells)).columns
    assert found["a_y"].numbers.tolist() == [2.0, 5.0, 8.0]
    for name, turn in (("a", R), ("b", R.swapaxes(1, 2))):
        q = np.column_stack([found[f"{name}_q{axis}"].numbers for axis in "xyzw"])
        assert np.allclose(from_quaternion(q), turn, atol=1e-12)


def test_a_trajectory_of_tum(table):
    """Without a header; other rows of eight numbers are none."""
    text = "# time stamps\n1.5 1 2 3 0 0 0 1\n1.75 4 5 6 0.6 0 0 0.8\n"
    found = table(text)
    assert found.numbers("y", LENGTH).tolist() == [2.0, 5.0]
    assert found.columns["qw"].numbers.tolist() == [1.0, 0.8]
    assert "TUM" in found.remarks[0]
    with pytest.raises(InputError, match="header"):
        table(text.replace("0.8", "0.7"))


@pytest.mark.parametrize("cell", ['"[-1.5, 2e0]"', "(-1.5 2.0)", '"{A1 -1.5, A2 2}"'])
def test_lists_in_cells_are_not_read_and_told(table, cell):
    found = table(f"c [mm],d\n{cell},1\n,2\n")
    assert "lists in c are not read" in found.remarks[0]
    assert not table("c,d\nP (2),1\n[1],2\n").remarks


def test_columns_that_the_setup_names_are_as_it_says(table):
    text = "Tx,Ty,Tz,Q0,Qx,Qy,Qz\n1,2,3,1,0,0,0\n"
    assert table(text).numbers("x", LENGTH).tolist() == [1e-3]
    found = table(text, {"x": "Tx [m]"})
    assert found.numbers("x", LENGTH).tolist() == [1.0] and not found.remarks


ROBOTS = {
    "franka": ("example:panda", "panda_link8"),
    "lerobot": ("example:so101", "gripper_frame_link"),
    "lerobot_normalized": ("example:so101", "gripper_frame_link"),
}
"""Robots of layouts that are not those of any; elsewhere a UR5."""

READINGS = {
    "points": ("points.txt", ["Ball"], "", False),
    "motive": ("motive.csv", ["Ball"], "tool", True),
    "motive_euler": ("motive.csv", ["Ball"], "tool", True),
    "motive_bodies": ("motive.csv", ["Ball", "Nest"], "tool", True),
    "motive_markers": ("motive.csv", ["Ball", "Nest"], "target", False),
    "vicon": ("vicon.csv", ["Ball", "Nest"], "target", False),
    "vicon_objects": ("vicon.csv", ["Ball"], "tool", True),
    "ndi": ("ndi.csv", ["Ball", "Nest"], "tool", True),
    "ndi_tools": ("ndi.csv", ["Ball", "Nest"], "tool", True),
}
"""Layouts of instruments: file, points, the column of their names, and whether they
state orientations."""


@cache
def job_of(layout: str) -> Job:
    return job(*ROBOTS.get(layout, ("example:ur5_robot", "tool0")), count=8)


@pytest.fixture
def written(tmp_path: Path):
    def written(layout: str, seed: int = 1) -> Path:
        rng = np.random.default_rng(seed)
        for name, text in WRITERS[layout](job_of(layout), rng).items():
            (tmp_path / name).write_text(text)
        return tmp_path

    return written


@pytest.mark.parametrize("layout", READINGS)
def test_readings_are_those_written(written, layout):
    file, points, kind, turned = READINGS[layout]
    found, job = read_table(written(layout) / file), job_of(layout)
    at = job.measured if layout == "points" else np.arange(len(job.q))
    seen = ~found.columns["x"].missing()
    kept = found.rows(np.flatnonzero(seen))
    assert seen.mean() > 0.9 and (layout == "points" or not seen.all())
    place = np.stack([job.point(name)[at] for name in points], axis=1).reshape(-1, 3)
    xyz = np.stack([kept.numbers(axis, LENGTH) for axis in "xyz"], axis=1)
    assert np.allclose(xyz, place[seen], rtol=0, atol=1e-6)
    if turned:
        q = np.repeat(job.quaternions, len(points), axis=0)[seen]
        right = from_quaternion(read_quaternions(kept, "quaternion"))
        assert np.allclose(right, from_quaternion(q), rtol=0, atol=5e-6)
    if layout != "points":
        time = np.repeat(job.time, len(points))[seen]
        ahead = kept.numbers("time", TIME) - time
        assert np.allclose(ahead, ahead[0], rtol=0, atol=2e-6)
        assert list(dict.fromkeys(kept.columns)).count(kind) == 1
        assert len({*kept.texts([kind])[kind]}) == len(points)


@pytest.mark.parametrize("layout", ["motive", "vicon", "ndi_tools"])
@pytest.mark.parametrize(
    "how",
    [
        lambda text: "\ufeff# by hand\n\n" + text.replace("\n", ",\n"),
        lambda text: re.sub(r"(?<=\d)\.(?=\d)", ",", text.replace(",", ";")),
        lambda text: text.replace(",", "\t").replace("\n", "\r\n"),
        lambda text: "# " * (text[0] in "FT") + text,
    ],
)
def test_headings_however_they_were_saved(written, layout, how):
    file = written(layout) / READINGS[layout][0]
    first = read_table(file)
    file.write_text(how(file.read_text()), encoding="utf-8")
    again = read_table(file)
    assert [*first.columns] == [name for name in again.columns if "column" not in name]
    for name in "xyz":
        both = (k.columns[name].numbers for k in (again, first))
        np.testing.assert_array_equal(*both)


JOINTS = ("rostopic", "rtde", "franka", "lerobot", "lerobot_normalized")
WHOLE = ("plotjuggler", "pandas")
"""Layouts of joints, and those of joints and positions."""


@pytest.mark.parametrize("layout", [*JOINTS, *WHOLE])
@pytest.mark.parametrize("seed", [1, 2])
def test_joints_are_those_written(written, layout, seed):
    job, whole = job_of(layout), layout in WHOLE
    file = written(layout, seed) / ("measurements.csv" if whole else "joints.csv")
    found, at = with_our_names(read_table(file)), job.measured if whole else slice(None)
    named = [name for name in job.joints if name in found]
    names = named or [f"q_{k}" for k in range(len(job.joints))]
    q = np.stack([found.numbers(name, ANGLE) for name in names], axis=1)
    assert np.allclose(q, job.q[at], rtol=0, atol=1e-6)
    # The controller's pose and what was commanded are nobody's.
    assert not re.search("comm|target|column", " ".join(found.columns))
    assert {*measured(foreign(found.columns))} <= {"time", *"xyz" * whole}
    if whole:
        xyz = np.stack([found.numbers(axis, LENGTH) for axis in "xyz"], axis=1)
        assert np.allclose(xyz, job.point("Ball")[at], rtol=0, atol=1e-6)
    else:
        time = found.numbers("time", TIME)
        assert np.allclose(time, job.time, rtol=0, atol=1e-6)


def test_each_layout_is_tested():
    assert WRITERS.keys() == {*READINGS, *JOINTS, *WHOLE}


@pytest.mark.parametrize(
    ("text", "names", "unit"),
    [
        ("p1 1.0 2.0 3.0\np2 1.5 2.0 3.0\n", ["point"], None),
        ("// units: in\nG,1,1.0,2.0,3.0\n", ["group", "point"], "in"),
        ("// in inches\nA B p 1.0 2.0 3.0\n", ["collection", "group", "point"], "in"),
        ("// m\nB,p,0,0,3\nB,q,1,2,3.5\n", ["group", "point"], None),
        ("// [mm]\nA;B;1;1,0;2,5;3,0\n", ["collection", "group", "point"], "mm"),
    ],
)
def test_points_have_up_to_three_names(table, text, names, unit):
    found = table(text)
    assert list(found.columns) == [*names, "x", "y", "z"]
    assert found.columns["z"].unit == unit and found.columns["z"].numbers[0] == 3.0


@pytest.mark.parametrize(
    "row",
    ["P1,0.1,0.2,0.3,0.4,0.5", "1,0.5,0.5,0.5", "2026-01-31T12:00:00,0.1,0.2,0.3"],
)
def test_other_rows_without_a_header_are_no_points(table, row):
    with refused(InputError, "the first row holds numbers", line=1):
        table(f"{row}\n{row}\n")


def test_a_motor_is_in_degrees_or_in_parts_of_its_range(table, tmp_path):
    head = "timestamp,shoulder_pan.pos,elbow_flex.pos,gripper.pos\n"
    degrees, parts = (f"{head}0,50,20,40\n1,-30,{k},40\n" for k in (-90, -100))
    found = table(degrees)
    assert np.allclose(found.numbers("elbow_flex", ANGLE), np.radians([20, -90]))
    assert "calibration file" in found.remarks[0] and "gripper.pos" in found
    with refused(InputError, "put the calibration file of the robot"):
        table(parts)
    # A position is none of motors; and in rad, whoever wrote that.
    assert "x.pos" in table(head.replace("\n", ",x.pos\n") + "0,50,20,40,1\n")
    assert table(head + "0,0.5,0.2,40\n1,-3,1,40\n").columns["elbow_flex"].unit is None
    motor = {"homing_offset": 5, "range_min": 1000, "range_max": 3000}
    motors = {"shoulder_pan": motor, "elbow_flex": {**motor, "drive_mode": 1}}
    (tmp_path / "arm.json").write_text(json.dumps(motors))
    found = table(parts)
    half = 1000 * 2.0 * np.pi / 4095
    assert np.allclose(found.numbers("shoulder_pan", ANGLE), [0.5 * half, -0.3 * half])
    assert np.allclose(found.numbers("elbow_flex", ANGLE), [-0.2 * half, half])
    # Beyond the range they are degrees after all.
    found = table(parts.replace("-100", "-101"))
    assert np.allclose(found.numbers("elbow_flex", ANGLE), np.radians([20, -101]))
    (tmp_path / "leader.json").write_text(json.dumps(motors))
    with refused(InputError, ["several", "arm.json, leader.json"]):
        table(degrees)


def test_names_and_index_of_a_data_frame(table):
    assert list(table('"",a\n0,1.5\n1,3.5\n').columns) == ["a"]
    # An index with a name has a line of its own; one that counts nothing stays.
    found = table(",q,q\n,a,b\nt,,\n0.5,1,2\n1.5,3,4\n")
    assert list(found.columns) == ["q_a", "q_b"]
    assert list(table(",a\n5,1\n7,1\n").columns) == ["column 1", "a"]
    assert not table(",a\n5,1\n7,1\n").remarks


def test_of_two_topics_and_poses_of_controllers(table):
    """The first has its joints' names; what is left out is there if it is named."""
    second = "/other/joint_states/elbow/position"
    found = table(f"__time,/joint_states/elbow/position,{second}\n0.5,1.5,2.5\n")
    assert found.columns["elbow"].numbers.tolist() == [1.5] and second in found
    names = [f"state.O_T_EE[{k}]" for k in range(16)]
    head = ",".join(["time", *(f"state.q[{k}]" for k in range(7)), *names, "x [mm]"])
    text = head + "\n" + ",".join(["0.5"] * 25)
    assert [*table(text).columns] == ["time", *(f"q_{k}" for k in range(7)), "x"]
    found = table(text, {"y": "state.O_T_EE[13] [m]"})
    assert found.numbers("y", LENGTH).tolist() == [0.5]


def test_a_dialect_of_another_package(table):
    class Shouting(Dialect):
        """A file of capitals."""

        def read(self, columns: Mapping[str, Column], file: Path) -> Reading | None:
            low = {name.lower(): column for name, column in columns.items()}
            return Reading(low, "loud") if all(map(str.isupper, columns)) else None

    register("dialects", "shouting", Shouting)
    found = table("X,Y\n1,2\n")
    assert list(found.columns) == ["x", "y"] and found.remarks == ("read as loud",)
    assert list(table("X,y\n1,2\n").columns) == ["X", "y"]
    assert list(DIALECTS)[-1] == "shouting"
