"""A drift of instrument or joints is told with its size, noise and moves are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.fit import fit_model
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Observations
from calib_pin.setup import ReadingSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.course import drift

WAY = np.array([0.6, 0.0, -0.8])


def found(job, block):
    fitted = fit_model(job.chain, Observations.of(block), Setup(), 0).fit
    return list(drift(Case.of(fitted, fitted.problem.chains)))


def drifting(block, size):
    values = block.values.copy()
    values[:, :3] += np.linspace(0.0, size, len(values))[:, None] * WAY
    return replace(block, values=values)


def test_a_drift_and_its_size(moved_job) -> None:
    job, size = moved_job((), (), model="pose"), 3e-4
    spoilt = drifting(job.plain.only, size)
    (finding,) = found(job, spoilt)
    assert (finding.code, finding.severity) == ("instrument-drift", "warning")
    vector = [finding.evidence[axis] for axis in "xyz"]
    deviation = finding.evidence["sigma"]
    np.testing.assert_allclose(vector, size * WAY, atol=4.0 * deviation)
    assert finding.evidence["rms_after"] < finding.evidence["rms_before"]
    (x, y, z) = finding.setup["reading"]["drift"]
    back = read_otherwise(Observations.of(spoilt), ReadingSetup(drift=(x, y, z)))
    assert found(job, back.only) == []


def test_a_bent_path_is_no_drift(moved_job) -> None:
    """Errors that swing slowly, as unmodeled ones along a path, go with time, too."""
    job = moved_job((), ())
    block = job.plain.only
    time = np.linspace(0.0, 1.0, len(block))
    waves = sum(np.sin(k * np.pi * time + 0.4 * k) for k in range(1, 8))
    values = block.values + 2e-4 * waves[:, None] * WAY
    assert found(job, replace(block, values=values)) == []


def test_a_drift_of_a_joint(moved_job) -> None:
    """Few measurements have absorbed a part of it, with nearly as many parameters."""
    job, size = moved_job((), ()), 0.017
    block = job.plain.only.rows(slice(24))
    q = block.q.copy()
    q[:, 2] -= np.linspace(0.0, size, len(q))
    (finding,) = found(job, replace(block, q=q))
    assert finding.code == "robot-drift"
    assert finding.evidence["joint"] == block.joints[2]
    assert finding.evidence["drift"] == pytest.approx(size, rel=0.3)
