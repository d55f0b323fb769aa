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
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import exact_problem
from calib_pin.validation.held_out import check

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
    found = check(CHAIN, rows, SETUP, model, 0, validation=rows, method="file")
    assert (found.parts, found.method) == ((), "none")
    assert [f.code for f in found.findings] == ["repeated-validation"]
    assert {g.method for g in found.gains} == {"press"}
    # Some of it does not spoil the rest.
    mixed = Observations.of(rows.rows(np.arange(5)), new)
    found = check(CHAIN, rows, SETUP, model, 0, validation=mixed, method="file")
    (part,) = found.parts
    np.testing.assert_array_equal(part.positions, np.arange(5, 17))
    assert found.findings[0].message.startswith("5 of 17 ")
    assert found.gains[0].configurations == 12
    few = Observations.of(rows, new.rows(np.arange(4)))
    assert check(CHAIN, rows, SETUP, model, 0, validation=few).method == "none"


def test_set_aside_rows_stay_out() -> None:
    """Out of the fits of the folds, and out of every accuracy."""
    rows = simulated(40).only
    values = rows.values.copy()
    values[[3, 20]] += 0.05
    weight = np.ones(40)
    weight[[3, 20]] = 0.0
    spoiled = Observations.of(replace(rows, values=values, weight=weight))
    found = check(CHAIN, spoiled, SETUP, fitted_to(spoiled), 0)
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
    found = check(CHAIN, rows, SETUP, model, 0, validate=False)
    assert (found.parts, found.method) == ((), "none")
    assert [g.method for g in found.gains] == ["press", "press"]
    checked = check(CHAIN, rows, SETUP, model, 0)
    folded, _, pressed, _ = checked.gains
    # The same question, asked of one row at a time and of six: without these, the
    # twelve unknowns of base and tool have 72 values in place of 87.
    assert pressed.mean == pytest.approx(folded.mean, rel=0.2)
    assert 0.8 < folded.ratio < 1.2 and 0.8 < pressed.ratio < 1.2


def test_five_poses_are_no_check_however_often() -> None:
    rows = simulated(5, repeats=30)
    assert len(rows) == 150
    found = check(CHAIN, rows, SETUP, fitted_to(rows), 0)
    assert (found.parts, found.method) == ((), "none")
    unseen = simulated(4, seed=3, repeats=30)
    many = simulated(30)
    model = fitted_to(many)
    assert check(CHAIN, many, SETUP, model, 0, validation=unseen).method == "none"


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
    found = check(CHAIN, rows, SETUP, fitted_to(rows), 0)
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


@pytest.mark.parametrize("by", [0.05, 3.0])
def test_a_moved_instrument_is_registered_on_itself(by: float) -> None:
    rows, new = simulated(40), simulated(20, seed=2)
    model = fitted_to(rows)
    plain = check(CHAIN, rows, SETUP, model, 0, validation=new, method="file")
    assert plain.findings == ()
    found = check(
        CHAIN, rows, SETUP, model, 0, validation=moved(new, by), method="file"
    )
    assert [f.code for f in found.findings] == ["moved-instrument"]
    assert found.gains[0].better < 1e-6 and 0.7 < found.gains[0].ratio < 1.3

    def rms(errors: Floats) -> float:
        return float(np.sqrt(np.mean(errors**2)))

    # Six of sixty values went into the stand.
    after = rms(found.parts[0].after) / rms(plain.parts[0].after)
    assert 0.8 < after < 1.02
    assert rms(found.parts[0].before) < 1.02 * rms(plain.parts[0].before)


def test_where_the_stand_is_known_meters_are_no_check() -> None:
    setup = replace(SETUP, base_frame=FrameSetup(estimate=False))
    rows, new = simulated(40), moved(simulated(20, seed=2), 3.0)
    model = fit_model(CHAIN, rows, setup, 0)
    found = check(CHAIN, rows, setup, model, 0, validation=new)
    assert not found.findings
    assert found.gains[0].ratio > 1000.0
    result = calib_pin.calibrate(CHAIN, rows, setup, validation=new)
    assert result.verdict == "untrusted"
    assert "errors of 2.99e+03 mm rms remain" in result.reason


def test_a_model_with_no_row_to_fit_is_refused() -> None:
    points, poses = simulated(30), simulated(10, seed=2, model="pose").only
    poses = replace(
        poses,
        validate=np.ones(10, bool),
        files=("poses.csv",) * 10,
        lines=np.arange(2, 12),
    )
    both = Observations.of(points, poses)
    with pytest.raises(InputError, match=r"poses.csv:2: no 'pose' measurement"):
        calib_pin.calibrate(CHAIN, both, SETUP)
