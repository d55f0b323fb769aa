"""The cost of a problem for a whole population of parameter values at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled import blocks as compiled
from calib_pin.compiled import kernels
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.many_rows import Segments
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import Block, compilable
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Batch, BatchedModel
from calib_pin.observations import Conditions

WORTHWHILE = 40_000
"""Evaluations of a configuration that are worth a thread: about a millisecond."""


class PopulationCost:
    """Half the sum of squared whitened residuals and priors of every member.

    Args:
        problem: The problem.
        threads: Number of threads; default one per available core.

    Attributes:
        evaluator: `kernel`, or `loop` where the members are evaluated one by one: the
            measurement model has no batch form, something was learned, or places of
            the chain bend row by row.

    Examples:
        >>> import numpy as np, calib_pin
        >>> from calib_pin.estimation.formulation import nominal_problem
        >>> from calib_pin.setup import Setup
        >>> from calib_pin.simulation import exact_problem
        >>> chain = calib_pin.load_chain("space6")
        >>> nominal = nominal_problem(chain, "position", Setup())
        >>> zero = np.zeros(len(nominal.parameters))
        >>> problem = exact_problem(nominal, zero, np.zeros((5, 6)), [""] * 5)
        >>> PopulationCost(problem)(np.array([zero, zero + 1e-3])) > 1e-6
        array([False,  True])
    """

    def __init__(self, problem: Problem, threads: int | None = None) -> None:
        """Compute what does not depend on the parameters."""
        self._problem, self._threads = problem, Threads(threads)
        self._parts: list[_Part] = []
        self.evaluator: Literal["kernel", "loop"] = "kernel"
        for block in problem.blocks:
            error, measurement = block.term.error, block.term.measurement
            batches: Sequence[Batch] = []
            if compilable(error) and isinstance(measurement, BatchedModel):
                weights = 1.0 / block.table(problem.sigma)
                batches = measurement.batches(block.data, weights)
            if not batches:
                self.evaluator = "loop"
                return
            segments = Segments(error)
            self._parts += [_Part(block, segments, batch) for batch in batches]

    def __call__(self, theta: Floats) -> Floats:
        """Costs of parameter values, shape (S, P) -> (S,)."""
        if self.evaluator == "loop":
            return np.array([self._problem.cost(member) for member in theta])
        further = self._problem.further.residual(theta)
        costs = 0.5 * np.asarray(np.sum(further**2, axis=-1))

        def evaluate(members: slice) -> None:
            for part in self._parts:
                costs[members] += part.costs(theta[members])

        least = -(-WORTHWHILE // max(len(self._problem.data), 1))
        for _ in self._threads.map(evaluate, self._threads.slices(len(theta), least)):
            pass
        return costs


class _Part:
    """The measurements of one batch."""

    def __init__(self, block: Block, segments: Segments, batch: Batch) -> None:
        self._batch, self._segments, self._term = batch, segments, block.term
        self._comparison = kernels.COMPARISONS.index(batch.comparison)
        start, conditions = block.data.start, block.data.conditions.rows(batch.rows)

        def move(q: Floats, at: Conditions) -> tuple[Floats, NDArray[np.int64], Floats]:
            factors = block.term.error.basis(q, at) * segments.factors
            motion, starts = compiled.motions(q * segments.signs, segments.revolute)
            return motion, starts, factors.T.copy()

        motion, starts, factors = move(block.data.q[batch.rows], conditions)
        begin, begin_factors = motion[:0], factors[:, :0]
        if start.size:
            begin, _, begin_factors = move(start[batch.rows], conditions.at_start)
        self._rows = kernels.Rows(
            starts=starts,
            motion=motion,
            begin=begin,
            revolute=segments.revolute,
            joints=segments.joints,
            factors=factors,
            begin_factors=begin_factors,
            point=batch.point,
            site=batch.site,
            values=batch.values.T.copy(),
            weights=batch.weights.T.copy(),
        )

    def costs(self, theta: Floats) -> Floats:
        """Half the sums of squares of these measurements, shape (S, P) -> (S,)."""
        of_robot, instrument = self._term.values(theta)
        links = self._segments.links(of_robot)
        amounts = of_robot[:, self._term.error.joint_corrections]
        found, result = self._batch.geometry(instrument), np.empty(len(instrument))
        of_members = links, amounts, found.points, found.sites
        kernels.population_costs(self._comparison, *of_members, self._rows, result)
        return result
