"""A set of configurations chosen among candidates, as exchange methods see it.

A search tries all candidates at every step. A configuration with rows U that joins a
set (s = 1) or leaves it (s = -1) changes the covariance C = M^-1 by

    dC = -s C U' (I + s U C U')^-1 U C,

so that to first order in it a cost with the derivative B by M changes by

    s trace((I + s U C U')^-1 U B U').

This orders trials of `prediction` as they are, and others nearly so; of the best few
the costs themselves decide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.planning.criteria import Criterion
from calib_pin.planning.information import Information

ALONE = 1e-9
"""Eigenvalue of `I - U C U'` below which rows hold all that is known of something:
without them nothing remains of it but rounding, which conditioning enlarges."""


class Selection:
    """A subset of C candidates with its information, its cost and what would change it.

    Satisfies `solvers.Subset`.

    Args:
        rows: Rows of the candidates, shape (C, d, m).
        nuisances: Number of leading columns that are projected out.
        criterion: Criterion to minimize.
        known: Information that is there already, shape (m, m).
        chosen: Candidates to begin with.
        measured: Number of rows that the known information comes from.

    Attributes:
        chosen: The members, in the order in which they were added.
    """

    def __init__(
        self,
        rows: Floats,
        nuisances: int,
        criterion: Criterion,
        known: Floats,
        chosen: Sequence[int] | Indices = (),
        measured: int = 0,
    ) -> None:
        """Sum what the members tell."""
        self._rows, self._known, self._measured = rows, known, measured
        self._nuisances, self._criterion = nuisances, criterion
        self.reset(list(chosen))

    @property
    def left(self) -> int:
        """Number of candidates that are not members."""
        return len(self._rows) - len(self.chosen)

    @property
    def value(self) -> float:
        """The value of the criterion."""
        if self._found is None:
            return np.inf
        return self._criterion.value(self._found, self._measured + len(self.chosen))

    def best_to_add(self) -> tuple[int, float]:
        """The candidate to add and the cost after that."""
        others = np.ones(len(self._rows), bool)
        others[self.chosen] = False
        return self._best(np.flatnonzero(others), 1.0)

    def best_to_remove(self) -> tuple[int, float]:
        """The member to remove and the cost after that."""
        return self._best(np.array(self.chosen), -1.0)

    def add(self, candidate: int) -> None:
        """Add a candidate."""
        self.reset([*self.chosen, candidate])

    def remove(self, candidate: int) -> None:
        """Remove a member."""
        self.reset([k for k in self.chosen if k != candidate])

    def reset(self, chosen: list[int]) -> None:
        """Become another subset."""
        self.chosen = list(chosen)
        # Summed anew each time: differences of information matrices lose digits.
        U = self._rows[self.chosen].reshape(-1, self._rows.shape[2])
        self._M = self._known + U.T @ U
        self._found, self.cost = self._judged(self._M)

    def _judged(self, M: Floats) -> tuple[Information | None, float]:
        """An information matrix factored, and its cost; infinite where singular."""
        found = Information.of(M, self._nuisances)
        return found, np.inf if found is None else self._criterion.cost(found)

    def _best(self, some: Indices, sign: float) -> tuple[int, float]:
        if self._found is None:
            return int(some[0]), np.inf
        # The first sharpness counts several small eigenvalues, not the least alone.
        sharpness = self._criterion.sharpnesses[0]
        _, B = self._criterion.slope(self._found, sharpness)
        U = self._rows[some]
        count, d, m = U.shape
        # As one table: products of many small ones take several times as long.
        Y, by_U = (
            (U.reshape(-1, m) @ A).reshape(U.shape) for A in (self._found.inverse, B)
        )
        I_G = np.eye(d) + sign * Y @ np.swapaxes(Y, 1, 2)
        alone = np.zeros(count, bool)
        if sign < 0.0:
            alone = np.linalg.eigvalsh(I_G)[:, 0] <= ALONE
            I_G[alone] = np.eye(d)
        pairs = by_U @ np.swapaxes(U, 1, 2)
        order = sign * np.trace(np.linalg.solve(I_G, pairs), axis1=1, axis2=2)
        order[alone] = np.inf
        tried = min(self._criterion.tried, len(some))
        first = np.argpartition(order, tried - 1)[:tried]
        costs = [
            self._judged(self._M + sign * self._rows[k].T @ self._rows[k])[1]
            for k in some[first]
        ]
        best = int(np.argmin(costs))
        return int(some[first][best]), costs[best]
