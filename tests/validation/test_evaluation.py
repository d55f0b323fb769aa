"""Evaluation looks for faults of the measurements, and asks for a registration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.io.documents import evaluation_document
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.report.accuracy import evaluated
from calib_pin.report.terminal import plain_text
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import Case


@pytest.fixture(scope="module")
def job(moved_job):
    job = moved_job((), ())
    rows = job.plain.only
    result = calib_pin.calibrate(job.chain, rows.rows(slice(0, 60)), validate=False)
    return job.chain, result.model, rows.rows(slice(60, 90))


def test_as_calibrated(job) -> None:
    chain, model, rows = job
    for robot in (model, chain):
        found = calib_pin.evaluate(robot, rows)
        assert (found.verdict, found.findings) == ("good", ())


@pytest.mark.parametrize(
    ("shift", "severity", "verdict"),
    [(1.0, "error", "untrusted"), (1e-3, "warning", "good")],
)
def test_moved_since(job, shift, severity, verdict) -> None:
    _, model, rows = job
    moved = replace(rows, values=rows.values + shift * np.eye(3)[0])
    found = calib_pin.evaluate(model, moved)
    (finding,) = found.findings
    assert (finding.code, finding.severity) == ("frames-moved", severity)
    assert finding.evidence["rms_before"] == pytest.approx(shift, rel=0.05)
    assert "--register" in finding.remedy and found.verdict == verdict
    assert calib_pin.evaluate(model, moved, registration=True).findings == ()


def test_reversed_joint(job) -> None:
    chain, model, rows = job
    q = rows.q * np.array([1, 1, -1, 1, 1, 1])
    for robot in (model, chain):
        found = calib_pin.evaluate(robot, replace(rows, q=q))
        assert found.verdict == "untrusted"
        (finding,) = found.findings
        assert finding.code == "joint-reversed" and finding.message in found.reason
        assert evaluation_document(found)["findings"][0]["setup"] == finding.setup
        text = plain_text(evaluated(found))
        lines = "joints:\n    joint_3: {joint: joint_3, sign: -1}"
        assert f"Lines for the setup file\n  {lines}" in text


def test_nothing_explains_it(job) -> None:
    chain, _, rows = job
    noise = np.random.default_rng(0).normal(0.0, 0.3, rows.values.shape)
    found = calib_pin.evaluate(chain, replace(rows, values=rows.values + noise))
    assert found.verdict == "untrusted"
    assert "rms remain, far more than a robot's geometry explains" in found.reason


def test_an_outlier_is_named_and_moves_nothing(job) -> None:
    chain, model, rows = job
    values = rows.values.copy()
    values[13] /= 0.3048
    spoiled = replace(rows, values=values)
    for robot in (model, chain):
        found = calib_pin.evaluate(robot, spoiled)
        (finding,) = found.findings
        assert (finding.code, finding.severity) == ("outliers", "warning")
        assert finding.setup == {"reading": {"without": [75]}}


def test_few_measurements_of_a_nominal_robot_ask_for_nothing(job) -> None:
    """They cannot tell errors of the robot from others: nothing is sought in vain."""
    chain, _, rows = job
    few = rows.rows(slice(0, 14))
    case = Case.of_robot(Chains.of(chain), Observations.of(few), Setup())
    assert not case.informed and not case.doubtful
    assert calib_pin.evaluate(chain, few).findings == ()
