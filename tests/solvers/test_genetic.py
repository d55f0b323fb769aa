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
from calib_pin.solvers.genetic import _Nursery

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
@pytest.mark.parametrize("seed", range(10))
def test_the_best_of_all_combinations(
    size: int, count: int, parameters: int, seed: int
) -> None:
    costs = determinant(size, parameters, seed)
    everything = np.array(list(combinations(range(size), count)))
    result = run(costs, Genetic(), size, count, seed)
    assert result.status is Status.CONVERGED
    assert result.x.tolist() == everything[costs(everything).argmin()].tolist()


def test_a_large_selection() -> None:
    values = np.random.default_rng(0).normal(size=500)
    best = np.sort(np.argsort(values)[:20])
    options = Genetic(population_size=200, generations=500)
    result = run(lambda x: values[x].sum(axis=1), options, 500, 20)
    assert result.x.tolist() == best.tolist()


def test_members_are_subsets_in_order_and_are_counted() -> None:
    seen: list[Indices] = []
    costs = determinant(20, 4)

    def watched(x: Indices) -> Floats:
        seen.append(x.copy())
        return costs(x)

    result = run(watched)
    for members in (*seen, result.population, result.x[None]):
        assert np.issubdtype(members.dtype, np.integer)
        assert members.shape[1] == 6
        assert (np.diff(members, axis=1) > 0).all()
        assert members.min() >= 0 and members.max() < 20
    assert len(seen) == result.nit + 1
    # The elite is not evaluated again.
    assert result.nfev == sum(map(len, seen)) == 30 + 28 * result.nit
    assert np.array_equal(result.population_energies, costs(result.population))


def test_the_best_cost_never_rises() -> None:
    result = run()
    assert all(b <= a for a, b in pairwise(result.best_history))
    assert result.best_history.shape == result.mean_history.shape == (result.nit + 1,)
    assert result.fun == result.best_history[-1] == determinant(20, 4)(result.x[None])
    assert result.mean_history[-1] == pytest.approx(result.population_energies.mean())


def test_the_same_seed_gives_the_same_bytes() -> None:
    one, two, other = (run(seed=seed) for seed in (3, 3, 4))
    assert one.population.tobytes() == two.population.tobytes()
    assert one.mean_history.tobytes() == two.mean_history.tobytes()
    assert one.population.tobytes() != other.population.tobytes()


@pytest.mark.parametrize("count", [1, 19, 20])
def test_few_and_nearly_all(count: int) -> None:
    values = np.random.default_rng(0).normal(size=20)
    result = run(lambda x: values[x].sum(axis=1), count=count)
    assert result.x.tolist() == np.sort(np.argsort(values)[:count]).tolist()


def test_x0_are_members_of_the_first_population() -> None:
    seen: list[Indices] = []

    def costs(x: Indices) -> Floats:
        seen.append(x)
        return (x != np.arange(6)).sum(axis=1).astype(float)

    x0 = np.array([[5, 4, 3, 2, 1, 0], [19, 0, 1, 2, 3, 4]])
    x0.flags.writeable = False
    result = run(costs, x0=x0)
    assert seen[0][:2].tolist() == [[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 19]]
    assert (result.fun, result.x.tolist()) == (0.0, [0, 1, 2, 3, 4, 5])


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


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nothing_is_feasible(value: float) -> None:
    result = run(lambda x: np.full(len(x), value))
    assert (result.status, result.nit, result.nfev) == (Status.NOT_FINITE, 0, 30)


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
        assert determinant(20, 4)(x[None])[0] == fun
        x[:] = 0  # A copy: the population does not change.
        seen.append(generation)
        return generation == 5

    result = run(callback=callback)
    assert (result.status, result.nit) == (Status.STOPPED, 5)
    assert seen == [1, 2, 3, 4, 5]
    assert (np.diff(result.x) > 0).all()


def children(swaps: float, crossover: float) -> tuple[Indices, Indices]:
    """Two parents of four items with two in common, and many of their children."""
    parents = np.array([[0, 1, 2, 3], [2, 3, 4, 5]])
    options = Genetic(402, swaps=swaps, crossover=crossover, tournament=1)
    nursery = _Nursery(options, 4, np.random.default_rng(0))
    return parents, nursery.children(parents, np.zeros(2), 12)


def test_children_keep_what_both_parents_have() -> None:
    _, born = children(swaps=0.0, crossover=1.0)
    assert born.shape == (400, 4)
    assert (born < 6).all()
    assert ((born == 2).any(axis=1) & (born == 3).any(axis=1)).all()
    # All ways to fill two places of four occur.
    assert len(np.unique(born, axis=0)) == 6


def test_without_crossover_children_are_copies() -> None:
    parents, born = children(swaps=0.0, crossover=0.0)
    assert np.array_equal(np.unique(born, axis=0), parents)


def test_swaps_bring_others_in() -> None:
    parents, born = children(swaps=1.0, crossover=0.0)
    swapped = 4 - np.isin(born, np.arange(6)).sum(axis=1)
    kept = [max(len({*child} & {*parent}) for parent in parents) for child in born]
    assert np.mean(4 - np.array(kept)) == pytest.approx(1.0, abs=0.15)
    assert (swapped > 0).any()


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("population_size", 1, "a whole number, "),
        ("generations", 0, "a whole number, 1"),
        ("tournament", 0, "a whole number, 1"),
        ("crossover", 1.5, "0 to 1"),
        ("swaps", -1, "0 or more"),
        ("swaps", np.inf, "0 or more"),
        ("elite", 0, "a whole number, 1"),
        ("patience", 2.0, "a whole number"),
        ("target", np.nan, "a number"),
    ],
)
def test_options_that_cannot_be_used(
    name: str, value: object, allowed: str, refused: Callable[..., Any]
) -> None:
    with refused(OptionError, f"{name} cannot be used", value=value, allowed=allowed):
        Genetic(**{name: value})  # type: ignore[arg-type]


def test_an_elite_leaves_room_for_children(refused: Callable[..., Any]) -> None:
    with refused(OptionError, "elite", value=5, allowed="less than"):
        Genetic(elite=5, population_size=5)


@pytest.mark.parametrize(
    ("arguments", "fields"),
    [
        ({"size": 0}, {"reason": "size", "value": 0, "allowed": "a whole number, 1"}),
        ({"count": 0}, {"reason": "count", "value": 0, "allowed": "1 to size = 20"}),
        ({"count": 21}, {"reason": "count", "value": 21, "allowed": "1 to size = 20"}),
        (
            {"x0": np.arange(6)},
            {"reason": "x0", "value": (6,), "allowed": "(up to 30, 6)"},
        ),
        (
            {"x0": np.tile(np.arange(6), (31, 1))},
            {"value": (31, 6), "allowed": "(up to 30, 6)"},
        ),
        (
            {"x0": np.array([[0, 1, 2, 3, 4, 4]])},
            {
                "reason": "row 0 of x0 is not a subset",
                "value": [0, 1, 2, 3, 4, 4],
                "allowed": "6 different",
            },
        ),
        (
            {"x0": np.array([[0, 1, 2, 3, 4, 20]])},
            {"allowed": "whole numbers, 0 to 19"},
        ),
        ({"x0": np.arange(6.0)[None]}, {"reason": "row 0 of x0 is not a subset"}),
        ({"costs": lambda x: 0.0}, {"reason": "one number per member", "value": ()}),
    ],
)
def test_what_cannot_be_used(
    arguments: dict[str, Any], fields: dict[str, Any], refused: Callable[..., Any]
) -> None:
    with refused(OptionError, **fields):
        run(**arguments)
