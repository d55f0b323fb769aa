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
from enum import Enum

import numpy as np

from calib_pin.spatial import Floats

__all__ = ["LeastSquaresResult", "Status", "gauss_newton"]

SHORTEST = 1e-12
"""Length of a step, in units of the basis, that ends the iteration."""

ROUNDING = 1e-7
"""Length of a step, in units of the basis, that may fail to improve by rounding."""

Linearize = Callable[[Floats], tuple[Floats, Floats]]
Residual = Callable[[Floats], Floats]


class Status(Enum):
    """How a solver ended: a word, and a sentence of advice."""

    CONVERGED = "converged"
    ITERATIONS = "iteration limit"
    STALLED = "stalled"
    NOT_FINITE = "not finite"

    @property
    def advice(self) -> str:
        """What it means and what to do about it."""
        return {
            Status.CONVERGED: "The fit converged.",
            Status.ITERATIONS: (
                "The fit did not converge within the iterations allowed; check units, "
                "joint signs and frames, or start closer with a first guess."
            ),
            Status.STALLED: (
                "No step improves the fit although it is not at a minimum; check for "
                "measurements near a singularity of the measurement model."
            ),
            Status.NOT_FINITE: (
                "The residual is not a finite number at the start; check the frames "
                "and the first guess."
            ),
        }[self]


@dataclass(frozen=True)
class LeastSquaresResult:
    """Outcome of a least-squares solve.

    Attributes:
        x: Solution, shape (P,).
        fun: Residual there, shape (M,).
        jac: Jacobian there, shape (M, P).
        cost: Half the sum of squared residuals.
        nit: Number of steps taken.
        nfev: Number of residual evaluations.
        active: Positions of the components of x that stand at a bound.
        status: How the solver ended.
    """

    x: Floats
    fun: Floats
    jac: Floats
    cost: float
    nit: int
    nfev: int
    active: tuple[int, ...]
    status: Status


def gauss_newton(
    linearize: Linearize,
    residual: Residual,
    x0: Floats,
    basis: Floats,
    *,
    bounds: tuple[Floats, Floats] | None = None,
    tolerance: float = 1e-14,
    rank_tolerance: float = 1e-12,
    max_iterations: int = 100,
    damped: bool = True,
    callback: Callable[[int, float], None] | None = None,
) -> LeastSquaresResult:
    """Minimize half the sum of squared residuals.

    Args:
        linearize: Residual (M,) and Jacobian (M, P) at x.
        residual: Residual (M,) at x.
        x0: Start, shape (P,), inside the bounds.
        basis: Directions that x may take, shape (P, k).
        bounds: Lower and upper bounds of x, each of shape (P,).
        tolerance: Converged when a step promises to lower the cost by less than this
            part of it, or is shorter than this part of its way (1e-12 of the unit).
        rank_tolerance: Singular values below this part of the largest are dropped.
        max_iterations: Limit on the steps.
        damped: Whether a step that raises the cost is damped and tried again;
            otherwise every step is taken whole.
        callback: Called with the step count and the cost after each step.

    Returns:
        The result; its status tells whether to trust it.
    """
    x = np.array(x0, float)
    r, J = linearize(x)
    cost, evaluations = 0.5 * float(r @ r), 1
    active: tuple[int, ...] = ()
    way, iteration, damping = 0.0, 0, 0.0
    status = Status.ITERATIONS if np.isfinite(cost) else Status.NOT_FINITE
    while status is Status.ITERATIONS and iteration < max_iterations:
        step = _Step(J @ basis, r, rank_tolerance)
        limit = max(tolerance * way, SHORTEST), tolerance * cost
        trial = _search(step, residual, x, basis, bounds, damping, limit, damped)
        evaluations, active = evaluations + trial.evaluations, trial.active
        if trial.improved or not damped:
            x, way = trial.x, way + trial.length
            r, J = linearize(x)
            cost = 0.5 * float(r @ r)
            damping = trial.damping / 10.0
            damping = damping if damping > 1e-9 * step.curvature else 0.0
            iteration += 1
            if callback is not None:
                callback(iteration, cost)
        elif not trial.done:
            status = Status.STALLED
        if trial.done:
            status = Status.CONVERGED
    return LeastSquaresResult(x, r, J, cost, iteration, evaluations, active, status)


@dataclass(frozen=True)
class _Trial:
    """A step that was tried: where it led and whether to take it."""

    x: Floats
    length: float
    damping: float
    improved: bool
    done: bool
    active: tuple[int, ...]
    evaluations: int


def _search(
    step: _Step,
    residual: Residual,
    x: Floats,
    basis: Floats,
    bounds: tuple[Floats, Floats] | None,
    damping: float,
    limit: tuple[float, float],
    damped: bool,
) -> _Trial:
    """Damp the step until the cost falls, or until there is nothing left to gain.

    Args:
        step: The linearized problem at x.
        residual: Residual at x.
        x: Where the step starts, shape (P,).
        basis: Directions, shape (P, k).
        bounds: Bounds of x.
        damping: Damping to begin with.
        limit: Length and promised decrease below which a step ends the iteration.
        damped: Whether to damp at all.
    """
    room = None if bounds is None else (bounds[0] - x, bounds[1] - x)
    first, evaluations = None, 0
    while True:
        dy, active = step.solve(damping, basis, room)
        length = float(np.linalg.norm(dy))
        first = length if first is None else first
        done = length <= limit[0] or step.promised(dy) <= limit[1]
        candidate = x + basis @ dy
        if bounds is not None:
            # Rounding must not carry a component across its bound.
            candidate = np.clip(candidate, *bounds)
        fresh = residual(candidate)
        evaluations += 1
        improved = float(fresh @ fresh) < step.square
        # A step this short that fails to improve has met rounding, not a wall.
        rounding = not improved and first <= ROUNDING
        exhausted = damping > 1e8 * step.curvature
        if improved or done or rounding or exhausted or not damped:
            return _Trial(
                x=candidate,
                length=length,
                damping=damping,
                improved=improved,
                done=done or rounding,
                active=active,
                evaluations=evaluations,
            )
        damping = max(10.0 * damping, 1e-6 * step.curvature)


class _Step:
    """One linearized problem, factored once and solved for several dampings."""

    def __init__(self, A: Floats, r: Floats, rank_tolerance: float) -> None:
        # A triangular factor with the rotated residual is a small problem with the
        # same solution; its SVD costs next to nothing.
        R: Floats = np.asarray(np.linalg.qr(np.column_stack([A, r]), mode="r"))
        width = A.shape[1]
        self.A = R[:, :width]
        self.r = R[:, width]
        self.square = float(r @ r)
        self.rank_tolerance = rank_tolerance
        self.svd = np.linalg.svd(self.A, full_matrices=False)
        self.curvature = float(self.svd[1][0] ** 2) if width else 0.0

    def promised(self, dy: Floats) -> float:
        """Decrease of the cost that the linear model promises."""
        change = self.A @ dy
        return float(-(self.r @ change) - 0.5 * change @ change)

    def solve(
        self, damping: float, basis: Floats, limits: tuple[Floats, Floats] | None
    ) -> tuple[Floats, tuple[int, ...]]:
        """The step, with components of x held at the bounds they run into.

        Bounds are added one at a time, the most violated first, and dropped again
        where the cost wants to leave them.
        """
        dy = self._damped(self.svd, self.r, damping)
        if limits is None:
            return dy, ()
        held: dict[int, float] = {}
        for _ in range(3 * len(basis)):
            dx = basis @ dy
            excess = np.maximum(limits[0] - dx, dx - limits[1])
            excess[list(held)] = 0.0
            worst = int(np.argmax(excess))
            if excess[worst] <= 1e-15:
                release = self._release(dy, damping, basis, held, limits)
                if release is None:
                    break
                del held[release]
            else:
                low = limits[0][worst] - dx[worst] > 0.0
                held[worst] = limits[0][worst] if low else limits[1][worst]
            dy = self._held(damping, basis, held)
        return dy, tuple(sorted(held))

    def _held(self, damping: float, basis: Floats, held: dict[int, float]) -> Floats:
        """The step under the equalities `basis[k] dy = value`, by the null space."""
        rows, values = basis[list(held)], np.array(list(held.values()))
        U, s, Vt = np.linalg.svd(rows, full_matrices=True)
        rank = int((s > 1e-12 * max(1.0, s[0] if len(s) else 1.0)).sum())
        particular: Floats = Vt[:rank].T @ ((U[:, :rank].T @ values) / s[:rank])
        Z = Vt[rank:].T
        if Z.shape[1] == 0:
            return particular
        svd = np.linalg.svd(self.A @ Z, full_matrices=False)
        return np.asarray(
            particular + Z @ self._damped(svd, self.r + self.A @ particular, damping)
        )

    def _release(
        self,
        dy: Floats,
        damping: float,
        basis: Floats,
        held: dict[int, float],
        limits: tuple[Floats, Floats],
    ) -> int | None:
        """A held bound that the cost pulls inward, or None."""
        if not held:
            return None
        gradient = self.A.T @ (self.A @ dy + self.r) + damping * dy
        rows = basis[list(held)]
        multipliers = np.linalg.lstsq(rows.T, gradient, rcond=None)[0]
        scale = np.linalg.norm(gradient) / (np.linalg.norm(rows, axis=1) + 1e-300)
        # At a lower bound the gradient along the component must not be negative.
        inward = [
            (-m if value == limits[0][k] else m) / s
            for (k, value), m, s in zip(held.items(), multipliers, scale, strict=True)
        ]
        worst = int(np.argmax(inward))
        return list(held)[worst] if inward[worst] > 1e-9 else None

    def _damped(
        self, svd: tuple[Floats, Floats, Floats], r: Floats, damping: float
    ) -> Floats:
        U, s, Vt = svd
        if len(s) == 0:
            return np.zeros(Vt.shape[1])
        keep = s > self.rank_tolerance * s[0]
        gain = s[keep] / (s[keep] ** 2 + damping)
        return np.asarray(-Vt[keep].T @ (gain * (U[:, keep].T @ r)))
