"""The command `compensate`: what it reads, finds, prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib_pin.io.measurements import read_configurations
from calib_pin.io.results import read_calibration
from calib_pin.io.setup import read_setup
from calib_pin.kinematics.spatial import so3_log
from tests.cli.files import column, document, numbers, table, write

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


@pytest.fixture
def model(here):
    return read_calibration("done/calibration.json").of()


@pytest.fixture
def positions(model):
    """Targets that the calibrated robot reaches, written to a file."""
    found = model.poses(Q)[:, :3, 3]
    write("targets.csv", "x [mm],y [mm],z [mm]", 1e3 * found)
    return found


# --- targets -----------------------------------------------------------------------


def test_positions(model, positions, run, here, listing):
    result = run(RUN)
    assert (result.status, result.err) == (0, "")
    header, _, comments = table("commands.csv")
    assert header == [*JOINTS, "row"]
    assert comments == [f"# commands of: calib-pin {RUN}"]
    found = numbers("commands.csv")
    assert found[:, 4].tolist() == [3, 4, 5, 6]
    reached = model.poses(found[:, :4])[:, :3, 3]
    np.testing.assert_allclose(reached, positions, atol=1e-9)
    assert result.out.startswith("arm: 4 of 4 targets reached")
    assert result.out.endswith("wrote commands.csv\n")
    assert max(map(len, result.out.splitlines())) <= 80
    before = listing(here)
    assert run(f"{RUN} --force").status == 0
    assert listing(here) == before


@pytest.mark.parametrize(
    ("unit", "turn", "zero"), [("deg", 360.0, 0.0), ("steps/4096@100", 4096.0, 100.0)]
)
def test_starts_and_their_units(model, run, unit, turn, zero):
    T, turn = model.poses(Q), turn / (2.0 * np.pi)
    start = zero + turn * (Q + 0.02)
    rows = np.hstack([start, T[:, :3, 3]])
    heads = ",".join(f"{name} [{unit}]" for name in JOINTS)
    write("targets.csv", f"{heads},x,y,z", rows)
    result = run(RUN)
    assert (result.status, result.err) == (0, "")
    header, _, _ = table("commands.csv")
    assert header == [*(f"{name} [{unit}]" for name in JOINTS), "row"]
    found = (numbers("commands.csv")[:, :4] - zero) / turn
    np.testing.assert_allclose(model.poses(found)[:, :3, 3], T[:, :3, 3], atol=1e-9)
    # The closest ones, which are closer than those the targets were made with.
    moved = np.linalg.norm(found - (start - zero) / turn, axis=1)
    assert (moved < 0.04).all()


GUESSED = "calib-pin: note: base or tool"


def test_poses(model, run):
    T = model.poses(Q)
    rows = np.hstack([T[:, :3, 3], so3_log(T[:, :3, :3])])
    write("targets.csv", "x,y,z,rx,ry,rz", rows)
    result = run(RUN)
    assert result.status == 0
    assert result.err.count("\n") == 1 and "orientation" in result.out
    np.testing.assert_allclose(
        model.poses(numbers("commands.csv")[:, :4]), T, atol=2e-9
    )
    assert run(f"{RUN} --force --point tip").err.startswith(GUESSED)
    result = run(f"{RUN} --force --position")
    assert (result.status, result.err) == (0, "")


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
    assert numbers("commands.csv")[:, 4].tolist() == [3, 5]

    result = run(f"{RUN} --force --quiet")
    assert (result.status, result.out) == (2, "")
    assert "targets.csv, lines 4, 6\n" in result.err


def test_a_joint_at_its_limit_is_told(model, run):
    q = Q.copy()
    q[1, 3] = 2.5
    rows = np.hstack([q, model.poses(q)[:, :3, 3]])
    write("targets.csv", ",".join([*JOINTS, "x", "y", "z"]), rows)
    result = run(RUN)
    assert result.status == 0 and "at its limit in line 4." in result.out
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
    assert "30 of 30 configurations" in result.out
    before, after = table("targets.csv"), table("commands.csv")
    assert after[0] == before[0]
    for k, kind in ((0, float), (5, str), (6, str)):
        assert [kind(row[k]) for row in after[1]] == [kind(row[k]) for row in before[1]]
    found = np.radians([[float(cell) for cell in row[1:5]] for row in after[1]])
    tips = model.error.tip_poses(found, model.theta)[:, :3, 3]
    np.testing.assert_allclose(tips, model.chain.poses(q)[:, :3, 3], atol=1e-9)
    assert 1e-4 < np.abs(found - q).max() < 0.02


def test_a_motion_with_a_gap_is_not_written(here, run, withholds):
    motion()
    lines = Path("targets.csv").read_text().splitlines()
    cells = lines[7].split(",")
    cells[3] = str(np.degrees(2.6))  # Joint 3 turns 2.5 rad at most.
    cells[2] = "0"
    lines[7] = ",".join(cells)
    Path("targets.csv").write_text("\n".join(lines) + "\n")
    told = withholds(RUN).out
    assert "targets.csv:8: " in told and told.count("targets.csv:") == 1


def test_a_motion_that_jumps_is_not_written(here, run, withholds, monkeypatch):
    motion()
    monkeypatch.setattr("calib_pin.control.compensation.JUMP", 1e-5)
    withholds(RUN)
    result = run(f"{RUN} --quiet")
    assert result.status == 2
    assert "targets.csv, line" in result.err and result.err.count("\n") == 1


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
    header, heads = table("commands.csv")[0], list(columns)[:5]
    assert set(header) == {*heads, "row"} if placed else header == heads
    np.testing.assert_array_equal(np.array(column("commands.csv", "rail"), float), rail)
    joints = read_setup("map.yaml").joints
    q = read_configurations("commands.csv", model.chain, joints)
    if placed:
        np.testing.assert_allclose(model.poses(q)[:, :3, 3], targets, atol=1e-9)
    else:
        tips = model.error.tip_poses(q, model.theta)[:, :3, 3]
        expected = model.chain.poses(Q)[:, :3, 3]
        np.testing.assert_allclose(tips, expected, atol=1e-9)


# --- what it must not do -----------------------------------------------------------


def test_an_untrusted_calibration(positions, run, withholds):
    stated = document("done")
    stated["verdict"] = {"status": "untrusted", "reason": "too few rows"}
    Path("done/calibration.json").write_text(json.dumps(stated))
    assert withholds(RUN).out.startswith("UNTRUSTED: done/calibration.json")
    result = run(f"{RUN} --quiet")
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("calib-pin: note: untrusted: done/calibration.json")


def test_columns_without_a_meaning(positions, run):
    write("targets.csv", "x,y,z,name,,joint9", [[*positions[0], "a", "b", "1"]])
    result = run(RUN)
    assert result.status == 0 and result.err.count("\n") == 1
    assert "targets.csv" in result.err and "name, column 5, joint9" in result.err
    assert run(f"{RUN} --force --quiet").err == ""


# --- how commands are written ------------------------------------------------------


def test_a_trajectory_of_ros_keeps_the_speeds(positions, run):
    assert run(f"{RUN} --speed 0.5").status == 0
    assert table("commands.csv")[0] == [*JOINTS, "row", "time"]
    q, times = numbers("commands.csv")[:, :4], numbers("commands.csv")[:, 5]
    words = f"{DONE} targets.csv -o degrees.csv --degrees"
    assert run(words).status == 0
    header = table("degrees.csv")[0]
    assert header == [*(f"{joint} [deg]" for joint in JOINTS), "row"]
    assert np.allclose(numbers("degrees.csv")[:, :4], np.rad2deg(q))
    words = f"{DONE} targets.csv -o t.yaml --format joint-trajectory --speed 0.5"
    assert run(words).status == 0
    made = yaml.safe_load(Path("t.yaml").read_text())
    assert made["joint_names"] == JOINTS
    assert np.array_equal([p["positions"] for p in made["points"]], q)
    stamps = [p["time_from_start"] for p in made["points"]]
    time = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    # The URDF allows 1 rad/s of every joint.
    speeds = np.abs(np.diff(q, axis=0)) / np.diff(time)[:, None]
    np.testing.assert_allclose(time, times, atol=2e-9)
    assert time[0] == 0.0 and np.allclose(speeds.max(axis=1), 0.5, atol=1e-6)


def test_times_that_are_used_are_not_called_ignored(positions, run):
    rows = np.column_stack([1e3 * positions, [0.0, 90.0, 180.0, 270.0]])
    write("targets.csv", "x [mm],y [mm],z [mm],time", rows)
    words = f"{DONE} targets.csv -o t.yaml --format joint-trajectory"
    assert run(words).err == ""
    points = yaml.safe_load(Path("t.yaml").read_text())["points"]
    assert [p["time_from_start"]["sec"] for p in points] == [0, 90, 180, 270]
    assert "ignored: time" in run(f"{words} --speed 0.5 --force").err


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


def test_a_motion_that_is_too_fast_is_not_written(here, run, withholds):
    timed_motion(1.2)
    withholds(f"{RUN} --format joint-trajectory")
    told = " ".join(run(RUN).out.split())
    assert "lines 4, 5, " in told and told.endswith(
        "nothing: a motion is written whole"
    )


def test_times_that_cannot_be(here, fails):
    q, time = timed_motion(0.9)
    fails(f"{RUN} --speed 0.5", "times of its own")
    time[7] = time[6]
    write("targets.csv", ",".join([*JOINTS, "time"]), np.column_stack([q, time]))
    fails(RUN, "targets.csv:10", "'time'")
