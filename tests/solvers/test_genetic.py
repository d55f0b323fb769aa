"""Selection by a genetic algorithm, compared with all there is to select."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import Status, genetic_selection
from calib_pin.solvers.evolution import Indices
from calib_pin.solvers.exchange import SelectionResult
from calib_pin.solvers.genetic import Genetic

QUICK = Genetic(population_size=30, generations=40)


def determinant(size: int, parameters: int, seed: int = 0) -> Callable[..., Floats]:
    """The D-optimal choice of rows: minus the log determinant of what they tell."""
    rows = np.random.default_rng(seed).normal(size=(size, parameters))
    products = rows[:, :, None] * rows[:, None, :]
    return lambda x: -np.linalg.slogdet(products[x].sum(axis=1))[1]


def run(
    costs: Callable[..., Floats] | None = None,
    options: Genetic = QUICK,
    size: int = 20,
    count: int = 6,
    seed: int = 0,
    **arguments: object,
) -> SelectionResult:
    rng = np.random.default_rng(seed)
    return genetic_selection(
        costs or determinant(20, 4),
        size,
        count,
        rng,
        options,
        **arguments,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(
    ("size", "count", "parameters"), [(12, 4, 3), (12, 4, 4), (16, 5, 4)]
)
def test_the_best_of_all_combinations(size: int, count: int, parameters: int) -> None:
    costs = determinant(size, parameters)
    everything = np.array(list(combinations(range(size), count)))
    result = run(costs, Genetic(), size, count)
    assert result.status is Status.CONVERGED
    assert list(result.chosen) == everything[costs(everything).argmin()].tolist()


@pytest.mark.parametrize(("size", "count"), [(20, 1), (20, 19), (20, 20), (150, 10)])
def test_few_and_nearly_all_and_many(size: int, count: int) -> None:
    values = np.random.default_rng(0).normal(size=size)
    options = Genetic(population_size=80, generations=200)
    result = run(lambda x: values[x].sum(axis=1), options, size, count)
    assert list(result.chosen) == np.sort(np.argsort(values)[:count]).tolist()


def test_members_are_subsets_in_order_and_are_counted() -> None:
    seen: list[Indices] = []
    costs = determinant(20, 4)

    def watched(x: Indices) -> Floats:
        seen.append(x.copy())
        return costs(x)

    result = run(watched)
    assert run() == result
    for members in seen:
        assert np.issubdtype(members.dtype, np.integer)
        assert members.shape[1] == 6
        assert (np.diff(members, axis=1) > 0).all()
        assert members.min() >= 0 and members.max() < 20
    assert len(seen) == result.nit + 1
    # The elite is not evaluated again.
    assert sum(map(len, seen)) == 30 + 28 * result.nit
    assert result.chosen in {tuple(x) for members in seen for x in members.tolist()}
    assert result.cost == min(costs(members).min() for members in seen)


def test_what_is_not_feasible_loses() -> None:
    costs = determinant(20, 4)

    def constrained(x: Indices) -> Floats:
        values = costs(x)
        values[(x == 3).any(axis=1)] = np.inf
        values[(x == 7).any(axis=1)] = np.nan
        return values

    result = run(constrained)
    assert not np.isin([3, 7], result.chosen).any()
    everything = np.array(list(combinations(sorted({*range(20)} - {3, 7}), 6)))
    assert result.cost == pytest.approx(costs(everything).min(), abs=0.05)
    nothing = run(lambda x: np.full(len(x), np.inf))
    assert (nothing.status, nothing.nit) == (Status.NOT_FINITE, 0)


def test_patience_and_generations_end_it() -> None:
    flat = run(lambda x: np.zeros(len(x)), Genetic(patience=7))
    assert (flat.status, flat.nit) == (Status.CONVERGED, 7)
    limited = run(options=Genetic(generations=1))
    assert (limited.status, limited.nit) == (Status.GENERATIONS, 1)


def test_the_callback_sees_every_generation_and_stops() -> None:
    seen: list[int] = []

    def callback(generation: int, x: Indices, fun: float) -> bool:
        assert determinant(20, 4)(x[None])[0] == pytest.approx(fun)
        x[:] = 0  # A copy: the population does not change.
        seen.append(generation)
        return generation == 5

    result = run(callback=callback)
    assert (result.status, result.nit) == (Status.STOPPED, 5)
    assert seen == [1, 2, 3, 4, 5]
    assert (np.diff(result.chosen) > 0).all()
