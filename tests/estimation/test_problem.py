"""Very many measurements of several stations leave the same fit as few."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chain
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from calib_pin.simulation import draw_errors, simulate

STATIONS = {
    name: FrameSetup((x, 1.0 - x, 0.2), (0.1, x, 2.0 * x))
    for name, x in (("a", 0.4), ("b", -0.9), ("c", 1.3), ("d", 0.7))
}
TOOLS = {"short": ToolSetup((0.05, 0.03, 0.1)), "long": ToolSetup((-0.08, 0.02, 0.25))}

# Station d has no positions and c no long tool; what a pose tells is no position.
KEYS = [
    *(BlockKey("position", "", s, t) for s in "ab" for t in TOOLS),
    *(BlockKey("pose", "", s, "short") for s in "bd"),
    BlockKey("position", "", "c", "short"),
]


def job() -> Problem:
    """A simulated job with noise."""
    setup = Setup(stations=STATIONS, tools=TOOLS)
    problem = nominal_problem(load_chain("space6"), KEYS, setup)
    rng = np.random.default_rng(4)
    truth = draw_errors(problem.parameters, rng)
    data = simulate(problem, truth, rng, count=20 * len(KEYS), noise=1e-4)
    # Files need not have the order of stations.
    return replace(problem, data=Observations(data.blocks[::-1]))


def test_a_fit_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = job()
    expected = fit(plain, np.random.default_rng(0))
    deviation = np.sqrt(np.diag(expected.covariance))
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", 0)
    many = replace(plain)
    assert many.many
    found = fit(many, np.random.default_rng(0))
    assert found.rank == expected.rank
    assert found.sigma0 == pytest.approx(expected.sigma0, rel=1e-6)
    off = np.abs(found.theta - expected.theta)[deviation > 0.0]
    # Steps end where they promise a thousandth of a deviation.
    assert (off / deviation[deviation > 0.0]).max() < 1e-2
    np.testing.assert_allclose(
        np.sqrt(np.diag(found.covariance)), deviation, rtol=0.05, atol=1e-12
    )
    for own, other in zip(found.noise, expected.noise, strict=True):
        assert own.estimate == pytest.approx(other.estimate, rel=1e-2)
