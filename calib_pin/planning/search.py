"""The methods that look for a good set of configurations.

Exchange, greedy and the genetic algorithm choose among candidates; the particle swarm
and the gradient move the configurations themselves. All start from sets that may be
measured and end in one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError, counted
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.planning.criteria import CRITERIA, Criterion, Information, Selection
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.workspace import Candidates, Workspace
from calib_pin.solvers import (
    ParticleSwarm,
    Status,
    exchange,
    genetic_selection,
    greedy,
    particle_swarm,
    projected_descent,
)

Progress = Callable[[str, float], bool | None]
"""Told the stage and the part that is done, 0 to 1; True stops the search."""

RIDGE = 1e-6
"""Information that lets a search begin, as a part of that of a mean configuration: more
than rounding, less than anything that is measured."""

FORBIDDEN = 1e6
"""Cost of a set with a configuration that may not be measured; more with several. No
logarithm of a criterion is as large."""

STARTS = 20
"""Most random sets from which the gradient method starts: from five, the best six poses
of a seven-joint arm had a condition number of 4.60, from twenty 4.29."""

VARIABLES = 2000
"""Joint positions that these together should hold: larger sets are all alike."""

FINALISTS = 3
"""Descents that go on to the ground."""

EXPLORING, REFINING = (1e-3, 60), (1e-6, 200)
"""Tolerance and steps of the descents before and after; costs are logarithms."""


@dataclass(frozen=True)
class Design:
    """A set of configurations, the end of a method.

    Attributes:
        q: Configurations, shape (K, n) [rad, m].
        aim: Position of what is measured at each among those of the workspace, (K,).
        cost: Their cost.
        method: The method.
        status: How it ended.
    """

    q: Floats
    aim: Indices
    cost: float
    method: str
    status: Status


@dataclass(eq=False)
class Search:
    """A search for the best set of configurations.

    Attributes:
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
        stopped: Whether the search was asked to stop.
    """

    rows: IdentificationRows
    workspace: Workspace
    criterion: Criterion
    known: Floats
    candidates: Candidates
    count: int
    rng: np.random.Generator
    progress: Progress | None = None
    starts: int = STARTS
    measured: int = 0
    stopped: bool = field(default=False, init=False)

    @cached_property
    def table(self) -> Floats:
        """Rows of the candidates, shape (C, d, m)."""
        return self.rows.rows(self.candidates.q, self.candidates.aim)

    def run(self, method: str) -> Design:
        """Search with a method of `METHODS`.

        Raises:
            OptionError: If the set cannot determine everything.
        """
        _ = self._determined  # The one clear line comes before the work.
        best = METHODS[method](self)
        return replace(best, status=Status.STOPPED) if self.stopped else best

    def information(self, rows: Floats) -> Information | None:
        """Information of rows (..., m) together with what is known."""
        U = rows.reshape(-1, rows.shape[-1])
        return Information.of(self.known + U.T @ U, self.rows.nuisances)

    def _cost(self, rows: Floats) -> float:
        """Cost of rows (..., m); infinite where they do not determine everything."""
        information = self.information(rows)
        return np.inf if information is None else self.criterion.cost(information)

    def selection(
        self, chosen: Sequence[int] | Indices = (), table: Floats | None = None
    ) -> Selection:
        """A subset of the candidates, or of others, under the criterion."""
        table = self.table if table is None else table
        known, nuisances = self.known, self.rows.nuisances
        return Selection(table, nuisances, self.criterion, known, chosen, self.measured)

    def by_greedy(self) -> Design:
        """Add the best candidate until there are enough."""
        return self._of("greedy", self._greedy("greedy"))

    def by_exchange(self) -> Design:
        """DETMAX, from what is best greedily or by its determinant."""
        starts = self._greedy("start"), self._determined
        start = min(starts, key=lambda chosen: self._cost(self.table[[*chosen]]))
        result = exchange(
            self.selection(start),
            lambda steps, cost: self.report("exchange", steps / (steps + 200.0)),
        )
        return self._of("exchange", result.chosen, result.status)

    def _by_genes(self) -> Design:
        """A genetic algorithm over subsets of the candidates (case B)."""

        def costs(subsets: NDArray[np.intp]) -> Floats:
            return np.array([self._cost(self.table[subset]) for subset in subsets])

        result = genetic_selection(
            costs,
            len(self.candidates.q),
            self.count,
            self.rng,
            callback=lambda k, x, cost: self.report("ga", k / (k + 100.0)),
        )
        return self._of("ga", result.chosen, result.status)

    def _by_swarm(self) -> Design:
        """The improved particle swarm on the configurations themselves (case C)."""
        options = ParticleSwarm()
        # All particles measure the same, what a set does that determines all.
        aim = self.candidates.aim[list(self._determined)]
        n = len(self.workspace.lower)
        fitting = [np.flatnonzero(self.candidates.aim == target) for target in aim]
        starts = [
            [int(self.rng.choice(some)) for some in fitting]
            for _ in range(options.particles)
        ]

        def costs(members: Floats) -> Floats:
            return self._costs_of_sets(members.reshape(-1, self.count, n), aim)

        result = particle_swarm(
            costs,
            np.tile(self.workspace.bounds, (self.count, 1)),
            self.rng,
            options,
            x0=self.candidates.q[np.array(starts)].reshape(len(starts), -1),
            callback=lambda k, x, cost: self.report("pso", k / options.iterations),
        )
        if not result.fun < FORBIDDEN:
            return self._of("pso", self._determined, result.status)
        q = self.workspace.settled(result.x.reshape(self.count, n), aim)
        return Design(q, aim, result.fun, "pso", result.status)

    def _by_gradient(self) -> Design:
        """Descents along the gradient from random sets of candidates."""
        if not self.rows.differentiable:
            raise OptionError(
                "the method 'gradient' needs derivatives by the configuration, which "
                "joint corrections and some measurement models do not have",
                allowed="exchange, greedy, pso, ga",
            )
        return self._descend(self._of("gradient", self._determined))

    def automatic(self) -> Design:
        """Exchange, then the gradient from its set and from random ones."""
        best = self.by_exchange()
        descends = self.rows.differentiable and not self.stopped
        return self._descend(best) if descends else best

    def _descend(self, best: Design) -> Design:
        """Go a little down from many sets, then to the ground from the best ones.

        Args:
            best: The first of these sets; the others are drawn among the candidates.
        """
        most = VARIABLES // best.q.size
        size, stages = len(self.candidates.q), self.criterion.sharpnesses
        drawn = [
            self._of("gradient", self.rng.choice(size, self.count, replace=False))
            for _ in range(min(self.starts, max(1, most)))
        ]
        sets = [design for design in (best, *drawn) if np.isfinite(design.cost)]
        explored = self._descents(sets, stages[:1], EXPLORING, 0.0)
        explored.sort(key=lambda design: design.cost)
        refined = self._descents(explored[:FINALISTS], stages, REFINING, 0.5)
        return min([best, *explored, *refined], key=lambda design: design.cost)

    def _descents(
        self,
        starts: Sequence[Design],
        sharpnesses: Sequence[float],
        limits: tuple[float, int],
        begin: float,
    ) -> list[Design]:
        """Ends of descents, of those that are done when the search is stopped."""
        ends = list[Design]()
        for start in starts:
            if self.stopped:
                break
            ends.append(self._down(start, sharpnesses, limits))
            self.report("gradient", begin + 0.5 * len(ends) / len(starts))
        return ends

    def _down(
        self, start: Design, sharpnesses: Sequence[float], limits: tuple[float, int]
    ) -> Design:
        """The best end of descents with a sharper and sharper cost.

        Each begins where the one before ended.

        Args:
            start: Set to go down from.
            sharpnesses: Those of the cost.
            limits: Tolerance and steps of each descent.
        """
        best, q, aim = start, start.q, start.aim
        settled = partial(self.workspace.settled, aim=aim)

        def smooth(sharpness: float, q: Floats) -> tuple[float, Floats]:
            rows, pullback = self.rows.linearize(settled(q), aim)
            information = self.information(rows)
            if information is None:
                return np.inf, np.zeros_like(q)
            cost, by_M = self.criterion.slope(information, sharpness)
            return cost, pullback(2.0 * rows @ by_M)

        for sharpness in sharpnesses:
            result = projected_descent(
                partial(smooth, sharpness),
                self.workspace.bounds,
                q,
                allowed=lambda q: self.workspace.inside(settled(q), aim),
                tolerance=limits[0],
                max_iterations=limits[1],
            )
            q = settled(result.x)
            cost = self._cost(self.rows.rows(q, aim))
            if cost < best.cost:
                best = Design(q, aim, cost, "gradient", result.status)
        return best

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
            lambda steps, cost: self.report(stage, steps / more),
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
        subset = Selection(self.table, 0, CRITERIA["O1"], self.known + ridge)

        def progress(steps: int, cost: float) -> None:
            # A set that is too small is of no use to who stops the search.
            self.report("start", steps / self.count)

        greedy(subset, self.count, progress)
        chosen = tuple(subset.chosen)
        if np.isfinite(self.selection(chosen).cost):
            return chosen
        size, allowed = self.table.shape[2], "more candidates (--candidates)"
        while len(subset.chosen) < min(len(self.table), self.count + size):
            subset.add(subset.best_to_add()[0])
            if np.isfinite(self.selection(subset.chosen).cost):
                allowed = f"{len(subset.chosen)} or more (--count, --add)"
                break
        few = counted(self.count, "configuration")
        raise OptionError(
            f"{few} cannot determine the {size} identifiable parameters",
            allowed=allowed,
        )

    def _costs_of_sets(self, sets: Floats, aim: Indices) -> Floats:
        """Costs of sets of configurations with given aims, shape (S, K, n)."""
        size, count, n = sets.shape
        aims = np.tile(aim, size)
        sets = self.workspace.settled(sets.reshape(-1, n), aims).reshape(sets.shape)
        bad = ~self.workspace.inside(sets.reshape(-1, n), aims).reshape(size, count)
        # The fewer are forbidden the better, however bad the set is otherwise.
        costs = FORBIDDEN + bad.sum(axis=1, dtype=float)
        good = np.flatnonzero(~bad.any(axis=1))
        if len(good):
            rows = self.rows.rows(sets[good].reshape(-1, n), np.tile(aim, len(good)))
            rows = rows.reshape(len(good), -1, rows.shape[2])
            costs[good] = [self._cost(member) for member in rows]
        return np.asarray(costs)

    def _of(
        self,
        method: str,
        chosen: Sequence[int] | Indices,
        status: Status = Status.CONVERGED,
    ) -> Design:
        at = list(chosen)
        q, aim = self.candidates.q[at], self.candidates.aim[at]
        return Design(q, aim, self._cost(self.table[at]), method, status)

    def report(self, stage: str, part: float) -> bool:
        """Tell the progress; whether the search is to stop."""
        if self.progress is not None and self.progress(stage, min(part, 1.0)):
            self.stopped = True
        return self.stopped


METHODS: Mapping[str, Callable[[Search], Design]] = {
    "auto": Search.automatic,
    "exchange": Search.by_exchange,
    "greedy": Search.by_greedy,
    "pso": Search._by_swarm,
    "ga": Search._by_genes,
    "gradient": Search._by_gradient,
}
"""The methods, by name."""
