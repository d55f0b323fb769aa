"""Robots whose controllers show other joints than their URDF has."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib_pin.io.results import read_calibration
from calib_pin.kinematics.joint_columns import JointColumns
from tests.cli.files import numbers, table, write
from tests.shared import chain_of, joint, urdf_of

RUN = "compensate done/calibration.json"
CALIBRATE = "calibrate lift.urdf rows.csv --tip tool --parameters joint-offset -o done"
COLUMNS = ["lift", "turn", "Elbow [wrist]", "last"]


@pytest.fixture
def lift():
    """Two stages that follow a drive outside the chain, and three joints behind."""
    half = '<mimic joint="lift" multiplier="0.5" offset="{}"/>'
    speed = '<limit effort="1" velocity="1"/>'
    slide = partial(joint, kind="prismatic", limits="0 0.6")
    turn = partial(joint, limits="-2 2")
    return urdf_of(
        joint("lift", "base drive", kind="prismatic", limits="0.1 1.1"),
        slide("low", "base m", more=half.format(0.01)),
        slide("high", "m t", "0.01 0 0.2", more=half.format(0.0)),
        joint("turn", "t a", "0 0 0.3", kind="continuous", more=speed),
        turn("Elbow [wrist]", "a b", "0.05 0 0.2", "0 1 0"),
        turn("last", "b c", "0.4 0 0", "0 1 0"),
        joint("mount", "c tool", "0.3 0.05 0", kind="fixed"),
    )


@pytest.fixture
def job(lift, alone, run):
    """Files of the robot, with measurements of what its controller shows."""
    Path("lift.urdf").write_text(lift)
    kinds = "--model position --parameters joint-offset --noise 1e-5 --count 40"
    words = f"simulate lift.urdf --tip tool {kinds} -o all.csv"
    assert run(words).status == 0
    header, rows, _ = table("all.csv")
    kept = [header.index(name) for name in [*COLUMNS, "x", "y", "z"]]
    write("rows.csv", ",".join(header[k] for k in kept), np.array(rows, float)[:, kept])
    return chain_of(lift, "base", "tool")


def test_init_asks_for_no_columns_of_mimic_joints(job, run):
    draft = run("init lift.urdf rows.csv")
    assert draft.status == 0 and draft.err == ""
    setup = yaml.safe_load(draft.out)
    assert setup["tip"] == "tool" and "columns" not in setup


def test_commands_are_those_of_the_drives(job, run):
    assert run(CALIBRATE).status == 0
    model = read_calibration("done/calibration.json").of()
    drives = JointColumns.of(job)
    assert drives.names == tuple(COLUMNS)
    header, rows, _ = table("rows.csv")
    cells = np.array(rows, float)[:6]
    q = drives.positions(cells[:, :4])

    def reached(columns):
        return model.poses(drives.positions(columns))[:, :3, 3]

    # Targets alone, targets with a start, and a motion of the nominal robot.
    write("targets.csv", "x,y,z", cells[:, 4:])
    assert run(f"{RUN} targets.csv -o commands.csv").status == 0
    heads = [*COLUMNS[:2], "Elbow [wrist] [rad]", "last"]
    assert table("commands.csv")[0] == [*heads, "row"]
    found = numbers("commands.csv")[:, :4]
    np.testing.assert_allclose(reached(found), cells[:, 4:], atol=1e-9)
    write("starts.csv", ",".join(header), cells)
    assert run(f"{RUN} starts.csv -o near.csv").status == 0
    assert table("near.csv")[0] == [*COLUMNS, "row"]
    near = numbers("near.csv")[:, :4]
    np.testing.assert_allclose(reached(near), cells[:, 4:], atol=1e-9)
    assert np.abs(near - cells[:, :4]).max() < 0.05
    write("motion.csv", ",".join(COLUMNS), cells[:, :4])
    assert run(f"{RUN} motion.csv -o moved.csv").status == 0
    moved = drives.positions(numbers("moved.csv"))
    # A recording of all joints says the same of those that follow.
    everything = np.column_stack([cells[:, :4], q[:, 0]])
    write("motion.csv", ",".join([*COLUMNS, "low"]), everything)
    assert run(f"{RUN} motion.csv -o all.csv --force").status == 0
    together = np.column_stack([numbers("moved.csv"), moved[:, 0]])
    np.testing.assert_allclose(numbers("all.csv"), together, atol=1e-9)
    tips = model.error.tip_poses(moved, model.theta)[:, :3, 3]
    np.testing.assert_allclose(tips, job.poses(q)[:, :3, 3], atol=1e-9)


def test_simulated_files_have_the_columns_of_the_controller(job, run):
    """So the setup that plans them reads them, too."""
    Path("map.yaml").write_text(
        "tip: tool\njoints: {A: {joint: turn, sign: -1, offset: 0.3}, "
        "B: {joint: last, gear: 2, coupled: {A: 0.5}}}\n"
    )
    Path("none.yaml").write_text("turn.joint-offset.q: 0\n")
    words = "--setup map.yaml --parameters joint-offset --model position"
    words += " --errors none.yaml --noise 0 --count 12 -o exact.csv"
    assert run(f"simulate lift.urdf {words}").status == 0
    header, rows, _ = table("exact.csv")
    assert [header[k] for k in (0, 1, 3)] == ["lift", "A", "B"]
    q = np.array([row[:4] for row in rows], float)
    positions = np.array([row[4:7] for row in rows], float)
    moved = np.column_stack(
        [q[:, 0], 0.3 - q[:, 1], q[:, 2], 2.0 * (q[:, 3] + 0.5 * q[:, 1])]
    )
    drives = JointColumns.of(job)
    np.testing.assert_allclose(
        job.poses(drives.positions(moved))[:, :3, 3], positions, atol=1e-9
    )
    result = run("evaluate lift.urdf exact.csv --setup map.yaml")
    assert result.status == 2 and "which no\ninstrument does" in result.out


def test_continuous_joints_go_the_short_way(job, run):
    assert run(CALIBRATE).status == 0
    turn = np.radians(np.arange(350.0, 371.0, 2.0))
    motion = np.tile([0.5, 0.0, 0.4, 0.7], (len(turn), 1))
    motion[:, 1] = turn % (2.0 * np.pi)
    write("motion.csv", ",".join(COLUMNS), motion)
    words = f"{RUN} motion.csv --speed 0.5"
    assert run(f"{words} -o t.yaml --format joint-trajectory").status == 0
    made = yaml.safe_load(Path("t.yaml").read_text())
    assert made["joint_names"] == COLUMNS
    steps = np.diff([point["positions"][1] for point in made["points"]])
    np.testing.assert_allclose(steps, np.radians(2.0), atol=1e-3)
    assert run(f"{words} -o timed.csv").status == 0
    timed = numbers("timed.csv")
    # In the turns of the file, and in the time that two degrees take.
    assert np.ptp(timed[:, 1]) > 6.0
    np.testing.assert_allclose(np.diff(timed[:, 4]), np.radians(2.0) / 0.5, atol=1e-2)


def test_what_to_do_about_joints_without_a_column(job, fails):
    header, rows, _ = table("rows.csv")

    def without(name, to):
        kept = [k for k, one in enumerate(header) if one != name]
        write(to, ",".join(header[k] for k in kept), np.array(rows)[:, kept])

    without("lift", "behind.csv")
    where = "start behind them with --base drive"
    fails("calibrate lift.urdf behind.csv --tip tool -o out", "'lift'", where)
    without("Elbow [wrist]", "within.csv")
    fails("calibrate lift.urdf within.csv --tip tool -o out", "Elbow [wrist]")
    fails("init lift.urdf within.csv", "Elbow [wrist]")


def test_a_base_that_moves_in_all_directions(job, fails):
    text = Path("lift.urdf").read_text()
    floating = (
        '<link name="world"/><joint name="virtual" type="floating">'
        '<parent link="world"/><child link="base"/></joint></robot>'
    )
    Path("floating.urdf").write_text(text.replace("</robot>", floating))
    for words in (
        "calibrate floating.urdf rows.csv --tip tool -o out",
        "init floating.urdf rows.csv",
    ):
        fails(words, "'virtual'", "behind it with --base base")
