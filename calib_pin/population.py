"""The cost of a problem for a whole population of parameter values at once."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin import kernels
from calib_pin.measurement_models import Batch, BatchedModel, MeasurementModel
from calib_pin.measurements import Measurements
from calib_pin.problem import Problem
from calib_pin.segments import Segments
from calib_pin.spatial import Floats
from calib_pin.threads import Threads

__all__ = ["PopulationCost"]

WORTHWHILE = 40_000
"""Evaluations of a configuration that are worth a thread: about a millisecond."""


class PopulationCost:
    """Half the sum of squared whitened residuals and priors of every member.

    Args:
        problem: The problem.
        threads: Number of threads; default one per available core.

    Attributes:
        evaluator: `kernel`, or `loop` where the members are evaluated one by one: the
            joints have corrections, which give every member other joint motions, or
            rows are relative to others.

    Example:
        >>> import numpy as np, calib_pin
        >>> from calib_pin.formulation import nominal_problem
        >>> from calib_pin.setup import Setup
        >>> chain = calib_pin.load_chain("space6")
        >>> nominal = nominal_problem(chain, "position", Setup())
        >>> zero = np.zeros(len(nominal.parameters))
        >>> problem = nominal.about(zero, np.zeros((5, 6)), [""] * 5)
        >>> PopulationCost(problem)(np.array([zero, zero + 1e-3])) > 0.0
        array([False,  True])
    """

    def __init__(self, problem: Problem, threads: int | None = None) -> None:
        """Compute what does not depend on the parameters."""
        self._problem = problem
        self._threads = Threads(threads)
        measurement = problem.measurement
        self.evaluator: Literal["kernel", "loop"] = "loop"
        if not problem.error.geometric or measurement.relative:
            return
        self.evaluator = "kernel"
        self._segments = Segments.of(problem.error)
        weights = 1.0 / problem.sigma
        found = None
        if isinstance(measurement, BatchedModel):
            found = measurement.batch(problem.data, weights)
        if found is None:
            found = posed_batch(measurement, problem.data, weights)
        self._batch = found
        self._motion, self._starts = kernels.motions(
            problem.data.q[found.order] * self._segments.signs,
            self._segments.revolute,
            found.groups,
        )

    def __call__(self, theta: Floats) -> Floats:
        """Costs of parameter values, shape (S, P) -> (S,)."""
        if self.evaluator == "loop":
            return np.array([self._problem.cost(member) for member in theta])
        of_robot, own = self._problem.split(theta)
        costs = np.empty(len(theta))

        def evaluate(part: slice) -> None:
            chains = self._segments.links(of_robot[part])
            self._batch.costs(
                chains, self._motion, self._starts, own[part], costs[part]
            )

        least = -(-WORTHWHILE // max(len(self._problem.data), 1))
        pieces = self._threads.slices(len(theta), least)
        for _ in self._threads.map(evaluate, pieces):
            pass
        further = self._problem.further_rows(theta)
        return costs + 0.5 * np.asarray(np.sum(further**2, axis=-1))


def posed_batch(
    measurement: MeasurementModel, data: Measurements, weights: Floats
) -> Batch:
    """The batch form of a model without a kernel: it looks at the poses of a member.

    Args:
        measurement: The model.
        data: The N rows.
        weights: Reciprocal standard deviations of the residual, shape (N, d).
    """

    def costs(
        chains: Floats,
        motion: Floats,
        starts: NDArray[np.int64],
        own: Floats,
        costs: Floats,
    ) -> None:
        T = np.empty((len(data), 4, 4))
        for k, chain in enumerate(chains):
            kernels.poses(chain, motion, starts, T)
            r = measurement.residual(T, own[k], data) * weights
            costs[k] = 0.5 * float(np.vdot(r, r))

    return Batch(np.arange(len(data)), (len(data),), costs)
