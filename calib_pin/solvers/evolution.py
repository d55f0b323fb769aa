"""The generation loop that all variants of differential evolution share.

A population of members x_i within a box of bounds is improved generation by generation
(Storn and Price 1997, doi 10.1023/A:1008202821328). A *variant* breeds one trial for
every member, its target; what leaves the box is brought back; all trials are evaluated
in one call; each trial then replaces its target unless it is worse. So the best cost
never rises, and whatever stops the loop, the best member ever seen is still there.

The population lives in the caller's units: every mutation is an affine combination of
members, which a scaling of the components does not change.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.status import Status

Booleans = NDArray[np.bool_]
Indices = NDArray[np.intp]
Rng = np.random.Generator

Costs = Callable[[Floats], Floats]
"""Costs of a whole population at once, shape (S, D) -> (S,)."""

Callback = Callable[[int, Floats, float], bool | None]
"""Told the generation, the best member (D,) and its cost; True stops the evolution."""


@dataclass(frozen=True)
class EvolutionResult:
    """Outcome of an evolution within bounds, in the words of scipy.optimize.

    Attributes:
        x: Best member, shape (D,).
        fun: Its cost.
        nit: Number of generations after the first population.
        nfev: Number of members evaluated.
        status: Outcome of the search.
        population: Last population, shape (S, D).
        best_history: Best cost of every generation, shape (nit + 1,).
    """

    x: Floats
    fun: float
    nit: int
    nfev: int
    status: Status
    population: Floats
    best_history: Floats


@dataclass(frozen=True)
class Stops:
    """Stopping criteria of an evolution.

    Attributes:
        target: Reached when `best cost <= target`.
        tol: Relative part of the spread, see `atol`.
        atol: Converged when `std(costs) <= atol + tol * |mean(costs)|`, as in scipy.
        evaluations: Ends before the generation that would need more than these.
    """

    target: float
    tol: float
    atol: float
    evaluations: int

    def reached(self, costs: Floats) -> Status | None:
        """The stop that a population of these costs, shape (S,), has reached, if any.

        Of infinite members there is no spread to judge.
        """
        if costs.min() <= self.target:
            return Status.TARGET
        mean = float(np.add.reduce(costs)) / len(costs)
        if not math.isfinite(mean):
            return None
        apart = costs - mean
        deviation = math.sqrt(float(np.dot(apart, apart)) / len(costs))
        converged = deviation <= self.atol + self.tol * abs(mean)
        return Status.CONVERGED if converged else None


@dataclass(frozen=True)
class Box:
    """The bounds of the members.

    Attributes:
        lower: Lower bounds, shape (D,).
        upper: Upper bounds, shape (D,); an equal pair holds its component fixed.
    """

    lower: Floats
    upper: Floats

    @staticmethod
    def of(bounds: Floats) -> Box:
        """The box of checked bounds, shape (D, 2).

        Raises:
            OptionError: If a bound is not finite, or a pair is reversed.
        """
        pairs = np.array(bounds, float)
        for k, (lower, upper) in enumerate(pairs.tolist()):
            if not np.isfinite([lower, upper]).all():
                raise OptionError(
                    f"bounds of component {k} are not finite", value=(lower, upper)
                )
            if lower > upper:
                raise OptionError(
                    f"bounds of component {k} are reversed",
                    value=(lower, upper),
                    allowed="lower <= upper",
                )
        return Box(pairs[:, 0].copy(), pairs[:, 1].copy())

    def populate(
        self, size: int, init: str, x0: Floats | None, rng: np.random.Generator
    ) -> Floats:
        """A first population, shape (size, D).

        Args:
            size: Number of members.
            init: `random`, or `latinhypercube` for one member in each of `size` equal
                slices of every component.
            x0: First members, shape (D,) or (S0, D), if there is a guess.
            rng: Source of chance.
        """
        shape = size, len(self.lower)
        place = rng.random(shape)
        if init == "latinhypercube":
            slices = np.broadcast_to(np.arange(size)[:, None], shape)
            place = (rng.permuted(slices, axis=0) + place) / size
        members = self.lower + place * (self.upper - self.lower)
        if x0 is not None:
            first = np.atleast_2d(x0)
            members[: len(first)] = first
        # Rounding may have led past the upper bound.
        return np.clip(members, self.lower, self.upper)

    def repair(self, trials: Floats, parents: Floats, rng: np.random.Generator) -> None:
        """Bring components that left the box back into it, in place, (S, D).

        They go anywhere between the parent and the bound that they violate. Clipped to
        the bound instead, members would pile up there, and where all members agree
        no difference of members leads away again.
        """
        outside = np.flatnonzero((trials < self.lower) | (trials > self.upper))
        if not len(outside):
            return
        column = outside % trials.shape[1]
        lower, upper = self.lower[column], self.upper[column]
        strays, inner = trials.ravel(), parents.ravel()[outside]
        bound = np.where(strays[outside] < lower, lower, upper)
        # As random numbers are less than 1, rounding never leads past the parent.
        trials.flat[outside] = bound + rng.random(len(outside)) * (inner - bound)


Breed = Callable[[Floats, Floats], Floats]
"""One trial for every member, by the population (S, D) and its costs (S,): a new array
(S, D) that may leave the box."""


def evolve(
    costs: Costs,
    box: Box,
    population: Floats,
    breed: Breed,
    stops: Stops,
    rng: Rng,
    callback: Callback | None = None,
) -> EvolutionResult:
    """Improve a population until something stops it.

    Args:
        costs: Costs of a population; called once per generation with all trials.
        box: Bounds of the members.
        population: First population, shape (S, D), within the bounds.
        breed: Breeds the trials.
        stops: Stopping criteria.
        rng: Source of chance for the way back into the box.
        callback: Called after every generation.
    """
    # Own copies: these two arrays evolve in place.
    population, energies = population.copy(), np.asarray(costs(population), float)
    energies = np.where(np.isnan(energies), np.inf, energies)
    nfev, best, status = len(energies), energies.argmin(), stops.reached(energies)
    best_history = [float(energies[best])]
    if best_history[0] == np.inf:
        status = Status.NOT_FINITE
    while status is None:
        if nfev + len(population) > stops.evaluations:
            status = Status.GENERATIONS
            break
        trials = breed(population, energies)
        box.repair(trials, population, rng)
        fresh = np.asarray(costs(trials), float)
        nfev += len(trials)
        # A tie goes to the trial, so that members can cross a plateau; NaN never wins.
        better = fresh <= energies
        np.copyto(population, trials, where=better[:, None])
        np.copyto(energies, fresh, where=better)
        best, status = energies.argmin(), stops.reached(energies)
        best_history.append(float(energies[best]))
        if callback is not None:
            generation = len(best_history) - 1
            stop = callback(generation, population[best].copy(), best_history[-1])
            status = status or (Status.STOPPED if stop else None)
    return EvolutionResult(
        x=population[best].copy(),
        fun=best_history[-1],
        nit=len(best_history) - 1,
        nfev=nfev,
        status=status,
        population=population,
        best_history=np.array(best_history),
    )


def below(limit: int | Floats, shape: int | tuple[int, ...], rng: Rng) -> Indices:
    """Random whole numbers from 0 to limit - 1; a third of the time of `integers`."""
    return np.asarray((rng.random(shape) * limit).astype(np.intp))


def three_others(size: int, generations: int, rng: Rng) -> Indices:
    """For every member, three that differ from it and from each other.

    The number drawn is the offset from the target, less one: the target itself never
    occurs. Each further offset comes from a range shorter by those already drawn and
    steps over them in ascending order: uniform, without trial and error.

    Returns:
        Indices of members, shape (generations, 3, size).
    """
    ranges = size - np.array([1.0, 2.0, 3.0])[:, None, None]
    a, b, c = below(ranges, (3, generations, size), rng)
    b += b >= a
    c += c >= np.minimum(a, b)
    c += c >= np.maximum(a, b)
    others = np.stack([a, b, c], axis=1) + np.arange(1, size + 1)
    return np.where(others >= size, others - size, others)


def crossing(shape: tuple[int, ...], CR: float, rng: Rng) -> Booleans:
    """Components that trials take from their mutants in binomial crossover.

    Those where `rand <= CR`, and one at a random place in any case.

    Args:
        shape: (..., D).
        CR: Recombination.
        rng: Source of chance.
    """
    # Single precision is chance enough, and these are most of all random numbers.
    crossed = rng.random(shape, np.float32) <= CR
    trials = crossed.reshape(-1, shape[-1])
    trials[np.arange(len(trials)), below(shape[-1], len(trials), rng)] = True
    return crossed
