"""Selection by a genetic algorithm, compared with all there is to select."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import Genetic, SelectionResult, Status, genetic_selection
from calib_pin.solvers.evolution import Indices
from tests.shared import refused

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
    assert result.x.tolist() == everything[costs(everything).argmin()].tolist()


@pytest.mark.parametrize(("size", "count"), [(20, 1), (20, 19), (20, 20), (150, 10)])
def test_few_and_nearly_all_and_many(size: int, count: int) -> None:
    values = np.random.default_rng(0).normal(size=size)
    options = Genetic(population_size=80, generations=200)
    result = run(lambda x: values[x].sum(axis=1), options, size, count)
    assert result.x.tolist() == np.sort(np.argsort(values)[:count]).tolist()


def test_members_are_subsets_in_order_and_are_counted() -> None:
    seen: list[Indices] = []
    costs = determinant(20, 4)

    def watched(x: Indices) -> Floats:
        seen.append(x.copy())
        return costs(x)

    result, again, other = run(watched), run(), run(seed=4)
    assert again.population.tobytes() == result.population.tobytes()
    assert other.population.tobytes() != result.population.tobytes()
    for members in (*seen, result.population, result.x[None]):
        assert np.issubdtype(members.dtype, np.integer)
        assert members.shape[1] == 6
        assert (np.diff(members, axis=1) > 0).all()
        assert members.min() >= 0 and members.max() < 20
    assert len(seen) == result.nit + 1
    # The elite is not evaluated again.
    assert result.nfev == sum(map(len, seen)) == 30 + 28 * result.nit
    assert result.population_energies == pytest.approx(costs(result.population))
    assert all(b <= a for a, b in pairwise(result.best_history))
    assert result.best_history.shape == result.mean_history.shape == (result.nit + 1,)
    assert result.fun == result.best_history[-1] == result.population_energies.min()
    assert result.mean_history[-1] == pytest.approx(result.population_energies.mean())


def test_what_is_not_feasible_loses() -> None:
    costs = determinant(20, 4)

    def constrained(x: Indices) -> Floats:
        values = costs(x)
        values[(x == 3).any(axis=1)] = np.inf
        values[(x == 7).any(axis=1)] = np.nan
        return values

    result = run(constrained)
    assert not np.isin([3, 7], result.x).any()
    everything = np.array(list(combinations(sorted({*range(20)} - {3, 7}), 6)))
    assert result.fun == pytest.approx(costs(everything).min(), abs=0.05)
    nothing = run(lambda x: np.full(len(x), np.inf))
    assert (nothing.status, nothing.nit, nothing.nfev) == (Status.NOT_FINITE, 0, 30)


def test_patience_target_and_generations_end_it() -> None:
    flat = run(lambda x: np.zeros(len(x)), Genetic(patience=7))
    assert (flat.status, flat.nit) == (Status.CONVERGED, 7)
    limited = run(options=Genetic(generations=1))
    assert (limited.status, limited.nit) == (Status.GENERATIONS, 1)
    target = limited.fun - 0.01
    reached = run(options=Genetic(target=target))
    assert reached.status is Status.TARGET
    assert reached.fun <= target < reached.best_history[-2]


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
    assert (np.diff(result.x) > 0).all()


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        ({"size": 0}, 0),
        ({"count": 0}, 0),
        ({"count": 21}, 21),
        ({"costs": lambda x: 0.0}, ()),
    ],
)
def test_what_cannot_be_used(arguments: dict[str, Any], value: object) -> None:
    with refused(OptionError, value=value):
        run(**arguments)
