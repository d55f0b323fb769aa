"""Particle swarm with crossover and mutation, after Liu Qian et al. (2022).

Every particle Y flies with a velocity V towards the best place that it has seen itself
and the best that any has seen. As printed, with r uniform in [0, 1),

    V <- V + c1 r (pBest - Y) + c2 r (gBest - Y)        Y <- Y + w V.

So it cannot converge: old velocity that is kept whole is too much for any c1 and c2
above zero. The variance of a particle stays bounded only if (Poli 2009)

    w (c1 + c2) < 24 (1 - inertia^2) / (7 - 5 inertia),

where `inertia` is the part of V that is kept, which is 1 here. Additions:

    inertia     0.73, for which c1 = c2 = 1.5 and w = 1 satisfy the above (3 < 3.35).
                The usual constriction is this very pair of numbers (0.7298 and 1.496,
                Clerc and Kennedy 2002), which makes it likely that the w of the source
                belongs into the other line. Its value is not given; `w` stays 1.
    velocity    No component of V is larger than a part of the width of the box, and it
                is 0 again where a particle would have left the box.
    r           Drawn anew for each component and both terms.

Then pairs of particles, drawn by chance, blend with one uniform e per pair,

    Y_k <- Y_k (1 - e) + Y_l e        Y_l <- Y_l (1 - e) + Y_k e,

and particles mutate in one component, towards its upper or its lower bound,

    Y <- Y + (bound - Y) g(u)         g(u) = r2 (1 - u / u_max)^2,

less and less over the iterations u. How often they do either is not given. Here it is
seldom: both push particles off their way, which costs digits of the minimum (on
Rastrigin's function of three variables 1e-5 remain of the cost where a tenth of the
particles mutate, 4e-8 where one in fifty does).

The population of the evolution loop is the pBest of all particles, since a new place
replaces its own pBest unless it is worse.

References:
    Liu Qian et al. 2022, Manned Spaceflight 28(6) 711-719: configurations of least
    condition number for a seven-joint space manipulator.
    Clerc, Kennedy 2002, doi 10.1109/4235.985692: constriction.
    Poli 2009, IEEE Transactions on Evolutionary Computation 13(4) 712-721: mean and
    variance of a particle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.evolution import (
    Box,
    Callback,
    Costs,
    EvolutionResult,
    Rng,
    Stops,
    below,
    evolve,
)


@dataclass(frozen=True)
class ParticleSwarm:
    """Options of the particle swarm.

    Attributes:
        particles: Number of particles, 2 to 100 000.
        iterations: Limit on the moves after the first places, 1 or more; over as many
            the mutations fade.
        c1: Pull of a particle's own best place, 0 to 4.
        c2: Pull of the best place of all, 0 to 4.
        w: Part of its velocity that a particle moves by, in (0, 2].
        inertia: Part of the old velocity that is kept, in [0, 1]; 1 as printed.
        velocity: Largest velocity of a component, in widths of the box, in (0, 1].
        crossover: Probability that a pair of particles blends, in [0, 1].
        mutation: Probability that a particle mutates in one component, in [0, 1].
        target: Ends when `best cost <= target`.
        tol: Converged when `std(costs) <= atol + tol * |mean(costs)|` for the costs of
            the particles' best places.
        atol: Absolute part of that, in the unit of the cost.
    """

    particles: int = 60
    iterations: int = 300
    c1: float = 1.5
    c2: float = 1.5
    w: float = 1.0
    inertia: float = 0.73
    velocity: float = 0.25
    crossover: float = 0.05
    mutation: float = 0.02
    target: float = -np.inf
    tol: float = 1e-8
    atol: float = 0.0

    @property
    def budget(self) -> int:
        """Evaluations of particles at most: the first places and the moves."""
        return self.particles * (self.iterations + 1)


def particle_swarm(
    costs: Costs,
    bounds: Floats,
    rng: Rng,
    options: ParticleSwarm = ParticleSwarm(),
    *,
    x0: Floats | None = None,
    callback: Callback | None = None,
) -> EvolutionResult:
    """Minimize a cost within bounds, without derivatives.

    Args:
        costs: Costs of a swarm, shape (S, D) -> (S,), called once per iteration; it
            must not write to its argument. An infinite or NaN cost is not feasible.
        bounds: Lower and upper bound of each component, shape (D, 2); where they are
            equal the component stays fixed.
        rng: Source of chance; the same seed gives the same result.
        options: Sizes, pulls, probabilities and stops.
        x0: First places of some particles within the bounds, shape (S0, D), S0 up to
            the number of particles. The others begin all over the box.
        callback: Called after each iteration with its number, the best place (D,) and
            its cost; returns True to stop.

    Returns:
        The result, whose population is the best place of each particle. Not finite if
        no first place was feasible.

    Raises:
        OptionError: If the bounds cannot be used.

    Examples:
        >>> def costs(x):  # Waves with their lowest point at (1, 1).
        ...     return ((x - 1) ** 2 - np.cos(5 * (x - 1))).sum(axis=1) + 2
        >>> bounds = np.array([[-3.0, 3.0], [-3.0, 3.0]])
        >>> options = ParticleSwarm(particles=30, target=1e-6)
        >>> result = particle_swarm(
        ...     costs, bounds, np.random.default_rng(0), options
        ... )
        >>> result.status.value, result.x.round(3).tolist()
        ('cost target reached', [1.0, 1.0])
    """
    box = Box.of(bounds)
    places = box.populate(options.particles, "latinhypercube", x0, rng)
    return evolve(
        costs,
        box,
        places,
        _Swarm(options, box, places.copy(), rng).breed,
        Stops(options.target, options.tol, options.atol, options.budget),
        rng,
        callback,
    )


class _Swarm:
    """Places and velocities of the particles."""

    def __init__(self, options: ParticleSwarm, box: Box, Y: Floats, rng: Rng) -> None:
        self.options, self.box, self.rng = options, box, rng
        self.fastest = options.velocity * (box.upper - box.lower)
        self.Y, self.V, self.iteration = Y, np.zeros_like(Y), 0

    def breed(self, population: Floats, energies: Floats) -> Floats:
        """The next place of every particle, from the best place of each."""
        self.iteration += 1
        self._fly(population, population[energies.argmin()])
        self._blend()
        self._mutate()
        # Strays come back into this very array.
        return self.Y

    def _fly(self, personal: Floats, best: Floats) -> None:
        """Move by the velocity, from the personal bests (S, D) and the global best."""
        options, Y = self.options, self.Y
        r1, r2 = self.rng.random((2, *Y.shape))
        V = options.inertia * self.V
        V += options.c1 * r1 * (personal - Y) + options.c2 * r2 * (best - Y)
        self.V = np.clip(V, -self.fastest, self.fastest)
        moved = Y + options.w * self.V
        self.V[(moved < self.box.lower) | (moved > self.box.upper)] = 0.0
        self.Y = moved

    def _blend(self) -> None:
        """Cross some pairs of particles, none of which is in two pairs."""
        half = len(self.Y) // 2
        pairs = self.rng.permutation(len(self.Y))[: 2 * half].reshape(2, half)
        one, other = pairs[:, self.rng.random(half) < self.options.crossover]
        step = self.rng.random((len(one), 1)) * (self.Y[other] - self.Y[one])
        self.Y[one] += step
        self.Y[other] -= step

    def _mutate(self) -> None:
        """Move some particles towards a bound of one of their components."""
        options, rng = self.options, self.rng
        mutants = np.flatnonzero(rng.random(len(self.Y)) < options.mutation)
        place = mutants, below(self.Y.shape[1], len(mutants), rng)
        upwards = rng.random(len(mutants)) < 0.5
        bound = np.where(upwards, self.box.upper[place[1]], self.box.lower[place[1]])
        fading = (1.0 - self.iteration / options.iterations) ** 2
        part = rng.random(len(mutants)) * fading
        self.Y[place] += part * (bound - self.Y[place])
