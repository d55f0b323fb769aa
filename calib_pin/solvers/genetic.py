"""A genetic algorithm that selects some of many items.

A member is a subset of `count` out of `size` items, without repetition and in no order.
Generation by generation

- the parents of a child are each the best of a few members drawn by chance (a
  tournament),
- the child keeps the items of both parents and draws the rest from those of either,
- then it swaps some of its items for others that it does not have,
- the best members live on unchanged, so that the best cost never rises.

Crossover and mutation are the same operation here: each item gets a rank, an integer
for its precedence plus a random fraction, and the `count` highest ranks are in.
So every child is a subset of the right size, and none has to be repaired.

References:
    Aoyagi et al. 2010, IROS: measuring points that make an observability index largest,
    under a limit on their number.
    Radcliffe 1993, doi 10.1007/BF01411376: crossover of sets that keeps what both
    parents share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.evolution import Booleans, Indices, Rng, below
from calib_pin.solvers.exchange import SelectionResult
from calib_pin.solvers.status import Status

SubsetCosts = Callable[[Indices], Floats]
"""Costs of a population of subsets, shape (S, count) -> (S,)."""

Callback = Callable[[int, Indices, float], bool | None]
"""Told the generation, the best subset and its cost; True stops the search."""


@dataclass(frozen=True)
class Genetic:
    """Options of the genetic algorithm.

    Attributes:
        population_size: Number of members, 2 or more.
        generations: Limit on the generations after the first population, 1 or more.
        tournament: Members drawn to find one parent, 1 or more; the more, the harder
            the selection.
        crossover: Probability that a child has two parents, in [0, 1].
        swaps: Items that a child swaps for others on average, 0 or more.
        elite: Members that live on, 1 or more, less than population_size.
        patience: Converged when the best cost has not fallen for as many generations.
    """

    population_size: int = 100
    generations: int = 300
    tournament: int = 3
    crossover: float = 0.9
    swaps: float = 1.0
    elite: int = 2
    patience: int = 50


def genetic_selection(
    costs: SubsetCosts,
    size: int,
    count: int,
    rng: Rng,
    options: Genetic = Genetic(),
    *,
    callback: Callback | None = None,
) -> SelectionResult:
    """Select the items that together cost least.

    Args:
        costs: Costs of subsets, shape (S, count) -> (S,), called once per generation.
            The rows are indices from 0 to size - 1 in ascending order. An infinite
            or NaN cost is not feasible.
        size: Number of items.
        count: Number of items to select, 1 to size.
        rng: Source of chance; the same seed gives the same result.
        options: Sizes, probabilities and stops.
        callback: Called after each generation with its number, the best subset
            (count,) and its cost; returns True to stop.

    Returns:
        The result, its members in ascending order. Not finite if the first population
        had no feasible member.

    Examples:
        >>> values = np.array([3.0, 1.0, 4.0, 1.5, 5.0, 9.0, 2.0, 6.0])
        >>> result = genetic_selection(
        ...     lambda x: -values[x].sum(axis=1), 8, 3, np.random.default_rng(0)
        ... )
        >>> result.status.value, result.chosen, result.cost
        ('converged', (4, 5, 7), -20.0)
    """
    nursery = _Nursery(options, count, rng)
    subsets = nursery.founders(size)
    energies = _energies(costs, subsets)
    best_history = [float(energies.min())]
    status = Status.NOT_FINITE if best_history[0] == np.inf else None
    status = status or _stop(options, best_history)
    while status is None:
        elite = np.argsort(energies, kind="stable")[: options.elite]
        children = nursery.children(subsets, energies, size)
        fresh = _energies(costs, children)
        subsets = np.concatenate([subsets[elite], children])
        energies = np.concatenate([energies[elite], fresh])
        best_history.append(float(energies.min()))
        status = _stop(options, best_history)
        if callback is not None:
            generation = len(best_history) - 1
            best = subsets[energies.argmin()]
            stop = callback(generation, best.copy(), best_history[-1])
            status = status or (Status.STOPPED if stop else None)
    chosen = tuple(subsets[energies.argmin()].tolist())
    return SelectionResult(chosen, best_history[-1], len(best_history) - 1, status)


def _energies(costs: SubsetCosts, subsets: Indices) -> Floats:
    """Costs of subsets, infinite where they are NaN, shape (S,)."""
    energies = np.asarray(costs(subsets), float)
    return np.where(np.isnan(energies), np.inf, energies)


def _stop(options: Genetic, best_history: list[float]) -> Status | None:
    """The stop reached by the last of these generations, if any."""
    generation = len(best_history) - 1
    before = generation - options.patience
    if before >= 0 and best_history[before] == best_history[-1]:
        return Status.CONVERGED
    return Status.GENERATIONS if generation >= options.generations else None


class _Nursery:
    """Source of members: subsets of `count` items."""

    def __init__(self, options: Genetic, count: int, rng: Rng) -> None:
        self.options, self.count, self.rng = options, count, rng

    def founders(self, size: int) -> Indices:
        """The first population, shape (S, count)."""
        return self._highest(self.rng.random((self.options.population_size, size)))

    def children(self, subsets: Indices, energies: Floats, size: int) -> Indices:
        """Children of a population, one for each member outside of the elite."""
        options, rng = self.options, self.rng
        number = options.population_size - options.elite
        contenders = below(len(subsets), (2, number, options.tournament), rng)
        winners = energies[contenders].argmin(axis=-1)[..., None]
        mother, father = np.take_along_axis(contenders, winners, axis=-1)[..., 0]
        father = np.where(rng.random(number) < options.crossover, father, mother)
        members = _membership(subsets, size)
        shared = np.add(members[mother], members[father], dtype=float)
        child = self._highest(shared + rng.random(shared.shape))
        # Others outrank those that leave, unless there are too few of them.
        stays = _membership(child, size)
        leaves = stays & (rng.random(stays.shape) < options.swaps / self.count)
        rank = np.where(leaves, 0.0, np.where(stays, 2.0, 1.0))
        return self._highest(rank + rng.random(rank.shape))

    def _highest(self, rank: Floats) -> Indices:
        """The items that rank highest, (S, size) -> (S, count), in ascending order."""
        last = rank.shape[1] - self.count
        items = np.argpartition(rank, last, axis=1)[:, last:]
        return np.sort(items, axis=1)


def _membership(subsets: Indices, size: int) -> Booleans:
    """Membership of items in subsets, (S, count) -> (S, size)."""
    members = np.zeros((len(subsets), size), bool)
    np.put_along_axis(members, subsets, True, axis=1)
    return members
