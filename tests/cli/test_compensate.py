"""The command `compensate`: what it reads, finds, prints, writes and refuses."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from calib_pin.io.results import read_calibration
from calib_pin.io.urdf import load_chain

DONE = "compensate done/calibration.json"
RUN = f"{DONE} targets.csv -o commands.csv"
JOINTS = ["joint1", "joint2", "joint3", "joint4"]
Q = np.array(
    [
        [0.3, 0.4, 0.7, -0.2],
        [-0.8, 0.2, 1.1, 0.5],
        [1.2, -0.3, 0.9, 0.1],
        [0.1, 0.7, 0.5, -0.9],
    ]
)


def table(path: str) -> tuple[list[str], list[list[str]], list[str]]:
    """Header, cells and comments of a CSV file."""
    lines = Path(path).read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    header, *rows = csv.reader([line for line in lines if not line.startswith("#")])
    return header, rows, comments


def numbers(path: str) -> np.ndarray:
    return np.array(table(path)[1], float)


def write(path: str, header: str, rows: object) -> None:
    lines = [",".join(str(cell) for cell in row) for row in rows]
    Path(path).write_text("\n".join(["# mine", header, *lines]) + "\n")


@pytest.fixture
def model(here):
    return read_calibration("done/calibration.json").of()


@pytest.fixture
def positions(model):
    """Targets that the calibrated robot reaches, written to a file."""
    found = model.poses(Q)[:, :3, 3]
    write("targets.csv", "x [mm],y [mm],z [mm]", 1e3 * found)
    return found


def test_help(run):
    result = run("compensate --help")
    assert result.status == 0
    usage = "Usage: calib-pin compensate [OPTIONS] calibration.json TARGETS"
    assert result.out.splitlines()[0] == usage
    options = "-o --frame --point --position --setup --force --quiet --json"
    for option in options.split():
        assert f"  {option}" in result.out
    assert max(map(len, result.out.splitlines())) <= 80
    assert "\n  compensate " in run("--help").out


# --- targets -----------------------------------------------------------------------


def test_positions(model, positions, run):
    result = run(RUN)
    assert (result.status, result.err) == (0, "")
    header, _, comments = table("commands.csv")
    assert header == [*JOINTS, "row"]
    assert comments == [f"# commands of: calib-pin {RUN}"]
    found = numbers("commands.csv")
    assert found[:, 4].tolist() == [3, 4, 5, 6]
    reached = model.poses(found[:, :4])[:, :3, 3]
    np.testing.assert_allclose(reached, positions, atol=1e-9)
    out = " ".join(result.out.split())
    assert out.startswith("arm: 4 of 4 targets reached (positions only), joint limits")
    assert "nominal" in out
    assert "compensated" in out
    for joint in JOINTS:
        assert joint in out
    assert out.endswith("wrote commands.csv")
    assert max(map(len, result.out.splitlines())) <= 80


def test_the_real_robot_gets_there(model, positions, run):
    assert run(RUN).status == 0
    q = numbers("commands.csv")[:, :4]
    true = load_chain("truth.urdf")
    base, tool = model.error.base.homogeneous, model.error.tool.homogeneous
    errors = [
        np.linalg.norm((base @ chain.poses(at) @ tool)[:, :3, 3] - positions, axis=1)
        for chain, at in ((true, q), (load_chain("arm.urdf"), q))
    ]
    # Measured with 0.1 mm of noise; the errors of the joints are 2 and 3 mrad.
    assert errors[0].max() < 2e-4
    assert errors[1].min() > 5e-4


def test_starts_and_their_units(model, run):
    T = model.poses(Q)
    start = np.degrees(Q + 0.02)
    rows = np.hstack([start, T[:, :3, 3]])
    heads = ",".join(f"{name} [deg]" for name in JOINTS)
    write("targets.csv", f"{heads},x,y,z", rows)
    result = run(RUN)
    assert (result.status, result.err) == (0, "")
    header, _, _ = table("commands.csv")
    assert header == [*(f"{name} [deg]" for name in JOINTS), "row"]
    found = np.radians(numbers("commands.csv")[:, :4])
    np.testing.assert_allclose(model.poses(found)[:, :3, 3], T[:, :3, 3], atol=1e-9)
    # The closest ones, which are closer than those the targets were made with.
    moved = np.linalg.norm(found - np.radians(start), axis=1)
    assert (moved < 0.04).all()


GUESSED = "calib-pin: note: base or tool were estimated along with the robot"


def test_poses_in_all_ways_to_write_them(here, run):
    import pinocchio as pin

    model = read_calibration("done/calibration.json").of()
    T = model.poses(Q)
    quaternions = np.array([pin.Quaternion(R).coeffs() for R in T[:, :3, :3]])
    vectors = np.array([pin.log3(R) for R in T[:, :3, :3]])
    angles = np.array([pin.rpy.matrixToRpy(R) for R in T[:, :3, :3]])
    heads = {
        "qx,qy,qz,qw": quaternions,
        "rx,ry,rz": vectors,
        "roll [deg],pitch [deg],yaw [deg]": np.degrees(angles),
    }
    for head, columns in heads.items():
        write("targets.csv", f"x,y,z,{head}", np.hstack([T[:, :3, 3], columns]))
        result = run(f"{RUN} --force")
        assert result.status == 0
        assert result.err.startswith(
            "calib-pin: note: the tool was measured as a point"
        )
        assert "(poses)" in result.out
        assert "orientation" in result.out
        found = numbers("commands.csv")[:, :4]
        np.testing.assert_allclose(model.poses(found), T, atol=2e-9)
    assert run(f"{RUN} --force --point tip").err.startswith(GUESSED)
    result = run(f"{RUN} --force --position")
    assert "(positions only)" in result.out
    assert result.err == ""


def test_a_small_robot_reaches_few_poses(model, run):
    rows = np.hstack([model.poses(Q)[:, :3, 3], np.full((4, 3), 0.3)])
    write("targets.csv", "x,y,z,rx,ry,rz", rows)
    result = run(RUN)
    assert result.status == 2
    out = " ".join(result.out.split())
    assert "4 joints reach few poses; --position asks for positions only" in out
    assert "mm and" in out
    assert "deg remain" in out


def test_frames_and_points(model, run):
    F = model.error.tip_poses(Q, model.theta)
    tool = F @ model.error.tool.homogeneous
    base = model.error.base.homogeneous
    for options, T in {
        "--frame base": tool,
        "--frame base --point tip": F,
        "--point tip": base @ F,
        "--frame measuring --point tool": base @ tool,
    }.items():
        rows = np.hstack([Q, T[:, :3, 3]])
        write("targets.csv", ",".join([*JOINTS, "x", "y", "z"]), rows)
        assert run(f"{RUN} --force {options}").status == 0
        found = numbers("commands.csv")[:, :4]
        np.testing.assert_allclose(found, Q, atol=1e-6)


def test_what_cannot_be_reached_is_listed(model, positions, run):
    positions[1] *= 5.0
    positions[3, 2] += 4.0
    write("targets.csv", "x,y,z", positions)
    result = run(RUN)
    assert result.status == 2
    assert result.err == ""
    lines = result.out.splitlines()
    assert lines[0].startswith("arm: 2 of 4 targets reached")
    listed = [line.strip() for line in lines if "targets.csv:" in line]
    assert [line.split(":")[1] for line in listed] == ["4", "6"]
    assert all(line.endswith("mm remain") for line in listed)
    assert numbers("commands.csv")[:, 4].tolist() == [3, 5]

    result = run(f"{RUN} --force --quiet")
    assert (result.status, result.out) == (2, "")
    assert result.err == "calib-pin: note: out of reach: targets.csv, lines 4, 6\n"


def test_where_nothing_can_be_reached_nothing_is_written(positions, run, listing, here):
    write("targets.csv", "x,y,z", positions + 5.0)
    before = listing(here)
    result = run(RUN)
    assert result.status == 2
    assert result.out.endswith("wrote nothing\n")
    assert listing(here) == before


def test_json(model, positions, run):
    positions[2] += 3.0
    write("targets.csv", "x,y,z", positions)
    result = run(f"{RUN} --json")
    assert (result.status, result.err) == (2, "")
    found = json.loads(result.out)
    assert found["verdict"] == {"status": "good", "reason": ""}
    assert (found["kind"], found["rows"], found["reached"]) == ("targets", 4, 3)
    (missed,) = found["unreachable"]
    assert missed["line"] == 5
    assert missed["position"] > 1.0
    assert list(found["corrections"]) == JOINTS
    joint3 = found["corrections"]["joint3"]
    assert joint3["unit"] == "rad"
    assert 0.0 < joint3["mean"] <= joint3["max"] < 0.02
    position = found["errors"]["position"]
    assert position["compensated"]["max"] < 1e-9
    assert position["nominal"]["mean"] > 1e-4
    assert found["at_limit"] == found["outside_trained_region"] == found["jumps"] == []
    assert found["written"] == "commands.csv"


def test_a_joint_at_its_limit_is_told(model, run):
    q = Q.copy()
    q[1, 3] = 2.5
    rows = np.hstack([q, model.poses(q)[:, :3, 3]])
    write("targets.csv", ",".join([*JOINTS, "x", "y", "z"]), rows)
    result = run(RUN)
    assert result.status == 0
    assert "A joint is at its limit in line 4." in result.out
    assert numbers("commands.csv")[1, 3] == 2.5


# --- motions -----------------------------------------------------------------------


def motion(name: str = "targets.csv", rows: int = 30) -> np.ndarray:
    """A motion in degrees with other columns around it."""
    part = np.linspace(0.0, 1.0, rows)[:, None]
    q = np.degrees(Q[0] + part * (Q[1] - Q[0]))
    cells = [
        (f"{0.05 * k:.2f}", *at, f'" go, {k}"', "0x1F")
        for k, at in enumerate(q.tolist())
    ]
    heads = ",".join(f"{joint} [deg]" for joint in JOINTS)
    write(name, f"time [s],{heads},note,speed", cells)
    return np.radians(q)


def test_a_motion(model, run):
    q = motion()
    result = run(RUN)
    assert result.status == 0
    # The rows that were fitted do not tell where the base link is.
    assert result.err.startswith(GUESSED) and result.err.count("\n") == 1
    out = " ".join(result.out.split())
    assert "by the calibrated model" in out
    assert "Error of the model itself on validation measurements (5-fold" in out
    assert "30 of 30 configurations of the nominal robot reached (positions" in out
    before, after = table("targets.csv"), table("commands.csv")
    assert after[0] == before[0]
    for column in (0, 5, 6):
        assert [row[column] for row in after[1]] == [row[column] for row in before[1]]
    found = np.radians([[float(cell) for cell in row[1:5]] for row in after[1]])
    tips = model.error.tip_poses(found, model.theta)[:, :3, 3]
    np.testing.assert_allclose(tips, model.chain.poses(q)[:, :3, 3], atol=1e-9)
    assert 1e-4 < np.abs(found - q).max() < 0.02


def test_a_motion_with_a_gap_is_not_written(model, run, listing, here):
    motion()
    lines = Path("targets.csv").read_text().splitlines()
    cells = lines[7].split(",")
    cells[3] = str(np.degrees(2.6))  # Joint 3 turns 2.5 rad at most.
    cells[2] = "0"
    lines[7] = ",".join(cells)
    Path("targets.csv").write_text("\n".join(lines) + "\n")
    before = listing(here)
    result = run(RUN)
    assert result.status == 2
    assert "targets.csv:8: " in result.out
    assert result.out.endswith("wrote nothing\n")
    assert listing(here) == before
    found = json.loads(run(f"{RUN} --json").out)
    assert found["kind"] == "motion"
    assert found["written"] is None
    assert [entry["line"] for entry in found["unreachable"]] == [8]


def test_a_motion_that_jumps_is_not_written(model, run, listing, here, monkeypatch):
    motion()
    monkeypatch.setattr("calib_pin.control.compensation.JUMP", 1e-5)
    before = listing(here)
    result = run(RUN)
    assert result.status == 2
    assert "Discontinuity in joint space" in result.out
    assert result.out.endswith("wrote nothing\n")
    assert listing(here) == before
    result = run(f"{RUN} --quiet")
    assert result.status == 2
    assert result.err.startswith(
        "calib-pin: note: discontinuity in joint space: targets.csv, line"
    )
    assert result.err.count("\n") == 1


MAP = """\
joints:
  A1: {joint: joint1, sign: -1, gear: 0.5, offset: 0.2}
  A2: {joint: joint2}
  A3: {joint: joint3, coupled: {A2: 1.0, rail: 0.1}}
  A4: {joint: joint4, offset: -0.1}
"""


@pytest.mark.parametrize("placed", [False, True])
def test_columns_of_a_controller(placed, model, run):
    # What a controller is told, and what it is told where an axis outside counts.
    rail = np.array([0.0, 1.0, -2.0, 0.5])
    columns = {
        "A1 [mrad]": 1e3 * (Q[:, 0] - 0.2) / -0.5,
        "A2": Q[:, 1],
        "rail": rail,
        "A3 [deg]": np.degrees(Q[:, 2] - Q[:, 1] - 0.1 * rail),
        "A4": Q[:, 3] + 0.1,
    }
    targets = model.poses(Q)[:, :3, 3]
    if placed:
        columns |= dict(zip("xyz", targets.T, strict=True))
    write("targets.csv", ",".join(columns), np.transpose(list(columns.values())))
    Path("map.yaml").write_text(MAP)
    result = run(f"{RUN} --setup map.yaml")
    assert (result.status, result.err.startswith(GUESSED)) == (0, not placed)
    header, rows, _ = table("commands.csv")
    found = dict(zip(header, np.array(rows, float).T, strict=True))
    heads = list(columns)[:5]
    assert set(header) == {*heads, "row"} if placed else header == heads
    np.testing.assert_array_equal(found["rail"], rail)
    q = np.stack(
        [
            -0.5 * 1e-3 * found["A1 [mrad]"] + 0.2,
            found["A2"],
            np.radians(found["A3 [deg]"]) + found["A2"] + 0.1 * rail,
            found["A4"] - 0.1,
        ],
        axis=1,
    )
    if placed:
        np.testing.assert_allclose(model.poses(q)[:, :3, 3], targets, atol=1e-9)
    else:
        tips = model.error.tip_poses(q, model.theta)[:, :3, 3]
        expected = model.chain.poses(Q)[:, :3, 3]
        np.testing.assert_allclose(tips, expected, atol=1e-9)


def test_columns_of_a_controller_without_a_start(model, positions, run):
    Path("map.yaml").write_text(MAP.replace(", rail: 0.1", ""))
    assert run(f"{RUN} --setup map.yaml").status == 0
    header, rows, _ = table("commands.csv")
    assert header == ["A1", "A2", "A3", "A4", "row"]
    a1, a2, a3, a4, _ = np.array(rows, float).T
    q = np.stack([-0.5 * a1 + 0.2, a2, a3 + a2, a4 - 0.1], axis=1)
    np.testing.assert_allclose(model.poses(q)[:, :3, 3], positions, atol=1e-9)


# --- what it must not do -----------------------------------------------------------


def test_inputs_stay_as_they_are(model, positions, run, listing, here):
    motion("motion.csv")
    before = listing(here)
    assert run(RUN).status == 0
    assert run(f"{DONE} motion.csv -o out/commands.csv --quiet").out == ""
    after = listing(here)
    assert {name: after[name] for name in before} == before
    new = {name for name in after if name not in before}
    assert new == {"commands.csv", "out", "out/commands.csv"}


def test_the_same_input_gives_the_same_bytes(positions, run):
    texts = []
    for _ in range(2):
        assert run(f"{RUN} --force").status == 0
        texts.append(Path("commands.csv").read_bytes())
    assert texts[0] == texts[1]


def test_an_untrusted_calibration(positions, run, listing, here):
    document = json.loads(Path("done/calibration.json").read_text())
    document["verdict"] = {"status": "untrusted", "reason": "too few rows"}
    Path("done/calibration.json").write_text(json.dumps(document))
    before = listing(here)
    result = run(RUN)
    assert result.status == 2
    first = " ".join(result.out.split("\n\n")[0].split())
    assert first == (
        "UNTRUSTED: done/calibration.json must not be trusted: too few rows."
    )
    assert result.out.endswith("wrote nothing\n")
    result = run(f"{RUN} --quiet")
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("calib-pin: note: untrusted: done/calibration.json")
    result = run(f"{RUN} --json")
    assert result.status == 2
    assert json.loads(result.out)["verdict"]["status"] == "untrusted"
    assert listing(here) == before


def test_columns_without_a_meaning(positions, run):
    write("targets.csv", "x,y,z,name,,joint9", [[*positions[0], "a", "b", "1"]])
    result = run(RUN)
    assert result.status == 0
    assert result.err == (
        "calib-pin: note: targets.csv: columns ignored: name, joint9, (unnamed)\n"
    )
    assert run(f"{RUN} --force --quiet").err == ""


# (options, files to write first, fields of the error)
CASES: Mapping[str, tuple[str, Mapping[str, str], dict[str, Any]]] = {
    "no targets": ("", {"targets.csv": ""}, dict(file="targets.csv", reason="empty")),
    "header only": (
        "",
        {"targets.csv": "x,y,z\n"},
        dict(file="targets.csv", reason="no rows"),
    ),
    "neither targets nor joints": (
        "",
        {"targets.csv": "# mine\na,b\n1,2\n"},
        dict(
            file="targets.csv",
            line=2,
            reason=("neither targets nor joint positions", "x, y, z", "joint1, joint2"),
        ),
    ),
    "a coordinate is missing": (
        "",
        {"targets.csv": "x,z\n1,2\n"},
        dict(file="targets.csv", line=1, column="y", reason="missing y"),
    ),
    "only an orientation": (
        "",
        {"targets.csv": "rx,ry,rz\n0,0,1\n"},
        dict(file="targets.csv", line=1, column="x", reason="missing x, y, z"),
    ),
    "no unit quaternion": (
        "",
        {"targets.csv": "x,y,z,qx,qy,qz,qw\n0,0,1,0,0,0,0\n"},
        dict(
            file="targets.csv",
            line=2,
            column="qx, qy, qz, qw",
            value="0, 0, 0, 0",
            reason="norm",
            allowed="0.99 to 1.01",
        ),
    ),
    "joints of another robot": (
        "",
        {"targets.csv": "joint1,joint2,joint_3,joint4\n0,0,1,0\n"},
        dict(
            file="targets.csv",
            line=1,
            column="joint3",
            reason=("joint 'joint3'", "did you mean 'joint_3'"),
        ),
    ),
    "not a number": (
        "",
        {"targets.csv": "x,y,z\n0,0,1\n\n0.1,0.2,nan\n"},
        dict(file="targets.csv", line=4, column="z", value="nan", reason="finite"),
    ),
    "millimeters": (
        "",
        {"targets.csv": "x,y,z\n900,0,400\n"},
        dict(
            file="targets.csv",
            line=2,
            column="x",
            value="900",
            reason=("900 m looks like the wrong unit", "x [mm]"),
        ),
    ),
    "millimeters nearby": (
        "",
        {"targets.csv": "x,y,z\n0.5,0,0.4\n40,20,50\n"},
        dict(
            file="targets.csv",
            line=3,
            column="x",
            value="40",
            reason=("wrong unit", "away from the base", "x [mm]"),
        ),
    ),
    "degrees": (
        "",
        {"targets.csv": "joint1,joint2,joint3,joint4\n0,30,60,0\n"},
        dict(
            file="targets.csv",
            line=2,
            column="joint2",
            value="30",
            reason=("wrong unit", "joint2 [deg]"),
        ),
    ),
    "unknown frame": (
        "--frame world",
        {},
        dict(reason="frame 'world'", allowed="measuring, base"),
    ),
    "unknown point": (
        "--point tol",
        {},
        dict(reason=("'tol'", "did you mean 'tool'"), allowed="tool, tip"),
    ),
    "a frame of a motion": (
        "--frame base",
        {"targets.csv": "joint1,joint2,joint3,joint4\n0,0.3,0.6,0\n"},
        dict(file="targets.csv", reason=("joint positions only", "--frame")),
    ),
    "another setup": (
        "--setup setup.yaml",
        {},
        dict(
            file="setup.yaml",
            reason="a calibration has its own setup",
            allowed="joints",
        ),
    ),
    "a map of joints that are not there": (
        "--setup map.yaml",
        {"map.yaml": "joints: {A1: {joint: joint_1}}\n"},
        dict(reason=("'A1'", "'joint_1'", "did you mean 'joint1'")),
    ),
    "a map that cannot be undone": (
        "--setup map.yaml",
        {
            "map.yaml": "joints:\n  joint1: {joint: joint1, coupled: {joint2: 1}}\n"
            "  joint2: {joint: joint2, coupled: {joint1: 1}}\n",
            "targets.csv": "joint1,joint2,joint3,joint4\n0,0.3,0.6,0\n",
        },
        dict(reason=("couplings", "cannot be undone")),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_wrong_input(name, positions, refuses):
    options, files, fields = CASES[name]
    for file, content in files.items():
        Path(file).write_text(content)
    refuses(f"{RUN} {options}", **fields)


@pytest.mark.parametrize(
    ("command", "fields"),
    [
        ("compensate done/calibration.json targets.csv", dict(text="-o")),
        ("compensate done/calibration.json -o commands.csv", dict(text="TARGETS")),
        (
            "compensate done targets.csv -o commands.csv",
            dict(file="done", reason="folder", allowed="done/calibration.json"),
        ),
        (
            f"{DONE} nothing.csv -o commands.csv",
            dict(file="nothing.csv", reason="no such file"),
        ),
        (f"{DONE} targets.csv -o new.csv", dict(file="new.csv", reason="--force")),
        (
            f"{DONE} targets.csv -o targets.csv --force",
            dict(file="targets.csv", reason="input"),
        ),
        (
            f"{DONE} targets.csv -o done/calibration.json --force",
            dict(file="done/calibration.json", reason="input"),
        ),
        (
            f"{DONE} targets.csv -o arm.urdf --force",
            dict(file="arm.urdf", reason="input"),
        ),
        (f"{DONE} targets.csv -o done --force", dict(file="done", reason="folder")),
        (
            "compensate arm.urdf targets.csv -o commands.csv",
            dict(file="arm.urdf", line=1, reason="not a calibration"),
        ),
        (
            "compensate none.json targets.csv -o commands.csv",
            dict(file="none.json", reason="no such file"),
        ),
    ],
)
def test_wrong_words(command, fields, positions, refuses):
    refuses(command, **fields)


# --- how commands are written ------------------------------------------------------


def test_degrees(positions, run):
    assert run(RUN).status == 0
    radians = numbers("commands.csv")
    assert run(f"{RUN} --degrees --force").status == 0
    header, rows, _ = table("commands.csv")
    assert header == [*(f"{joint} [deg]" for joint in JOINTS), "row"]
    assert np.allclose(np.array(rows, float)[:, :4], np.rad2deg(radians[:, :4]))


def test_a_trajectory_of_ros_keeps_the_speeds(positions, run):
    assert run(RUN).status == 0
    q = numbers("commands.csv")[:, :4]
    words = f"{DONE} targets.csv -o t.yaml --format joint-trajectory --speed 0.5"
    assert run(words).status == 0
    document = yaml.safe_load(Path("t.yaml").read_text())
    assert document["joint_names"] == JOINTS
    assert np.array_equal([p["positions"] for p in document["points"]], q)
    stamps = [p["time_from_start"] for p in document["points"]]
    time = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    # The URDF allows 1 rad/s of every joint.
    speeds = np.abs(np.diff(q, axis=0)) / np.diff(time)[:, None]
    assert time[0] == 0.0 and np.allclose(speeds.max(axis=1), 0.5, atol=1e-6)


def timed_motion(part: float) -> tuple[np.ndarray, np.ndarray]:
    """A motion whose times need a part of the URDF's speed, which is 1 rad/s."""
    q = motion()
    way = np.abs(np.diff(q, axis=0)).max(axis=1)
    time = 5.0 + np.concatenate([[0.0], np.cumsum(way / part)])
    write("targets.csv", ",".join([*JOINTS, "time"]), np.column_stack([q, time]))
    return q, time


def test_a_motion_keeps_its_times(here, run):
    _, time = timed_motion(0.9)
    assert run(RUN).status == 0
    header, rows, _ = table("commands.csv")
    assert header == [*JOINTS, "time"]
    np.testing.assert_array_equal([float(row[4]) for row in rows], time)
    words = f"{DONE} targets.csv -o t.yaml --format joint-trajectory"
    assert run(words).status == 0
    points = yaml.safe_load(Path("t.yaml").read_text())["points"]
    stamps = [p["time_from_start"] for p in points]
    seconds = [stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps]
    np.testing.assert_allclose(seconds, time - 5.0, atol=2e-9)
    # A part of the speeds, if that is what is asked for.
    assert run(f"{words} --speed 0.1 --force").status == 0
    last = yaml.safe_load(Path("t.yaml").read_text())["points"][-1]
    assert last["time_from_start"]["sec"] > 8.0 * (time[-1] - 5.0)


@pytest.mark.parametrize("form", ["csv", "joint-trajectory"])
def test_a_motion_that_is_too_fast_is_not_written(here, run, listing, form):
    timed_motion(1.2)
    before = listing(here)
    result = run(f"{RUN} --format {form}")
    assert result.status == 2
    words = " ".join(result.out.split())
    assert "faster than the URDF allows to lines 4, 5," in words
    assert result.out.endswith("wrote nothing\n")
    assert "faster than the URDF allows" in run(f"{RUN} --quiet").err
    document = json.loads(run(f"{RUN} --json").out)
    assert document["too_fast"][:2] == [4, 5] and document["written"] is None
    assert listing(here) == before


def test_times_of_commands(positions, run):
    assert run(f"{RUN} --speed 0.5").status == 0
    header, _, _ = table("commands.csv")
    assert header == [*JOINTS, "row", "time"]
    found = numbers("commands.csv")
    steps = np.abs(np.diff(found[:, :4], axis=0)).max(axis=1)
    np.testing.assert_allclose(np.diff(found[:, 5]), steps / 0.5, rtol=1e-9)


def test_times_that_do_not_go_on(here, refuses):
    q, time = timed_motion(0.9)
    time[7] = time[6]
    write("targets.csv", ",".join([*JOINTS, "time"]), np.column_stack([q, time]))
    refuses(RUN, reason="the time does not go on", line=10, column="time")


def test_times_and_speeds_contradict(here, run):
    timed_motion(0.9)
    assert "the motion has times of its own" in run(f"{RUN} --speed 0.5").err


def test_a_program_for_another_robot_is_refused(positions, refuses):
    words = f"{DONE} targets.csv -o p.script --format urscript"
    refuses(words, reason="six revolute joints", value=4)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--format g-code", "g-code"),
        ("--format joint-trajectory --degrees", "--degrees is for --format csv"),
        ("--format joint-trajectory --speed 2", "--speed cannot be '2'"),
    ],
)
def test_wrong_ways_to_write(positions, run, words, said):
    result = run(f"{DONE} targets.csv -o p.yaml {words}")
    assert (result.status, result.out) == (1, "")
    assert said in result.err and not Path("p.yaml").exists()
