"""What counts as unseen, and what too little of it is."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.fit import FittedModel, fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations import BlockKey, Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import exact_problem
from calib_pin.validation.held_out import HeldOut, check

SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))
CHAIN = calib_pin.load_chain("space6")


def simulated(
    count: int, seed: int = 1, model: str = "position", repeats: int = 1
) -> Observations:
    """Rows of one robot; the seed chooses its configurations and the noise."""
    problem = nominal_problem(CHAIN, model, SETUP)
    truth = calib_pin.draw_errors(problem.parameters, np.random.default_rng(7))
    rng = np.random.default_rng(seed)
    return calib_pin.simulate(
        problem, truth, rng, count=count, noise=5e-5, repeats=repeats
    )


def fitted_to(rows: Observations) -> FittedModel:
    return fit_model(CHAIN, rows, SETUP, 0)


def test_a_copy_of_what_was_fitted_checks_nothing() -> None:
    rows, new = simulated(30), simulated(12, seed=2)
    model = fitted_to(rows)
    found = check(model, rows, 0, validation=rows, method="file")
    assert (found.parts, found.method) == ((), "none")
    assert [f.code for f in found.findings] == ["repeated-validation"]
    assert {g.method for g in found.gains} == {"press"}
    # Some of it does not spoil the rest.
    mixed = Observations.of(rows.rows(np.arange(5)), new)
    found = check(model, rows, 0, validation=mixed, method="file")
    (part,) = found.parts
    np.testing.assert_array_equal(part.positions, np.arange(5, 17))
    assert found.gains[0].configurations == 12
    few = Observations.of(rows, new.rows(np.arange(4)))
    # Few are used, and are too few for a verdict.
    found = check(model, rows, 0, validation=few)
    assert (found.method, found.gains[0].configurations) == ("set", 4)


def test_set_aside_rows_stay_out() -> None:
    """Out of the fits of the folds, and out of every accuracy."""
    rows = simulated(40).only
    values = rows.values.copy()
    values[[3, 20]] += 0.05
    weight = np.ones(40)
    weight[[3, 20]] = 0.0
    spoiled = Observations.of(replace(rows, values=values, weight=weight))
    found = check(fitted_to(spoiled), spoiled, 0)
    assert found.method == "5-fold"
    positions = np.concatenate([part.positions for part in found.parts])
    assert sorted(positions) == list(range(40))
    counted = np.concatenate([part.positions for part in found.counted])
    assert sorted(counted) == sorted(set(range(40)) - {3, 20})
    after = np.concatenate([part.after for part in found.counted])
    assert np.abs(after).max() < 3e-4
    assert {g.configurations for g in found.gains} == {38}


def test_without_validation_there_is_the_hat_matrix() -> None:
    rows = simulated(30)
    model = fitted_to(rows)
    found = check(model, rows, 0, validate=False)
    assert (found.parts, found.method) == ((), "none")
    assert [g.method for g in found.gains] == ["press", "press"]
    checked = check(model, rows, 0)
    folded, _, pressed, _ = checked.gains
    # The same question, asked of one row at a time and of six: without these, the
    # twelve unknowns of base and tool have 72 values in place of 87.
    assert pressed.mean == pytest.approx(folded.mean, rel=0.2)
    assert 0.8 < folded.ratio < 1.2 and 0.8 < pressed.ratio < 1.2


def jogged() -> Observations:
    """Positions on straight lines from one random configuration to the next."""
    problem = nominal_problem(CHAIN, "position", SETUP)
    rng = np.random.default_rng(5)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    ends = rng.uniform(-2.0, 2.0, (13, 6))
    part = np.linspace(0.0, 1.0, 10, endpoint=False)[:, None]
    q = np.concatenate([a + part * (b - a) for a, b in pairwise(ends)])
    data = exact_problem(problem, truth, q, ("",) * len(q)).data.only
    noise = 5e-5 * rng.normal(size=data.values.shape)
    return Observations.of(replace(data, values=data.values + noise))


def test_a_path_is_folded_by_stretch() -> None:
    rows = jogged()
    found = check(fitted_to(rows), rows, 0)
    assert found.method == "5-fold by stretch"
    for part in found.parts:
        # Whole stretches: few places where the next row belongs to another part.
        assert np.count_nonzero(np.diff(part.positions) > 1) < 8
    assert 5 <= found.gains[0].configurations < 30
    result = calib_pin.calibrate(CHAIN, rows, SETUP, holdout=0.25)
    assert result.held_out is not None
    left = np.isin(rows.q[:, 0], result.held_out.rows.q[:, 0])
    assert np.count_nonzero(np.diff(left.astype(int))) < 16


def moved(rows: Observations, by: float) -> Observations:
    values = rows.only.values + by * np.array([0.6, -0.5, 0.62])
    return Observations.of(replace(rows.only, values=values))


def test_a_model_with_no_row_to_fit_is_refused() -> None:
    points, poses = simulated(30), simulated(10, seed=2, model="pose").only
    poses = replace(
        poses,
        validate=np.ones(10, bool),
        files=("poses.csv",) * 10,
        lines=np.arange(2, 12),
    )
    both = Observations.of(points, poses)
    with pytest.raises(InputError, match="'pose'") as error:
        calib_pin.calibrate(CHAIN, both, SETUP)
    assert (error.value.file, error.value.line) == ("poses.csv", 2)


STATIONS = {
    "floor": FrameSetup((1.0, 2.0, 0.3), (0.1, 0.2, 0.3)),
    "bench": FrameSetup((-2.0, 1.0, 0.3), (0.1, 0.2, 2.3)),
    "door": FrameSetup((-2.0, -3.0, 0.3), (0.1, 0.2, -2.3)),
}


def from_station(name: str, count: int, seed: int = 1) -> Observations:
    """Positions of the same robot by an instrument that stands elsewhere."""
    keys = [BlockKey("position", station=station) for station in STATIONS]
    problem = nominal_problem(CHAIN, keys, replace(SETUP, stations=STATIONS))
    truth = calib_pin.draw_errors(problem.parameters, np.random.default_rng(7))
    rng, key = np.random.default_rng(seed), keys[list(STATIONS).index(name)]
    return calib_pin.simulate(problem, truth, rng, key=key, count=count, noise=5e-5)


def two_stations() -> Observations:
    return Observations.of(from_station("floor", 25), from_station("bench", 15, 2))


def test_a_new_station_is_registered_on_itself() -> None:
    """And nothing else: neither the robot nor the tool."""
    rows, new = from_station("floor", 40), from_station("door", 15, 3)
    setup = replace(SETUP, base_frame=replace(STATIONS["floor"], estimate=True))
    alone = calib_pin.calibrate(CHAIN, rows, setup, validate=False)
    result = calib_pin.calibrate(CHAIN, rows, setup, validation=new)
    np.testing.assert_array_equal(result.model.theta, alone.model.theta)
    assert (result.validation.located, result.findings) == (("station door",), ())
    assert [g.method for g in result.statistics.gains] == ["file"] * 2 + ["press"] * 2
    assert 0.7 < result.statistics.gains[0].ratio < 1.3
    assert result.held_out is not None
    door = result.held_out
    # As if the instrument had never moved, but for six of 45 values.
    same = calib_pin.calibrate(
        CHAIN, rows, setup, validation=from_station("floor", 15, 3)
    ).held_out
    assert same is not None
    np.testing.assert_allclose(door.points, same.points, rtol=0, atol=1e-12)
    for own, floor in ((door.before, same.before), (door.after, same.after)):
        assert np.sqrt(np.mean(own**2)) < 1.05 * np.sqrt(np.mean(floor**2))
    assert np.abs(door.after).max() < 3e-4 < 2e-3 < np.abs(door.before).max()
    found = calib_pin.evaluate(result.model, new)
    assert (found.registered, found.located) == (False, ("station door",))
    after = result.errors[0].validation_after
    assert after is not None and found.errors[0][2] == after


def test_a_station_that_is_known_is_not_registered() -> None:
    setup = replace(SETUP, stations={"door": replace(STATIONS["door"], estimate=False)})
    new = from_station("door", 15, 3)
    result = calib_pin.calibrate(CHAIN, two_stations(), setup, validation=new)
    assert result.validation.located == () and result.held_out is not None
    known = frame_pose(STATIONS["door"]).rotation
    np.testing.assert_allclose(result.held_out.to_base, [known.T], atol=1e-12)


def test_only_the_station_that_was_moved_is_registered_anew() -> None:
    rows, seen = two_stations(), from_station("bench", 10, 4)
    new = from_station("floor", 15, 3)
    model = fitted_to(rows)

    def checked(*parts: Observations) -> HeldOut:
        every = Observations.of(*parts)
        return check(model, rows, 0, validation=every, method="file")

    plain, found = checked(seen, new), checked(seen, moved(new, 0.3))
    assert plain.findings == ()
    (finding,) = found.findings
    assert finding.code == "moved-instrument" and "'floor'" in finding.message
    assert found.gains[0].better < 1e-6
    # Six of 45 values went into the stand.
    after, before = (
        np.sqrt(np.mean(one.parts[0].after[10:] ** 2)) for one in (found, plain)
    )
    assert 0.8 < after / before < 1.02
    (was,), (part,) = plain.parts, found.parts
    np.testing.assert_array_equal(part.after[:10], was.after[:10])
    np.testing.assert_array_equal(part.positions, np.arange(25))
    assert 0.7 < found.gains[0].ratio < 1.3
    # Too few from there are left out; the others still check the fit.
    found = checked(seen, moved(new.rows(np.arange(2)), 0.3))
    np.testing.assert_array_equal(found.parts[0].positions, np.arange(10))


def test_validation_that_cannot_be_is_refused() -> None:
    """A new station that is hardly seen, a tool that was not fitted."""
    rows, model = two_stations(), fitted_to(two_stations())
    few = replace(
        from_station("door", 1, 3).only, files=("door.csv",), lines=np.array([2])
    )
    both = Observations.of(from_station("bench", 10, 4), few)
    with pytest.raises(InputError, match="door") as error:
        check(model, rows, 0, validation=both)
    assert (error.value.file, error.value.line) == ("door.csv", 2)
    probe = Observations.of(replace(from_station("floor", 15, 3).only, tool="probe"))
    with pytest.raises(InputError, match="'probe'"):
        check(model, rows, 0, validation=probe)
