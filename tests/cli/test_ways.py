"""`compensate --avoid-collisions`: ways around obstacles, and what it says of them."""

from __future__ import annotations

import json
import shutil
from contextlib import chdir
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib_pin.cli import main
from calib_pin.io.collision import load_collisions
from calib_pin.io.results import read_calibration
from calib_pin.planning.travel import Ways
from calib_pin.setup import Obstacle
from tests.cli.files import table, write

JOINTS = [f"joint{k}" for k in range(1, 5)]
BALL = Obstacle(sphere=0.12, xyz=(0.77, 0.0, 0.2))
Q = np.array([[-0.6, 0.3, 0.2, 0.1], [0.6, 0.3, 0.2, 0.1], [0.7, -0.2, 0.5, 0.0]])

RUN = "compensate solid/calibration.json targets.csv --setup ball.yaml -o commands.csv"
AVOID = f"{RUN} --avoid-collisions"
PLAN = (
    "plan solid.urdf --tip tool --model position --count 10 --method greedy "
    "--candidates 60 --setup ball.yaml -o plan.csv"
)


@pytest.fixture(scope="module")
def cell(workshop, tmp_path_factory):
    """A calibration of the small robot with solid links, and a ball in its way."""
    folder = tmp_path_factory.mktemp("ways") / "work"
    shutil.copytree(workshop, folder)
    with chdir(folder):
        made()
    return folder


@pytest.fixture
def solid(cell, tmp_path, monkeypatch):
    """A copy of it, as the working folder, and its model."""
    folder = tmp_path / "cell"
    shutil.copytree(cell, folder)
    monkeypatch.chdir(folder)
    return read_calibration("solid/calibration.json").of()


def made() -> None:
    rod = '<link name="{}"><collision><origin xyz="{} 0 0"/><geometry><box size='
    text = Path("arm.urdf").read_text()
    for link, length in (("link2", 0.5), ("link3", 0.4), ("link4", 0.16)):
        box = f'"{length - 0.1} 0.06 0.06"/></geometry></collision></link>'
        body = rod.format(link, length / 2) + box
        text = text.replace(f'<link name="{link}"/>', body)
    Path("solid.urdf").write_text(text)
    words = "calibrate solid.urdf rows.csv --setup setup.yaml -o solid --quiet"
    assert main(words.split()) == 0
    ball = {"obstacles": [{"sphere": 0.12, "xyz": [*BALL.xyz]}]}
    Path("ball.yaml").write_text(yaml.safe_dump(ball))
    model = read_calibration("solid/calibration.json").of()
    write("targets.csv", "x,y,z", model.poses(Q)[:, :3, 3])


def touches(model, q: np.ndarray) -> bool:
    """Whether anything touches on straight ways that are cut very finely."""
    bare = load_collisions(model.chain, [BALL], clearance=0.0)
    parts = np.linspace(0.0, 1.0, 1000)[:, None]
    ways = pairwise(q)
    return not all(bare.free(a + parts * (b - a)).all() for a, b in ways)


def commands() -> tuple[np.ndarray, list[str]]:
    header, rows, _ = table("commands.csv")
    assert header == [*JOINTS, "row"]
    return np.array([row[:4] for row in rows], float), [row[4] for row in rows]


def test_via_configurations_lead_around(solid, run):
    straight = run(RUN.replace("--setup ball.yaml ", ""))
    assert straight.status == 0
    assert touches(solid, commands()[0])
    result = run(f"{AVOID} --force --json")
    assert (result.status, result.err) == (0, "")
    q, rows = commands()
    assert not touches(solid, q)
    assert [row for row in rows if row] == ["3", "4", "5"]
    assert rows[0] and rows[-1] and "" in rows
    reached = solid.poses(q[[row != "" for row in rows]])[:, :3, 3]
    np.testing.assert_allclose(reached, solid.poses(Q)[:, :3, 3], atol=1e-9)
    chain = solid.chain
    assert ((q >= chain.lower) & (q <= chain.upper)).all()
    document = json.loads(result.out)
    vias = rows.count("")
    assert document["collisions"] == {"vias": vias, "colliding": [], "blocked": []}


def test_programs_take_the_same_way(solid, run):
    assert run(AVOID).status == 0
    words = AVOID.replace("commands.csv", "way.yaml")
    assert run(f"{words} --format joint-trajectory").status == 0
    points = yaml.safe_load(Path("way.yaml").read_text())["points"]
    np.testing.assert_array_equal([p["positions"] for p in points], commands()[0])


def test_a_target_in_an_obstacle_is_left_out(solid, run):
    targets = solid.poses(Q)[:, :3, 3]
    write("targets.csv", "x,y,z", [*targets, BALL.xyz])
    result = run(AVOID)
    assert result.status == 2
    assert [row for row in commands()[1] if row] == ["3", "4", "5"]
    assert run(f"{AVOID} --force --quiet").err.endswith("targets.csv, line 6\n")


def test_where_no_way_is_free_nothing_is_written(solid, run, withholds, monkeypatch):
    monkeypatch.setattr(Ways, "around", lambda *about: None)
    assert "lines 4, 5" in " ".join(withholds(AVOID).out.split())
    result = run(f"{PLAN} --motion motion.csv")
    assert result.status == 2
    lines = ", ".join(map(str, range(4, 13)))
    assert f"plan.csv, lines {lines}" in result.err
    assert Path("plan.csv").exists() and not Path("motion.csv").exists()


def test_a_motion_is_checked_and_stays(solid, run, withholds):
    part = np.linspace(0.0, 1.0, 15)[:, None]
    write("targets.csv", ",".join(JOINTS), Q[0] + part * (Q[1] - Q[0]))
    withholds(AVOID)
    write("targets.csv", ",".join(JOINTS), Q[1] + part * (Q[2] - Q[1]))
    assert run(AVOID).status == 0


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (RUN, "ball.yaml"),
        (f"{RUN.replace('--setup ball.yaml', '')} --clearance 0.1", "--clearance"),
        (f"{AVOID} --clearance 2", "0 to 1 m"),
        (f"{AVOID} --srdf none.srdf", "none.srdf"),
        (AVOID.replace("solid/", "done/"), "URDF"),
        (f"{PLAN} --motion motion.csv".replace("solid.urdf", "arm.urdf"), "URDF"),
        (f"{PLAN} --motion motion.csv --ignore-collisions", "--ignore-collisions"),
        (f"{PLAN} --motion plan.csv", "plan.csv"),
    ],
)
def test_wrong_ways_to_ask(solid, fails, words, named):
    fails(words, named)


def test_the_motion_of_a_plan(solid, run, monkeypatch):
    # The order of a plan itself avoids what is in the way.
    as_found = "calib_pin.planning.travel.shortest_order"
    monkeypatch.setattr(as_found, lambda q, *about: (np.arange(len(q)), ()))
    assert run(f"{PLAN} --motion motion.csv").status == 0
    header, rows, comments = table("motion.csv")
    assert header == [*JOINTS, "row"]
    assert comments[0].startswith("# motion of: calib-pin plan solid.urdf")
    q = np.array([row[:4] for row in rows], float)
    assert not touches(solid, q)
    # Those of the plan, by their lines, among configurations around the ball.
    lines = Path("plan.csv").read_text().splitlines()
    named = {int(row[4]): row[:4] for row in rows if row[4]}
    assert named == {k: line.split(",") for k, line in enumerate(lines, 1) if k > 2}
    planned = [row[4] != "" for row in rows]
    assert planned.count(False) >= 1
    assert touches(solid, q[planned])
