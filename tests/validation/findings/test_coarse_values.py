"""Steps of values that make more noise than the instrument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.orientations import numbers_of, quaternions
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.coarse_values import coarse_step, coarse_values

Job = Callable[..., Any]
RANDOM = np.random.default_rng(0).uniform(-2.0, 2.0, 60)


def found(job: Any, **changed: Floats) -> list[Finding]:
    (block,) = job.plain.blocks
    data: Measurements = replace(block, **changed)  # type: ignore[arg-type]
    problem = make_problem(job.chain, Observations.of(data), Setup())
    fitted = fit(problem, np.random.default_rng(0))
    return list(coarse_values(Case.of(fitted, fitted.problem.chains)))


@pytest.mark.parametrize("step", [1e-3, 2e-3, 0.05, 2.54e-3, 1e-6])
def test_the_largest_step_of_all_values(step: float) -> None:
    assert coarse_step(step * np.round(RANDOM / step), "m") == pytest.approx(step)


def test_no_step() -> None:
    assert coarse_step(RANDOM, "m") == 0.0
    # Ten of them may stand on a grid because someone wanted them there.
    assert coarse_step(np.repeat(np.arange(10.0), 6), "m") == 0.0
    degrees = np.radians(0.1 * np.round(np.degrees(RANDOM) / 0.1))
    assert coarse_step(degrees, "rad") == pytest.approx(np.radians(0.1))


def test_clean_measurements_have_no_steps(moved_job: Job) -> None:
    assert found(moved_job((), (), 40)) == []


def test_millimeters(moved_job: Job) -> None:
    job = moved_job((), (), 60)
    (one,) = found(job, values=np.round(job.plain.only.values, 3))
    assert (one.code, one.severity) == ("coarse-steps", "warning")
    assert "steps of 1 mm, which makes 0.29 mm of the 0." in one.message
    # A tenth of the noise does no harm.
    assert found(job, values=np.round(job.plain.only.values, 5)) == []


def test_degrees_of_joints(moved_job: Job) -> None:
    job = moved_job((), (), 60)
    q = np.radians(np.round(np.degrees(job.plain.only.q), 1))
    (one,) = found(job, q=q)
    assert one.code == "coarse-steps" and one.severity == "warning"
    assert "joint positions are written in steps of 0.1 deg" in one.message


def test_orientations(moved_job: Job) -> None:
    job = moved_job((), (), 60, model="pose")
    values = job.plain.only.values
    angles = numbers_of(values[:, 3:], "roll-pitch-yaw")[0]
    coarse = quaternions(np.round(angles, 3), "roll-pitch-yaw")
    (one,) = found(job, values=np.hstack([values[:, :3], coarse]))
    assert "the measured orientations are written in steps of 0.0573" in one.message
