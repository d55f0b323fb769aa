"""Simulated robots with one physical error each: it is found, and none is invented.

Errors are those at other configurations. A drift of the instrument is in
`estimation/test_drift`, and how ripples are found in `validation/findings/test_ripple`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import calib_pin
from calib_pin.control.compensation import commands
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Payload, Setup, ThermalSetup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.calibrated_model import CalibratedModel

NOISE = 2e-5

TERMS: dict[str, dict[str, Any]] = {
    "cross-compliance": {"payloads": {"load": Payload(20.0, (0.1, 0.0, 0.1))}},
    "thermal": {"thermal": ThermalSetup(20.0)},
    "warm-up": {"thermal": ThermalSetup(switched_on=(0.0,), warm_up_time=300.0)},
    "motor-ripple": {"gear_ratios": {"joint_2": 80.0, "joint_3": 101.0}},
}
"""Terms with what a setup states of them."""


@dataclass(frozen=True)
class Job:
    chain: Chain
    problem: Problem
    theta: Floats
    data: Observations

    @property
    def setup(self) -> Setup:
        return self.problem.setup

    def fitted(self, setup: Setup) -> CalibratedModel:
        found = fit_model(self.chain, self.data, setup, 0)
        return CalibratedModel.create(found.problem, found.theta)

    def errors(self, *setups: Setup) -> list[float]:
        """Rms errors at other configurations [m] of fits with these setups."""
        at = simulated(self.problem, self.theta, 200, 77, noise=0.0).only
        result = []
        for setup in setups:
            model = self.fitted(setup)
            off = model.predict(model.theta, at) - at.values
            result.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
        return result


def simulated(
    problem: Problem, theta: Floats, count: int, seed: int, noise: float = NOISE
) -> Observations:
    """Positions of a robot that grows warm from 15 to 35 degC."""
    rng = np.random.default_rng(seed)
    q = problem.chains.random_configurations(count, rng)
    held = Conditions(
        temperature=np.linspace(15.0, 35.0, count), time=10.0 * np.arange(count)
    )
    return simulate(problem, theta, rng, q=q, conditions=held, noise=noise)


def job(term: str, size: float, seed: int, count: int = 100) -> Job:
    """A robot with errors of the geometry, and of a term in so many expected sizes."""
    chain = calib_pin.load_chain("space6")
    tool = FrameSetup((0.0, 0.0, 0.1), estimate=True)
    setup = Setup(parameters=("placement", term), tool_frame=tool, **TERMS[term])
    problem = nominal_problem(chain, "position", setup)
    theta = draw_errors(problem.parameters, np.random.default_rng(seed))
    theta[of_term(problem)] *= size
    return Job(chain, problem, theta, simulated(problem, theta, count, seed))


def of_term(problem: Problem) -> NDArray[np.bool_]:
    kinds = {"motor-ripple": "transmission"}
    kind = kinds.get(problem.setup.parameters[-1], problem.setup.parameters[-1])
    names = problem.parameters.names
    return np.array([name.split(".")[-2] == kind for name in names])


def significance(one: Job) -> float:
    """Chi-square of the values of a term beyond its mean, in deviations of it."""
    found = fit_model(one.chain, one.data, one.setup, 0).fit
    kept = of_term(found.problem)
    scales = found.problem.parameters.scales[kept]
    values = found.theta[kept] / scales
    C = found.posterior.covariance[np.ix_(kept, kept)] / np.outer(scales, scales)
    s, V = np.linalg.eigh(C)
    told = s > 1e-9 * s.max()
    square = float(np.sum((V[:, told].T @ values) ** 2 / s[told]))
    return float((square - told.sum()) / np.sqrt(2.0 * told.sum()))


@pytest.mark.parametrize("term", TERMS)
def test_it_is_found_and_pays(term: str) -> None:
    one = job(term, 1.0, 3)
    with_it, without = one.errors(*both(one))
    assert with_it < 0.25 * without and significance(one) > 50.0
    # In a robot that does not have it, it is chance and costs as such.
    none = job(term, 0.0, 3)
    with_it, without = none.errors(*both(none))
    assert with_it < 1.5 * without and abs(significance(none)) < 3.5


def both(one: Job) -> tuple[Setup, Setup]:
    """Setups with the term and without."""
    return one.setup, replace(one.setup, parameters=("placement",))


@pytest.mark.slow
@pytest.mark.parametrize("term", TERMS)
def test_a_small_one_is_found_and_none_is_invented(term: str) -> None:
    """A quarter of the expected size in each of 20 robots; none in 40 others.

    The fit of a robot without the term, where none is asked for, is as good as any.
    """
    found, ratios = [], []
    for seed in range(20):
        one = job(term, 0.25, 200 + seed)
        found.append(significance(one) > 5.0)
        same = job(term, 0.0, 200 + seed)
        (with_it,), (_, right) = one.errors(one.setup), same.errors(*both(same))
        ratios.append(with_it / right)
    assert all(found)
    # Each value that is fitted costs its share, whether the model is right or not.
    parameters = one.problem.parameters
    free = int((parameters.free & ~of_term(one.problem)).sum())
    share = np.sqrt(1.0 + of_term(one.problem).sum() / free)
    assert np.mean(ratios) < 1.2 * share
    # Chi-square of 5 to 12 values is above 3.5 deviations less than once in a hundred.
    invented = [significance(job(term, 0.0, 300 + seed)) > 3.5 for seed in range(40)]
    assert sum(invented) <= 2


@pytest.mark.parametrize("term", TERMS)
def test_commands_take_it_into_account(term: str) -> None:
    """A calibrated robot goes where it shall, whatever bends under way."""
    one = job(term, 1.0, 5)
    chain = one.fitted(one.setup).of()
    rng = np.random.default_rng(0)
    q = 0.5 * one.chain.random_configurations(5, rng)
    targets = one.chain.poses(q) @ chain.tool.homogeneous
    found = commands(chain, targets, q, frame="base")
    assert found.reached.all()
    T = invert(chain.error.base.homogeneous) @ chain.poses(found.q)
    np.testing.assert_allclose(T[:, :3, 3], targets[:, :3, 3], rtol=0, atol=1e-6)
    assert np.abs(found.q - q).max() > 1e-5
