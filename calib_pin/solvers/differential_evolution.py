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
wants F of 0.7 to 0.8, or l-shade.

References:
    Liu, Ni, Liu, Xu 2012, doi 10.1007/s11771-012-1095-1: calibration of a robot with a
    laser distance sensor; rand/1, best/1 and the "tradeoff" mutation (eq. 16).
    Storn, Price 1997, doi 10.1023/A:1008202821328: differential evolution.
    Tanabe, Fukunaga 2014, doi 10.1109/CEC.2014.6900380: L-SHADE.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from calib_pin.errors import require_known
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
    Variant,
    below,
    crossing,
    evolve,
    three_others,
)
from calib_pin.solvers.options import (
    FRACTION,
    LIMIT,
    TARGET,
    TOLERANCE,
    UP_TO_TWO,
    NumericOptions,
    limited,
    whole,
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
    a, b, c = _gather(members, others)
    return a + F * (b - c)


def _best(members: Floats, best: Floats, others: Indices, F: float) -> Floats:
    a, b = _gather(members, others[:2])
    return best + F * (a - b)


def _rand_to_best(members: Floats, best: Floats, others: Indices, F: float) -> Floats:
    a, b, c = _gather(members, others)
    return a + F * (best - a + b - c)


def _midpoint(members: Floats, best: Floats, others: Indices, F: float) -> Floats:
    a, b, c = _gather(members, others)
    return 0.5 * (a + best) + F * (b - c)


def _gather(members: Floats, others: Indices) -> list[Floats]:
    """The first, second, ... other of every member, k arrays of shape (S, D)."""
    return list(members.take(others, axis=0))


MUTATIONS: dict[str, Mutation] = {
    "rand/1": _rand,
    "best/1": _best,
    "rand-to-best/1": _rand_to_best,
    "midpoint": _midpoint,
}
MUTATIONS["tradeoff"] = MUTATIONS[TRADEOFF]

STRATEGIES = (*MUTATIONS, "l-shade")
"""Names of the mutation strategies."""

BLOCK = 16
"""Generations for which chance is drawn at once."""

INITS = ("latinhypercube", "random")
"""Names of the ways to choose the first population."""


@dataclass(frozen=True)
class DifferentialEvolution(NumericOptions):
    """Options of differential evolution; the defaults are those of Liu et al. (2012).

    Attributes:
        strategy: `rand/1`, `best/1`, `rand-to-best/1`, `midpoint`, `tradeoff` (here
            the same as `rand-to-best/1`, a reconstruction) or `l-shade`.
        population_size: Number of members Np, 4 to 100 000. (The popsize of scipy is a
            multiple of the number of components instead.)
        mutation: Factor F of the differences, in (0, 2]. l-shade adapts its own.
        recombination: CR, in [0, 1]: part of the components that a trial takes from
            the mutant. l-shade adapts its own.
        maxiter: Limit on the generations after the first population, 1 or more.
            l-shade spends the same population_size * (maxiter + 1) evaluations on
            more generations of a shrinking population.
        target: Ends when `best cost <= target`; the V of Liu et al.
        tol: Converged when `std(costs) <= atol + tol * |mean(costs)|`, as in scipy.
        atol: Absolute part of that, in the unit of the cost.
        init: First population, `latinhypercube` or `random`.

    Raises:
        OptionError: If a value is not allowed.
    """

    strategy: str = "tradeoff"
    population_size: int = limited(150, whole(4, 100_000))
    mutation: float = limited(0.6, UP_TO_TWO)
    recombination: float = limited(0.9, FRACTION)
    maxiter: int = limited(500, LIMIT)
    target: float = limited(-np.inf, TARGET)
    tol: float = limited(1e-8, TOLERANCE)
    atol: float = limited(0.0, TOLERANCE)
    init: str = "latinhypercube"

    def __post_init__(self) -> None:
        """Check the values."""
        require_known("mutation strategy", self.strategy, STRATEGIES)
        require_known("init", self.init, INITS)
        super().__post_init__()

    @property
    def budget(self) -> int:
        """Evaluations of members at most: the first population and the generations."""
        return int(self.population_size) * (int(self.maxiter) + 1)


class _Classic(Variant):
    """One mutation with fixed factors and binomial crossover."""

    def __init__(self, options: DifferentialEvolution, dimension: int, rng: Rng):
        self.mutate, self.F = MUTATIONS[options.strategy], options.mutation
        shape = BLOCK, int(options.population_size), dimension
        self.chances = _chances(shape, options.recombination, rng)

    def breed(self, population: Floats, energies: Floats) -> Floats:
        """One trial for every member."""
        others, crossed = next(self.chances)
        best = population[energies.argmin()]
        mutants = self.mutate(population, best, others, self.F)
        return np.where(crossed, mutants, population)


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


@dataclass(frozen=True)
class LShadeOptions:
    """Constants of L-SHADE.

    Attributes:
        smallest: Members at the end: current-to-pbest/1 draws from as many.
        memory: Entries H of the success history.
        pbest: Part p of the members from which the leader is chosen.
        archive: Members the archive holds, relative to the population.
        spread: Scale of the distributions of F and CR about their remembered means.
    """

    smallest: int = 4
    memory: int = 6
    pbest: float = 0.11
    archive: float = 2.6
    spread: float = 0.1


OPTIONS = LShadeOptions()
"""The default options."""

TERMINAL = -np.inf
"""Mean of CR where only CR = 0 succeeded: draws about it stay 0 forever."""


class LShade(Variant):
    """The variant L-SHADE.

    The mutant of x_i is current-to-pbest/1 (eq. 3), with F_i and CR_i of its own,

        v = x_i + F_i (x_pbest - x_i) + F_i (x_r1 - x_r2),

    where x_pbest is one of the best members and x_r2 may also come from an archive of
    members that better trials replaced: those point the way that the population went.
    F_i and CR_i are drawn about means that worked before, and the population shrinks
    linearly over the evaluations, from exploring to refining. Equation numbers and
    constants are those of Tanabe and Fukunaga 2014.
    """

    def __init__(self, size: int, dimension: int, budget: int, rng: Rng) -> None:
        """Start with an empty archive, and a budget of evaluations."""
        self.size, self.budget, self.rng = size, budget, rng
        self.archive = np.empty((round(OPTIONS.archive * size), dimension))
        self.archived = 0
        self.mean_F = np.full(OPTIONS.memory, 0.5)
        self.mean_CR = np.full(OPTIONS.memory, 0.5)
        self.entry = 0  # Written next.
        self.F = self.CR = np.empty(0)

    def breed(self, population: Floats, energies: Floats) -> Floats:
        """One trial for every member, with factors of its own."""
        size, rng = len(population), self.rng
        self._draw_factors(size)
        count = max(2, round(OPTIONS.pbest * size))
        leaders = np.argsort(energies, kind="stable")[:count]
        pbest = population.take(leaders[below(count, size, rng)], axis=0)
        # Offsets from the target, as in `three_others`; those of r2 that go beyond the
        # population lead into the archive.
        first = below(size - 1, size, rng)
        second = below(size + self.archived - 2, size, rng)
        second += second >= first
        following = np.arange(1, size + 1)
        r1 = population.take(first + following, axis=0, mode="wrap")
        r2 = population.take(second + following, axis=0, mode="wrap")
        old = np.flatnonzero(second >= size - 1)
        r2[old] = self.archive[second[old] - (size - 1)]
        step = pbest - population + r1 - r2
        mutants = population + self.F[:, None] * step
        crossed = crossing(population.shape, self.CR[:, None], rng)
        return np.where(crossed, mutants, population)

    def _draw_factors(self, size: int) -> None:
        """CR_i normal (eq. 1) and F_i Cauchy (eq. 2) about remembered means."""
        rng = self.rng
        entry = below(OPTIONS.memory, size, rng)
        CR = self.mean_CR[entry] + OPTIONS.spread * rng.standard_normal(size)
        self.CR = np.clip(CR, 0.0, 1.0)
        # A Cauchy number is the tangent of a uniform angle. To begin at the angle
        # where F = 0 is the same as to draw again until F > 0, but takes one pass.
        mean = self.mean_F[entry]
        least = -np.arctan(mean / OPTIONS.spread)
        angle = least + rng.random(size) * (np.pi / 2 - least)
        self.F = np.minimum(mean + OPTIONS.spread * np.tan(angle), 1.0)

    def learn(
        self, parents: Floats, energies: Floats, fresh: Floats, evaluations: int
    ) -> int:
        """Remember successes, archive the replaced members, shrink (eq. 10)."""
        better = np.flatnonzero(fresh < energies)
        if len(better):
            self._remember(energies[better] - fresh[better], better)
            self._archive(parents[better], round(OPTIONS.archive * len(parents)))
        part = evaluations / self.budget
        size = round(self.size + (OPTIONS.smallest - self.size) * part)
        # The last generations take the evaluations that are left.
        return max(OPTIONS.smallest, min(size, self.budget - evaluations))

    def _remember(self, gains: Floats, better: Indices) -> None:
        """Write the Lehmer means of successful factors, weighted by gains (eq. 7)."""
        # A cost that was infinite gained infinitely: nothing else counts beside it.
        infinite = np.isinf(gains)
        weights = infinite if infinite.any() else gains / gains.max()
        F, CR = self.F[better], self.CR[better]
        self.mean_F[self.entry] = (weights @ F**2) / (weights @ F)
        if self.mean_CR[self.entry] != TERMINAL:
            total = weights @ CR
            self.mean_CR[self.entry] = (
                (weights @ CR**2) / total if total > 0.0 else TERMINAL
            )
        self.entry = (self.entry + 1) % OPTIONS.memory

    def _archive(self, replaced: Floats, capacity: int) -> None:
        """Put members into free places, or into those of random older ones."""
        held = min(self.archived, capacity)
        places = np.arange(held, held + len(replaced))
        full = places >= capacity
        places[full] = below(capacity, int(full.sum()), self.rng)
        self.archive[places] = replaced
        self.archived = min(held + len(replaced), capacity)


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
        x0: Member of the first population, shape (D,), if there is a guess.
        callback: Called after each generation with its number, the best member (D,)
            and its cost; returns True to stop.

    Returns:
        The result; its status tells whether to trust it.

    Raises:
        OptionError: If the bounds or x0 cannot be used, or `costs` does not give one
            number per member.

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
    variant: Variant
    if options.strategy == "l-shade":
        variant = LShade(size, len(box.lower), options.budget, rng)
    else:
        variant = _Classic(options, len(box.lower), rng)
    return evolve(
        costs,
        box,
        box.populate(size, options.init, x0, rng),
        variant,
        Stops(options.target, options.tol, options.atol, options.budget),
        rng,
        callback,
    )
