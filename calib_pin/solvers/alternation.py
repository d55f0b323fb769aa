"""Alternating least squares in two blocks, accelerated to the joint optimum.

One half of the unknowns is solved for while the other stands still, then the other:
base and tool, then the robot (Wu, Klimchik, Caro, Furet, Pashkevich). Each half is
small and simple, but where both explain nearly the same, the alternation converges as
slowly as the halves are alike. Anderson's mixing of the last rounds finds the limit of
such a sequence in a few of them; a mixture that does not lower the cost is not taken,
so that the result is that of the plain alternation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.gauss_newton import LeastSquaresResult, gauss_newton
from calib_pin.solvers.status import Status

MEMORY = 10
"""Rounds that are mixed."""

GAINLESS = 1e-11
"""Part of the cost that a step of both halves must promise for another round."""

NEGLIGIBLE = 1e-10
"""The same where a round has changed nothing: by rounding neither half moves."""

SHORTEST = 1e-11
"""Length of a joint step, in units of the directions, that ends the alternation."""


def alternation(
    linearize: Callable[[Floats], tuple[Floats, Floats]],
    cost_of: Callable[[Floats], float],
    x0: Floats,
    first: Floats,
    second: Floats,
    *,
    max_rounds: int = 1000,
    memory: int = MEMORY,
) -> LeastSquaresResult:
    """Minimize half the sum of squared residuals in two alternating halves.

    Args:
        linearize: Residual (M,) and Jacobian (M, P) at x.
        cost_of: Half the sum of squared residuals at x.
        x0: Start, shape (P,).
        first: Directions that are solved for first, shape (P, k).
        second: Those of the second step, shape (P, l).
        max_rounds: Limit on the rounds.
        memory: Rounds that are mixed; 0 for the plain alternation.

    Returns:
        The result; its steps are rounds. It has converged where a step of both halves
        together would gain nothing.
    """
    halves = [half for half in (first, second) if half.shape[1]]
    basis = np.column_stack([first, second])
    x = np.array(x0, float)
    evaluations, status, rounds = 0, Status.ITERATIONS, 0
    seen: deque[tuple[Floats, Floats]] = deque(maxlen=memory + 1)
    r, J = linearize(x)
    while rounds < max_rounds:
        rounds += 1
        before = x
        for half in halves:
            solution = gauss_newton(linearize, cost_of, x, half, max_iterations=20)
            evaluations += solution.nfev
            x, r, J = solution.x, solution.fun, solution.jac
        if not np.isfinite(r).all():
            status = Status.NOT_FINITE
            break
        cost = 0.5 * float(r @ r)
        A = J @ basis
        step = np.linalg.lstsq(A, -r, rcond=1e-12)[0]
        promised = -0.5 * float(r @ (A @ step))
        least = NEGLIGIBLE if np.array_equal(x, before) else GAINLESS
        if promised <= least * cost or float(np.linalg.norm(step)) < SHORTEST:
            status = Status.CONVERGED
            break
        if np.array_equal(x, before):
            status = Status.STALLED
            break
        seen.append((before, x))
        mixed = _mixture(seen)
        evaluations += 1
        if mixed is not None and cost_of(mixed) < cost:
            x = mixed
    result = LeastSquaresResult(
        x, r, J, 0.5 * float(r @ r), rounds, evaluations, status
    )
    if status is Status.ITERATIONS:
        # The last mixture has not been evaluated.
        r, J = linearize(x)
        result = replace(result, fun=r, jac=J, cost=0.5 * float(r @ r))
    return result


def _mixture(seen: deque[tuple[Floats, Floats]]) -> Floats | None:
    """The mixture of the last rounds whose change is least (Anderson 1965)."""
    if len(seen) < 2:
        return None
    starts, ends = (np.array(part).T for part in zip(*seen, strict=True))
    changes = ends - starts
    difference = np.diff(changes, axis=1)
    weights = np.linalg.lstsq(difference, changes[:, -1], rcond=1e-10)[0]
    return np.asarray(ends[:, -1] - np.diff(ends, axis=1) @ weights)
