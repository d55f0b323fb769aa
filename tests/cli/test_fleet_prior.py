"""`prior: fleet.json` in a setup file, from the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import calib_pin
from calib_pin.io.json_text import encode
from calib_pin.io.results import read_result
from calib_pin.io.setup import prior_document
from calib_pin.setup import PopulationPrior
from calib_pin.validation.robot_state import robot_evidence
from tests.cli.files import document

CALIBRATE = "calibrate space6 rows.csv --setup setup.yaml -o out"


@pytest.fixture
def bench(fleet, tmp_path, monkeypatch) -> Path:
    """Measurements of one more robot, and the prior of its fleet."""
    monkeypatch.chdir(tmp_path)
    data, _ = fleet.measured(600, 12)
    calib_pin.write_measurements("rows.csv", data)
    prior = fleet.population.prior()
    Path("fleet.json").write_bytes(encode(prior_document(prior)))
    Path("setup.yaml").write_text("prior: fleet.json\n")
    return tmp_path


def test_few_measurements_are_enough(bench, run) -> None:
    """Verdict and folder: the latter holds the prior and tells fleets no more."""
    assert run(f"{CALIBRATE} --details").status == 0
    stated = document("out")
    assert stated["verdict"]["status"] == "good"
    assert stated["setup"]["prior"]["format"] == "calib-pin/fleet-prior"
    # What the measurements tell, whatever the prior holds.
    found = stated["identifiability"]
    assert found["rank"] + found["weak"] == found["structural_rank"]
    Path("fleet.json").unlink()
    there = read_result("out")
    assert isinstance(there.model.setup.prior, PopulationPrior)
    assert len(robot_evidence(there).values) < len(robot_evidence(there).names)


def test_priors_of_others(bench, fleet, fails) -> None:
    """Of another robot, of other parameters, and of the same robot otherwise made."""
    fails(CALIBRATE.replace("space6", "space7"))
    fails(f"{CALIBRATE} --parameters dh", "parameters")
    prior = fleet.population.prior()
    first = replace(prior.robot.joints[1], axis=(0.0, 0.6, 0.8))
    joints = (prior.robot.joints[0], first, *prior.robot.joints[2:])
    other = replace(prior, robot=replace(prior.robot, joints=joints))
    Path("fleet.json").write_bytes(encode(prior_document(other)))
    fails(CALIBRATE, "fleet.json", "'space6'", "axis")


def test_a_plan_knows_it(bench, run) -> None:
    words = "plan space6 --model position --count 12 --json -o plan.csv"
    words += " --method greedy --candidates 200"
    plain = json.loads(run(words).out)
    told = json.loads(run(f"{words} --setup setup.yaml --force").out)
    assert told["predicted"]["position"] < 0.95 * plain["predicted"]["position"]
