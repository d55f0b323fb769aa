"""The cost of a problem for a whole population of parameter values at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled import kernels
from calib_pin.compiled.blocks import motions
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.segments import Segments
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Batch, BatchedModel

WORTHWHILE = 40_000
"""Evaluations of a configuration that are worth a thread: about a millisecond."""


class PopulationCost:
    """Half the sum of squared whitened residuals and priors of every member.

    Args:
        problem: The problem.
        threads: Number of threads; default one per available core.

    Attributes:
        evaluator: `kernel`, or `loop` where the members are evaluated one by one: the
            measurement model has no batch form, or something was learned.

    Example:
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
        self._problem = problem
        self._threads = Threads(threads)
        batches: Sequence[Batch] = []
        measurement = problem.measurement
        if problem.error.learned is None and isinstance(measurement, BatchedModel):
            batches = measurement.batches(problem.data, 1.0 / problem.sigma)
        self.evaluator: Literal["kernel", "loop"] = "kernel" if batches else "loop"
        self._segments = Segments.of(problem.error)
        self._parts = [_Part(problem, self._segments, batch) for batch in batches]

    def __call__(self, theta: Floats) -> Floats:
        """Costs of parameter values, shape (S, P) -> (S,)."""
        if self.evaluator == "loop":
            return np.array([self._problem.cost(member) for member in theta])
        further = self._problem.further.residual(theta)
        costs = 0.5 * np.asarray(np.sum(further**2, axis=-1))
        of_robot, instrument = self._problem.split(theta)

        def evaluate(members: slice) -> None:
            chains = self._segments.links(of_robot[members])
            amounts = of_robot[members, self._problem.error.joint_corrections]
            for part in self._parts:
                costs[members] += part.costs(chains, amounts, instrument[members])

        least = -(-WORTHWHILE // max(len(self._problem.data), 1))
        pieces = self._threads.slices(len(theta), least)
        for _ in self._threads.map(evaluate, pieces):
            pass
        return costs


class _Part:
    """The rows of one batch."""

    def __init__(self, problem: Problem, segments: Segments, batch: Batch) -> None:
        self._batch = batch
        self._comparison = kernels.COMPARISONS.index(batch.comparison)
        error, start = problem.error, problem.data.start
        payload = [problem.data.payload[k] for k in batch.rows]
        joints = [error.screws[k].frame - 1 for k in error.joint_corrections]
        # From base to tool the joints come in the other order and move back.
        forward = slice(None, None, -1 if batch.inward else 1)
        signs = -segments.signs if batch.inward else segments.signs
        revolute = segments.revolute[forward]

        def moving(q: Floats) -> tuple[Floats, NDArray[np.int64], Floats]:
            motion, starts = motions((q * signs)[:, forward], revolute)
            factors = error.basis(q, payload) * signs[joints]
            return motion, starts, factors.T.copy()

        motion, starts, factors = moving(problem.data.q[batch.rows])
        begin, begin_factors = motion[:0], factors[:, :0]
        if start.size and np.isfinite(start[batch.rows]).all():
            begin, _, begin_factors = moving(start[batch.rows])
        places = np.arange(len(revolute))[forward]
        self._rows = kernels.Rows(
            starts=starts,
            motion=motion,
            begin=begin,
            revolute=revolute.copy(),
            joints=places[joints],
            factors=factors,
            begin_factors=begin_factors,
            point=batch.point,
            site=batch.site,
            values=batch.values.T.copy(),
            weights=batch.weights.T.copy(),
        )

    def costs(self, chains: Floats, amounts: Floats, instrument: Floats) -> Floats:
        """Half the sums of squares of these rows, shape (S,).

        By links of the members, (S, n + 1, 12), their joint corrections, (S, C), and
        instruments, (S, K).
        """
        found, result = self._batch.geometry(instrument), np.empty(len(instrument))
        if found.stand is not None and found.mount is not None:
            chains = chains.copy()
            chains[:, 0] = _product(found.stand, chains[:, 0])
            chains[:, -1] = _product(chains[:, -1], found.mount)
        if self._batch.inward:
            chains = _inverted(chains)
        kernels.population_costs(
            self._comparison,
            chains,
            amounts,
            found.points,
            found.sites,
            self._rows,
            result,
        )
        return result


def _product(a: Floats, b: Floats) -> Floats:
    """Products of links (R | p), shape (S, 12) each."""
    first, second = a.reshape(-1, 3, 4), b.reshape(-1, 3, 4)
    result = first[:, :, :3] @ second
    result[:, :, 3] += first[:, :, 3]
    return np.asarray(result.reshape(-1, 12))


def _inverted(chains: Floats) -> Floats:
    """Chains from tool to base, shape (S, n + 1, 12)."""
    links = chains.reshape(*chains.shape[:2], 3, 4)[:, ::-1]
    result = np.empty_like(links)
    result[..., :3] = np.swapaxes(links[..., :3], 2, 3)
    result[..., 3] = -np.einsum("snji,snj->sni", links[..., :3], links[..., 3])
    return result.reshape(chains.shape)
