"""A joint that was homed anew during a job is named, with the line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations import Measurements
from calib_pin.setup import Setup

ARM = calib_pin.load_chain("space6")
PROBLEM = nominal_problem(ARM, "position", Setup())


def measured(count: int, noise: float = 5e-5) -> Measurements:
    """Measurements of a robot with errors."""
    rng = np.random.default_rng(3)
    truth = calib_pin.draw_errors(PROBLEM.parameters, rng)
    return calib_pin.simulate(PROBLEM, truth, rng, count=count, noise=noise).only


def with_zero(rows: Measurements, joint: int, first: int, size: float) -> Measurements:
    """The same, and a joint whose column reads more from some row on."""
    q = rows.q.copy()
    q[first:, joint] += size
    return replace(rows, q=q)


# Of a thousand rows three hundred are looked at, and the line is found among all.
@pytest.mark.parametrize(("count", "first"), [(60, 31), (1000, 522)])
def test_the_joint_the_line_and_the_size(count: int, first: int) -> None:
    rows = with_zero(measured(count), 2, first, 0.01)
    result = calib_pin.calibrate(ARM, rows, validate=False)
    (finding,) = (f for f in result.findings if f.code == "joint-rehomed")
    assert result.verdict == "untrusted"
    assert finding.evidence["joint"] == "joint_3"
    assert f"after measurement {first} " in finding.message
    # It is the column that reads more.
    assert finding.evidence["offset"] == pytest.approx(-0.01, abs=5e-4)
    assert finding.evidence["rms_after"] < 2e-4 < finding.evidence["rms_before"]


def test_a_robot_that_grows_warm_was_not_homed_anew() -> None:
    rows = measured(60)
    q = rows.q.copy()
    q[:, 2] += np.linspace(0.0, 0.01, len(q))
    found = calib_pin.calibrate(ARM, replace(rows, q=q), validate=False).findings
    assert "joint-rehomed" not in [finding.code for finding in found]
