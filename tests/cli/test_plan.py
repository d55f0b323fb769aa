"""`calib-pin plan` as users run it."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.io.measurements import read_configurations
from calib_pin.io.setup import read_setup
from tests.cli.files import column, marked, numbers, table

QUICK = "--method greedy --candidates 100 --ignore-collisions"
PLAN = f"plan arm.urdf --model position --setup setup.yaml {QUICK}"
ADD = f"plan arm.urdf --setup setup.yaml {QUICK}"

BOXES = Path(__file__).with_name("boxes.urdf").read_text()
CELL = """\
parameters: [joint-offset]
frames: {tool: {xyz: [0.4, 0.05, 0.02]}}
obstacles: [{box: [2, 2, 0.02], xyz: [0, 0, 0.15]}]
region: {box: [[0.2, -0.6, 0.2], [1.2, 0.6, 1.4]]}
limits: {pan: [-1, 1]}
"""


def positions(file: str, robot: str = "arm.urdf", **joints: object) -> np.ndarray:
    return read_configurations(file, calib_pin.load_chain(robot), **joints)


# --- what it writes ----------------------------------------------------------------


def test_what_is_written_and_printed(here, run):
    words = f"{PLAN} --count 8 -o plan.csv"
    result = run(words)
    # Neither a bar nor a note where nobody looks.
    assert (result.status, result.err) == (0, "")
    header, rows, comments = table("plan.csv")
    assert header == ["joint1", "joint2", "joint3", "joint4"]
    assert len(rows) == 8
    assert comments[0] == f"# planned by: calib-pin {words}"
    assert result.out.endswith("wrote 8 configurations to plan.csv\n")
    assert max(map(len, result.out.splitlines())) <= 80
    assert run(f"{PLAN} --count 8 -o degrees.csv --degrees").status == 0
    assert table("degrees.csv")[0][0] == "joint1 [deg]"
    found = positions("degrees.csv")
    assert np.allclose(found, positions("plan.csv"), rtol=0, atol=1e-12)


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
    header, rows, _ = table("plan.csv")
    assert header == ["joint1", "joint2", "joint3", "joint4", "station", "tool"]
    places = [tuple(row[4:]) for row in rows]
    # One after another: an instrument is placed and a tool mounted once.
    assert len([place for place, _ in groupby(places)]) == len(set(places)) == 4
    simulate = "simulate arm.urdf --setup places.yaml"
    result = run(f"{simulate} --configurations plan.csv -o one.csv")
    assert (result.status, result.err) == (0, "")
    found = [*zip(column("one.csv", "station"), column("one.csv", "tool"), strict=True)]
    assert len(found) == 16 and set(found) == set(places)
    result = run(f"{words} --count 4 --add --to one.csv -o more.csv")
    assert (result.status, result.err) == (0, "")
    assert len(table("more.csv")[1]) == 4


def test_additions_to_several_files(here, run):
    result = run(f"{ADD} --count 4 --add --to rows.csv --to new.csv -o more.csv")
    assert (result.status, result.err) == (0, "")
    assert len(table("more.csv")[1]) == 4
    assert "addition to 65 measurements" in " ".join(result.out.split())
    # It starts with nothing: the table shows what is there already.
    (line,) = [line for line in result.out.splitlines() if line.startswith("0 ")]
    assert float(line.split()[1]) > 0.0


def test_validation_rows_are_not_counted(here, run, refuses):
    marked("rows.csv", 4)
    result = run(f"{ADD} --count 4 --add --to rows.csv -o more.csv")
    assert "in addition to 30 measurements" in " ".join(result.out.split())
    marked("new.csv", 1)
    refuses(f"{ADD} --count 3 --add --to new.csv -o most.csv", column="set")


def test_quiet(here, run):
    # Neither the table nor the remark on collisions.
    words = PLAN.replace("--ignore-collisions", "")
    result = run(f"{words} --count 8 -o plan.csv")
    assert result.status == 0 and "collision" in result.err
    result = run(f"{words} --count 8 -o quiet.csv --quiet")
    assert (result.status, result.out, result.err) == (0, "", "")
    assert positions("quiet.csv").tolist() == positions("plan.csv").tolist()


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
    assert table("mapped.csv")[0] == ["A1", "A2", "A3", "joint4", "track"]
    assert not numbers("mapped.csv")[:, 4].any()
    found = positions("mapped.csv", joints=read_setup("mapped.yaml").joints)
    np.testing.assert_allclose(found, positions("plan.csv"), atol=1e-12)


@pytest.mark.parametrize("names", [{"wall"}, {"wall", "floor"}])
def test_configurations_that_name_planes_are_what_the_next_commands_take(
    names, here, run
):
    if "floor" in names:
        with Path("plane.yaml").open("a") as file:
            file.write("  floor: {normal: [0.1, 0, 1], offset: 0.3}\n")
    about = "arm.urdf --setup plane.yaml"
    assert run(f"plan {about} {QUICK} --count 30 -o plan.csv").status == 0
    # Which plane is told even where there is one: others may come later.
    targets = column("plan.csv", "target")
    assert set(targets) == names
    result = run(
        f"simulate {about} --configurations plan.csv --noise 1e-4 "
        "--errors errors.yaml -o measured.csv"
    )
    assert (result.status, result.err) == (0, "")
    # Each configuration looks at the plane that it was planned for.
    assert column("measured.csv", "target") == targets
    result = run("calibrate arm.urdf measured.csv --setup plane.yaml")
    assert result.status == 0 and result.out.startswith("GOOD: ")
    # The plan promised what the fit then knew.
    words = f"plan {about} {QUICK} --count 4 --add --to measured.csv -o a.csv"
    assert run(words).status == 0
    assert set(column("a.csv", "target")) <= names


def test_obstacles_region_and_limits_of_the_setup_file(here, run):
    Path("boxes.urdf").write_text(BOXES)
    Path("cell.yaml").write_text(CELL)
    words = (
        "plan boxes.urdf --model position --setup cell.yaml --count 8 --candidates 60 "
        "--method exchange -o plan.csv"
    )
    result = run(words)
    assert (result.status, result.err) == (0, "")
    assert "No configuration" in result.out and "collide" in result.out
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


# --- what cannot be ----------------------------------------------------------------

UNDOABLE = """joints:
  A1: {joint: joint1, coupled: {A2: 1}}
  A2: {joint: joint2, coupled: {A1: 1}}
"""
EARLY = [
    # Further words, the end of the setup file, and what the refusal names.
    ("--criterion condtion", "", "'condtion'"),
    ("--method exchnge", "", "'exchnge'"),
    ("", UNDOABLE, "couplings"),
    ("", "joints: {' A1': {joint: joint1}}\n", "' A1'"),
    ("", "planes: {' w': {normal: [1, 0, 0], offset: -2}}\n", "' w'"),
]


@pytest.mark.parametrize(("words", "text", "named"), EARLY)
def test_what_no_search_could_change_is_said_before_it(
    words, text, named, here, fails, monkeypatch
):
    Path("bad.yaml").write_text("parameters: [joint-offset]\n" + text)

    def late(*args: object, **options: object) -> None:
        raise AssertionError("too late")

    monkeypatch.setattr("calib_pin.io.collision.load_collisions", late)
    monkeypatch.setattr("calib_pin.planning.plan.plan", late)
    model = "plane-distance" if "planes" in text else "position"
    plan = f"plan arm.urdf --model {model} --setup bad.yaml --count 8 -o out.csv"
    fails(f"{plan} {words}", named)


BOX = (
    "plan boxes.urdf --model position --parameters joint-offset --candidates 50 "
    "--count 8 -o out.csv"
)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (f"{BOX} --setup swallowed.yaml", "collision"),
        (f"{BOX} --srdf other.srdf", "other.srdf"),
        (BOX.replace("boxes", "mesh"), "mesh.urdf:3"),
    ],
)
def test_solids_that_nothing_can_be_planned_with(words, named, here, fails):
    srdf = '<robot name="crates"><disable_collisions link1="a" link2="b"/></robot>'
    mesh = BOXES.replace(
        '<box size="0.2 0.2 0.4"/>', '<mesh filename="package://x/b"/>'
    )
    obstacle = "obstacles: [{sphere: 0.35, xyz: [0, 0, 0.5]}]\n"
    files = {"swallowed.yaml": obstacle, "other.srdf": srdf}
    for file, text in {**files, "boxes.urdf": BOXES, "mesh.urdf": mesh}.items():
        Path(file).write_text(text)
    fails(words, named)
