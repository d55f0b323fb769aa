"""Criteria: their definitions, the trials of a search, and their slopes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib_pin.estimation.identifiability import observability
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import CRITERIA, SHARPER, Criterion, Prediction
from calib_pin.planning.information import Information

COLUMNS, NUISANCES = 8, 3

TESTS = np.cov(np.random.default_rng(9).normal(size=(COLUMNS, 40)))
ALL: dict[str, Criterion] = {**CRITERIA, "prediction": Prediction(TESTS)}


def table(d: int, count: int, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, d, COLUMNS)) * np.linspace(0.3, 3.0, COLUMNS)


def gram(rows: Floats) -> Floats:
    U = rows.reshape(-1, rows.shape[-1])
    return U.T @ U


def factored(M: Floats, f: int = NUISANCES) -> Information:
    found = Information.of(M, f)
    assert found is not None
    return found


def cost_of(criterion: Criterion, M: Floats, f: int = NUISANCES) -> float:
    found = Information.of(M, f)
    return np.inf if found is None else criterion.cost(found)


def projected(rows: Floats, f: int = NUISANCES) -> Floats:
    """Singular values of the robot's columns with the nuisances projected out."""
    U = rows.reshape(-1, rows.shape[-1])
    Q = np.linalg.qr(U[:, :f])[0]
    return np.linalg.svd(U[:, f:] - Q @ (Q.T @ U[:, f:]), compute_uv=False)


def test_names() -> None:
    assert list(ALL) == ["condition", "O1", "O2", "O3", "O4", "O5", "prediction"]
    assert all(criterion.name == name for name, criterion in ALL.items())


@pytest.mark.parametrize("f", [0, 3])
@pytest.mark.parametrize("name", ["O1", "O2", "O3", "O4", "O5"])
def test_indices_are_those_of_the_projected_matrix(name: str, f: int) -> None:
    rows = table(3, 12)
    s = projected(rows, f)
    expected = observability(s, 12)[name]
    found = factored(gram(rows), f)
    criterion = CRITERIA[name]
    assert criterion.value(found, 12) == pytest.approx(expected, rel=1e-9)
    # What is maximized is minimized as the logarithm of its inverse.
    if name == "O1":
        expected *= np.sqrt(12)
    assert criterion.cost(found) == pytest.approx(-np.log(expected), rel=1e-9)


def test_condition() -> None:
    rows = table(3, 12)
    s = projected(rows)
    found = factored(gram(rows))
    assert CRITERIA["condition"].value(found, 12) == pytest.approx(s[0] / s[-1])
    assert CRITERIA["condition"].cost(found) == pytest.approx(np.log(s[0] / s[-1]))


def test_prediction_is_the_error_of_the_tip() -> None:
    """Root-mean-square over test rows of the standard deviation a covariance gives."""
    rows = table(3, 12)
    J_0 = np.random.default_rng(2).normal(size=(50, 3, COLUMNS))
    covariance = np.linalg.inv(gram(rows))
    per_pose = np.einsum("ndi,ij,ndj->n", J_0, covariance, J_0)
    expected = np.sqrt(per_pose.mean())
    criterion = Prediction(gram(J_0) / 50)
    for f in (0, 3):
        found = factored(gram(rows), f)
        assert criterion.value(found, 12) == pytest.approx(expected, rel=1e-9)
        assert criterion.cost(found) == pytest.approx(np.log(expected), rel=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("d", [1, 3, 6])
@pytest.mark.parametrize("name", ALL)
def test_best_trial_is_that_of_brute_force(name: str, d: int, sign: float) -> None:
    criterion = ALL[name]
    for seed in range(6):
        members = table(d, 12, seed)
        M = gram(members)
        # Many candidates, so that the blocks of exact costs come into play.
        tried = members if sign < 0.0 else table(d, 120, 100 + seed)
        costs = np.array([cost_of(criterion, M + sign * U.T @ U) for U in tried])
        trials = criterion.trials(factored(M), np.swapaxes(tried, 0, 1), sign)
        barred = np.zeros(len(tried), bool)
        for _ in range(4):
            # The best ones are barred one after the other.
            position, cost = trials.best(barred)
            allowed = np.where(barred, np.inf, costs)
            assert not barred[position]
            assert cost == pytest.approx(allowed.min(), abs=1e-7)
            assert costs[position] == pytest.approx(allowed.min(), abs=1e-7)
            barred[position] = True


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", ALL)
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    d=st.sampled_from([1, 3]),
    stretch=st.floats(-2.0, 2.0),
    f=st.integers(0, 4),
)
def test_bounds_are_lower_bounds(
    name: str, sign: float, seed: int, d: int, stretch: float, f: int
) -> None:
    criterion = ALL[name]
    rows = table(d, 16, seed) * np.logspace(0.0, stretch, COLUMNS)
    M = gram(rows)
    tried = rows if sign < 0.0 else 2.0 * rows[::-1][:, :, ::-1]
    trials = criterion.trials(factored(M, f), np.swapaxes(tried, 0, 1), sign)
    costs = np.array([cost_of(criterion, M + sign * U.T @ U, f) for U in tried])
    bounds = np.where(np.isnan(trials.bounds), np.inf, trials.bounds)
    # Each stage comes closer from below; the last one is there.
    stages = [bounds, *(closer(np.arange(len(tried))) for closer in trials.closer)]
    for before, after in pairwise(stages):
        assert (before <= after + 1e-6).all() and (after <= costs + 1e-6).all()
    bounds = stages[-1]
    np.testing.assert_allclose(bounds, costs, atol=1e-6)


@pytest.mark.parametrize("name", ALL)
def test_bounds_spare_most_of_the_work(name: str) -> None:
    """Bounds that were just minus infinity would be bounds as well."""
    criterion = ALL[name]
    rows = table(3, 200, 1)
    trials = criterion.trials(
        factored(gram(table(3, 40))), np.swapaxes(rows, 0, 1), 1.0
    )
    if not trials.closer:
        return
    asked: list[list[int]] = [[] for _ in trials.closer]
    counted = type(trials)(
        trials.bounds,
        tuple(
            lambda some, k=k, of=of: (asked[k].extend(some), of(some))[1]
            for k, of in enumerate(trials.closer)
        ),
    )
    assert counted.best(np.zeros(200, bool)) == trials.best(np.zeros(200, bool))
    for some, fewer in pairwise(asked):
        assert len(set(fewer)) == len(fewer) <= len(some) < 100


@pytest.mark.parametrize("name", ALL)
def test_removals_that_leave_the_robot_undetermined(name: str) -> None:
    """Only two members tell of the last column; without both there is no cost."""
    rows = table(3, 12)
    rows[2:, :, -1] = 0.0
    rows[:2, 1:, -1] = 0.0
    rows[1, :, -1] = 0.0
    M = gram(rows)
    trials = ALL[name].trials(factored(M), np.swapaxes(rows, 0, 1), -1.0)
    position, cost = trials.best(np.zeros(12, bool))
    assert position != 0
    others = [cost_of(ALL[name], M - U.T @ U) for U in rows[1:]]
    assert cost == pytest.approx(min(others), abs=1e-7)


@pytest.mark.parametrize("count", [10, 12, 30])
@pytest.mark.parametrize("name", ALL)
def test_removals_that_leave_the_nuisances_undetermined(name: str, count: int) -> None:
    """Three planes, say, each known from one measurement that cannot be missed."""
    rows = table(1, count)
    rows[:, 0, :NUISANCES] = 0.0
    rows[:NUISANCES, 0, :NUISANCES] = np.eye(NUISANCES)
    M = gram(rows)
    trials = ALL[name].trials(factored(M), np.swapaxes(rows, 0, 1), -1.0)
    position, cost = trials.best(np.zeros(count, bool))
    costs = np.array([cost_of(ALL[name], M - U.T @ U) for U in rows])
    assert np.isinf(costs[:NUISANCES]).all()
    assert np.isfinite(costs[NUISANCES:]).all()
    assert costs[position] == pytest.approx(costs.min(), abs=1e-7)
    assert cost == pytest.approx(costs.min(), abs=1e-7)


@pytest.mark.parametrize("name", ALL)
def test_when_every_removal_leaves_too_little(name: str) -> None:
    """As many rows as columns: whatever leaves, the rest tells too little."""
    rows = table(1, COLUMNS)
    trials = ALL[name].trials(factored(gram(rows)), np.swapaxes(rows, 0, 1), -1.0)
    position, cost = trials.best(np.zeros(COLUMNS, bool))
    assert 0 <= position < COLUMNS
    assert cost > cost_of(ALL[name], gram(rows)) + 1.0


def numbers(M: Floats, criterion: Criterion, sharpness: float, dM: Floats) -> float:
    ahead, behind = factored(M + dM), factored(M - dM)
    return (
        criterion.slope(ahead, sharpness)[0] - criterion.slope(behind, sharpness)[0]
    ) / 2.0


@pytest.mark.parametrize("sharpness", [1.0, 4.0, 16.0, 64.0])
@pytest.mark.parametrize("name", ALL)
def test_slope_agrees_with_central_differences(name: str, sharpness: float) -> None:
    criterion = ALL[name]
    M = gram(table(3, 12))
    _, by_M = criterion.slope(factored(M), sharpness)
    np.testing.assert_allclose(by_M, by_M.T, atol=1e-12 * np.abs(by_M).max())
    rng = np.random.default_rng(0)
    size = np.sqrt(np.diag(M))
    found, expected = [], []
    for _ in range(12):
        dM = rng.normal(size=M.shape) * np.outer(size, size)
        dM = 1e-6 * (dM + dM.T)
        found.append(float(np.sum(by_M * dM)))
        expected.append(numbers(M, criterion, sharpness, dM))
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("name", ALL)
def test_smooth_cost_becomes_the_cost(name: str) -> None:
    criterion = ALL[name]
    found = factored(gram(table(3, 12)))
    cost = criterion.cost(found)
    costs = [criterion.slope(found, p)[0] for p in (*SHARPER, 256.0, 4096.0)]
    errors = np.abs(np.array(costs) - cost)
    if criterion.sharpnesses == (np.inf,):
        assert errors.max() < 1e-12
        return
    assert criterion.sharpnesses == SHARPER
    assert (np.diff(errors) <= 0.0).all()
    assert errors[0] > errors[1] > errors[2]
    assert errors[-1] < 2e-3
    # Power means of r numbers are at most log(r) / p away, twice here.
    for p, error in zip((*SHARPER, 256.0, 4096.0), errors, strict=True):
        assert error <= 1.5 * np.log(COLUMNS - NUISANCES) / p


@pytest.mark.parametrize("name", ALL)
def test_more_rows_never_cost_more(name: str) -> None:
    """But for the condition, which may get worse."""
    criterion = ALL[name]
    members, more = table(3, 12), table(3, 30, 7)
    costs = [cost_of(criterion, gram(members) + gram(U)) for U in more]
    better = np.array(costs) < cost_of(criterion, gram(members))
    if name in ("condition", "O2", "O4"):
        assert better.any()
    else:
        assert better.all()
