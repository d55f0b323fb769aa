"""L-SHADE: differential evolution that adapts its factors and its population size.

Equation numbers are those of Tanabe and Fukunaga 2014, doi 10.1109/CEC.2014.6900380;
so are the constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.evolution import Indices, Rng, below, crossing


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


class LShade:
    """The variant L-SHADE.

    The mutant of x_i is current-to-pbest/1 (eq. 3), with F_i and CR_i of its own,

        v = x_i + F_i (x_pbest - x_i) + F_i (x_r1 - x_r2),

    where x_pbest is one of the best members and x_r2 may also come from an archive of
    members that better trials replaced: those point the way that the population went.
    F_i and CR_i are drawn about means that worked before, and the population shrinks
    linearly over the evaluations, from exploring to refining.
    """

    def __init__(self, size: int, dimension: int, budget: int, rng: Rng) -> None:
        """Start with an empty archive and means of 0.5.

        Args:
            size: Members of the first population.
            dimension: Components of a member.
            budget: Evaluations over which the population shrinks.
            rng: Source of chance.
        """
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
