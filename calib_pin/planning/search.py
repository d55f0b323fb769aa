"""The methods that look for a good set of configurations.

Exchange, greedy and the genetic algorithm choose among candidates; the particle swarm
and the gradient move the configurations themselves. All start from sets that may be
measured and end in one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError, require_known
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.planning.criteria import CRITERIA, Criterion
from calib_pin.planning.descents import (
    EXPLORING,
    REFINING,
    Descent,
    Descents,
    descend,
)
from calib_pin.planning.objective import Found, Listener, Objective, Progress
from calib_pin.planning.rows import Rows
from calib_pin.planning.selection import Selection, selection
from calib_pin.planning.workspace import Candidates, Workspace
from calib_pin.solvers import (
    ParticleSwarm,
    Status,
    exchange,
    genetic_selection,
    greedy,
    particle_swarm,
)
from calib_pin.workers import SERIAL, Workers

RIDGE = 1e-6
"""Information that lets a search begin, as a part of that of a mean configuration."""

FORBIDDEN = 1e6
"""Cost of a set with a configuration that may not be measured; more with several."""

STARTS = 20
"""Most random sets from which the gradient method starts."""

VARIABLES = 2000
"""Joint positions that these together should hold."""

FINALISTS = 3
"""Descents that go on to the ground."""

GENES = 100_000
"""Most candidates of the genetic algorithm: each member ranks all of them."""


class Search:
    """A search for the best set of configurations.

    Args:
        rows: The rows of a configuration.
        workspace: The constraints of configurations.
        criterion: Criterion to minimize.
        known: Information that is there already, shape (m, m).
        candidates: Configurations to choose from.
        count: Size K of the set.
        rng: Source of chance.
        progress: Told how far the search is; may stop it.
        starts: Most random sets from which the gradient method starts.
        measured: Number of measurements that the known information comes from.
        workers: Who descends.

    Attributes:
        table: Rows of the candidates, shape (C, d, m).

    Raises:
        OptionError: If there are fewer candidates than wanted.
    """

    def __init__(
        self,
        rows: Rows,
        workspace: Workspace,
        criterion: Criterion,
        known: Floats,
        candidates: Candidates,
        count: int,
        rng: np.random.Generator,
        progress: Progress | None = None,
        starts: int = STARTS,
        measured: int = 0,
        workers: Workers = SERIAL,
    ) -> None:
        """Compute the rows of the candidates."""
        candidates.require(count)
        self.rows, self.workspace, self.criterion = rows, workspace, criterion
        self.known, self.candidates, self.count = known, candidates, count
        self.measured = measured
        self.objective = Objective(rows, criterion, known)
        self.table = rows.rows(candidates.q, candidates.aim)
        self._listener, self._workers = Listener(progress), workers
        self._rng, self._starts = rng, starts
        self._bounds = np.column_stack([workspace.lower, workspace.upper])

    @property
    def stopped(self) -> bool:
        """Whether the search was asked to stop."""
        return self._listener.stopped

    def run(self, method: str) -> Found:
        """Search with a method of `METHODS`.

        Raises:
            OptionError: If there is no such method, or the set cannot determine
                everything.
        """
        require_known("method", method, METHODS)
        _ = self._determined  # The one clear line comes before the work.
        found = METHODS[method](self)
        return replace(found, status=Status.STOPPED) if self.stopped else found

    def selection(
        self, chosen: Sequence[int] = (), table: Floats | None = None
    ) -> Selection:
        """A subset of the candidates, or of others, under the criterion."""
        table = self.table if table is None else table
        nuisances, criterion = self.rows.nuisances, self.criterion
        return selection(table, nuisances, criterion, self.known, chosen, self.measured)

    def value(self, chosen: Indices) -> float:
        """The value of the criterion of some of all candidates."""
        found = self.objective.information(self.table[chosen])
        if found is None:
            return np.inf
        return self.criterion.value(found, self.measured + len(chosen))

    def by_greedy(self) -> Found:
        """Add the best candidate until there are enough."""
        return self._of("greedy", self._greedy("greedy"))

    def by_exchange(self) -> Found:
        """DETMAX, from what is best greedily or by its determinant."""
        start = min(
            self._greedy("start"),
            self._determined,
            key=lambda chosen: self.selection(chosen).cost,
        )
        result = exchange(
            self.selection(start),
            lambda steps, cost: self.told("exchange", steps / (steps + 200.0)),
        )
        return self._of("exchange", result.chosen, result.status)

    def by_genes(self) -> Found:
        """A genetic algorithm over subsets of the candidates (case B)."""

        def costs(subsets: NDArray[np.intp]) -> Floats:
            U = self.table[subsets].reshape(len(subsets), -1, self.table.shape[2])
            return np.array([self.objective.of_rows(member) for member in U])

        result = genetic_selection(
            costs,
            min(len(self.candidates.q), GENES),
            self.count,
            self._rng,
            callback=lambda k, x, cost: self.told("ga", k / (k + 100.0)),
        )
        q, aim = self.candidates.q[result.x], self.candidates.aim[result.x]
        return Found(q, aim, result.fun, "ga", result.status)

    def by_swarm(self) -> Found:
        """The improved particle swarm on the configurations themselves (case C)."""
        options = ParticleSwarm()
        # All particles measure the same, what a set does that determines all.
        aim = self.candidates.aim[list(self._determined)]
        n = len(self.workspace.lower)
        starts = [self._drawn(aim) for _ in range(options.particles)]

        def costs(members: Floats) -> Floats:
            return self._costs_of_sets(members.reshape(-1, self.count, n), aim)

        result = particle_swarm(
            costs,
            np.tile(self._bounds, (self.count, 1)),
            self._rng,
            options,
            x0=np.array([self.candidates.q[start].ravel() for start in starts]),
            callback=lambda k, x, cost: self.told("pso", k / options.iterations),
        )
        if not result.fun < FORBIDDEN:
            return self._of("pso", self._determined, result.status)
        q = self.workspace.settled(result.x.reshape(self.count, n), aim)
        return Found(q, aim, result.fun, "pso", result.status)

    def by_gradient(self) -> Found:
        """Descents along the gradient from random sets of candidates."""
        return self._descended(self._of("gradient", self._determined))

    def automatic(self) -> Found:
        """Exchange, then the gradient from its set and from random ones."""
        best = self.by_exchange()
        descends = self.rows.differentiable and not self.stopped
        return self._descended(best) if descends else best

    def _descended(self, best: Found) -> Found:
        """Go a little down from many sets, then to the ground from the best ones.

        Args:
            best: The first of these sets; the others are drawn among the candidates.
        """
        variables = self.count * len(self.workspace.lower)
        size = len(self.candidates.q)
        sets = [(best.q, best.aim)]
        for _ in range(min(self._starts, max(1, VARIABLES // variables))):
            chosen = self._rng.choice(size, self.count, replace=False)
            sets.append((self.candidates.q[chosen], self.candidates.aim[chosen]))
        stages = self.criterion.sharpnesses
        total = len(sets) + FINALISTS * len(stages)
        shared = Descents(self.objective, self.workspace, self._listener, total)
        found = self._descents(
            shared,
            [
                Descent(q, aim, stages[:1], EXPLORING, k)
                for k, (q, aim) in enumerate(sets)
            ],
        )
        explored = [of_start[0] for of_start in found]
        finalists = sorted(explored, key=lambda one: one.cost)[:FINALISTS]
        refined = self._descents(
            shared,
            [
                Descent(one.q, one.aim, stages, REFINING, len(sets) + k * len(stages))
                for k, one in enumerate(finalists)
            ],
        )
        ends = [best, *explored, *chain.from_iterable(refined)]
        return min(ends, key=lambda one: one.cost)

    def _descents(
        self, shared: Descents, tasks: Sequence[Descent]
    ) -> list[tuple[Found, ...]]:
        """Ends of descents, of those that are done when the search is stopped."""
        found = list[tuple[Found, ...]]()
        if self.stopped:
            return found
        for task, one in zip(
            tasks, self._workers.map(descend, shared, tasks), strict=True
        ):
            found.append(one)
            # Where others descend, this is the only one to tell.
            done = task.begin + len(task.sharpnesses)
            if self.told("gradient", done / shared.total):
                break
        return found

    def _greedy(self, stage: str) -> tuple[int, ...]:
        """The set that grows by the best candidate; where stopped, `_determined`."""
        chosen = self._determined
        # Before everything is determined, only the determinant tells what is better.
        least = next(
            k
            for k in range(len(chosen) + 1)
            if np.isfinite(self.selection(chosen[:k]).cost)
        )
        more = max(self.count - least, 1)
        result = greedy(
            self.selection(chosen[:least]),
            self.count,
            lambda steps, cost: self.told(stage, steps / more),
        )
        return result.chosen if len(result.chosen) == self.count else chosen

    @cached_property
    def _determined(self) -> tuple[int, ...]:
        """The set of candidates that is best by its determinant, greedily.

        Raises:
            OptionError: If it does not determine everything; says how many would.
        """
        mean = np.einsum("cdi,cdi->i", self.table, self.table) / len(self.table)
        ridge = np.diag(RIDGE * mean)
        # The nuisances count here: a plane that nobody measures is not determined.
        subset = selection(self.table, 0, CRITERIA["O1"], self.known + ridge)

        def told(steps: int, cost: float) -> None:
            # A set that is too small is of no use to who stops the search.
            self.told("start", steps / self.count)

        greedy(subset, self.count, told)
        chosen = tuple(subset.chosen)
        if np.isfinite(self.selection(chosen).cost):
            return chosen
        size, allowed = self.table.shape[2], "more candidates (--candidates)"
        while len(subset.chosen) < min(len(self.table), self.count + size):
            subset.add(subset.best_to_add()[0])
            if np.isfinite(self.selection(subset.chosen).cost):
                allowed = f"{len(subset.chosen)} or more (--count, --add)"
                break
        few = "1 configuration" if self.count == 1 else f"{self.count} configurations"
        raise OptionError(
            f"{few} cannot determine the {size} identifiable parameters",
            allowed=allowed,
        )

    def _costs_of_sets(self, sets: Floats, aim: Indices) -> Floats:
        """Costs of sets of configurations with given aims, shape (S, K, n)."""
        size, count, n = sets.shape
        aims = np.tile(aim, size)
        sets = self.workspace.settled(sets.reshape(-1, n), aims).reshape(sets.shape)
        allowed = self.workspace.inside(sets.reshape(-1, n), aims)
        bad = ~allowed.reshape(size, count)
        bad |= ~np.array([self.workspace.apart(q) for q in sets])
        # The fewer are forbidden the better, however bad the set is otherwise.
        costs = FORBIDDEN + bad.sum(axis=1, dtype=float)
        good = np.flatnonzero(~bad.any(axis=1))
        if len(good):
            rows = self.rows.rows(sets[good].reshape(-1, n), np.tile(aim, len(good)))
            rows = rows.reshape(len(good), -1, rows.shape[2])
            costs[good] = [self.objective.of_rows(member) for member in rows]
        return np.asarray(costs)

    def _drawn(self, aim: Indices) -> list[int]:
        """Random candidates with given aims; twice only if there are few."""
        result = list[int]()
        for one in aim:
            fitting = np.flatnonzero(self.candidates.aim == one)
            fresh = np.setdiff1d(fitting, result)
            result.append(int(self._rng.choice(fresh if len(fresh) else fitting)))
        return result

    def _of(
        self, method: str, chosen: Sequence[int], status: Status = Status.CONVERGED
    ) -> Found:
        at = list(chosen)
        return Found(
            q=self.candidates.q[at],
            aim=self.candidates.aim[at],
            cost=self.selection(chosen).cost,
            method=method,
            status=status,
        )

    def told(self, stage: str, part: float) -> bool:
        """Tell the progress; whether the search is to stop."""
        return self._listener.told(stage, part)


METHODS: Mapping[str, Callable[[Search], Found]] = {
    "auto": Search.automatic,
    "exchange": Search.by_exchange,
    "greedy": Search.by_greedy,
    "pso": Search.by_swarm,
    "ga": Search.by_genes,
    "gradient": Search.by_gradient,
}
"""The methods, by name."""
