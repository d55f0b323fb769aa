"""A drift of the instrument is found in its size, and none is invented."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.time_course import with_drift
from calib_pin.io.json_text import encode
from calib_pin.io.results import calibration_document, provenance, read_calibration
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import DriftSetup, FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.model_errors import model_errors

HOUR = 3600.0
KINDS = ("placement", "instrument-drift")


@dataclass(frozen=True)
class Job:
    """A robot that was measured for an hour, and the truth about it."""

    chain: Chain
    data: Observations
    setup: Setup
    problem: Problem
    theta: Floats

    def elsewhere(self, seed: int) -> Observations:
        """Exact values at other configurations within the same hour."""
        rng = np.random.default_rng(seed)
        q = self.chain.random_configurations(150, rng)
        held = Conditions(time=rng.uniform(0.0, HOUR, len(q)))
        exact = (self.problem, self.theta, rng)
        return simulate(*exact, q=q, conditions=held, noise=0.0)


def job(shift: float, turn: float, seed: int, count: int = 60) -> Job:
    """A walk of these sizes, and noise of 20 um."""
    chain = calib_pin.load_chain("space6")
    drift = DriftSetup({"base": (0.0, HOUR)}, shift, turn)
    tool = FrameSetup((0.0, 0.0, 0.1), estimate=True)
    setup = Setup(parameters=KINDS, drift=drift, tool_frame=tool)
    problem, rng = (
        nominal_problem(chain, "position", setup),
        np.random.default_rng(seed),
    )
    theta = draw_errors(problem.parameters, rng)
    for k, parameter in enumerate(problem.parameters):
        if "drift" in parameter.name:
            theta[k] = rng.normal() * parameter.prior
    q = chain.random_configurations(count, rng)
    held = Conditions(time=np.sort(rng.uniform(0.0, HOUR, count)))
    data = simulate(problem, theta, rng, q=q, conditions=held, noise=2e-5)
    return Job(chain, data, replace(setup, drift=DriftSetup()), problem, theta)


def sizes(one: Job) -> tuple[float, float]:
    found = with_drift(Chains.of(one.chain), one.data, one.setup, 0).drift
    assert found.shift is not None and found.turn is not None
    return found.shift, found.turn


@pytest.mark.parametrize("size", [0.0, 1e-4])
def test_its_size_is_that_of_the_walk(size: float) -> None:
    """A size of 24 increments is known to a sixth; what is not there is zero."""
    for found in sizes(job(size, size, 0)):
        assert 0.5 * size <= found <= 1.8 * size


def test_what_is_stated_stands() -> None:
    one = job(1e-4, 0.0, 0)
    stated = replace(one.setup, drift=DriftSetup({"base": (0.0, 1800.0)}, 5e-5, 0.0))
    assert with_drift(Chains.of(one.chain), one.data, stated, 0).drift == stated.drift
    other = replace(one.setup, parameters=("placement",))
    assert with_drift(Chains.of(one.chain), one.data, other, 0) == other


def test_it_costs_no_accuracy() -> None:
    """Within the hour, against a model that knows how much the instrument drifts."""
    one, errors = job(1e-4, 0.0, 0), []
    there, chains = one.elsewhere(50), Chains.of(one.chain)
    known = replace(one.setup, drift=one.problem.setup.drift)
    still = replace(one.setup, parameters=("placement",))
    for setup in (with_drift(chains, one.data, one.setup, 0), known, still):
        model = fit_model(one.chain, one.data, setup, 0)
        off = model_errors(model, there, np.arange(len(there))).after
        errors.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
    assert errors[0] < 1.3 * errors[1] < 1.3 * 0.6 * errors[2]


def test_a_calibration_tells_and_keeps_it(tmp_path: Path) -> None:
    one = job(1e-4, 0.0, 0)
    result = calib_pin.calibrate(one.chain, one.data, one.setup, validate=False)
    (told,) = [f for f in result.findings if f.code == "modeled-drift"]
    assert told.severity == "info"
    # The walk is known to the noise of some positions.
    names = [f"base.instrument-drift.{axis}" for axis in "xyz"]
    truth = dict(zip(one.problem.given.names, one.theta, strict=True))
    walk = [sum(truth[f"{name}{k}"] for k in range(1, 9)) for name in names]
    assert told.evidence["shift"] == pytest.approx(np.linalg.norm(walk), abs=3e-5)
    assert result.model.geometric
    # A file holds the walk and its time.
    file = tmp_path / "calibration.json"
    file.write_bytes(encode(calibration_document(result, provenance())))
    (tmp_path / "nominal.urdf").write_bytes(one.chain.robot.source)
    back, model, at = read_calibration(file), result.model, one.elsewhere(3).only
    assert back.setup.drift == model.setup.drift
    np.testing.assert_allclose(
        back.predict(back.theta, at), model.predict(model.theta, at), rtol=0, atol=1e-12
    )
    early = replace(at, conditions=Conditions())
    moved = back.predict(back.theta, at) - back.predict(back.theta, early)
    assert np.abs(moved).max() > 1e-5
