"""Differential evolution with the mutations of Liu, Ni, Liu and Xu (2012).

For a target x_i and members x_a, x_b, x_c, different from each other and from x_i, the
mutant v is

    rand/1           v = x_a + F (x_b - x_c)
    best/1           v = x_best + F (x_a - x_b)
    rand-to-best/1   v = x_a + F (x_best - x_a) + F (x_b - x_c)
    midpoint         v = (x_a + x_best) / 2 + F (x_b - x_c)

The difference of two members gives each step the scale and the direction of the
population itself, which is why no step size has to be chosen. rand/1 explores and is
slow; best/1 is fast and gets stuck; the others lie between. Their mutants have
2 F^2 (best/1), (1 - F)^2 + 2 F^2 (rand-to-best/1) and 1/4 + 2 F^2 (midpoint) times the
variance of the members: below F = 0.71, 0.67 and 0.61 the population contracts even
without selection. That is quick in one basin and too early in a long bent valley, which
wants F of 0.7 to 0.8.

References:
    Liu, Ni, Liu, Xu 2012, doi 10.1007/s11771-012-1095-1: calibration of a robot with a
    laser distance sensor; rand/1, best/1 and the "tradeoff" mutation (eq. 16).
    Storn, Price 1997, doi 10.1023/A:1008202821328: differential evolution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from calib_pin.errors import OptionError, require_known
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.evolution import (
    Booleans,
    Box,
    Callback,
    Costs,
    EvolutionResult,
    Indices,
    Rng,
    Stops,
    crossing,
    evolve,
    three_others,
)

TRADEOFF = "rand-to-best/1"
"""The mutation that `tradeoff` stands for.

A reconstruction: eq. 16 of Liu et al. is lost in the text at hand. It draws three
different members and lies between rand/1 and best/1; `midpoint` and `rand-to-best/1`
both fit that. On the published case both come to the optimum of 100 configurations,
this one in fewer generations (`scripts/reproduce liu2012`).
"""

Mutation = Callable[[Floats, Floats, Indices, float], Floats]


def _rand(members: Floats, best: Floats, others: Indices, F: float) -> Floats:
    a, b, c = members[others]
    return np.asarray(a + F * (b - c))


def _best(members: Floats, best: Floats, others: Indices, F: float) -> Floats:
    a, b = members[others[:2]]
    return np.asarray(best + F * (a - b))


def _rand_to_best(members: Floats, best: Floats, others: Indices, F: float) -> Floats:
    a, b, c = members[others]
    return np.asarray(a + F * (best - a + b - c))


def _midpoint(members: Floats, best: Floats, others: Indices, F: float) -> Floats:
    a, b, c = members[others]
    return np.asarray(0.5 * (a + best) + F * (b - c))


MUTATIONS: dict[str, Mutation] = {
    "rand/1": _rand,
    "best/1": _best,
    "rand-to-best/1": _rand_to_best,
    "midpoint": _midpoint,
}
MUTATIONS["tradeoff"] = MUTATIONS[TRADEOFF]

STRATEGIES = tuple(MUTATIONS)
"""Names of the mutation strategies."""

BLOCK = 16
"""Generations for which chance is drawn at once."""

INITS = ("latinhypercube", "random")
"""Names of the ways to choose the first population."""

SMALLEST, LARGEST = np.nextafter(0.0, 1.0), np.finfo(float).max

LIMITS: dict[str, tuple[type, float, float, str]] = {
    "population_size": (Integral, 4, 100_000, "a whole number, 4 to 100000"),
    "mutation": (Real, SMALLEST, 2, "more than 0, up to 2"),
    "recombination": (Real, 0, 1, "0 to 1"),
    "maxiter": (Integral, 1, np.inf, "a whole number, 1 or more"),
    "target": (Real, -np.inf, LARGEST, "a number"),
    "tol": (Real, 0, np.inf, "0 or more"),
    "atol": (Real, 0, np.inf, "0 or more"),
}
"""Kind, least and largest value of the options that are numbers, and all in words."""


@dataclass(frozen=True)
class DifferentialEvolution:
    """Options of differential evolution; the defaults are those of Liu et al. (2012).

    Attributes:
        strategy: `rand/1`, `best/1`, `rand-to-best/1`, `midpoint` or `tradeoff` (here
            the same as `rand-to-best/1`, a reconstruction).
        population_size: Number of members Np, 4 to 100 000. (The popsize of scipy is a
            multiple of the number of components instead.)
        mutation: Factor F of the differences, in (0, 2].
        recombination: CR, in [0, 1]: part of the components that a trial takes from
            the mutant.
        maxiter: Limit on the generations after the first population, 1 or more.
        target: Ends when `best cost <= target`; the V of Liu et al.
        tol: Converged when `std(costs) <= atol + tol * |mean(costs)|`, as in scipy.
        atol: Absolute part of that, in the unit of the cost.
        init: First population, `latinhypercube` or `random`.

    Raises:
        OptionError: If a value is not allowed.
    """

    strategy: str = "tradeoff"
    population_size: int = 150
    mutation: float = 0.6
    recombination: float = 0.9
    maxiter: int = 500
    target: float = -np.inf
    tol: float = 1e-8
    atol: float = 0.0
    init: str = "latinhypercube"

    def __post_init__(self) -> None:
        """Check the values."""
        require_known("mutation strategy", self.strategy, STRATEGIES)
        require_known("init", self.init, INITS)
        for name, (kind, least, most, words) in LIMITS.items():
            value = getattr(self, name)
            # Here True is no number, and NaN is within no limits.
            number = isinstance(value, kind) and not isinstance(value, bool)
            if not number or not least <= value <= most:
                raise OptionError(f"{name} cannot be used", value=value, allowed=words)

    @property
    def budget(self) -> int:
        """Evaluations of members at most: the first population and the generations."""
        return int(self.population_size) * (int(self.maxiter) + 1)


def _chances(
    shape: tuple[int, int, int], CR: float, rng: Rng
) -> Iterator[tuple[Indices, Booleans]]:
    """Others (3, S) and crossing (S, D) of one generation after the other.

    They depend on nothing that evolves and are drawn for a block of generations, shape
    (generations, S, D): for populations of this size the calls cost more than the work.
    """
    while True:
        others = three_others(shape[1], shape[0], rng)
        yield from zip(others, crossing(shape, CR, rng), strict=True)


def differential_evolution(
    costs: Costs,
    bounds: Floats,
    rng: Rng,
    options: DifferentialEvolution = DifferentialEvolution(),
    *,
    x0: Floats | None = None,
    callback: Callback | None = None,
) -> EvolutionResult:
    """Minimize a cost within bounds, without derivatives.

    Args:
        costs: Costs of a population, shape (S, D) -> (S,), called once per generation;
            it must not write to its argument. NaN counts as infinite.
        bounds: Lower and upper bound of each component, shape (D, 2); where they are
            equal the component stays fixed.
        rng: Source of chance; the same seed gives the same result.
        options: Strategy, sizes and stops.
        x0: Member of the first population within the bounds, shape (D,), if there is a
            guess.
        callback: Called after each generation with its number, the best member (D,)
            and its cost; returns True to stop.

    Returns:
        The result; its status tells whether to trust it.

    Raises:
        OptionError: If the bounds cannot be used.

    Examples:
        >>> def costs(x):  # A bent valley with its lowest point at (1, 1).
        ...     return 100 * (x[:, 1] - x[:, 0] ** 2) ** 2 + (1 - x[:, 0]) ** 2
        >>> bounds = np.array([[-2.0, 2.0], [-2.0, 2.0]])
        >>> options = DifferentialEvolution(population_size=30, target=1e-12)
        >>> result = differential_evolution(
        ...     costs, bounds, np.random.default_rng(0), options
        ... )
        >>> result.status.value, result.x.round(4).tolist()
        ('cost target reached', [1.0, 1.0])
    """
    box, size = Box.of(bounds), int(options.population_size)
    first = box.populate(size, options.init, x0, rng)
    chances = _chances((BLOCK, *first.shape), options.recombination, rng)

    def breed(population: Floats, energies: Floats) -> Floats:
        others, crossed = next(chances)
        best, mutate = population[energies.argmin()], MUTATIONS[options.strategy]
        mutants = mutate(population, best, others, options.mutation)
        return np.where(crossed, mutants, population)

    return evolve(
        costs,
        box,
        first,
        breed,
        Stops(options.target, options.tol, options.atol, options.budget),
        rng,
        callback,
    )
