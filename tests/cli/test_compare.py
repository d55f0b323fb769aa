"""`calib-pin compare` as users run it, and its numbers as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.cli.compare import comparison_document
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.json_text import encode
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey
from calib_pin.validation.comparison import Comparison, compare
from tests.cli.files import document

PAIR = "compare done/calibration.json later/calibration.json"


def edited(change: Callable[[dict[str, Any]], object]) -> None:
    """Change the second calibration."""
    found = document("later")
    change(found)
    Path("later/calibration.json").write_text(json.dumps(found))


def test_two_calibrations_of_one_robot(here, run, listing):
    before = listing(here)
    result = run(PAIR)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("No drift ")
    assert max(map(len, result.out.splitlines())) <= 80
    assert listing(here) == before


def test_json_has_the_numbers_of_the_report(here, run):
    found = json.loads(run(f"{PAIR} --json").out)
    assert found["format"] == "calib-pin/comparison"
    text = run(PAIR).out
    rms = found["tip"]["position"]["rms"]
    assert f"{1e3 * rms:.4f}" in text
    for key in ("a", "b"):
        sizes = found[key]["errors"]["position"]["validation"]
        assert f"{1e3 * sizes['rms']:.4f}" in text
    other = json.loads(run(f"{PAIR} --json --seed 1").out)
    assert other["tip"]["largest"] != found["tip"]["largest"]
    assert other["parameters"] == found["parameters"]


def test_a_drift_is_no_failure(here, run):
    words = "calibrate arm.urdf foreign.csv --setup setup.yaml -o later --quiet --force"
    assert run(words).status == 0
    result = run(PAIR)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("The robot changed")
    assert "joint3.joint-offset.q " in result.out


def test_what_must_not_be_trusted(here, run):
    verdict = {"status": "untrusted", "reason": "not converged"}
    edited(lambda d: d.update(verdict=verdict))
    result = run(PAIR)
    assert (result.status, result.err) == (2, "")
    first, second, *_ = result.out.splitlines()
    assert first.startswith("UNTRUSTED: B (later/calibration.json)")
    assert second.startswith("No drift ")
    result = run(f"{PAIR} --json")
    assert result.status == 2
    assert json.loads(result.out)["b"]["verdict"] == verdict


def test_calibrations_of_different_robots(here, run):
    text = Path("arm.urdf").read_text()
    Path("other.urdf").write_text(text.replace("0.5 0 0.05", "0.6 0 0.05"))
    words = "simulate other.urdf --model position --count 25 --noise 1e-4 -o other.csv"
    words += " --errors errors.yaml --parameters joint-offset"
    assert run(words).status == 0
    words = "calibrate other.urdf other.csv --setup setup.yaml -o later --quiet --force"
    assert run(words).status == 0
    result = run(PAIR)
    assert (result.status, result.err) == (2, "")
    (finding,) = json.loads(run(f"{PAIR} --json").out)["findings"]
    assert (finding["code"], finding["severity"]) == ("different-robots", "error")
    assert finding["evidence"]["rms"] > 0.02


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda d: d.update(version=1), "calibrate again"),
        (lambda d: d["parameters"][0].update(sigma="1 mm"), "'1 mm'"),
        (lambda d: d["robot"].update(tip="link4"), "compared"),
        (lambda d: d.pop("identifiability"), "'identifiability'"),
        (lambda d: d["robot"].update(sha256="0" * 64), "is not the robot"),
    ],
)
def test_wrong_files(change, named, here, fails):
    edited(change)
    fails(PAIR, "later/", named)


def test_other_joints(here, run, refuses):
    Path("other.urdf").write_text(
        Path("arm.urdf").read_text().replace('"joint4"', '"wrist"')
    )
    rows = Path("new.csv").read_text().replace("joint4", "wrist")
    Path("other.csv").write_text(rows)
    words = "calibrate other.urdf other.csv --setup setup.yaml -o other --quiet"
    assert run(words).status == 0
    refuses(
        "compare done/calibration.json other/calibration.json",
        file="other/calibration.json",
        reason=("wrist", "joint4"),
    )


# --- numbers ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def found(recorded) -> Comparison:
    chain = calib_pin.load_chain("space6")
    later = recorded(chain, "pose", 1, {"joint_4.placement.rz": 2e-3})
    return compare(recorded(chain, "pose", 0), later)


def test_numbers(found):
    document = json.loads(encode(comparison_document(found)))
    assert (document["format"], document["version"]) == ("calib-pin/comparison", 1)
    assert document["drifted"] is document["changed"] is True
    same = {"nominal_robot": True, "parameters": True, "measurements": False}
    assert document["same"] == same
    tip, drift = document["tip"], found.drift
    assert tip["position"]["rms"] == pytest.approx(np.sqrt(np.mean(drift.drift**2)))
    assert tip["orientation"]["mean"] == pytest.approx(drift.turn.mean())
    explained = tuple(tip[name]["explained"] for name in ("position", "orientation"))
    assert explained == tuple(found.drift.explained)
    assert tip["largest"]["drift"] == tip["position"]["max"] == drift.drift.max()
    assert tip["largest"]["tip"] == drift.points[drift.farthest].tolist()
    assert tip["largest"]["configuration"] == drift.q[drift.farthest].tolist()
    assert tip["fitted_away"] == ["base", "tool"]
    rows = [*document["parameters"], *document["coupled"]]
    assert len(rows) == len(found.differences)
    for row in rows:
        assert row["difference"] == row["b"] - row["a"]
        assert row["significance"] == pytest.approx(
            abs(row["difference"]) / row["sigma"]
        )
    leading = max(rows, key=lambda row: row["significance"])
    assert leading["expression"] == found.differences[0].name
    assert leading["terms"][0]["parameter"] == "joint_4.placement.rz"
    assert document["displacements"]["tool"]["position"] > 0.0
    assert document["a"]["errors"]["position"]["validation"] is None
    assert document["b"]["training"] == 60


def test_what_is_unknown_is_null(found):
    (position, _) = found.second.errors
    less = replace(found.second, accuracies={}, errors=(position,))
    document = comparison_document(
        replace(compare(found.first, less), displacements=())
    )
    assert document["drifted"] is None
    assert document["tip"]["orientation"] is None
    assert document["tip"]["position"]["explained"] is None
    assert document["displacements"] == {"base": None, "tool": None}


@pytest.mark.slow
def test_the_tips_of_several_chains():
    robot = calib_pin.load_chain("example:talos_reduced", tip="arm_left_7_link").robot
    names = ("arm_left_7_link", "arm_right_7_link")
    chains = Chains(robot, names=names)
    setup = calib_pin.Setup(parameters=("joint-offset",))
    problem = nominal_problem(chains, [BlockKey("pose", name) for name in names], setup)
    rng = np.random.default_rng(1)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, theta, rng, count=25)
    first = calib_pin.calibrate(chains, rows, setup, validate=False)
    moved = replace(first.model, theta=first.model.theta + 1e-3)
    both = compare(first, replace(first, model=moved))
    document = comparison_document(both)
    assert list(document["tips"]) == list(names)
    assert document["tip"] == document["tips"][document["chain"]]
    for name, tip in document["tips"].items():
        assert tip["position"]["rms"] == both.drifts[name].position.rms > 1e-4
        assert tip["position"]["explained"] == both.drifts[name].explained[0]
        joints = len(chains[name].joints)
        assert len(tip["largest"]["configuration"]) == joints
