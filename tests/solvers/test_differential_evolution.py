"""Both searches on functions with known minima; no robots here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import (
    DifferentialEvolution,
    EvolutionResult,
    ParticleSwarm,
    Status,
    differential_evolution,
    particle_swarm,
)
from calib_pin.solvers.differential_evolution import MUTATIONS, STRATEGIES, TRADEOFF

WIDE = np.tile([-5.0, 5.0], (10, 1))
QUICK = DifferentialEvolution(population_size=20, maxiter=30)
SWARM = ParticleSwarm(particles=20, iterations=30)
SEARCHES: dict[str, Any] = {name: replace(QUICK, strategy=name) for name in STRATEGIES}
SEARCHES["swarm"] = SWARM


def sphere(x: Floats) -> Floats:
    return np.sum((x - 1.0) ** 2, axis=1)


def rosenbrock(x: Floats) -> Floats:
    valley = 100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2
    return np.sum(valley + (1 - x[:, :-1]) ** 2, axis=1)


def rastrigin(x: Floats) -> Floats:
    return np.sum((x - 1) ** 2 + 10 - 10 * np.cos(2 * np.pi * (x - 1)), axis=1)


def run(
    costs: Callable[[Floats], Floats] = sphere,
    options: Any = QUICK,
    bounds: Floats = WIDE,
    seed: int = 0,
    **arguments: Any,
) -> EvolutionResult:
    """A search by its options."""
    swarm = isinstance(options, ParticleSwarm)
    search: Any = particle_swarm if swarm else differential_evolution
    rng = np.random.default_rng(seed)
    found: EvolutionResult = search(costs, bounds, rng, options, **arguments)
    return found


@pytest.mark.parametrize(
    ("strategy", "mutants"),
    [
        # Members 1, 10, 100, 1000, the best is 5, a, b, c = (0, 1, 2), (3, 2, 0).
        ("rand/1", [1 + 0.5 * (10 - 100), 1000 + 0.5 * (100 - 1)]),
        ("best/1", [5 + 0.5 * (1 - 10), 5 + 0.5 * (1000 - 100)]),
        (
            "rand-to-best/1",
            [
                1 + 0.5 * (5 - 1) + 0.5 * (10 - 100),
                1000 + 0.5 * (5 - 1000) + 0.5 * (100 - 1),
            ],
        ),
        ("midpoint", [(1 + 5) / 2 + 0.5 * (10 - 100), 1005 / 2 + 0.5 * (100 - 1)]),
    ],
)
def test_mutations_of_known_members(strategy: str, mutants: list[float]) -> None:
    members = np.array([[1.0], [10.0], [100.0], [1000.0]])
    others = np.array([[0, 3], [1, 2], [2, 0]])
    result = MUTATIONS[strategy](members, np.array([5.0]), others, 0.5)
    assert result[:, 0].tolist() == mutants


@pytest.mark.parametrize("name", SEARCHES)
def test_members_stay_within_bounds_and_are_counted(name: str) -> None:
    seen, told = list[Floats](), list[int]()

    def costs(x: Floats) -> Floats:
        seen.append(x.copy())
        return x @ np.array([1.0, -1.0, 1.0, 1.0])

    # The minimum is in a corner; one component is fixed, one is narrow.
    bounds = np.array([[-1.0, 1.0], [0.1, 0.3], [0.7, 0.7], [1e-12, 3e-12]])
    wild: dict[str, Any] = {"mutation": 1.5}
    if name == "swarm":
        wild = {"velocity": 1.0, "crossover": 0.5, "mutation": 0.5, "tol": 0}
    options = replace(SEARCHES[name], **wild)
    result = run(costs, options, bounds, callback=lambda n, *_: told.append(n))
    members = np.concatenate(seen)
    assert (len(members), len(seen)) == (result.nfev, result.nit + 1)
    assert told == [*range(1, result.nit + 1)]
    assert (bounds[:, 0] <= members).all() and (members <= bounds[:, 1]).all()
    assert (members[:, 2] == 0.7).all()
    assert result.x[:3] == pytest.approx([-1.0, 0.3, 0.7], rel=0.05)
    # The way back of a mutant leads into the box: nobody was put down on a bound.
    away = members[:, [0, 1, 3]] != bounds[[0, 1, 3]].T[:, None]
    assert away.all() or name == "swarm"


@pytest.mark.parametrize("options", [QUICK, SWARM])
def test_x0_is_a_member_of_the_first_population(options: Any) -> None:
    """Of a swarm several may be."""
    seen: list[Floats] = []

    def costs(x: Floats) -> Floats:
        seen.append(x.copy())
        return sphere(x)

    best, bounds = np.full(10, 1.0), WIDE.copy()
    x0 = np.array([best, np.full(10, 2.0)]) if options is SWARM else best.copy()
    x0.flags.writeable = bounds.flags.writeable = False
    result = run(costs, options, bounds, x0=x0)
    given = np.atleast_2d(x0)
    assert np.array_equal(seen[0][: len(given)], given) and len(seen[0]) == 20
    assert (result.fun, result.x.tolist()) == (0.0, best.tolist())
    assert not np.shares_memory(result.x, x0)


def test_each_strategy_follows_its_name() -> None:
    assert DifferentialEvolution().strategy == "tradeoff"
    results = {n: run(options=SEARCHES[n]).x.tobytes() for n in STRATEGIES}
    assert results.pop("tradeoff") == results[TRADEOFF]
    assert len(set(results.values())) == len(results)
    # The same seed gives the same bytes, another one does not.
    for name, found in results.items():
        assert found == run(options=SEARCHES[name]).x.tobytes()
        assert found != run(options=SEARCHES[name], seed=4).x.tobytes()


# With F = 0.6 all but rand/1 contract too early for a bent valley.
@pytest.mark.parametrize(
    ("strategy", "costs", "generations"),
    [
        ("rand/1", sphere, 800),
        ("best/1", sphere, 300),
        ("midpoint", sphere, 300),
        ("rand-to-best/1", rosenbrock, 500),
    ],
)
def test_known_minima(
    strategy: str, costs: Callable[[Floats], Floats], generations: int
) -> None:
    options = DifferentialEvolution(
        strategy, population_size=60, mutation=0.7, maxiter=generations, target=1e-8
    )
    result = run(costs, options, seed=1)
    assert result.status is Status.TARGET
    assert result.fun <= 1e-8 < result.best_history[-2]
    assert result.x == pytest.approx(np.ones(10), abs=2e-3)


# Swarms.


@pytest.mark.parametrize(
    ("costs", "size", "within"),
    [(sphere, 5, 2e-3), (rosenbrock, 2, 0.02), (rastrigin, 3, 1e-3)],
)
def test_known_minima_of_a_swarm(
    costs: Callable[[Floats], Floats], size: int, within: float
) -> None:
    options = ParticleSwarm(particles=60, iterations=400, target=1e-6)
    result = run(costs, options, WIDE[:size])
    assert result.status is Status.TARGET
    assert result.x == pytest.approx(np.ones(size), abs=within)


def test_the_swarm_converges_in_one_basin() -> None:
    """As printed, without inertia below 1, it does not."""
    options = ParticleSwarm(particles=30, iterations=300, mutation=0.0, tol=1e-6)

    def found(seed: int = 0, **changes: float) -> EvolutionResult:
        changed = replace(options, **changes)
        return run(lambda x: sphere(x) + 1.0, changed, WIDE[:5], seed)

    result = found()
    assert result.status is Status.CONVERGED and result.nit < 300
    assert result.x == pytest.approx(np.ones(5), abs=0.01)
    assert found(inertia=1.0).status is Status.GENERATIONS
    assert found().population.tobytes() == result.population.tobytes()
    assert found(4).x.tobytes() != result.x.tobytes()
