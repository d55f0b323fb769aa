"""`prior: fleet.json` in a setup file, from the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import calib_pin
from calib_pin.io.population_prior import write_population_prior
from calib_pin.io.result_file import read_result
from calib_pin.setup import PopulationPrior
from calib_pin.validation.population_evidence import robot_evidence

CALIBRATE = "calibrate space6 rows.csv --setup setup.yaml -o out"


@pytest.fixture
def bench(fleet, tmp_path, monkeypatch) -> Path:
    """Measurements of one more robot, and the prior of its fleet."""
    monkeypatch.chdir(tmp_path)
    data, _ = fleet.measured(600, 12)
    calib_pin.write_measurements("rows.csv", data)
    prior = fleet.population.prior()
    write_population_prior(prior, "fleet.json")
    Path("setup.yaml").write_text("prior: fleet.json\n")
    return tmp_path


def test_few_measurements_are_enough(bench, run) -> None:
    """Verdict, page and folder: the latter holds the prior and tells fleets no more."""
    result = run(f"{CALIBRATE} --details")
    assert result.status == 0 and "by 16 robots of this type" in result.out
    document = json.loads(Path("out/calibration.json").read_text())
    assert document["verdict"]["status"] == "good"
    assert document["setup"]["prior"]["format"] == "calib-pin/fleet-prior"
    # What the measurements tell, whatever the prior holds.
    found = document["identifiability"]
    assert found["rank"] + found["weak"] == found["structural_rank"]
    Path("fleet.json").unlink()
    there = read_result("out")
    assert isinstance(there.model.setup.prior, PopulationPrior)
    assert len(robot_evidence(there).values) < len(robot_evidence(there).names)


def test_the_prior_of_another_robot(bench, run) -> None:
    result = run(CALIBRATE.replace("space6", "space7"))
    assert result.status == 1 and not Path("out").exists()


def test_the_prior_of_another_type(bench, fleet, run) -> None:
    prior = fleet.population.prior()
    first = replace(prior.robot.joints[1], axis=(0.0, 0.6, 0.8))
    joints = (prior.robot.joints[0], first, *prior.robot.joints[2:])
    other = replace(prior, robot=replace(prior.robot, joints=joints))
    write_population_prior(other, "fleet.json", force=True)
    result = run(CALIBRATE)
    assert result.status == 1 and not Path("out").exists()
    assert "fleet.json: a prior of other robots, 'space6'" in result.err
    assert "has another nominal axis" in result.err
    assert len(result.err.strip().splitlines()) == 1


def test_the_prior_of_other_parameters(bench, run) -> None:
    result = run(f"{CALIBRATE} --parameters dh")
    assert result.status == 1 and "does not have the parameters" in result.err
    assert len(result.err.strip().splitlines()) == 1


def test_a_plan_knows_it(bench, run) -> None:
    words = "plan space6 --model position --count 12 --json -o plan.csv"
    plain = json.loads(run(words).out)
    told = json.loads(run(f"{words} --setup setup.yaml --force").out)
    assert told["predicted"]["position"] < 0.95 * plain["predicted"]["position"]
