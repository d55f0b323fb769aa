"""L-SHADE: what it draws, remembers, archives, and how it shrinks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import DifferentialEvolution, Status, differential_evolution
from calib_pin.solvers.differential_evolution import OPTIONS, TERMINAL, LShade

WIDE = np.tile([-5.0, 5.0], (10, 1))


def rosenbrock(x: Floats) -> Floats:
    valley = 100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2
    return np.sum(valley + (1 - x[:, :-1]) ** 2, axis=1)


def variant(size: int = 10, dimension: int = 2, budget: int = 1000) -> LShade:
    return LShade(size, dimension, budget, np.random.default_rng(0))


def drawn(mean_F: float, mean_CR: float) -> tuple[Floats, Floats]:
    shade = variant()
    shade.mean_F[:], shade.mean_CR[:] = mean_F, mean_CR
    shade._draw_factors(100_000)
    return shade.F, shade.CR


@pytest.mark.parametrize("mean", [0.02, 0.3, 0.9])
def test_factors_are_cauchy_numbers_above_zero(mean: float) -> None:
    F, _ = drawn(mean, 0.5)
    # As in the paper: drawn again while not positive, and cut off at 1.
    chance = np.random.default_rng(1).standard_cauchy(400_000)
    expected = mean + 0.1 * chance
    expected = np.minimum(expected[expected > 0], 1)
    assert F.min() >= 0 and F.max() == 1
    parts = np.linspace(0.05, 0.95, 10)
    assert np.quantile(F, parts) == pytest.approx(
        np.quantile(expected, parts), abs=0.01
    )


def test_recombination_is_normal_within_limits() -> None:
    _, CR = drawn(0.5, 0.5)
    assert (CR.mean(), CR.std()) == pytest.approx((0.5, 0.1), abs=0.002)
    _, CR = drawn(0.5, 0.95)
    assert CR.max() == 1 and np.mean(CR == 1) == pytest.approx(0.309, abs=0.01)
    _, CR = drawn(0.5, TERMINAL)
    assert (CR == 0).all()


def test_means_are_those_of_lehmer_weighted_by_gains() -> None:
    shade = variant()
    shade.F, shade.CR = np.array([0.2, 0.9, 0.6]), np.array([0.1, 0.7, 0.4])
    parents, energies = np.zeros((3, 2)), np.array([5.0, 5.0, 5.0])
    shade.learn(parents, energies, np.array([4.0, 6.0, 2.0]), 3)
    # Gains 1 and 3 of the first and the last member.
    assert shade.mean_F[0] == pytest.approx((0.2**2 + 3 * 0.6**2) / (0.2 + 3 * 0.6))
    assert shade.mean_CR[0] == pytest.approx((0.1**2 + 3 * 0.4**2) / (0.1 + 3 * 0.4))
    assert (shade.mean_F[1:] == 0.5).all() and (shade.mean_CR[1:] == 0.5).all()
    assert (shade.entry, shade.archived) == (1, 2)


def test_what_gained_from_infinity_counts_alone() -> None:
    shade = variant()
    shade.F, shade.CR = np.array([0.2, 0.6]), np.array([0.1, 0.4])
    energies = np.array([5.0, np.inf])
    shade.learn(np.zeros((2, 2)), energies, np.ones(2), 2)
    assert shade.mean_F[0] == pytest.approx(0.6)
    assert shade.mean_CR[0] == pytest.approx(0.4)


def test_nothing_is_learnt_from_ties_failures_or_nan() -> None:
    shade = variant()
    shade.F = shade.CR = np.full(3, 0.9)
    fresh = np.array([1.0, 2.0, np.nan])
    shade.learn(np.zeros((3, 2)), np.ones(3), fresh, 3)
    assert (shade.entry, shade.archived) == (0, 0)
    assert (shade.mean_F == 0.5).all()


def test_entries_are_written_in_turn_and_terminal_ones_stay() -> None:
    shade = variant()

    def succeed(CR: float) -> None:
        shade.F, shade.CR = np.array([0.7]), np.array([CR])
        shade.learn(np.zeros((1, 2)), np.ones(1), np.zeros(1), 1)

    succeed(0.0)
    for _ in range(OPTIONS.memory):
        succeed(0.3)
    assert shade.entry == 1
    assert shade.mean_CR[0] == TERMINAL
    assert shade.mean_CR[1:] == pytest.approx(np.full(OPTIONS.memory - 1, 0.3))
    assert shade.mean_F == pytest.approx(np.full(OPTIONS.memory, 0.7))


def test_the_archive_fills_and_then_replaces_at_random() -> None:
    shade = variant(size=10, dimension=1)
    for generation in range(60):
        replaced = 10.0 * generation + np.arange(10.0)[:, None]
        shade._archive(replaced, 26)
        assert shade.archived == min(10 * (generation + 1), 26)
        held = shade.archive[: shade.archived, 0]
        assert len(np.unique(held)) == len(held)
        assert np.isin(held, np.arange(10.0 * (generation + 1))).all()
    # Newer members outnumber older ones, but some old ones are there.
    age = 599 - held
    assert np.median(age) < 30 < age.max() < 300
    shade._archive(np.array([[-1.0]]), 5)
    assert shade.archived == 5 and -1.0 in shade.archive[:5]


def test_trials_are_what_the_formula_allows() -> None:
    # Members far apart in size: each mutant shows which members made it.
    population = 10.0 ** np.arange(4)[:, None]
    energies = np.array([3.0, 1.0, 2.0, 4.0])
    shade = variant(4, 1)
    shade._archive(np.array([[1e5]]), 10)
    made = set()
    for _ in range(2000):
        trials = shade.breed(population, energies)
        made |= {
            (i, float(f"{step:.4g}"))
            for i, step in enumerate((trials - population)[:, 0] / shade.F)
        }
    x = population[:, 0]
    pool = [*x, 1e5]
    expected = {
        (i, float(f"{x[pbest] - x[i] + x[r1] - pool[r2]:.4g}"))
        for i in range(4)
        for pbest in (1, 2)  # The two best.
        for r1 in range(4)
        for r2 in range(5)
        if r1 != i and r2 not in (i, r1)
    }
    assert made == expected


@pytest.mark.parametrize(("size", "maxiter"), [(60, 100), (30, 1), (30, 2), (4, 20)])
def test_the_population_shrinks_to_four(size: int, maxiter: int) -> None:
    sizes: list[int] = []

    def costs(x: Floats) -> Floats:
        sizes.append(len(x))
        return rosenbrock(x)

    options = DifferentialEvolution("l-shade", size, maxiter=maxiter)
    result = differential_evolution(costs, WIDE, np.random.default_rng(0), options)
    budget = size * (maxiter + 1)
    assert result.status is Status.GENERATIONS
    assert budget - 4 < result.nfev == sum(sizes) <= budget
    assert len(result.population) == 4
    assert sizes[0] == size
    assert all(b <= a for a, b in pairwise(sizes))
    # Linear over the evaluations (eq. 10) from the second generation on, until what
    # is left of them is less than that.
    spent = np.cumsum(sizes)[1:-1]
    planned = np.minimum(size + (4 - size) * spent / budget, budget - spent)
    assert np.all(np.abs(np.maximum(planned, 4) - sizes[2:]) <= 0.5)
    assert result.fun == rosenbrock(result.x[None])[0]


def test_lower_than_fixed_factors_with_the_same_evaluations() -> None:
    def median(strategy: str) -> float:
        options = DifferentialEvolution(strategy, 50, maxiter=200, tol=0.0)
        found = [
            differential_evolution(
                rosenbrock, WIDE, np.random.default_rng(seed), options
            ).fun
            for seed in range(5)
        ]
        return float(np.median(found))

    assert median("l-shade") < 1e-3 * median("rand/1")
