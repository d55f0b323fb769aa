"""`calibrate --start` and `plan --start`, from files to files."""

from __future__ import annotations

import json
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest

from calib_pin.cli import main
from calib_pin.io.result_file import read_result
from calib_pin.setup import JointPrior

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
    for words in (
        f"{SIMULATE} errors.yaml --count 40 --seed 1 -o first.csv",
        f"{SIMULATE} errors.yaml --count 10 --seed 2 -o later.csv",
        f"{SIMULATE} hit.yaml --count 10 --seed 3 -o hit.csv",
        "calibrate space6 first.csv -o first",
        "calibrate space6 later.csv --start first -o later",
    ):
        with chdir(folder):
            assert main(words.split()) == 0
    return folder


@pytest.fixture(autouse=True)
def there(robot, monkeypatch) -> None:
    monkeypatch.chdir(robot)


def test_the_older_calibration_holds(robot, run) -> None:
    document = json.loads((robot / "later" / "calibration.json").read_text())
    assert document["verdict"]["status"] == "good"
    assert document["setup"]["prior"]["format"] == "calib-pin/robot-prior"
    assert document["findings"][0]["code"] == "old-calibration-holds"
    (step,) = document["recalibration"]["steps"]
    assert step["start"] == "first/calibration.json" and step["measurements"] == 10
    there = read_result(robot / "later")
    assert isinstance(there.model.setup.prior, JointPrior)
    assert there.recalibration.last.drifts[0].worth > 0.0
    page = (robot / "later" / "report.html").read_text()
    assert "by the older calibration" in page and "still holds" in page
    again = run("report later --force")
    assert again.status == 0
    assert (robot / "later" / "report.html").read_text() == page


def test_a_collision_is_told_in_the_chain(robot, run) -> None:
    words = "calibrate space6 hit.csv --start later/calibration.json -o hit"
    found = run(words)
    assert found.status == 0
    told = " ".join(found.out.split())
    assert "no longer holds" in told
    assert "the offset of 'joint_3' has changed by" in told
    there = read_result(robot / "hit").recalibration
    assert [len(step.jumps) for step in there.steps] == [0, 1]
    assert there.last.jumps[0].change == pytest.approx(1.5e-3, abs=3e-4)
    details = run(f"{words}2 --details").out
    assert "Calibrations since the first one" in details and "joint_3" in details
    compared = " ".join(
        run("compare later/calibration.json hit/calibration.json").out.split()
    )
    assert "B began with A" in compared


def test_a_plan_for_it(robot, run) -> None:
    words = "plan space6 --model position --count 10 --method greedy --json"
    told = json.loads(run(f"{words} --start first -o ten.csv").out)
    plain = json.loads(run(f"{words} -o plain.csv").out)
    assert told["predicted"]["position"] < 0.6 * plain["predicted"]["position"]
    assert len(np.loadtxt(robot / "ten.csv", delimiter=",", skiprows=2)) == 10


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("first.csv --start first", "would count twice"),
        ("later.csv --start first --model-ladder", "not selected anew"),
        ("later.csv --start first --learned network", "learned correction"),
        ("later.csv --start first --parameters dh", "other parameters"),
        ("later.csv --start first --process-noise 1", "--process-noise cannot be"),
        ("later.csv --process-noise 1e-5", "belongs to an older calibration"),
        ("later.csv --start first.csv", "not a calibration"),
        ("later.csv --start nowhere", "nowhere: no such file"),
        ("hit.csv --start first -o first --force", "is an input of this run"),
    ],
)
def test_refusals(words, said, robot, run) -> None:
    found = run(f"calibrate space6 {words}")
    assert found.status == 1 and found.out == ""
    assert said in found.err and len(found.err.strip().splitlines()) == 1


def test_another_robot_and_an_untrusted_start(robot, run) -> None:
    simulated = "simulate space7 --model position --count 30 -o other.csv"
    assert run(simulated).status == 0
    found = run("calibrate space7 other.csv --start first")
    assert found.status == 1 and "not of this robot" in found.err
    few = f"{SIMULATE} errors.yaml --count 6 --seed 5 -o few.csv"
    assert run(few).status == 0
    assert run("calibrate space6 few.csv -o few").status == 2
    found = run("calibrate space6 later.csv --start few")
    assert found.status == 1 and "is no start" in found.err
    assert len(found.err.strip().splitlines()) == 1
