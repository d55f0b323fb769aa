"""Subsets of candidates: their costs, and the exchange methods on them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import (
    CRITERIA,
    Criterion,
    Information,
    Prediction,
    Selection,
)
from tests.planning.test_criteria import factored, gram

COLUMNS, NUISANCES = 5, 2

ALL: dict[str, Criterion] = {**CRITERIA, "prediction": Prediction(np.eye(COLUMNS))}


def table(seed: int, count: int = 10) -> Floats:
    return np.random.default_rng(seed).normal(size=(count, 2, COLUMNS))


def known() -> Floats:
    return 1e-3 * np.eye(COLUMNS)


def information(rows: Floats, chosen: Iterable[int]) -> Information:
    return factored(known() + gram(rows[list(chosen)]), NUISANCES)


def select(rows: Floats, criterion: Criterion, *chosen: int) -> Selection:
    return Selection(rows, NUISANCES, criterion, known(), chosen)


@pytest.mark.parametrize("name", ALL)
def test_cost_and_value_follow_every_change(name: str) -> None:
    rows, criterion = table(0), ALL[name]
    subset = select(rows, criterion, 0, 1, 2, 3)
    changes = [
        (lambda: None, (0, 1, 2, 3)),
        (lambda: subset.add(7), (0, 1, 2, 3, 7)),
        (lambda: subset.remove(1), (0, 2, 3, 7)),
        (lambda: subset.reset(given), (5, 4, 6)),
        (lambda: subset.add(1), (5, 4, 6, 1)),
    ]
    given = [5, 4, 6]
    for change, chosen in changes:
        change()
        assert subset.chosen == list(chosen)
        found = information(rows, chosen)
        assert subset.cost == pytest.approx(criterion.cost(found), rel=1e-9)
        value = criterion.value(found, len(chosen))
        assert subset.value == pytest.approx(value, rel=1e-9)
    assert given == [5, 4, 6]


def check_best(name: str, costs: dict[int, float], chosen: int, cost: float) -> None:
    """Its cost is its own, and the least; near it where first order is not enough."""
    assert cost == pytest.approx(costs[chosen], abs=1e-9)
    exact = name in ("prediction", "O1", "O3", "O5")
    assert cost <= min(costs.values()) + (1e-9 if exact else 0.05)


@pytest.mark.parametrize("name", ALL)
def test_best_steps_are_those_of_brute_force(name: str) -> None:
    for seed in range(3):
        rows, criterion = table(seed, 30), ALL[name]
        members = tuple(range(0, 12, 2))
        subset = select(rows, criterion, *members)
        costs = {
            k: criterion.cost(information(rows, (*members, k)))
            for k in range(30)
            if k not in members
        }
        candidate, cost = subset.best_to_add()
        assert candidate not in members
        check_best(name, costs, candidate, cost)
        costs = {
            k: criterion.cost(information(rows, {*members} - {k})) for k in members
        }
        member, cost = subset.best_to_remove()
        check_best(name, costs, member, cost)


def test_a_subset_that_determines_nothing_costs_everything() -> None:
    rows = table(0)
    subset = Selection(rows, NUISANCES, ALL["O3"], np.zeros((COLUMNS, COLUMNS)), (4,))
    assert (subset.cost, subset.value) == (np.inf, np.inf)
    candidate, cost = subset.best_to_add()
    assert candidate != 4 and cost == np.inf
    assert subset.best_to_remove() == (4, np.inf)


@pytest.mark.parametrize("d", [1, 3])
@pytest.mark.parametrize("name", ALL)
def test_members_that_cannot_be_missed_stay(name: str, d: int) -> None:
    """Three planes, say, each known from one measurement, rounding or not."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        rows = rng.normal(size=(14, d, COLUMNS)) * np.linspace(0.3, 3.0, COLUMNS)
        rows[:, :, :NUISANCES] = 0.0
        rows[:NUISANCES, 0, :NUISANCES] = rng.normal(size=(NUISANCES, NUISANCES))
        nothing = np.zeros((COLUMNS, COLUMNS))
        subset = Selection(rows, NUISANCES, ALL[name], nothing, range(14))
        member, cost = subset.best_to_remove()
        assert member >= NUISANCES, seed
        costs = []
        for k in range(NUISANCES, 14):
            subset.reset([j for j in range(14) if j != k])
            costs.append(subset.cost)
        assert cost == pytest.approx(min(costs), abs=1e-7)
