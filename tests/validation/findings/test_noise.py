"""A stated standard deviation that is wrong by a factor of two and more is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.fit import fit_model
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.noise import noise

NOISE = 1e-4


def found(job, factor, repeats=1, seed=0):
    data = job.plain.only
    rng = np.random.default_rng(seed)
    values = np.repeat(data.values, repeats, axis=0)
    data = replace(data.rows(np.repeat(np.arange(len(data)), repeats)), values=values)
    data = replace(
        data,
        values=data.values + rng.normal(0.0, NOISE, data.values.shape),
        sigma=np.full(data.values.shape, factor * NOISE),
    )
    fitted = fit_model(job.chain, Observations.of(data), Setup(), 0).fit
    return list(noise(Case.of(fitted, fitted.problem.chains)))


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
def test_about_right(moved_job, factor) -> None:
    assert found(moved_job((), ()), factor) == []


def test_too_large(moved_job) -> None:
    (finding,) = found(moved_job((), ()), 5.0)
    assert finding.code == "noise" and finding.severity == "warning"
    assert "0.5 mm, is" in finding.message and "too large" in finding.message
    assert finding.evidence["factor"] == pytest.approx(0.2, rel=0.2)
    assert finding.setup["reading"] == {"sigmas": False}
    assert finding.setup["noise"]["position"] == pytest.approx(NOISE, rel=0.2)


def test_too_small(moved_job) -> None:
    """Without repetitions nobody knows whether the robot has more errors."""
    (finding,) = found(moved_job((), ()), 0.2)
    assert finding.severity == "warning" and "repeat some" in finding.remedy
    assert "times the stated 0.02 mm: sigma is too small, or" in finding.message
    (finding,) = found(moved_job((), ()), 0.2, repeats=2)
    assert "0.02 mm, is" in finding.message and "times too small" in finding.message
