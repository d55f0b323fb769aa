"""Gauss-Newton with Levenberg-Marquardt damping and truncated-SVD steps.

Minimizes `|r(x)|^2 / 2` over `x = x_0 + basis y`. The columns of `basis` are the
directions that x may take, in units that make them comparable; directions outside it
keep their start value exactly, however long the iteration. Each step solves

    min_dy |J basis dy + r|^2 + damping |dy|^2

by the SVD of `J basis`. Singular values at rounding level are dropped: among equal
steps the shortest is taken. The normal equations are never formed, because that would
square the condition number, and a redundant robot model has none to spare.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.status import Status


@dataclass(frozen=True)
class GaussNewtonOptions:
    """Tolerances of a Gauss-Newton iteration.

    Attributes:
        shortest: Length of a step, in units of the basis, that ends the iteration.
        short: Length of a step, in units of the basis, that may fail to improve by
            rounding.
        negligible: Part of the squares that a step may fail to gain by rounding.
        patience: Steps that are judged together.
        promised: Part of the cost that a step must promise: all that rounding leaves.
    """

    shortest: float = 1e-12
    short: float = 1e-7
    negligible: float = 1e-10
    patience: int = 8
    promised: float = 1e-14


OPTIONS = GaussNewtonOptions()
"""The default options."""

RANK = 1e-12
"""Part of the largest singular value up to which others are rounding."""

Linearize = Callable[[Floats], tuple[Floats, Floats]]
Cost = Callable[[Floats], float]
Complete = Callable[[Floats, Floats], Floats]
"""A step from x with that of variables which were eliminated, from the others' step."""


@dataclass(frozen=True)
class LeastSquaresResult:
    """Outcome of a least-squares solve.

    Attributes:
        x: Solution, shape (P,).
        fun: Residual there, shape (M,).
        jac: Jacobian there, shape (M, P).
        cost: Half the sum of squared residuals.
        nit: Number of steps taken.
        nfev: Number of evaluations of the cost.
        status: How the solver ended.
    """

    x: Floats
    fun: Floats
    jac: Floats
    cost: float
    nit: int
    nfev: int
    status: Status


def gauss_newton(
    linearize: Linearize,
    cost_of: Cost,
    x0: Floats,
    basis: Floats,
    *,
    tolerance: float = OPTIONS.promised,
    worthwhile: float = 0.0,
    max_iterations: int = 100,
    spare: bool = False,
    complete: Complete | None = None,
) -> LeastSquaresResult:
    """Minimize half the sum of squared residuals.

    Args:
        linearize: Residual (M,) and Jacobian (M, P) at x, or those of any system with
            the same normal equations.
        cost_of: Half the sum of squared residuals at x.
        x0: Start, shape (P,).
        basis: Directions that x may take, shape (P, k).
        tolerance: Converged when a step promises to lower the cost by less than this
            part of it, or is shorter than this part of its way (1e-12 of the unit).
        worthwhile: Converged as well when several steps together lower the cost by
            less than this part of it: a valley that goes on for ever, of a direction
            that the residuals can hardly tell.
        max_iterations: Limit on the steps.
        spare: Whether a step that promises less than the tolerance is not even taken:
            where evaluations are dear.
        complete: Completes steps where `linearize` has eliminated variables.

    Returns:
        The result; its status tells whether to trust it.
    """
    x = np.array(x0, float)
    r, J = linearize(x)
    cost, evaluations = 0.5 * float(r @ r), 1
    path, iteration, damping = 0.0, 0, 0.0
    status = Status.ITERATIONS if np.isfinite(cost) else Status.NOT_FINITE
    passed = [cost]
    while status is Status.ITERATIONS and iteration < max_iterations:
        if not np.isfinite(J).all():
            # A distance of zero has a cost, and no derivative.
            status = Status.NOT_FINITE
            break
        step = _Step(J @ basis, r)
        limit = max(tolerance * path, OPTIONS.shortest), tolerance * cost
        if spare and step.promised(step.solve(0.0)) <= limit[1]:
            status = Status.CONVERGED
            break
        trial = _search(step, cost_of, x, basis, damping, limit, complete)
        evaluations += trial.evaluations
        if trial.improved:
            x, path = trial.x, path + trial.length
            r, J = linearize(x)
            cost = 0.5 * float(r @ r)
            damping = trial.damping / 10.0
            # No damping only where this little would change nothing: a step that
            # leaps along weak directions costs all that was gained.
            damping = damping if damping > 0.01 * step.weakest else 0.0
            iteration += 1
            passed = [*passed[1 - OPTIONS.patience :], cost]
            crawling = passed[0] - cost < worthwhile * cost
            if len(passed) == OPTIONS.patience and crawling:
                status = Status.CONVERGED
        elif not trial.done:
            status = Status.STALLED
        if trial.done:
            status = Status.CONVERGED
    return LeastSquaresResult(x, r, J, cost, iteration, evaluations, status)


@dataclass(frozen=True)
class _Trial:
    """A step that was tried: where it led and whether to take it."""

    x: Floats
    length: float
    damping: float
    improved: bool
    done: bool
    evaluations: int


def _search(
    step: _Step,
    cost_of: Cost,
    x: Floats,
    basis: Floats,
    damping: float,
    limit: tuple[float, float],
    complete: Complete | None,
) -> _Trial:
    """Damp the step from x until the cost falls, or nothing is left to gain.

    The length and the promised decrease of the full step that end the iteration are
    its limits.
    """
    full = step.solve(0.0)
    reach = float(np.linalg.norm(full))
    # The full step decides: damping makes any step short.
    promised = step.promised(full)
    done = reach <= limit[0] or promised <= limit[1]
    # Where so little is left, a step that fails to improve has met rounding, no wall.
    negligible = reach <= OPTIONS.short or promised <= OPTIONS.negligible * step.square
    evaluations = 0
    while True:
        dy = step.solve(damping)
        change = basis @ dy
        candidate = x + (change if complete is None else complete(x, change))
        evaluations += 1
        improved = 2.0 * cost_of(candidate) < step.square
        rounding = not improved and negligible
        exhausted = damping > 1e8 * step.curvature
        if improved or done or rounding or exhausted:
            return _Trial(
                x=candidate,
                length=float(np.linalg.norm(dy)),
                damping=damping,
                improved=improved,
                done=done or rounding,
                evaluations=evaluations,
            )
        damping = max(10.0 * damping, 1e-6 * step.curvature)


class _Step:
    """One linearized problem, factored once and solved for several dampings."""

    def __init__(self, A: Floats, r: Floats) -> None:
        # A triangular factor with the rotated residual is a small problem with the
        # same solution; its SVD costs next to nothing.
        R = np.asarray(np.linalg.qr(np.column_stack([A, r]), mode="r"))
        self.A, self.r = R[:, :-1], R[:, -1]
        self.square = float(r @ r)
        U, s, Vt = np.linalg.svd(self.A, full_matrices=False)
        keep = s > RANK * s.max(initial=0.0)
        self.s, self.V = s[keep], Vt[keep].T
        self.along = U[:, keep].T @ self.r
        self.curvature = float(s.max(initial=0.0) ** 2)
        self.weakest = float(self.s.min(initial=np.inf) ** 2)

    def promised(self, dy: Floats) -> float:
        """Decrease of the cost that the linear model promises."""
        change = self.A @ dy
        return float(-(self.r @ change) - 0.5 * change @ change)

    def solve(self, damping: float) -> Floats:
        """The damped step of least length, shape (k,)."""
        return np.asarray(-self.V @ (self.s / (self.s**2 + damping) * self.along))
