"""`calibrate --start` and `plan --start`, from files to files."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest

from calib_pin.cli import main
from calib_pin.cli.jobs import read_jobs, request_of
from calib_pin.io.results import read_result
from calib_pin.setup import JointPrior
from tests.cli.files import document, planned_uncertainty, undrawn

ERRORS = """\
joint_2.placement.x: 0.8e-3
joint_3.placement.rz: 2.0e-3
joint_4.placement.y: -0.6e-3
joint_5.placement.rx: 1.5e-3
"""

SIMULATE = "simulate space6 --model position --errors"


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Path:
    """A calibrated robot, ten measurements of a later day, ten behind a collision."""
    folder = tmp_path_factory.mktemp("robot")
    (folder / "errors.yaml").write_text(ERRORS)
    (folder / "hit.yaml").write_text(ERRORS.replace("2.0e-3", "3.5e-3"))
    with chdir(folder), undrawn():
        for words in (
            f"{SIMULATE} errors.yaml --count 40 --seed 1 -o first.csv",
            f"{SIMULATE} errors.yaml --count 10 --seed 2 -o later.csv",
            f"{SIMULATE} hit.yaml --count 10 --seed 3 -o hit.csv",
            f"{SIMULATE} errors.yaml --count 6 --seed 5 -o few.csv",
            "simulate space7 --model position --count 10 -o other.csv",
            "calibrate space6 first.csv -o first",
            "calibrate space6 later.csv --start first -o later",
            "calibrate space6 few.csv -o few",
        ):
            expected = 2 if words.endswith("-o few") else 0
            assert main(words.split()) == expected
    return folder


@pytest.fixture(autouse=True)
def there(robot, tmp_path, monkeypatch) -> None:
    shutil.copytree(robot, tmp_path / "robot")
    monkeypatch.chdir(tmp_path / "robot")


def test_the_older_calibration_holds(run) -> None:
    stated = document("later")
    assert stated["verdict"]["status"] == "good"
    assert stated["setup"]["prior"]["format"] == "calib-pin/robot-prior"
    assert stated["findings"][0]["code"] == "old-calibration-holds"
    (step,) = stated["recalibration"]["steps"]
    assert step["start"] == "first/calibration.json" and step["measurements"] == 10
    there = read_result("later")
    assert isinstance(there.model.setup.prior, JointPrior)
    assert there.recalibration.last.drifts[0].worth > 0.0
    page = Path("later/report.html").read_text()
    assert run("report later --force").status == 0
    assert Path("later/report.html").read_text() == page


def test_a_collision_is_told_in_the_chain(run) -> None:
    words = "calibrate space6 hit.csv --start later/calibration.json -o hit --details"
    found = run(words)
    assert found.status == 0 and "'joint_3'" in found.out
    there = read_result("hit").recalibration
    assert [len(step.jumps) for step in there.steps] == [0, 1]
    assert there.last.jumps[0].change == pytest.approx(1.5e-3, abs=3e-4)
    assert run("compare later/calibration.json hit/calibration.json").status == 0


def test_a_plan_for_it(run) -> None:
    """Model, frames and noise are those that the older calibration has found."""
    words = "plan space6 --count 10 --method greedy --candidates 200"
    told = run(f"{words} --start first -o ten.csv").out
    plain = run(f"{words} --model position -o plain.csv").out
    assert "is assumed" not in told and "is assumed" in plain
    assert planned_uncertainty(told) < 0.6 * planned_uncertainty(plain)
    assert len(np.loadtxt("ten.csv", delimiter=",", skiprows=2)) == 10


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("space6 first.csv --start first", "twice"),
        ("space6 later.csv --start first --model-ladder", "selected"),
        ("space6 later.csv --start first --learned network", "learned"),
        ("space6 later.csv --start first --parameters dh", "parameters"),
        ("space6 later.csv --start first --process-noise 1", "--process-noise"),
        ("space6 later.csv --process-noise 1e-5", "needs --start"),
        ("space6 later.csv --start first.csv", "first.csv"),
        ("space6 later.csv --start nowhere", "nowhere"),
        ("space6 hit.csv --start first -o first --force", "input"),
        ("space7 other.csv --start first", "robot"),
        ("space6 later.csv --start few", "few"),
    ],
)
def test_refusals(words, named, fails) -> None:
    fails(f"calibrate {words}", named)


def test_rows_are_watched_by_the_older_calibration(run) -> None:
    os.utime("later.csv", (1, 1))
    expected = []
    for words in ("--tip tool", "--start first"):
        lines = run(f"watch space6 later.csv --once --json {words}").out.splitlines()
        (state,) = (one for one in map(json.loads, lines) if one["kind"] == "state")
        expected.append(state["workspace"])
    assert expected[1] < 0.5 * expected[0]


def test_measurements_that_frames_use_up_are_refused(fails) -> None:
    lines = Path("later.csv").read_text().splitlines(keepends=True)
    Path("three.csv").write_text("".join(lines[:5]))
    fails("calibrate space6 three.csv --start first", "three.csv", "used up by the 9")


def test_the_corrected_robot_is_not_the_nominal_one(fails) -> None:
    fails("calibrate first/space6.urdf later.csv --start first", "nominal.urdf")


@pytest.mark.slow
def test_a_fleet_goes_on(run, inside) -> None:
    """In the order of days, whatever that of the lines is; also with a later table."""
    Path("jobs.csv").write_text(
        "robot,measurements,serial_number,date,start,process_noise\n"
        "space6,hit.csv,A,2026-07-01,previous,\n"
        "space6,later.csv,A,2026-06-01,first,1e-5\n"
        "space6,hit.csv,B,2026-06-01,previous,\n"
    )
    words = "fleet jobs.csv -o out --no-pages --workers 1"
    assert "calibration of 'B'" in run(words).out.replace("\n", " ")
    june, july = (document(f"out/A-2026-0{month}-01") for month in (6, 7))
    (step,) = june["recalibration"]["steps"]
    assert step["start"].endswith("first/calibration.json")
    assert step["drifts"][0]["size"] == 1e-5
    assert [len(s["jumps"]) for s in july["recalibration"]["steps"]] == [0, 1]
    there = Path("out", "A-2026-07-01", "calibration.json")
    kept = there.stat().st_mtime_ns
    run(f"{words} --resume")
    assert there.stat().st_mtime_ns == kept
    Path("more.csv").write_text(
        "robot,measurements,serial_number,date,start\n"
        "space6,later.csv,A,2026-08-01,previous\n"
    )
    (job,) = read_jobs("more.csv")
    assert request_of(job, Path("out")).start == Path("out/A-2026-07-01")
