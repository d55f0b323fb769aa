"""What simulation put in comes out: exactly without noise, as predicted with it.

The ways of measuring are those of `scripts/benchmark recovery`, which judges the
covariance of each by 200 runs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from benchmarks.recovery import CASES, FRAMES, Study
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import Payload
from calib_pin.solvers import Status


def test_errors_are_those_that_the_covariance_tells() -> None:
    """NEES is chi-square distributed, with the variance 2 / rank in units of it."""
    case, runs = CASES["position"], 10
    found, values = Study(case).trials(runs), case.rank * runs
    deviation = np.sqrt(2.0 / values)
    assert found.nees.mean() == pytest.approx(1.0, abs=3.0 * deviation)
    deviation = np.sqrt(0.95 * 0.05 / values)
    assert found.covered.size == values
    assert found.covered.mean() == pytest.approx(0.95, abs=3.3 * deviation)
    allowed = 0.05 * np.sqrt(200.0 / runs)
    assert found.accuracy == pytest.approx(1.0, abs=allowed)


# Without noise.


CONTACTS = {"fixed-point", "position and fixed-point", "sphere-contact"}
"""Cases of the slow tier; the quick one has planes to touch, and mixes of others."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if n in CONTACTS else []) for n in CASES],
)
def test_exact_rows_give_the_robot(name: str) -> None:
    """Of equal robots the one closest to nominal; frames and places come along."""
    study = Study(CASES[name], seed=3)
    problem, truth = study.problem, study.truth()
    scales = problem.parameters.scales
    assert np.abs(truth / scales).max() > 0.1
    fitted = study.calibrated(truth, noise=0.0)
    assert fitted.result.status is Status.CONVERGED
    assert fitted.rank == study.structure.rank == study.case.rank
    np.testing.assert_allclose(fitted.theta / scales, truth / scales, rtol=0, atol=1e-9)
    assert np.abs(fitted.problem.errors(fitted.theta)).max() < 1e-9


def test_the_tip_of_any_robot_is_recovered() -> None:
    """Geometry, gears and compliance together, from positions alone."""
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    load = {"load": Payload(4.0, (0.05, 0.02, 0.1))}
    parameters = ("placement", "transmission", "compliance")
    setup = replace(FRAMES, parameters=parameters, payloads=load)
    problem = nominal_problem(chain, "position", setup)
    rng = np.random.default_rng(3)
    q = chain.random_configurations(50, rng)

    def predicted(fitted: Problem, theta: Floats) -> Floats:
        term = fitted.only
        return term.error.poses(q, term.values(theta)[0])[:, :3, 3]

    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=80, noise=0.0)
    fitted = fit(replace(problem, data=rows), rng)
    assert fitted.result.status is Status.CONVERGED
    at = predicted(problem, truth)
    assert np.abs(at - predicted(problem, 0.0 * truth)).max() > 1e-3
    found = predicted(fitted.problem, fitted.theta)
    np.testing.assert_allclose(found, at, rtol=0, atol=1e-9)
