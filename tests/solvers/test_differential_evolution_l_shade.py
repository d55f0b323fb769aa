"""L-SHADE: what it draws, remembers, archives, and how it shrinks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import DifferentialEvolution, Status, differential_evolution
from calib_pin.solvers.differential_evolution import TERMINAL, LShade
from tests.solvers.test_differential_evolution import rosenbrock

WIDE = np.tile([-5.0, 5.0], (10, 1))


def variant(size: int = 10, dimension: int = 2, budget: int = 1000) -> LShade:
    return LShade(size, dimension, budget, np.random.default_rng(0))


@pytest.mark.parametrize(("mean", "at_limit"), [(0.5, 0.0), (0.95, 0.309)])
def test_factors_are_drawn_about_their_means(mean: float, at_limit: float) -> None:
    """As in the paper: drawn again while not positive, and cut off at 1."""
    shade = variant()
    shade.mean_F[:], shade.mean_CR[:] = mean, mean
    shade._draw_factors(100_000)
    chance = mean + 0.1 * np.random.default_rng(1).standard_cauchy(100_000)
    expected = np.minimum(chance[chance > 0], 1)
    assert shade.F.min() >= 0 and shade.F.max() == 1
    parts = np.linspace(0.05, 0.95, 10)
    assert np.quantile(shade.F, parts) == pytest.approx(
        np.quantile(expected, parts), abs=0.02
    )
    assert np.median(shade.CR) == pytest.approx(mean, abs=0.002)
    assert np.mean(shade.CR == 1) == pytest.approx(at_limit, abs=0.01)
    shade.mean_CR[:] = TERMINAL
    shade._draw_factors(10)
    assert (shade.CR == 0).all()


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
    # Ties, failures and NaN teach nothing; a gain from infinity counts alone.
    fresh = np.array([5.0, 6.0, np.nan])
    shade.learn(parents, energies, fresh, 3)
    assert (shade.entry, shade.archived) == (1, 2)
    shade.learn(parents, np.array([5.0, np.inf, 5.0]), np.ones(3), 3)
    assert (shade.mean_F[1], shade.mean_CR[1]) == pytest.approx((0.9, 0.7))


def test_trials_are_what_the_formula_allows() -> None:
    # Members far apart in size: each mutant shows which members made it.
    population = 10.0 ** np.arange(4)[:, None]
    energies = np.array([3.0, 1.0, 2.0, 4.0])
    shade = variant(4, 1)
    shade._archive(np.array([[1e5]]), 10)
    made = set()
    for _ in range(1500):
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


@pytest.mark.parametrize(("size", "maxiter"), [(60, 20), (30, 1), (4, 20)])
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
