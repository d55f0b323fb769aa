"""`calib-pin plan` as users run it."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.io.measurements import read_configurations, read_names
from calib_pin.io.setup import read_setup
from calib_pin.planning.search import Search

QUICK = "--method greedy --candidates 100 --ignore-collisions"
PLAN = f"plan arm.urdf --model position --setup setup.yaml {QUICK}"
ADD = f"plan arm.urdf --setup setup.yaml {QUICK}"

BOXES = """<?xml version="1.0"?>
<robot name="boxes">
  <link name="base_link"><collision><geometry><box size="0.2 0.2 0.4"/></geometry>
  </collision></link>
  <link name="link1"/>
  <link name="link2"><collision><origin xyz="0.25 0 0"/><geometry>
    <box size="0.5 0.08 0.08"/></geometry></collision></link>
  <link name="tool"><collision><origin xyz="0.2 0 0"/><geometry>
    <box size="0.4 0.06 0.06"/></geometry></collision></link>
  <joint name="pan" type="revolute"><origin xyz="0 0 0.4"/>
    <parent link="base_link"/><child link="link1"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="lift" type="revolute"><origin xyz="0 0 0.1"/>
    <parent link="link1"/><child link="link2"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="0.5 0 0"/>
    <parent link="link2"/><child link="tool"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
</robot>
"""
CELL = """\
parameters: [joint-offset]
frames: {tool: {xyz: [0.4, 0.05, 0.02]}}
obstacles: [{box: [2, 2, 0.02], xyz: [0, 0, 0.15]}]
region: {box: [[0.2, -0.6, 0.2], [1.2, 0.6, 1.4]]}
limits: {pan: [-1, 1]}
"""


def table(file: str) -> tuple[list[str], list[list[str]]]:
    header, *rows = [
        row.split(",")
        for row in Path(file).read_text().splitlines()
        if not row.startswith("#")
    ]
    return header, rows


def positions(file: str, robot: str = "arm.urdf", **joints: object) -> np.ndarray:
    return read_configurations(file, calib_pin.load_chain(robot), **joints)


# --- what it writes ----------------------------------------------------------------


def test_what_is_written_and_printed(here, run):
    words = f"{PLAN} --count 8 -o plan.csv"
    result = run(words)
    assert (result.status, result.err) == (0, "")
    header, rows = table("plan.csv")
    assert header == ["joint1", "joint2", "joint3", "joint4"]
    assert len(rows) == 8
    text = Path("plan.csv").read_text()
    assert text.startswith(f"# planned by: calib-pin {words}\n")
    assert result.out.startswith("arm: 4 joints from base_link to tool; position, 8 c")
    assert result.out.endswith("wrote 8 configurations to plan.csv\n")
    assert "8  planned" in result.out
    assert "8  random baseline" in result.out
    assert "Collisions are not checked." in result.out
    assert max(map(len, result.out.splitlines())) <= 80


def test_stations_and_tools_of_a_plan_are_measured_and_added_to(here, run):
    """Every configuration says from where and with which tool."""
    Path("places.yaml").write_text(
        """\
model: position
parameters: [joint-offset]
stations: {day 1: {xyz: [1, 0, 0], estimate: true}, day 2: {xyz: [0, 2, 0]}}
tools: {ball: {xyz: [0.02, 0.05, 0.1]}, tip: {xyz: [0.1, 0.02, 0.02]}}
targets: {a: {xyz: [0.02, 0, 0]}, b: {xyz: [0, 0.02, 0]}, c: {xyz: [0, 0, 0.03]}}
"""
    )
    words = f"plan arm.urdf --setup places.yaml {QUICK}"
    assert run(f"{words} --count 16 -o plan.csv").status == 0
    header, rows = table("plan.csv")
    assert header == ["joint1", "joint2", "joint3", "joint4", "station", "tool"]
    places = [tuple(row[4:]) for row in rows]
    # One after another: an instrument is placed and a tool mounted once.
    assert len([place for place, _ in groupby(places)]) == len(set(places)) == 4
    simulate = "simulate arm.urdf --setup places.yaml"
    result = run(f"{simulate} --configurations plan.csv --all-targets -o all.csv")
    assert (result.status, result.err) == (0, "")
    # A configuration is measured at all three targets, and at one without the flag.
    header, measured = table("all.csv")
    assert len(measured) == 3 * 16
    columns = [header.index(name) for name in ("station", "tool")]
    found = {tuple(row[k] for k in columns) for row in measured}
    assert found == set(places)
    assert run(f"{simulate} --configurations plan.csv -o one.csv").status == 0
    assert len(table("one.csv")[1]) == 16
    result = run(f"{words} --add 4 --to all.csv -o more.csv")
    assert (result.status, result.err) == (0, "")
    assert len(table("more.csv")[1]) == 4


def test_a_place_that_the_setup_does_not_state_is_named(here, run):
    Path("places.yaml").write_text(
        "model: position\nparameters: [joint-offset]\n"
        "stations: {day 1: {xyz: [1, 0, 0]}}\n"
    )
    Path("plan.csv").write_text(
        "joint1,joint2,joint3,joint4,station\n0,0,0.2,0,day 1\n0,0,0.5,0,day 3\n"
    )
    words = "simulate arm.urdf --setup places.yaml --configurations plan.csv"
    result = run(f"{words} -o none.csv")
    assert result.status == 1 and not Path("none.csv").exists()
    assert "configuration 2 is of no chain, station and tool" in result.err
    assert "position, station day 1" in result.err


def test_the_file_is_what_the_next_commands_take(here, run):
    assert run(f"{PLAN} --count 12 -o plan.csv").status == 0
    words = (
        "simulate arm.urdf --setup setup.yaml --model position --configurations "
        "plan.csv --errors errors.yaml -o measured.csv"
    )
    result = run(words)
    assert (result.status, result.err) == (0, "")
    np.testing.assert_array_equal(positions("measured.csv"), positions("plan.csv"))
    result = run("calibrate arm.urdf measured.csv --setup setup.yaml")
    assert result.status == 0
    assert result.out.startswith("GOOD: ")
    # The plan promised what the fit then knew.
    result = run(f"{ADD} --add 4 --to measured.csv -o more.csv")
    assert (result.status, result.err) == (0, "")
    assert "4 configurations in addition to 12 measurements" in " ".join(
        result.out.split()
    )
    assert len(table("more.csv")[1]) == 4


@pytest.mark.parametrize(
    "words",
    [
        "--add 4 --to rows.csv",
        "--add --count 4 --to rows.csv",
        "--count 4 --add --to rows.csv",
        "--add=4 --to rows.csv",
        "--add 4 --count 4 --to rows.csv --to new.csv",
    ],
)
def test_additions_in_every_form(words, here, run):
    result = run(f"{ADD} {words} -o more.csv")
    assert (result.status, result.err) == (0, "")
    assert len(table("more.csv")[1]) == 4
    measured = 65 if "new.csv" in words else 40
    assert f"in addition to {measured} measurements" in " ".join(result.out.split())
    # It starts with nothing: the table shows what is there already.
    (line,) = [line for line in result.out.splitlines() if line.startswith("0 ")]
    assert float(line.split()[1]) > 0.0


def test_validation_rows_are_not_counted(here, run):
    comment, header, *rows = Path("rows.csv").read_text().splitlines()
    marks = ["validate" if k % 4 == 0 else "train" for k in range(len(rows))]
    marked = [f"{row},{mark}" for row, mark in zip(rows, marks, strict=True)]
    Path("rows.csv").write_text("\n".join([comment, f"{header},set", *marked]) + "\n")
    result = run(f"{ADD} --add 4 --to rows.csv -o more.csv --json")
    assert json.loads(result.out)["measured"] == 30


def test_no_training_measurements_to_add_to(here, refuses):
    comment, header, *rows = Path("rows.csv").read_text().splitlines()
    marked = [f"{header},set", *(f"{row},validate" for row in rows)]
    Path("rows.csv").write_text("\n".join([comment, *marked]) + "\n")
    reason = "no measurement is left to fit: all are marked for validation"
    refuses(f"{ADD} --add 3 --to rows.csv -o more.csv", column="set", reason=reason)


def test_the_same_words_give_the_same_bytes(here, run, refuses):
    words = f"{PLAN} --count 8 --seed 3 -o plan.csv"
    assert run(words).status == 0
    first = Path("plan.csv").read_bytes()
    refuses(words, file="plan.csv", reason="--force")
    assert run(f"{words} --force").status == 0
    assert Path("plan.csv").read_bytes() == first
    assert run(f"{words.replace('seed 3', 'seed 4')} --force").status == 0
    assert Path("plan.csv").read_bytes() != first


def test_json(here, run):
    result = run(f"{PLAN} --count 8 --criterion O1 -o plan.csv --json")
    assert (result.status, result.err) == (0, "")
    found = json.loads(result.out)
    assert found["joints"] == ["joint1", "joint2", "joint3", "joint4"]
    np.testing.assert_array_equal(found["configurations"], positions("plan.csv"))
    assert found["criterion"]["name"] == "O1"
    assert found["criterion"]["value"] > found["random"] > 0.0
    assert (found["method"], found["status"]) == ("greedy", "converged")
    assert found["collisions"] == {"checked": False, "blocked_moves": []}
    assert found["candidates"] == 100
    counts = [step["count"] for step in found["steps"]]
    assert counts == list(range(counts[0], 17))
    predicted = found["predicted"]
    assert predicted["rank"] == predicted["structural_rank"] == 11
    assert 0.0 < predicted["position"] < 1e-3
    names = {p["name"] for p in predicted["parameters"]}
    assert {"base.frame.x", "joint2.joint-offset.q", "tool.frame.z"} <= names


def test_quiet(here, run):
    # Neither the table nor the remark on collisions.
    words = PLAN.replace("--ignore-collisions", "")
    result = run(f"{words} --count 8 -o plan.csv")
    assert result.status == 0
    assert "no collision geometry" in result.err
    result = run(f"{words} --count 8 -o quiet.csv --quiet")
    assert (result.status, result.out, result.err) == (0, "", "")
    assert positions("quiet.csv").tolist() == positions("plan.csv").tolist()


def test_inputs_stay_as_they_are(here, run, listing):
    before = listing(here)
    for words in (
        f"{PLAN} --count 8 --tests new.csv -o out.csv",
        f"{ADD} --add 4 --to rows.csv -o more.csv",
    ):
        assert run(words).status == 0
    after = listing(here)
    assert {name: after[name] for name in before} == before
    assert set(after) - set(before) == {"out.csv", "more.csv"}


def test_joint_maps_give_what_the_controller_needs(here, run):
    assert run(f"{PLAN} --count 8 -o plan.csv").status == 0
    Path("mapped.yaml").write_text(
        Path("setup.yaml").read_text()
        + """joints:
  A1: {joint: joint1, sign: -1, offset: 0.3}
  A2: {joint: joint2, gear: 0.01}
  A3: {joint: joint3, coupled: {A2: 0.02, track: 3.0}}
"""
    )
    words = PLAN.replace("setup.yaml", "mapped.yaml")
    result = run(f"{words} --count 8 -o mapped.csv")
    assert (result.status, result.err) == (0, "")
    header, rows = table("mapped.csv")
    assert header == ["A1", "A2", "A3", "joint4", "track"]
    q, values = positions("plan.csv"), np.array(rows, float)
    # By hand: what the controller shows while the robot stands there.
    np.testing.assert_allclose(values[:, 0], -(q[:, 0] - 0.3), atol=1e-12)
    np.testing.assert_allclose(values[:, 1], q[:, 1] / 0.01, atol=1e-9)
    np.testing.assert_allclose(values[:, 2], q[:, 2] - 0.02 * values[:, 1], atol=1e-9)
    assert (values[:, 4] == 0.0).all()
    joints = read_setup("mapped.yaml").joints
    np.testing.assert_allclose(positions("mapped.csv", joints=joints), q, atol=1e-12)


def test_limits_of_the_command_line(here, run):
    Path("cell.yaml").write_text(
        Path("setup.yaml").read_text() + "limits: {joint1: [-1, 0.5], joint4: [0, 1]}\n"
    )
    words = PLAN.replace("setup.yaml", "cell.yaml").split()
    limits = ["--limits", "joint[12]=-30:20 [deg]", "--limits", "joint4=-1:0.5"]
    result = run([*words, *limits, "--count", "8", "-o", "plan.csv"])
    assert (result.status, result.err) == (0, "")
    q = positions("plan.csv")
    low, high = np.radians([-30.0, 20.0])
    assert (q[:, :2] >= low - 1e-6).all() and (q[:, :2] <= high + 1e-6).all()
    # The flag wins over the file where both name the same joint.
    assert q[:, 3].min() < 0.0 and q[:, 3].max() <= 0.5
    assert np.abs(q[:, 2]).max() > 1.0
    # The line at the head of the file can be pasted into a shell.
    assert "--limits 'joint[12]=-30:20 [deg]'" in Path("plan.csv").read_text()


def test_a_held_joint(here, run):
    result = run(
        [
            *PLAN.split(),
            "--limits",
            "joint2=0.25:0.25",
            "--count",
            "9",
            "-o",
            "plan.csv",
        ]
    )
    assert (result.status, result.err) == (0, "")
    assert (positions("plan.csv")[:, 1] == 0.25).all()


def test_planes_are_named(here, run):
    Path("planes.yaml").write_text(
        "model: plane-distance\nparameters: [joint-offset]\n"
        "planes:\n  wall: {normal: [1, 0.2, 0.3], offset: -1.8}\n"
        "  floor: {normal: [0.1, 0, 1], offset: 0.3}\n"
    )
    words = f"plan arm.urdf --setup planes.yaml {QUICK} --count 30 -o plan.csv"
    result = run(words)
    assert (result.status, result.err) == (0, "")
    targets = read_names(Path("plan.csv"), "target")
    assert set(targets) == {"wall", "floor"}
    result = run(
        "simulate arm.urdf --setup planes.yaml --configurations plan.csv -o out.csv"
    )
    assert (result.status, result.err) == (0, "")
    # Each configuration looks at the plane that it was planned for.
    assert read_names(Path("out.csv"), "target") == targets


@pytest.mark.parametrize(
    ("setup", "names"),
    [("plane.yaml", {"wall"}), ("planes.yaml", {"wall", "floor"})],
)
def test_configurations_that_name_planes_are_what_the_next_commands_take(
    setup, names, here, run
):
    Path("planes.yaml").write_text(
        Path("plane.yaml").read_text() + "  floor: {normal: [0.1, 0, 1], offset: 0.3}\n"
    )
    words = f"plan arm.urdf --setup {setup} {QUICK} --count 30 -o plan.csv"
    assert run(words).status == 0
    # Which plane is told even where there is one: others may come later.
    assert table("plan.csv")[0][-1] == "target"
    targets = read_names(Path("plan.csv"), "target")
    assert set(targets) == names
    result = run(
        f"simulate arm.urdf --setup {setup} --configurations plan.csv --noise 1e-4 "
        "--errors errors.yaml -o measured.csv"
    )
    assert (result.status, result.err) == (0, "")
    assert read_names(Path("measured.csv"), "target") == targets
    result = run(f"calibrate arm.urdf measured.csv --setup {setup}")
    assert result.status == 0
    assert result.out.startswith("GOOD: ")
    words = f"plan arm.urdf --setup {setup} {QUICK} --add 4 --to measured.csv -o a.csv"
    assert run(words).status == 0
    assert set(read_names(Path("a.csv"), "target")) <= names


def test_obstacles_region_and_limits_of_the_setup_file(here, run):
    Path("boxes.urdf").write_text(BOXES)
    Path("cell.yaml").write_text(CELL)
    words = (
        "plan boxes.urdf --model position --setup cell.yaml --count 8 --candidates 60 "
        "--method exchange --distance 0.2 -o plan.csv --json"
    )
    result = run(words)
    assert (result.status, result.err) == (0, "")
    assert json.loads(result.out)["collisions"]["checked"] is True
    chain = calib_pin.load_chain("boxes.urdf")
    q = positions("plan.csv", "boxes.urdf")
    tool = chain.poses(q)
    point = tool[:, :3, :3] @ [0.4, 0.05, 0.02] + tool[:, :3, 3]
    assert ((point >= [0.2, -0.6, 0.2]) & (point <= [1.2, 0.6, 1.4])).all()
    assert np.abs(q[:, 0]).max() <= 1.0
    # The end of the last box stays above the table, whose top is at 0.16.
    corners = [(0.4, y, z) for y in (-0.03, 0.03) for z in (-0.03, 0.03)]
    for corner in corners:
        height = tool[:, 2, :3] @ corner + tool[:, 2, 3]
        assert height.min() >= 0.16 + 0.009
    between = np.abs(q[:, None] - q[None]).max(axis=2)
    np.fill_diagonal(between, np.inf)
    assert between.min() >= 0.2


# --- while it runs -----------------------------------------------------------------


def read_until(master: int, wanted: bytes, seconds: float) -> bytes:
    """What a terminal shows until a word appears, or the other end is closed."""
    shown, deadline = b"", time.monotonic() + seconds
    while wanted not in shown and time.monotonic() < deadline:
        if not select.select([master], [], [], 0.2)[0]:
            continue
        try:
            part = os.read(master, 65536)
        except OSError:  # The process is gone.
            break
        if not part:
            break
        shown += part
    return shown


def started(words: str, master: int, slave: int) -> subprocess.Popen[str]:
    os.set_blocking(master, True)
    process = subprocess.Popen(
        [sys.executable, "-m", "calib_pin.cli", *words.split()],
        stdout=subprocess.PIPE,
        stderr=slave,
        text=True,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(slave)
    return process


@pytest.mark.slow
def test_ctrl_c_writes_the_best_plan_so_far(here):
    """The bar on the terminal says when the search runs; it would take minutes."""
    words = (
        "plan arm.urdf --model position --setup setup.yaml --count 40 "
        "--candidates 20000 --method ga --ignore-collisions -o plan.csv"
    )
    master, slave = os.openpty()
    process = started(words, master, slave)
    try:
        shown = read_until(master, b"ga ", 60.0)
        assert b"ga " in shown, shown
        process.send_signal(signal.SIGINT)
        shown += read_until(master, b"so far", 60.0)
        out, _ = process.communicate(timeout=60.0)
    finally:
        process.kill()
        process.wait()
        os.close(master)
    assert process.returncode == 0, shown
    assert b"calib-pin: note: interrupted: this is the best plan found so far" in shown
    assert b"Traceback" not in shown
    assert "(stopped: the best so far)" in out
    q = positions("plan.csv")
    assert q.shape == (40, 4)
    assert len(np.unique(q, axis=0)) == 40
    chain = calib_pin.load_chain("arm.urdf")
    assert (q >= chain.lower).all() and (q <= chain.upper).all()


def test_ctrl_c_without_a_terminal(here, run, monkeypatch):
    """No bar; the note comes all the same, and the JSON says how it ended."""
    told = Search.told

    def once(search: Search, *arguments: Any) -> Any:
        monkeypatch.setattr(Search, "told", told)
        os.kill(os.getpid(), signal.SIGINT)
        return told(search, *arguments)

    monkeypatch.setattr(Search, "told", once)
    # Should the command not take the signal, it must not end the tests.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        # The search would take minutes.
        result = run(
            "plan arm.urdf --model position --setup setup.yaml --count 40 "
            "--candidates 5000 --method ga --ignore-collisions --json -o plan.csv"
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert result.status == 0
    assert result.err == (
        "calib-pin: note: interrupted: this is the best plan found so far\n"
    )
    assert json.loads(result.out)["status"] == "stopped"
    assert len(table("plan.csv")[1]) == 40


def test_the_handler_of_ctrl_c_is_put_back(here, run):
    before = signal.getsignal(signal.SIGINT)
    assert run(f"{PLAN} --count 8 -o plan.csv").status == 0
    assert signal.getsignal(signal.SIGINT) is before
    assert run(f"{PLAN} --count 2 -o other.csv").status == 1
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.slow
@pytest.mark.parametrize("quiet", ["", "--quiet"])
def test_a_progress_bar_on_a_terminal(quiet, here):
    # The bar is drawn ten times a second, so the search must take longer than that.
    plan = PLAN.replace("greedy", "exchange").replace("100", "5000")
    words = f"{plan} --count 40 -o plan.csv {quiet}"
    master, slave = os.openpty()
    process = started(words, master, slave)
    try:
        shown = read_until(master, b"never shown", 60.0)
        process.communicate(timeout=60.0)
    finally:
        process.kill()
        process.wait()
        os.close(master)
    assert process.returncode == 0, shown
    assert (b"exchange" in shown) == (not quiet)
    # What is left of it is an empty line, in color or not.
    assert Path("plan.csv").exists()


def test_no_bar_where_nobody_looks(here, run):
    assert run(f"{PLAN} --count 8 -o plan.csv").err == ""


# --- what cannot be ----------------------------------------------------------------


SRDF = '<robot name="{}"><disable_collisions link1="base_link" link2="link2"/></robot>'
BOX = "plan boxes.urdf --model position --parameters joint-offset --candidates 50"

# (command, files to write first, fields of the error)
CASES = {
    "unknown criterion": (
        f"{PLAN} --count 8 --criterion conditions -o out.csv",
        {},
        dict(
            reason=("unknown criterion 'conditions'", "did you mean 'condition'"),
            allowed="prediction",
        ),
    ),
    "unknown method": (
        f"{PLAN} --count 8 --method exchnge -o out.csv",
        {},
        dict(
            reason=("unknown method 'exchnge'", "did you mean 'exchange'"),
            allowed="gradient",
        ),
    ),
    "unknown model": (
        f"plan arm.urdf --model positions {QUICK} --count 8 -o out.csv",
        {},
        dict(reason=("'positions'", "did you mean 'position'")),
    ),
    "no model": (
        f"plan arm.urdf {QUICK} --count 8 -o out.csv",
        {},
        dict(reason="--model", allowed="pose"),
    ),
    "no count": (f"{PLAN} -o out.csv", {}, dict(reason="--count N")),
    "no output": (f"{PLAN} --count 8", {}, dict(text="--output")),
    "no robot": ("plan --count 8 -o out.csv", {}, dict(text=("ROBOT", "plan --help"))),
    "count of zero": (
        f"{PLAN} --count 0 -o out.csv",
        {},
        dict(reason=("--count", "'0'"), allowed="1 to 1000"),
    ),
    "count is no number": (
        f"{PLAN} --count 8.5 -o out.csv",
        {},
        dict(reason=("--count", "'8.5'")),
    ),
    "more than a thousand": (
        f"{PLAN} --count 1001 -o out.csv",
        {},
        dict(reason=("--count", "'1001'")),
    ),
    "no candidates": (
        f"{PLAN} --count 8 --candidates 0 -o out.csv",
        {},
        dict(reason="--candidates"),
    ),
    "joint of limits": (
        f"{PLAN} --count 8 --limits joit1=0:1 -o out.csv",
        {},
        dict(
            reason=("no joint of the chain: 'joit1'", "did you mean 'joint1'"),
            allowed="joint1, joint2",
        ),
    ),
    "limits without a joint": (
        f"{PLAN} --count 8 --limits 0:1 -o out.csv",
        {},
        dict(reason=("--limits", "'0:1'"), allowed="JOINT=LOWER:UPPER"),
    ),
    "limits in the unit of another kind of joint": (
        [
            *PLAN.split(),
            "--count",
            "8",
            "--limits",
            "joint1=-90:90 [mm]",
            "-o",
            "o.csv",
        ],
        {},
        dict(
            reason=("--limits", "'joint1=-90:90 [mm]'", "'joint1' is revolute"),
            allowed="rad, deg, mrad",
        ),
    ),
    "crossed limits": (
        f"{PLAN} --count 8 --limits joint1=1:-1 -o out.csv",
        {},
        dict(reason=("--limits", "'joint1=1:-1'"), allowed="LOWER"),
    ),
    "limits beyond those of the robot": (
        f"{PLAN} --count 8 --limits joint2=2.5:3 -o out.csv",
        {},
        dict(value=[2.5, 3.0], reason=("'joint2'", "leave nothing"), allowed="-2 to 2"),
    ),
    "crossed limits in the setup": (
        f"plan arm.urdf --model position --setup bad.yaml {QUICK} --count 8 -o out.csv",
        {"bad.yaml": "parameters: [joint-offset]\nlimits: {joint1: [1, -1]}\n"},
        dict(
            file="bad.yaml",
            line=2,
            value="[1, -1]",
            reason="limits.joint1",
            allowed="lower < upper",
        ),
    ),
    "limits beyond the robot in the setup": (
        f"plan arm.urdf --model position --setup bad.yaml {QUICK} --count 8 -o out.csv",
        {"bad.yaml": "parameters: [joint-offset]\nlimits: {joint2: [3, 4]}\n"},
        dict(value=[3.0, 4.0], reason=("'joint2'", "leave nothing")),
    ),
    "add without to": (
        f"{PLAN} --add 4 -o out.csv",
        {},
        dict(reason=("--add", "--to CSV")),
    ),
    "to without add": (
        f"{ADD} --count 4 --to rows.csv -o out.csv",
        {},
        dict(reason=("--to", "--add N")),
    ),
    "add without a number": (
        f"{ADD} --add --to rows.csv -o out.csv",
        {},
        dict(reason="--count N"),
    ),
    "add and count": (
        f"{ADD} --add 4 --count 5 --to rows.csv -o out.csv",
        {},
        dict(reason=("--add 4", "--count 5", "contradict")),
    ),
    "add no number": (
        f"{ADD} --add four --to rows.csv -o out.csv",
        {},
        dict(reason=("--add", "'four'"), allowed="1 to 1000"),
    ),
    "rows twice": (
        f"{ADD} --add 4 --to rows.csv --to ./rows.csv -o out.csv",
        {},
        dict(file="rows.csv", reason="twice"),
    ),
    "rows of another kind": (
        f"{PLAN} --add 4 --to distances.csv -o out.csv",
        {},
        dict(
            file="distances.csv", line=2, column="x", reason=("'position'", "x, y, z")
        ),
    ),
    "too few for the rank": (
        f"{PLAN} --count 3 -o out.csv",
        {},
        dict(
            reason="3 configurations cannot determine the 11 identifiable parameters",
            allowed="4 or more",
        ),
    ),
    "too few candidates for the rank": (
        "plan arm.urdf --model position --count 3 --candidates 3 --setup setup.yaml "
        "--ignore-collisions -o out.csv",
        {},
        dict(reason="3 configurations cannot determine"),
    ),
    "empty region": (
        f"plan arm.urdf --model position --setup bad.yaml {QUICK} --count 8 -o out.csv",
        {"bad.yaml": "region: {sphere: {center: [9, 0, 0], radius: 0.5}}\n"},
        dict(reason=("none of", "outside the region"), allowed="a larger region"),
    ),
    "region without extent": (
        f"plan arm.urdf --model position --setup bad.yaml {QUICK} --count 8 -o out.csv",
        {"bad.yaml": "region: {box: [[0, 0, 0], [1, 1, 0]]}\n"},
        dict(
            file="bad.yaml",
            line=1,
            value="[[0, 0, 0], [1, 1, 0]]",
            reason="region.box",
            allowed="[lower, upper]",
        ),
    ),
    "obstacles that swallow the robot": (
        f"{BOX} --setup bad.yaml --count 8 -o out.csv",
        {
            "boxes.urdf": BOXES,
            "bad.yaml": "obstacles: [{sphere: 0.35, xyz: [0, 0, 0.5]}]\n",
        },
        dict(reason=("none of", "configurations", "in collision")),
    ),
    "missing SRDF of a robot without solids": (
        "plan arm.urdf --model position --setup setup.yaml --srdf none.srdf --count 8 "
        "-o out.csv --quiet",
        {},
        dict(file="none.srdf", reason="no such file"),
    ),
    "SRDF of another robot": (
        f"{BOX} --srdf other.srdf --count 8 -o out.csv",
        {"boxes.urdf": BOXES, "other.srdf": SRDF.format("crates")},
        dict(
            file="other.srdf", value="crates", reason="another robot", allowed="boxes"
        ),
    ),
    "missing mesh": (
        f"{BOX} --count 8 -o out.csv",
        {
            "boxes.urdf": BOXES.replace(
                '<box size="0.2 0.2 0.4"/>', '<mesh filename="package://x/base.stl"/>'
            )
        },
        dict(
            file="boxes.urdf",
            line=3,
            reason=("'base_link'", "package://x/base.stl"),
            allowed=("--package-dir", "--ignore-collisions"),
        ),
    ),
    "negative distance": (
        f"{PLAN} --count 8 --distance -1 -o out.csv",
        {},
        dict(reason="--distance"),
    ),
    "distance too large": (
        f"{PLAN} --count 60 --distance 3 -o out.csv",
        {},
        dict(
            reason="may be measured, fewer than the 60 wanted",
            allowed="a shorter distance",
        ),
    ),
    "clearance too large": (
        f"{PLAN.replace('--ignore-collisions', '')} --count 8 --clearance 2 -o out.csv",
        {},
        dict(reason=("--clearance", "'2'"), allowed="0 to 1 m"),
    ),
    "collisions that are ignored and described": (
        f"{PLAN} --count 8 --clearance 0.1 -o out.csv",
        {},
        dict(reason=("--ignore-collisions", "--clearance")),
    ),
    "tests of another robot": (
        f"{PLAN} --count 8 --tests tests.csv -o out.csv",
        {"tests.csv": "axis1,axis2,axis3,axis4\n0,0,0,0\n"},
        dict(file="tests.csv", line=1, column="joint1"),
    ),
    "tests without rows": (
        f"{PLAN} --count 8 --tests tests.csv -o out.csv",
        {"tests.csv": "joint1,joint2,joint3,joint4\n"},
        dict(file="tests.csv", reason="no rows"),
    ),
    "missing tests": (
        f"{PLAN} --count 8 --tests none.csv -o out.csv",
        {},
        dict(file="none.csv", reason="no such file"),
    ),
    "output is the robot": (
        f"{PLAN} --count 8 -o arm.urdf --force",
        {},
        dict(file="arm.urdf", reason="input"),
    ),
    "output is the rows": (
        f"{ADD} --add 4 --to rows.csv -o rows.csv --force",
        {},
        dict(file="rows.csv", reason="input"),
    ),
    "output is the tests": (
        f"{PLAN} --count 8 --tests new.csv -o ./new.csv --force",
        {},
        dict(file="new.csv", reason="input"),
    ),
    "output is the setup": (
        f"{PLAN} --count 8 -o setup.yaml --force",
        {},
        dict(file="setup.yaml", reason="input"),
    ),
    "output is a folder": (
        f"{PLAN} --count 8 -o done",
        {},
        dict(file="done", reason="is a folder, not a file"),
    ),
    "output is a folder, by force": (
        f"{PLAN} --count 8 -o done --force",
        {},
        dict(file="done", reason="is a folder, not a file"),
    ),
    "couplings that cannot be undone": (
        f"plan arm.urdf --model position --setup bad.yaml {QUICK} --count 8 -o out.csv",
        {
            "bad.yaml": "parameters: [joint-offset]\njoints:\n"
            "  A1: {joint: joint1, coupled: {A2: 1}}\n"
            "  A2: {joint: joint2, coupled: {A1: 1}}\n"
        },
        dict(reason=("couplings", "joints")),
    ),
}


UNDOABLE = """joints:
  A1: {joint: joint1, coupled: {A2: 1}}
  A2: {joint: joint2, coupled: {A1: 1}}
"""
EARLY = {
    "criterion": (
        "--criterion condtion",
        "",
        dict(reason="unknown criterion 'condtion'"),
    ),
    "method": ("--method exchnge", "", dict(reason="unknown method 'exchnge'")),
    "couplings": ("", UNDOABLE, dict(reason="cannot be undone")),
    "joint": (
        "",
        "joints: {'A1 [deg]': {joint: joint1}}\n",
        dict(text="joint 'A1 [deg]' cannot be the name of a column"),
    ),
    "plane": (
        "",
        "planes: {' w': {normal: [1, 0, 0], offset: -2}}\n",
        dict(text="target ' w'"),
    ),
}


@pytest.mark.parametrize("name", EARLY)
def test_what_no_search_could_change_is_said_before_it(
    name, here, refuses, monkeypatch
):
    flags, text, fields = EARLY[name]
    Path("bad.yaml").write_text("parameters: [joint-offset]\n" + text)

    def late(*args: object, **options: object) -> None:
        raise AssertionError("too late")

    monkeypatch.setattr("calib_pin.io.collision.load_collisions", late)
    monkeypatch.setattr("calib_pin.planning.plan.plan", late)
    model = "plane-distance" if name == "plane" else "position"
    words = f"plan arm.urdf --model {model} --setup bad.yaml --count 8 -o out.csv"
    refuses(f"{words} {flags}", **fields)


def test_help_of_additions(run):
    words = " ".join(run("plan --help").out.replace("\u2502", " ").split())
    assert "Number of configurations to add to the measurements of --to." in words
    assert "Measurements that exist already; may be repeated." in words


@pytest.mark.parametrize("name", CASES)
def test_wrong_input(name, here, refuses):
    command, files, fields = CASES[name]
    for file, content in files.items():
        Path(file).write_text(content)
    refuses(command, **fields)


def test_a_plan_in_degrees(here, run):
    words = f"{PLAN} --count 6 -o"
    assert run(f"{words} radians.csv").status == 0
    assert run(f"{words} degrees.csv --degrees").status == 0
    chain = calib_pin.load_chain("arm.urdf", tip="tool")
    first, second = (
        read_configurations(f"{name}.csv", chain) for name in ("radians", "degrees")
    )
    assert "joint1 [deg]" in Path("degrees.csv").read_text()
    assert np.allclose(first, second, rtol=0, atol=1e-12)
