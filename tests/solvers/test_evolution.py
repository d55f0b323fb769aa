"""The loop that all evolutions share: selection, stops, history, chance."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import EvolutionResult, Status
from calib_pin.solvers.evolution import Box, Stops, crossing, evolve, three_others

UNIT = Box(np.zeros(1), np.ones(1))
NEVER = {"target": -np.inf, "tol": 0.0, "atol": 0.0}


class Script:
    """A variant that brings the trials that a test prescribes."""

    def __init__(self, *generations: list[float]) -> None:
        self.trials = [np.array(members)[:, None] for members in generations]

    def breed(self, population: Floats, energies: Floats) -> Floats:
        return self.trials.pop(0)


def cost(x: Floats) -> Floats:
    return x[:, 0]


def run(first: list[float], script: Script, **options: object) -> EvolutionResult:
    generations = len(script.trials)
    costs = options.pop("costs", cost)
    callback = options.pop("callback", None)
    stops = NEVER | {"evaluations": len(first) * (generations + 1)} | options
    return evolve(
        costs,  # type: ignore[arg-type]
        UNIT,
        np.array(first)[:, None],
        script.breed,
        Stops(**stops),  # type: ignore[arg-type]
        np.random.default_rng(0),
        callback,  # type: ignore[arg-type]
    )


def test_each_trial_replaces_its_own_target_unless_worse() -> None:
    result = run([0.4, 0.5, 0.6], Script([0.45, 0.1, 0.6]))
    assert result.population[:, 0].tolist() == [0.4, 0.1, 0.6]
    assert (result.x.tolist(), result.fun) == ([0.1], 0.1)
    assert (result.nit, result.nfev) == (1, 6)
    assert result.best_history.tolist() == [0.4, 0.1]


def test_generations_end_before_they_exceed_the_evaluations() -> None:
    result = run([0.4, 0.5], Script([0.9, 0.9], [0.9, 0.9]), evaluations=5)
    assert (result.status, result.nit, result.nfev) == (Status.GENERATIONS, 1, 4)


@pytest.mark.parametrize(("target", "generations"), [(0.4, 0), (0.2, 1), (0.19, 2)])
def test_target_is_reached_at_equality(target: float, generations: int) -> None:
    """It also outranks a callback that stops."""
    script = Script([0.2, 0.9], [0.1, 0.1])
    result = run([0.4, 0.5], script, target=target, callback=lambda n, *_: n == 2)
    assert (result.status, result.nit) == (Status.TARGET, generations)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_spread_is_that_of_scipy(sign: float) -> None:
    energies = sign * np.array([1.0, 1.1, 1.3])
    spread, size = energies.std(), abs(energies.mean())

    def status(tol: float, atol: float) -> Status:
        first = (np.abs(energies) / 2).tolist()
        costs = {"costs": lambda x: 2 * sign * x[:, 0]}
        return run(first, Script(), **costs, tol=tol, atol=atol).status

    for tol, atol in (
        (spread / size, 0.0),
        (0.0, spread),
        (0.5 * spread / size, 0.5 * spread),
    ):
        assert status(tol * 1.001, atol * 1.001) is Status.CONVERGED
        assert status(tol / 1.001, atol / 1.001) is Status.GENERATIONS


def test_the_callback_sees_each_generation_and_can_stop() -> None:
    seen: list[tuple[int, list[float], float]] = []

    def callback(generation: int, x: Floats, fun: float) -> bool:
        seen.append((generation, x.tolist(), fun))
        x[:] = 0.7  # A copy: the population does not change.
        return generation == 2

    script = Script([0.3, 0.9], [0.9, 0.2], [0.1, 0.1])
    result = run([0.4, 0.5], script, callback=callback)
    assert seen == [(1, [0.3], 0.3), (2, [0.2], 0.2)]
    assert result.status is Status.STOPPED
    assert (result.nit, result.fun, result.status.success) == (2, 0.2, False)
    assert result.population[:, 0].tolist() == [0.3, 0.2]


def test_costs_that_are_not_finite_lose() -> None:
    def costs(x: Floats) -> Floats:
        return np.select([x[:, 0] > 0.8, x[:, 0] > 0.6], [np.nan, np.inf], x[:, 0])

    result = run([0.9, 0.7, 0.5], Script([0.9, 0.9, 0.9], [0.7, 0.3, 0.7]), costs=costs)
    # NaN loses even to infinity, among equals the trial wins.
    assert result.population[:, 0].tolist() == [0.7, 0.3, 0.5]
    assert result.best_history.tolist() == [0.5, 0.5, 0.3]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_first_population_without_a_finite_cost(value: float) -> None:
    result = run([0.4, 0.5], Script([0.1, 0.1]), costs=lambda x: x[:, 0] * 0 + value)
    assert result.status is Status.NOT_FINITE
    assert (result.fun, result.nit, result.nfev) == (np.inf, 0, 2)


def test_others_are_uniform() -> None:
    """Different from each other and from the target, every triple as likely."""
    generations, size = 20_000, 5
    others = three_others(size, generations, np.random.default_rng(0))
    everyone = np.broadcast_to(np.arange(size), (generations, 1, size))
    group = np.sort(np.concatenate([others, everyone], axis=1), axis=1)
    assert (np.diff(group, axis=1) > 0).all()
    assert group.min() == 0 and group.max() == size - 1
    # Ordered triples of the four others: 24 of them.
    for a, b, c in others.transpose(2, 1, 0):
        counts = np.bincount((a * size + b) * size + c)
        counts = counts[counts > 0]
        assert len(counts) == 24
        assert np.abs(counts / generations * 24 - 1.0).max() < 0.15


@pytest.mark.parametrize("CR", [0.0, 0.3, 0.9, 1.0])
def test_crossing_takes_its_part_and_at_least_one(CR: float) -> None:
    crossed = crossing((50, 40, 8), CR, np.random.default_rng(0))
    assert crossed.any(axis=-1).all()
    # One in eight is forced, the others are left to chance.
    assert crossed.mean() == pytest.approx(1 / 8 + 7 / 8 * CR, abs=0.01)
    assert crossed.mean(axis=(0, 1)) == pytest.approx(
        np.full(8, crossed.mean()), abs=0.05
    )
    rates = np.array([[0.0], [1.0]])
    crossed = crossing((2, 8), rates, np.random.default_rng(0))
    assert crossed.sum(axis=1).tolist() == [1, 8]
