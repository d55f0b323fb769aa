"""Values that are coarse, copied, exchanged or in another unit: what is particular."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.measurement_models.orientations import numbers_of, quaternions
from calib_pin.validation.findings.facts import coarse_step

RANDOM = np.random.default_rng(0).uniform(-2.0, 2.0, 60)


@pytest.fixture(scope="module")
def told(moved_job):
    """The findings of a job's measurements of which something was changed."""

    def of(change, **more):
        job = moved_job((), (), 55, **more)
        block = replace(job.plain.only, sigma=None)
        rows = replace(block, **change(block))
        result = calib_pin.calibrate(job.chain, rows, validate=False)
        return {finding.code: finding for finding in result.findings}

    return of


@pytest.mark.parametrize("step", [1e-3, 2.54e-3, 1e-6])
def test_the_largest_step_of_all_values(step: float) -> None:
    assert coarse_step(step * np.round(RANDOM / step), "m") == pytest.approx(step)


def test_no_step() -> None:
    assert coarse_step(RANDOM, "m") == 0.0
    # Ten of them may stand on a grid because someone wanted them there.
    assert coarse_step(np.repeat(np.arange(10.0), 6), "m") == 0.0
    degrees = np.radians(0.1 * np.round(np.degrees(RANDOM) / 0.1))
    assert coarse_step(degrees, "rad") == pytest.approx(np.radians(0.1))


def test_coarse_joint_positions(told) -> None:
    step = np.radians(0.02)
    found = told(lambda rows: {"q": step * np.round(rows.q / step)})
    assert found["coarse-steps"].severity == "warning"
    assert " 0.02 deg" in found["coarse-steps"].message


def test_coarse_orientations(told) -> None:
    def change(block):
        angles = numbers_of(block.values[:, 3:], "roll-pitch-yaw")[0]
        coarse = quaternions(np.round(angles, 3), "roll-pitch-yaw")
        return {"values": np.hstack([block.values[:, :3], coarse])}

    found = told(change, model="pose")["coarse-steps"]
    assert found.evidence["step"] == pytest.approx(1e-3)
    assert "orientations" in found.message


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


def test_a_grid_repeats_values_by_chance(moved_job) -> None:
    """Readings of one configuration, alike to the millimeter, are no copies."""
    job = moved_job((), (), 60)
    rows = job.plain.only.rows(np.append(np.arange(60), np.arange(20)))
    rows = replace(rows, values=np.round(rows.values, 3), sigma=None)
    found = calib_pin.calibrate(job.chain, rows, validate=False).findings
    assert [finding.code for finding in found] == ["coarse-steps"]


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


def test_fine_steps_of_a_robot_that_bends_are_no_copies() -> None:
    """Readings repeat on a grid of 1 um, beside 0.3 mm that no fit explains."""
    chain = calib_pin.load_chain("space6")
    rng = np.random.default_rng(4)
    q = np.repeat(chain.random_configurations(25, rng), 4, axis=0)
    bent = np.repeat(rng.normal(0.0, 3e-4, (25, 3)), 4, axis=0)
    points = chain.poses(q)[:, :3, 3] + bent + rng.normal(0.0, 3e-7, (100, 3))
    values = np.round(points, 6)

    def codes(values):
        rows = calib_pin.Measurements(chain.joints, q, "position", values)
        result = calib_pin.calibrate(chain, rows, validate=False)
        return {finding.code for finding in result.findings}

    assert "copied-measurements" not in codes(values)
    values = points + rng.normal(0.0, 3e-5, (100, 3))
    values[[1, 42]] = values[[0, 41]]
    assert "copied-measurements" in codes(values)
