"""`plan --accept`: from the plan through the measured visits to the test itself."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.results import read_calibration

PLAN = "plan arm.urdf --tip tool --accept --ignore-collisions -o visits.csv"


def filled(model, error: np.ndarray, noise: float) -> dict[str, float]:
    """Fill in what a robot with other joint offsets does; its error by pose."""
    lines = Path("visits.csv").read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    header, *rows = csv.reader(lines[len(comments) :])
    degrees = "[deg]" in header[0]
    q = np.array([row[:4] for row in rows], float)
    q = np.radians(q) if degrees else q
    rng = np.random.default_rng(0)
    wrong, right = (model.poses(at)[:, :3, 3] for at in (q + error, q))
    points = 1e3 * (wrong + noise * rng.standard_normal(wrong.shape))
    place = header.index("x [mm]")
    for row, point in zip(rows, points, strict=True):
        row[place : place + 3] = [str(value) for value in point]
    text = [*comments, ",".join(header), *(",".join(row) for row in rows)]
    Path("visits.csv").write_text("\n".join(text) + "\n")
    names = [row[header.index("pose")] for row in rows]
    away = np.linalg.norm(wrong - right, axis=1)
    return dict(zip(names, away.tolist(), strict=True))


@pytest.mark.parametrize("degrees", ["", "--degrees"])
def test_from_the_plan_to_the_test(here, run, degrees):
    result = run(f"{PLAN} {degrees}")
    assert (result.status, result.err) == (0, "")
    assert "positions only" in result.out
    assert "30 cycles of P5, P4, P3, P2, P1" in result.out
    assert "calib-pin accept arm.urdf visits.csv --tip tool" in result.out
    assert result.out.endswith("wrote 150 visits to visits.csv\n")
    assert max(map(len, result.out.splitlines())) <= 80
    assert result.out.isascii()
    # The schedule is in the file as well.
    comments = Path("visits.csv").read_text().replace("# ", "").replace("#", "")
    assert result.out.rsplit("\nwrote", 1)[0] in comments
    model = read_calibration("done/calibration.json").of()
    errors = filled(model, np.array([0.0, 1e-3, -1e-3, 0.0]), 1e-6)
    tested = run("accept done/calibration.json visits.csv -o out")
    assert tested.status in (0, 2)
    document = json.loads(Path("out/acceptance.json").read_text())
    poses = document["tests"]["calibrated"]["poses"]
    assert [pose["visits"] for pose in poses] == [30] * 5
    found = [pose["accuracy"]["value"] for pose in poses]
    assert list(errors) == ["P5", "P4", "P3", "P2", "P1"]
    # Thirty visits of 1 um each.
    np.testing.assert_allclose(found, list(errors.values()), atol=2e-6)
    assert min(found) > 1e-4


def test_cycles_and_the_same_again(here, run):
    assert run(f"{PLAN} --cycles 4").status == 0
    first = Path("visits.csv").read_bytes()
    rows = [r for r in first.decode().splitlines() if not r.startswith("#")]
    assert len(rows) == 1 + 20
    assert [row.split(",")[4:6] for row in rows[5:7]] == [["1", "P1"], ["2", "P5"]]
    assert run(f"{PLAN} --cycles 4 --force --quiet").out == ""
    again = Path("visits.csv").read_bytes().splitlines()
    assert again[1:] == first.splitlines()[1:]


BOX = "region: {box: [[0.3, 0.2, 0.3], [0.5, 0.4, 0.5]]}\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (f"{PLAN} --count 3", "without --count"),
        (f"{PLAN} --criterion O1", "without --criterion"),
        (f"{PLAN} --model pose", "without --model"),
        (f"{PLAN} --cycles 2", "3 to 1000"),
        (f"{PLAN} --clearance 0.1", "contradicts"),
        (PLAN.replace("--accept", "--model position --count 8 --cycles 5"), "--accept"),
        (f"{PLAN} --setup box.yaml", "no cube of 250 mm"),
        (PLAN.replace("visits.csv", "arm.urdf"), "arm.urdf"),
    ],
)
def test_what_cannot_be_planned(here, run, listing, words, said):
    Path("box.yaml").write_text(BOX)
    before = listing(here)
    result = run(words)
    assert (result.status, result.out) == (1, "")
    assert said in result.err and result.err.count("\n") == 1
    assert listing(here) == before


def test_a_robot_of_six_joints_keeps_its_orientation(here, run):
    result = run("plan space6 --accept -o visits.csv --ignore-collisions --cycles 3")
    assert result.status == 0
    assert "roll " in result.out and "positions only" not in result.out
    assert "- 0.0" not in result.out and " -0.0 " not in result.out
    assert "wrote 15 visits" in result.out


def test_an_acceptance_test_is_of_one_chain(here, run):
    Path("two.yaml").write_text("chains: {a: {tip: link3}, b: {tip: tool}}\n")
    words = PLAN.replace("--tip tool", "--setup two.yaml")
    assert "say which one with --chain" in run(words).err
    result = run(f"{words} --chain b --cycles 3")
    assert (result.status, result.err) == (0, "")
