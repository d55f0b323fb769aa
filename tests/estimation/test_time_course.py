"""A robot that grows warm, and an instrument that drifts: found, and not invented."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import (
    fit,
    fit_model,
    with_drift,
    with_time_course,
    with_warm_up,
)
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.io.json_text import encode
from calib_pin.io.results import calibration_document, read_calibration
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import DriftSetup, FrameSetup, Setup, ThermalSetup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.model_errors import model_errors
from calib_pin.validation.result import Provenance

HOUR = 3600.0
CHAIN = calib_pin.load_chain("space6")
CHAINS = Chains.of(CHAIN)
PLAIN = Setup(tool_frame=FrameSetup((0.0, 0.0, 0.1), estimate=True))
WARM = replace(PLAIN, parameters=("placement", "warm-up"))
DRIFTING = replace(PLAIN, parameters=("placement", "instrument-drift"))


@dataclass(frozen=True)
class Job:
    """A robot that is measured for an hour, and the truth about it."""

    problem: Problem
    theta: Floats

    @staticmethod
    def warm(constant: float, seed: int) -> Job:
        """Links that are 0.6 per mille shorter when cold."""
        thermal = ThermalSetup(switched_on=(0.0,), warm_up_time=constant)
        problem = nominal_problem(CHAIN, "position", replace(WARM, thermal=thermal))
        theta = draw_errors(problem.parameters, np.random.default_rng(seed))
        warm = [".warm-up." in name for name in problem.parameters.names]
        return Job(problem, np.where(warm, 6e-4, theta))

    @staticmethod
    def drifting(shift: float, turn: float) -> Job:
        """A walk of these sizes."""
        drift = DriftSetup({"base": (0.0, HOUR)}, shift, turn)
        problem = nominal_problem(CHAIN, "position", replace(DRIFTING, drift=drift))
        rng = np.random.default_rng(0)
        theta = draw_errors(problem.parameters, rng)
        for k, parameter in enumerate(problem.parameters):
            if "drift" in parameter.name:
                theta[k] = rng.normal() * parameter.prior
        return Job(problem, theta)

    def measured(self, seed: int, count: int, noise: float = 2e-5) -> Observations:
        """Positions within the hour."""
        rng = np.random.default_rng(seed)
        time = Conditions(time=np.append(0.0, np.sort(rng.uniform(0.0, HOUR, count))))
        q = CHAIN.random_configurations(count + 1, rng)
        return simulate(
            self.problem, self.theta, rng, q=q, conditions=time, noise=noise
        )


@pytest.fixture(scope="module")
def drifting() -> tuple[Job, Observations]:
    job = Job.drifting(1e-4, 0.0)
    return job, job.measured(1, 60)


def test_the_time_constant_of_a_warm_up_is_found() -> None:
    found = with_warm_up(CHAINS, Job.warm(400.0, 1).measured(1, 40), WARM, 0).thermal
    assert found.switched_on == (0.0,)
    assert found.warm_up_time == pytest.approx(400.0, rel=0.3)


def test_what_is_stated_stands(drifting: tuple[Job, Observations]) -> None:
    _, data = drifting
    warm = replace(WARM, thermal=ThermalSetup(switched_on=(0.0,), warm_up_time=900.0))
    drift = DriftSetup({"base": (0.0, 1800.0)}, 5e-5, 0.0)
    for stated in (PLAIN, warm, replace(DRIFTING, drift=drift)):
        found = with_time_course(CHAINS, data, stated, 0)
        assert (found.drift, found.thermal) == (stated.drift, stated.thermal)


def test_the_geometry_is_that_of_the_warm_robot() -> None:
    job = Job.warm(900.0, 3)
    data = job.measured(3, 40)
    result = calib_pin.calibrate(CHAIN, data, job.problem.setup, validate=False)
    still = fit(make_problem(CHAIN, data, PLAIN), np.random.default_rng(0))
    q = CHAIN.random_configurations(100, np.random.default_rng(9))
    error, own = job.problem.only.error, job.problem.only.values(job.theta)[0]
    warm, errors = error.poses(q, own)[:, :3, 3], []
    term = still.problem.only
    for found in (
        result.model.of().poses(q),
        term.error.poses(q, term.values(still.theta)[0]),
    ):
        off = found[:, :3, 3] - warm
        errors.append(rms(off - off.mean(0)))
    assert errors[0] < 0.4 * errors[1]
    (told,) = [f for f in result.findings if f.code == "modeled-warm-up"]
    basis = error.basis(q, Conditions(time=np.zeros(len(q))))
    cold = error.poses(q, own, basis)[:, :3, 3] - warm
    assert told.evidence["cold"] == pytest.approx(rms(cold), rel=0.3)


def rms(vectors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def test_each_morning_anew() -> None:
    """A robot that is switched on twice is cold twice."""
    thermal = ThermalSetup(switched_on=(0.0, 1e5), warm_up_time=600.0)
    problem = nominal_problem(CHAIN, "position", replace(WARM, thermal=thermal))
    q = np.zeros((3, len(CHAIN.joints)))
    time = Conditions(time=np.array([0.0, 1e5 - 1.0, 1e5]))
    values = problem.only.error.basis(q, time)
    np.testing.assert_allclose(values[0], values[2])
    assert np.abs(values[0]).min() == 1.0 and np.abs(values[1]).max() < 1e-6


@pytest.mark.parametrize("size", [0.0, 1e-4])
def test_the_size_of_a_drift_is_that_of_the_walk(size: float) -> None:
    """A size of 24 increments is known to a sixth; what is not there is zero."""
    found = with_drift(CHAINS, Job.drifting(size, size).measured(0, 60), DRIFTING, 0)
    for one in (found.drift.shift, found.drift.turn):
        assert one is not None and 0.5 * size <= one <= 1.8 * size


def test_a_drift_costs_no_accuracy(drifting: tuple[Job, Observations]) -> None:
    """Within the hour, against a model that knows how much the instrument drifts."""
    job, data = drifting
    there, errors = job.measured(50, 150, noise=0.0), []
    for setup in (with_drift(CHAINS, data, DRIFTING, 0), job.problem.setup, PLAIN):
        model = fit_model(CHAIN, data, setup, 0)
        errors.append(rms(model_errors(model, there, np.arange(len(there))).after))
    assert errors[0] < 1.3 * errors[1] < 1.3 * 0.6 * errors[2]


def test_a_calibration_tells_and_keeps_a_drift(
    drifting: tuple[Job, Observations], tmp_path: Path
) -> None:
    job, data = drifting
    result = calib_pin.calibrate(CHAIN, data, DRIFTING, validate=False)
    (told,) = [f for f in result.findings if f.code == "modeled-drift"]
    assert told.severity == "info" and result.model.geometric
    # The walk is known to the noise of some positions.
    steps = [
        [f"base.instrument-drift.{axis}{k}" for k in range(1, 9)] for axis in "xyz"
    ]
    truth = dict(zip(job.problem.given.names, job.theta, strict=True))
    walk = [sum(truth[name] for name in axis) for axis in steps]
    place = {p.name: k for k, p in enumerate(result.parameters)}
    own = [[place[name] for name in axis] for axis in steps]
    covariance = np.asarray(result.covariance)
    sigma = np.sqrt(sum(covariance[np.ix_(axis, axis)].sum() for axis in own))
    assert told.evidence["shift"] == pytest.approx(np.linalg.norm(walk), abs=3 * sigma)
    assert sigma < 0.3 * np.linalg.norm(walk)
    # A file holds the walk and its time.
    file = tmp_path / "calibration.json"
    file.write_bytes(encode(calibration_document(result, Provenance.at("2026-01-01"))))
    (tmp_path / "nominal.urdf").write_bytes(CHAIN.robot.source)
    back, model = read_calibration(file), result.model
    at = job.measured(3, 50).only
    assert back.setup.drift == model.setup.drift
    np.testing.assert_allclose(
        back.predict(back.theta, at), model.predict(model.theta, at), rtol=0, atol=1e-12
    )
    early = replace(at, conditions=Conditions())
    moved = back.predict(back.theta, at) - back.predict(back.theta, early)
    assert np.abs(moved).max() > 1e-5
