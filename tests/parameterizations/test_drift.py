"""An instrument that drifts: when, where to, and under which names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem
from calib_pin.io.urdf import load_chain
from calib_pin.observations import Conditions, Measurements, Observations
from calib_pin.parameterizations.drift import INCREMENTS, InstrumentDrift
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import DriftSetup, Setup

SETUP = Setup(parameters=("placement", "instrument-drift"))


def test_it_walks_within_its_time_and_stands_still_without() -> None:
    chain = load_chain("space6")
    setup = replace(SETUP, drift=DriftSetup({"base": (100.0, 900.0)}, 1e-3, 1e-3))
    model = ErrorModel.create(chain, ["instrument-drift"], setup=setup)
    steps = np.random.default_rng(0).normal(size=INCREMENTS) * 1e-3
    theta = model.parameters.vector(
        {f"base.instrument-drift.y{k + 1}": step for k, step in enumerate(steps)}
    )
    time = np.array([-50.0, 100.0, 250.0, 900.0, 5000.0])
    q = np.zeros((len(time), 6))
    T = model.poses(q, theta, model.basis(q, Conditions(time=time)))
    knots = np.linspace(100.0, 900.0, INCREMENTS + 1)
    way = np.interp(time, knots, np.concatenate([[0.0], np.cumsum(steps)]))
    moved = T[:, :3, 3] - chain.poses(q)[:, :3, 3]
    np.testing.assert_allclose(moved, np.outer(way, [0.0, 1.0, 0.0]), atol=1e-12)
    # Of the robot nothing is said, and at no time the instrument is where it was.
    np.testing.assert_array_equal(model.tip_poses(q, theta), chain.poses(q))
    np.testing.assert_array_equal(model.poses(q, theta), chain.poses(q))
    assert model.geometric


def test_sizes_are_those_of_the_whole_walk() -> None:
    chain = load_chain("space6")
    drift = DriftSetup({"base": (0.0, 1.0)}, 4e-4, 0.0)
    screws = InstrumentDrift(drift).screws(chain)
    assert len(screws) == 3 * INCREMENTS
    walk = np.sqrt(sum(s.parameter.prior**2 for s in screws) / 3.0)
    assert walk == pytest.approx(4e-4)
    assert not InstrumentDrift().screws(chain)


def block(station: str, first: float, timed: bool = True) -> Measurements:
    chain = load_chain("space6")
    q = chain.random_configurations(6, np.random.default_rng(0))
    time = first + 10.0 * np.arange(6.0) if timed else np.zeros(0)
    held = Conditions(time=time)
    values = chain.poses(q)[:, :3, 3]
    given = chain.joints, q, "position", values
    return Measurements(*given, conditions=held, station=station)


def test_every_station_has_a_drift_of_its_own() -> None:
    chain = load_chain("space6")
    one = make_problem(chain, block("", 0.0), SETUP)
    assert one.setup.drift.spans == {"base": (0.0, 50.0)}
    assert "base.instrument-drift.rz8" in one.given.names
    data = Observations.of(block("day1", 0.0), block("day2", 900.0))
    both = make_problem(chain, data, SETUP)
    assert both.setup.drift.spans == {"day1": (0.0, 50.0), "day2": (900.0, 950.0)}
    drifting = [name for name in both.given.names if "drift" in name]
    assert len(drifting) == 2 * 6 * INCREMENTS
    assert {name.split(".")[0] for name in drifting} == {"day1", "day2"}
    assert both.given.nuisance[[both.given.index(name) for name in drifting]].all()
    # What drifts is in no reference: it stays where values are moved into those.
    theta = np.linspace(1e-5, 1e-3, len(both.given))
    moved, values = both.rebased(theta)
    kept = [both.given.index(name) for name in drifting]
    np.testing.assert_array_equal(values[kept], theta[kept])
    np.testing.assert_allclose(
        moved.residual(values)[: len(both.layout.row)],
        both.residual(theta)[: len(both.layout.row)],
        rtol=0,
        atol=1e-9,
    )


def test_without_times() -> None:
    with pytest.raises(InputError, match="'instrument-drift'"):
        make_problem(load_chain("space6"), block("", 0.0, timed=False), SETUP)
