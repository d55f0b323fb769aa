"""Projected quasi-Newton descent of points in a box where some places are forbidden.

The K points of n components are one vector x. Each iteration looks along the projected
path (Bertsekas 1982, eq. 6)

    x(a) = P(x - a H g),        P the projection onto the box,

from a = 1 downwards for a place where the function has fallen enough for the way that
was really gone (Armijo's rule, Nocedal and Wright eq. 3.4, along the path),

    f(x(a)) <= f(x) + 1e-4 g . (x(a) - x).

H stands for the inverse Hessian; the last changes s of x and y of g give it by the
limited-memory BFGS formula (Nocedal and Wright algorithm 7.4). It is built on the
*free* components only: those at a bound that `-g` pushes against keep a multiple of
`-g` as their step, or the path could lead uphill however short (Bertsekas, section 2).

Of the forbidden places nothing is known but yes or no. In each trial the points that
would land in one stay where they are while the others go on, and their next steps are
shorter, so that they close in on the edge. One that is blocked time and again is no
longer free, like a component at a bound; it keeps trying. Points do not slide along an
edge.

Inside, all components are measured in widths of the box: radians and meters count
alike.

References:
    Bertsekas 1982, doi 10.1137/0320018: projected Newton methods.
    Nocedal, Wright 2006, doi 10.1007/978-0-387-40065-5: Numerical Optimization.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.evolution import Booleans, Box
from calib_pin.solvers.status import Status


@dataclass(frozen=True)
class DescentOptions:
    """Tolerances of a projected descent.

    Attributes:
        sufficient: Part of the decrease promised by the slope that a step must bring
            (Armijo).
        trials: Trials of one search along the projected path.
        first: Largest component of a first step, in widths of the box.
        curved: Least cosine between changes of x and of g from which a curvature is
            learnt.
        edge: Distance from a bound, in widths of the box, that counts as at the bound.
        held: Part of its step at or below which a blocked point is no longer free.
        memory: Steps from which the curvature is learnt.
    """

    sufficient: float = 1e-4
    trials: int = 20
    first: float = 0.1
    curved: float = 1e-10
    edge: float = 1e-9
    held: float = 1e-2
    memory: int = 10


OPTIONS = DescentOptions()
"""The default options."""

Function = Callable[[Floats], tuple[float, Floats]]
Allowed = Callable[[Floats], Booleans]


@dataclass(frozen=True)
class DescentResult:
    """Outcome of a descent.

    Attributes:
        x: Points, shape (K, n), within the bounds and allowed.
        fun: The function there.
        nit: Number of steps taken.
        nfev: Number of evaluations of the function and its gradient.
        status: How the descent ended.
    """

    x: Floats
    fun: float
    nit: int
    nfev: int
    status: Status


def projected_descent(
    function: Function,
    bounds: Floats,
    x0: Floats,
    *,
    allowed: Allowed | None = None,
    max_iterations: int = 200,
    tolerance: float = 1e-8,
) -> DescentResult:
    """Go down to a local minimum of a smooth function of points in a box.

    Args:
        function: The function of points (K, n) and its gradient, shape (K, n). No step
            leads to where either is not finite.
        bounds: Lower and upper bound of each component, shape (n, 2), the same for
            all points; where they are equal the component stays fixed.
        x0: Start, shape (K, n), within the bounds and allowed.
        allowed: Whether each of the points (K, n) may be where it is, shape (K,),
            whatever the others do. Without it all may.
        max_iterations: Limit on the steps.
        tolerance: Converged when a full step lowered the function by no more than
            `tolerance * max(|f|, 1)`, or when no free component promises to do so by
            its gradient on the way across the box.

    Returns:
        The result. Converged speaks of the points that were free to move: others may
        be held up at the edge of a forbidden place.

    Raises:
        OptionError: If the bounds cannot be used.

    Examples:
        >>> def valley(x):
        ...     e = x - [2.0, 0.5]
        ...     return float((e**2).sum()), 2 * e
        >>> box = np.array([[0.0, 1.0], [0.0, 1.0]])
        >>> result = projected_descent(valley, box, np.zeros((3, 2)))
        >>> result.status.value, result.x.round(6).tolist()
        ('converged', [[1.0, 0.5], [1.0, 0.5], [1.0, 0.5]])
    """
    box = Box.of(bounds)
    problem = _Problem(function, box, allowed, x0.shape)
    x = np.array(x0, float).ravel()
    fun, gradient = problem.evaluate(x)
    reach, pairs = _Reach(x0.shape), _Pairs(x.size)
    nit, status = 0, Status.ITERATIONS
    if not math.isfinite(fun):
        max_iterations, status = 0, Status.NOT_FINITE
    # Searches that fail count too, so that nothing goes on forever.
    for _ in range(max_iterations):
        little = tolerance * max(abs(fun), 1.0)
        free = reach.free()
        free[problem.stopped(x, gradient)] = 0.0
        largest = float(np.abs(free * gradient).max())
        if largest <= little:
            status = Status.CONVERGED
            break
        step = pairs.step(gradient, free, OPTIONS.first / largest)
        trial = problem.search(x, fun, gradient, reach.shortened(step))
        done = 0.0 <= trial.promised <= little  # If it failed, rounding hides the rest.
        if trial.improved:
            done = trial.part == 1.0 and fun - trial.fun <= little
            pairs.learn((trial.x - x) / problem.unit, trial.gradient - gradient)
            x, fun, gradient, nit = trial.x, trial.fun, trial.gradient, nit + 1
        closing = reach.learn(trial.blocked)
        if done and not closing:
            status = Status.CONVERGED
        elif not trial.improved and not closing:
            # Without learned curvature the step is along the gradient: the last resort.
            status = status if pairs.count else Status.STALLED
            pairs.forget()
        if status is not Status.ITERATIONS:
            break
    return DescentResult(problem.points(x), fun, nit, problem.evaluations, status)


@dataclass(frozen=True)
class _Trial:
    """End of a search along the projected path.

    Attributes:
        improved: Whether the function fell enough; if not, x is where the search began.
        x: Components, shape (N,).
        fun: The function there.
        gradient: Its gradient per width of the box, shape (N,).
        part: The a of the path.
        promised: Decrease that the slope promised for the full step.
        blocked: Points that the full step would have led astray, shape (K,).
    """

    improved: bool
    x: Floats
    fun: float
    gradient: Floats
    part: float
    promised: float
    blocked: Booleans


class _Problem:
    """The function in its box, with the places that are forbidden.

    Points are flat here, N = K n components.
    """

    def __init__(
        self,
        function: Function,
        box: Box,
        allowed: Allowed | None,
        shape: tuple[int, ...],
    ) -> None:
        self.function, self.allowed, self.shape = function, allowed, shape
        self.lower, self.upper = (
            np.tile(box.lower, shape[0]),
            np.tile(box.upper, shape[0]),
        )
        self.width = self.upper - self.lower
        self.unit = np.where(self.width > 0.0, self.width, 1.0)
        self.low = self.lower + OPTIONS.edge * self.width
        self.high = self.upper - OPTIONS.edge * self.width
        self.nobody = np.zeros(shape[0], bool)
        self.evaluations = 0

    def points(self, x: Floats) -> Floats:
        """The points, shape (K, n), of flat components."""
        return x.reshape(self.shape)

    def evaluate(self, x: Floats) -> tuple[float, Floats]:
        """The function and its gradient per width of the box, shape (N,)."""
        self.evaluations += 1
        fun, gradient = self.function(self.points(x))
        # A new array, as the caller may use its own again.
        gradient = gradient.ravel() * self.width
        return (float(fun) if np.isfinite(gradient).all() else math.inf), gradient

    def stopped(self, x: Floats, gradient: Floats) -> Booleans:
        """Components that a bound stops on the way down, shape (N,)."""
        below = (x <= self.low) & (gradient > 0.0)
        return np.asarray(below | ((x >= self.high) & (gradient < 0.0)))

    def search(self, x: Floats, fun: float, gradient: Floats, step: Floats) -> _Trial:
        """Look along the projected path from x for a lower function.

        Args:
            x: Components, shape (N,).
            fun: The function there.
            gradient: Its gradient per width of the box, shape (N,).
            step: Where the full step leads, in widths of the box, shape (N,).
        """
        slopes, path = gradient / self.unit, step * self.width
        part, promised, blocked = 1.0, 0.0, self.nobody
        for trial in range(OPTIONS.trials):
            moved = np.minimum(np.maximum(x + part * path, self.lower), self.upper)
            stopped = self._put_back(moved, x)
            slope = float(slopes @ (moved - x))
            if trial == 0:
                promised, blocked = -slope, stopped
            factor = 0.25
            if slope < 0.0:
                lower, rise = self.evaluate(moved)
                if -math.inf < lower <= fun + OPTIONS.sufficient * slope:
                    return _Trial(True, moved, lower, rise, part, promised, blocked)
                if math.isfinite(lower):
                    # The lowest point of the parabola through the known values.
                    factor = min(max(-0.5 * slope / (lower - fun - slope), 0.1), 0.5)
            part *= factor
        return _Trial(False, x, fun, gradient, 0.0, promised, blocked)

    def _put_back(self, moved: Floats, x: Floats) -> Booleans:
        """Put points back that are where they may not be; which those are, (K,)."""
        if self.allowed is None:
            return self.nobody
        blocked = ~np.asarray(self.allowed(self.points(moved)), bool)
        if blocked.any():
            self.points(moved)[blocked] = self.points(x)[blocked]
        return blocked


class _Reach:
    """Part of its step that each point tries: less where it was blocked."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.parts, self.components = np.ones(shape[0]), shape[1]

    def free(self) -> Floats:
        """1 for components of points not held up, 0 for others, new, shape (N,)."""
        return np.repeat(self.parts > OPTIONS.held, self.components).astype(float)

    def shortened(self, step: Floats) -> Floats:
        """The part that is tried of a full step, shape (N,)."""
        return step * np.repeat(self.parts, self.components)

    def learn(self, blocked: Booleans) -> bool:
        """Shorten the next steps of points that were blocked, shape (K,).

        Returns:
            Whether points are still closing in on an edge: as long as they do, little
            progress of the whole does not mean its end.
        """
        closing = bool((blocked & (self.parts > OPTIONS.held)).any())
        # A point that is held up keeps trying, should the others set it free.
        shorter = np.maximum(0.25 * self.parts, 0.25 * OPTIONS.held)
        self.parts = np.where(blocked, shorter, np.minimum(2.0 * self.parts, 1.0))
        return closing


class _Pairs:
    """The last changes of x and of the gradient, in a ring of shape (memory, 2, N)."""

    def __init__(self, size: int) -> None:
        self.changes = np.empty((OPTIONS.memory, 2, size))
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self.newest, self.count = -1, 0

    def learn(self, s: Floats, y: Floats) -> None:
        """Take note of changes s of x and y of the gradient, shape (N,)."""
        length = math.sqrt(s @ s)
        # Armijo's rule alone does not rule out a curvature that is not positive.
        if s @ y > OPTIONS.curved * length * math.sqrt(y @ y):
            self.newest = (self.newest + 1) % OPTIONS.memory
            self.count = min(self.count + 1, OPTIONS.memory)
            # H does not change where s and y are scaled alike.
            self.changes[self.newest] = s / length, y / length

    def step(self, gradient: Floats, free: Floats, first: float) -> Floats:
        """The step `-H g` of Nocedal and Wright, algorithm 7.4, on free components.

        Args:
            gradient: Gradient g, shape (N,).
            free: 1 for free components, 0 for others, shape (N,). The others do not
                enter the recursion; their step is `-gamma g`.
            first: The gamma of H = gamma I before anything is known of the curvature.
        """
        order = (self.newest - np.arange(self.count)) % OPTIONS.memory
        S, Y = free * self.changes[order, 0], free * self.changes[order, 1]
        sy = np.einsum("ij,ij->i", S, Y)
        sizes = np.einsum("ij,ij->i", S, S) * np.einsum("ij,ij->i", Y, Y)
        # Not every pair curves upwards on the components that are free now.
        curving = np.flatnonzero(sy > OPTIONS.curved * np.sqrt(sizes))
        step, alpha = -gradient, np.zeros(self.count)
        for k in curving:
            alpha[k] = (S[k] @ step) / sy[k]
            step -= alpha[k] * Y[k]
        if len(curving):
            newest = curving[0]
            first = sy[newest] / (Y[newest] @ Y[newest])
        step *= first
        for k in curving[::-1]:
            step += (alpha[k] - (Y[k] @ step) / sy[k]) * S[k]
        return step
