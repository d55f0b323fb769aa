"""Stations that are eliminated one by one leave the same fit as all together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem, absorbed, completed
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from tests.shared import chain_of, joint, simulated, urdf_of

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


def job(chain: Chain | None = None) -> Problem:
    """A simulated job with noise."""
    setup, robot = Setup(stations=STATIONS, tools=TOOLS), chain or "space6"
    problem, _ = simulated(KEYS, setup, 140, 1.0, 4, robot=robot, noise=1e-4)
    # Files need not have the order of stations.
    return replace(problem, data=Observations(problem.data.blocks[::-1]))


def eliminated(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> Problem:
    """The same problem, whose stations are as many as is needed."""
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", 0)
    monkeypatch.setattr("calib_pin.estimation.problem.WORTHWHILE", 1)
    return replace(problem)


def test_a_fit_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = job()
    expected = fit(plain, np.random.default_rng(0))
    deviation = np.sqrt(np.diag(expected.covariance))
    few = eliminated(plain, monkeypatch)
    assert absorbed(few) == 6 * len(STATIONS)
    found = fit(few, np.random.default_rng(0))
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


def test_the_same_is_left_for_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the factors of stations, and by the whole Jacobian.

    A mimic joint has the parameters of its leader: its columns add up.
    """
    rng = np.random.default_rng(0)
    joints = [
        joint(f"j{k}", f"l{k} l{k + 1}", pin.exp6(at), np.eye(3)[k % 3])
        for k, at in enumerate(rng.uniform(-0.5, 0.5, (4, 6)))
    ]
    joints[2]["more"] = '<mimic joint="j1" multiplier="-0.6" offset="0.1"/>'
    plain = job(chain_of(urdf_of(*joints)))
    setup = replace(plain.setup, parameters=("joint-offset", "transmission"))
    plain = make_problem(plain.chains, plain.data, setup)
    index = next(iter(plain.terms.values())).index
    assert len(index) > len(np.unique(index))
    theta = 0.01 * np.random.default_rng(1).normal(size=len(plain.parameters))
    r, J = plain.linearize(theta)
    few = eliminated(plain, monkeypatch)
    own = np.concatenate(list(few.station_parameters.values()))
    shared = np.setdiff1d(np.arange(len(theta)), own)
    Q, _ = np.linalg.qr(J[:, own])
    columns = np.column_stack([J, r])
    rest = columns - Q @ (Q.T @ columns)
    kept = np.append(shared, -1)
    rest, others = rest[:, kept], columns[:, kept]
    unit = np.maximum(np.linalg.norm(others, axis=0), 1.0)
    expected = rest.T @ rest / np.outer(unit, unit)
    r, J = few.linearize(theta)
    assert not J[:, own].any()
    found = np.column_stack([J[:, shared], r]) / unit
    np.testing.assert_allclose(found.T @ found, expected, rtol=0, atol=1e-11)
    # What was eliminated follows from the others.
    step = np.zeros(len(theta))
    step[shared] = 1e-3 * np.random.default_rng(2).normal(size=len(shared))
    r, J = plain.linearize(theta)
    solved = np.linalg.lstsq(J[:, own], -(r + J @ step), rcond=None)[0]
    found = completed(few.stations(theta), step)
    np.testing.assert_allclose(
        J[:, own] @ found[own], J[:, own] @ solved, rtol=0, atol=1e-6 * np.abs(r).max()
    )
