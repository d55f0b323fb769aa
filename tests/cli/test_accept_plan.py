"""`plan --accept`: from the plan through the measured visits to the test itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.results import read_calibration
from tests.cli.files import document, table, write

PLAN = "plan arm.urdf --tip tool --accept --ignore-collisions -o visits.csv"


def filled(model, error: np.ndarray, noise: float) -> dict[str, float]:
    """Fill in what a robot with other joint offsets does; its error by pose."""
    header, rows, _ = table("visits.csv")
    q = np.radians(np.array([row[:4] for row in rows], float))
    rng = np.random.default_rng(0)
    wrong, right = (model.poses(at)[:, :3, 3] for at in (q + error, q))
    points = 1e3 * (wrong + noise * rng.standard_normal(wrong.shape))
    place = header.index("x [mm]")
    for row, point in zip(rows, points.tolist(), strict=True):
        row[place : place + 3] = [str(value) for value in point]
    write("visits.csv", ",".join(header), rows)
    names = [row[header.index("pose")] for row in rows]
    away = np.linalg.norm(wrong - right, axis=1)
    return dict(zip(names, away.tolist(), strict=True))


@pytest.mark.slow
def test_from_the_plan_to_the_test(here, run):
    Path("two.yaml").write_text(TWO)
    words = PLAN.replace("--tip tool", "--setup two.yaml --chain b")
    result = run(f"{words} --degrees --cycles 4")
    assert (result.status, result.err) == (0, "")
    assert "calib-pin accept arm.urdf visits.csv" in result.out
    assert max(map(len, result.out.splitlines())) <= 80 and result.out.isascii()
    # The schedule is in the file as well.
    comments = Path("visits.csv").read_text().replace("# ", "").replace("#", "")
    assert result.out.rsplit("\nwrote", 1)[0] in comments
    header, rows, _ = table("visits.csv")
    assert header[0] == "joint1 [deg]" and len(rows) == 20
    assert [row[4:6] for row in rows[4:6]] == [["1", "P1"], ["2", "P5"]]
    model = read_calibration("done/calibration.json").of()
    errors = filled(model, np.array([0.0, 1e-3, -1e-3, 0.0]), 1e-6)
    tested = run("accept done/calibration.json visits.csv -o out")
    assert tested.status in (0, 2)
    poses = document("out/acceptance.json")["tests"]["calibrated"]["poses"]
    assert [pose["visits"] for pose in poses] == [4] * 5
    found = [pose["accuracy"]["value"] for pose in poses]
    assert list(errors) == ["P5", "P4", "P3", "P2", "P1"]
    # Four visits of 1 um each.
    np.testing.assert_allclose(found, list(errors.values()), atol=4e-6)
    assert min(found) > 1e-4


TWO = "chains: {a: {tip: link3}, b: {tip: tool}}\n"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (f"{PLAN} --count 3", "--count"),
        (f"{PLAN} --model pose", "--model"),
        (f"{PLAN} --cycles 2", "3 to 1000"),
        (f"{PLAN} --clearance 0.1", "--clearance"),
        (PLAN.replace("--accept", "--model position --count 8 --cycles 5"), "--accept"),
        (PLAN.replace("visits.csv", "arm.urdf"), "arm.urdf"),
        (PLAN.replace("--tip tool", "--setup two.yaml"), "--chain"),
    ],
)
def test_what_cannot_be_planned(here, fails, words, named):
    Path("two.yaml").write_text(TWO)
    fails(words, named)


@pytest.mark.slow
def test_a_robot_of_six_joints_keeps_its_orientation(here, run):
    words = "plan space6 --accept -o visits.csv --ignore-collisions --cycles 3"
    result = run(words)
    assert result.status == 0
    assert "roll " in result.out
    assert "- 0.0" not in result.out and " -0.0 " not in result.out
