"""The comparison as JSON: the numbers of the comparison, in SI units."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.cli.compare import comparison_document
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.json_text import encode
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey
from calib_pin.validation.comparison import Comparison, compare


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
