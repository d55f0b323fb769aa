"""Very many candidates of which a search has few in memory.

A search that adds the best candidate time and again looks at all of them each time. It
does not need to: it runs among some, the working set, and notes which sets it asked the
best addition to. Then one pass over all candidates, in chunks of the sequence they come
from, finds what would have been the answer to each of these questions. Better answers
join the working set and the search goes on; where a pass finds none, the search would
have ended in the same set with all candidates in memory. (Column generation does the
same for linear programs: what is not there enters when its price is right.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.planning.information import Information
from calib_pin.planning.objective import Listener, Objective
from calib_pin.planning.rows import Rows
from calib_pin.planning.selection import Asked
from calib_pin.planning.workspace import Candidates
from calib_pin.workers import SERIAL, Workers

WORKING = 5000
"""Candidates in memory to begin with; of no more than these there are no passes."""

CHUNK = 4000
"""Candidates of a chunk: fixed, since each names one answer to each question."""

ENTERING = 40
"""Most candidates that enter after a pass for the sake of one question."""

WORTH = 1e-5
"""Difference of costs, which are logarithms, below which an answer is no better."""


@dataclass(frozen=True)
class Questions:
    """Sets that the best addition is sought for.

    Attributes:
        objective: What is to be small.
        sets: The information of each set.
    """

    objective: Objective
    sets: tuple[Information, ...]


def answers(
    shared: Questions, chunk: tuple[Floats, Indices]
) -> tuple[list[int], list[float]]:
    """The best addition to each set among the candidates of a chunk, and its cost.

    Args:
        shared: The sets.
        chunk: Configurations, shape (C, n) [rad, m], and their aims, shape (C,).
    """
    rows = shared.objective.rows.rows(*chunk)
    by_component = np.ascontiguousarray(np.swapaxes(rows, 0, 1))
    barred = np.zeros(len(rows), bool)
    found = [
        shared.objective.criterion.trials(one, by_component, 1.0).best(barred)
        for one in shared.sets
    ]
    return [k for k, _ in found], [cost for _, cost in found]


class WorkingSet:
    """The candidates that a search has in memory, with their rows.

    Args:
        rows: The rows of a configuration.
        candidates: All candidates.
        workers: Who goes over them.
        size: Number of candidates to begin with: the first, an even spread too.

    Attributes:
        at: Positions of those in memory among all, shape (W,).
        table: Their rows, shape (W, d, m).
    """

    def __init__(
        self,
        rows: Rows,
        candidates: Candidates,
        workers: Workers = SERIAL,
        size: int = WORKING,
    ) -> None:
        """Compute the rows of the first."""
        self._rows, self._candidates, self._workers = rows, candidates, workers
        self.at = np.arange(min(size, len(candidates.q)))
        self.table = self._compute(self.at)

    @property
    def complete(self) -> bool:
        """Whether all candidates are in memory."""
        return len(self.at) == len(self._candidates.q)

    def rows_of(self, which: Indices) -> Floats:
        """Rows of candidates by their positions among all, shape (N, d, m)."""
        return self.table[which] if self.complete else self._compute(which)

    def grow(
        self,
        objective: Objective,
        asked: Asked,
        listener: Listener,
    ) -> bool:
        """Let candidates enter that are better answers than those in memory.

        Args:
            objective: What is to be small.
            asked: The sets whose best addition was sought.
            listener: Told the part of the pass that is done; may end it.

        Returns:
            Whether there were any; no if the pass was ended.
        """
        sets, costs = list[Information](), list[float]()
        for members, cost in asked.items():
            found = objective.information(self.table[sorted(members)])
            # A set that determines nothing takes the first candidate, whatever it is.
            if found is not None:
                sets.append(found)
                costs.append(cost)
        if self.complete or not sets:
            return False
        q, aim = self._candidates.q, self._candidates.aim
        left = np.ones(len(q), bool)
        left[self.at] = False
        chunks = [
            begin + np.flatnonzero(left[begin : begin + CHUNK])
            for begin in range(0, len(q), CHUNK)
        ]
        chunks = [chunk for chunk in chunks if len(chunk)]
        results = self._workers.map(
            answers,
            Questions(objective, tuple(sets)),
            ((q[chunk], aim[chunk]) for chunk in chunks),
        )
        best = np.empty((len(chunks), len(sets)))
        named = np.empty(best.shape, np.int64)
        for k, (chunk, (positions, values)) in enumerate(
            zip(chunks, results, strict=True)
        ):
            named[k], best[k] = chunk[positions], values
            if listener.told("passes", (k + 1) / len(chunks)):
                return False
        if not (best.min(axis=0) < np.array(costs) - WORTH).any():
            return False
        # Also what is almost as good: after the next steps it may be the best.
        first = np.argsort(best, axis=0, kind="stable")[:ENTERING]
        new = np.unique(np.take_along_axis(named, first, axis=0))
        self.at = np.concatenate([self.at, new])
        self.table = np.concatenate([self.table, self._compute(new)])
        return True

    def _compute(self, which: Indices) -> Floats:
        candidates = self._candidates
        return self._rows.rows(candidates.q[which], candidates.aim[which])
