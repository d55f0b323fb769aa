"""All kinds together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations import Measurements
from calib_pin.setup import FrameSetup, Setup

ARM = calib_pin.load_chain("space6")
SETUP = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12)))


def measured(count: int = 40) -> Measurements:
    problem, rng = nominal_problem(ARM, "position", SETUP), np.random.default_rng(2)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    return calib_pin.simulate(problem, theta, rng, count=count, noise=1e-4).only


def test_clean_measurements_have_no_faults() -> None:
    result = calib_pin.calibrate(ARM, measured(), SETUP)
    assert result.verdict == "good"
    assert [f.code for f in result.findings if f.severity != "info"] == []


@pytest.mark.slow
def test_random_measurements_have_no_explanation() -> None:
    """With enough faults at once anything would be explained a little."""
    rows = measured(24)
    mixed = replace(rows, values=np.random.default_rng(0).permutation(rows.values))
    result = calib_pin.calibrate(ARM, mixed, SETUP, validate=False)
    assert result.verdict == "untrusted"
    assert "check the base and tip links" in result.reason
    assert not any(finding.setup for finding in result.findings)


@pytest.mark.parametrize("fault", ["reversed", "shifted"])
def test_lines_of_a_finding_make_the_job_good(fault: str) -> None:
    rows = measured(60)
    q = rows.q.copy()
    if fault == "reversed":
        q[:, 2] *= -1.0
    else:
        q = np.roll(q, 1, axis=0)
    result = calib_pin.calibrate(ARM, replace(rows, q=q), SETUP)
    assert result.verdict == "untrusted"
    (cause,) = (f for f in result.findings if f.severity == "error")
    expected = {
        "reversed": {"joints": {"joint_3": {"joint": "joint_3", "sign": -1}}},
        "shifted": {"reading": {"shift": 1}},
    }
    assert cause.setup == expected[fault]
    assert cause.message in result.reason
