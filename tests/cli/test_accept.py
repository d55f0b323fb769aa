"""`accept`: what it prints and writes, and visits that are no test."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.io.measurements import encode_table

LIMITS = "tip: tool\nlimit: {position: 5.0e-4, repeatability: 2.0e-4}\n"


@pytest.fixture
def visits(here) -> None:
    """Thirty cycles of five poses of the robot that `rows.csv` is of."""
    chain = calib_pin.load_chain("arm.urdf", tip="tool")
    rng = np.random.default_rng(0)
    q = np.tile(0.5 * chain.random_configurations(5, rng), (30, 1))
    moved = q + np.array([0.0, 4e-3, -6e-3, 0.0])
    points = chain.poses(moved)[:, :3, 3] + rng.normal(0.0, 1e-5, (150, 3))
    table = dict(zip(chain.joints, q.T, strict=True))
    table |= dict(zip("xyz", points.T, strict=True))
    Path("visits.csv").write_bytes(encode_table(table, []))
    Path("limits.yaml").write_text(LIMITS)


ACCEPT = "accept arm.urdf visits.csv --setup limits.yaml"


def test_a_robot_is_tested(visits, run):
    result = run(f"{ACCEPT} -o out")
    assert result.status == 2 and result.err == ""
    lines = result.out.splitlines()
    assert lines[0].startswith("FAIL: AP ") and "the limit is 0.5000 mm." in lines[0]
    assert lines[1].startswith("PASS: RP ")
    assert "150 visits of 5 poses; base and tool registered" in result.out
    document = json.loads(Path("out/acceptance.json").read_text())
    assert document["format"] == "calib-pin/acceptance"
    assert [one["status"] for one in document["limits"]] == ["fail", "pass"]
    poses = document["tests"]["robot"]["poses"]
    assert [pose["visits"] for pose in poses] == [30] * 5
    rows = Path("out/acceptance.csv").read_text().splitlines()
    assert float(rows[2].split(",")[3]) == poses[0]["accuracy"]["value"]


def test_a_calibration_is_tested_beside_the_nominal_robot(visits, run):
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o out").status == 0
    result = run("accept out/calibration.json visits.csv --register")
    assert "Poses, nominal" in result.out and "Poses, calibrated" in result.out


def test_a_calibration_has_its_own_setup_but_the_limits(visits, run):
    """Of a setup that it has already nothing is passed over in silence."""
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o out").status == 0
    accept = "accept out/calibration.json visits.csv --setup limits.yaml"
    assert "a calibration has its own setup" in run(accept).err
    Path("limits.yaml").write_text(LIMITS.partition("\n")[2])
    result = run(accept)
    assert "the limit is 0.5000 mm" in result.out and result.err == ""


def test_what_is_within_its_limits_is_accepted(visits, run):
    Path("limits.yaml").write_text(LIMITS.replace("5.0e-4", "0.1"))
    assert run(ACCEPT).status == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("accept arm.urdf rows.csv --tip tool", "no pose was visited 3 times"),
        ("accept arm.urdf visits.csv --tip tool --model camera", "camera"),
        ("accept arm.urdf none.csv --tip tool", "no such file"),
        (f"{ACCEPT} -o visits.csv", "folder"),
        ("accept arm.urdf visits.csv visits.csv --tip tool", "given twice"),
    ],
)
def test_what_is_no_test_is_told(visits, run, listing, words, text):
    before = listing(Path.cwd())
    result = run(words)
    assert (result.status, result.out) == (1, "")
    assert text in result.err and result.err.count("\n") == 1
    assert listing(Path.cwd()) == before


def test_a_path_is_its_worst_point(visits, run):
    result = run(f"{ACCEPT} --path -o out")
    assert result.out.startswith("FAIL: AT ") and "\nPASS: RT " in result.out
    document = json.loads(Path("out/acceptance.json").read_text())
    poses = document["tests"]["robot"]["poses"]
    row = next(line for line in result.out.splitlines() if line.startswith("robot "))
    assert row.split()[1] == "5"
    for at, key in ((2, "accuracy"), (6, "repeatability")):
        worst = max(pose[key]["value"] for pose in poses)
        assert float(row.split()[at]) == pytest.approx(1e3 * worst, rel=1e-3)
