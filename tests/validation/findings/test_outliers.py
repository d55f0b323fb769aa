"""Measurements that do not fit: exchanged, in another unit, off, noisier than said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin


def test_pairs_that_are_exchanged_and_one_that_is_off(told) -> None:
    def change(block):
        values = block.values.copy()
        values[[10, 20, 30, 31]] = values[[20, 10, 31, 30]]
        values[50] += 1.0
        return {"values": values}

    found = told(change)
    lines = {"reading": {"exchanged": [[12, 22], [32, 33]]}}
    assert found["measurements-exchanged"].setup == lines
    assert found["outliers"].setup == {"reading": {"without": [52]}}


def test_many_outliers_are_counted(told) -> None:
    """Lines 7 to 20 are off; a message that names them all would not be read."""

    def change(block):
        values = block.values.copy()
        values[5:19] += np.random.default_rng(0).normal(0.0, 0.3, (14, 3))
        return {"values": values}

    found = told(change)["outlying-stretch"]
    assert all(f" {number} " in found.message for number in (7, 11, 14))
    assert len(found.message) < 300 and len(found.remedy) < 300


def test_a_stretch_of_lengths_in_feet(told) -> None:
    def change(block):
        values = block.values.copy()
        values[30:35, :3] /= 0.3048
        return {"values": values}

    found = told(change)["unit-of-some"]
    converted = [{"factor": 0.3048, "lines": [32, 36]}]
    assert found.setup == {"reading": {"converted": converted}}


def test_outliers_are_no_unit(told) -> None:
    def change(block):
        values = block.values.copy()
        values[[3, 20, 44]] += np.random.default_rng(1).normal(size=(3, 3))
        return {"values": values}

    assert set(told(change)) == {"outliers"}


@pytest.mark.parametrize(("repeats", "sure"), [(1, False), (2, True)])
def test_noise_that_is_stated_too_small(moved_job, repeats, sure) -> None:
    """Without repetitions nobody knows whether the robot has more errors."""
    job = moved_job((), ())
    block = job.plain.only.rows(np.repeat(np.arange(90), repeats))
    noise = 1e-4 * np.random.default_rng(0).normal(size=block.values.shape)
    sigma = np.full(noise.shape, 2e-5)
    rows = replace(block, values=block.values + noise, sigma=sigma)
    (finding,) = calib_pin.calibrate(job.chain, rows, validate=False).findings
    assert (finding.code, finding.severity) == ("noise", "warning")
    assert finding.evidence["factor"] == pytest.approx(5.5, rel=0.15)
    assert ("repeat" in finding.remedy) == (not sure)
