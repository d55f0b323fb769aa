"""Problems meet solvers: Gauss-Newton, alternating steps, differential evolution.

All move the parameters in given directions only. Gauss-Newton follows the derivative
from a start, in all directions or alternating between frames and robot; evolution
searches a box around the nominal robot whose size the linear solution suggests, with
the compiled kernels, and needs no derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from calib_pin.compiled.threads import Threads
from calib_pin.errors import in_file, require_known
from calib_pin.estimation.identifiability import Directions
from calib_pin.estimation.problem import (
    SAMPLE,
    Problem,
    completed,
    evaluator,
    known_count,
)
from calib_pin.estimation.terms import compilable
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import BatchedModel
from calib_pin.observations import states_sigmas
from calib_pin.progress import Progress
from calib_pin.setup import SOLVERS
from calib_pin.solvers import (
    DifferentialEvolution,
    EvolutionResult,
    LeastSquaresResult,
    Status,
    alternation,
    differential_evolution,
    gauss_newton,
)
from calib_pin.solvers.gauss_newton import OPTIONS

MARGIN = 4.0
"""Size of the box of an evolution, in sizes of the linear solution.

That is about right even for errors that put the tip off by a third of a meter.
"""

ROBOT_BOX = (10.0, 100.0)
"""Smallest and largest half width in the robot's directions, in expected sizes."""

NUISANCE_BOX = (0.02, 1.0)
"""The same in the directions of frames and instrument [m, rad]."""

ROWS = 1000
"""Rows that an evolution looks at when Gauss-Newton follows."""

ENOUGH = 1e-12
"""Part of the cost that a step of very many rows must promise; of a million it is a
thousandth of a deviation."""

INVISIBLE = 1e-3
"""Gain in chi-square, in squared deviations of unit weight, or change of an estimate,
in its own deviations, that nobody can see."""

NEGLIGIBLE = 0.01
"""Part of the cost that an evolution may leave to gain and yet have converged."""


@dataclass(frozen=True)
class Solution(LeastSquaresResult):
    """A solution, and how it was found.

    Attributes:
        evaluator: Evaluator of the rows: `pinocchio`, the compiled `kernel`, or for
            an evolution the `loop` over members where there is no kernel.
        evolution: The evolution, if there was one.
    """

    evaluator: str = "pinocchio"
    evolution: EvolutionResult | None = None

    def after(self, last: Solution) -> Solution:
        """The solution with the steps of the one it started from, and its search."""
        searched = self if self.evolution or not last.evolution else last
        kind, evolution = searched.evaluator, searched.evolution
        nit, nfev = self.nit + last.nit, self.nfev + last.nfev
        return replace(self, evaluator=kind, evolution=evolution, nit=nit, nfev=nfev)


class Solver:
    """The solver that a setup names.

    Args:
        problem: A problem with the setup.
        rng: Random generator of evolutions and of the configurations around them.
        progress: Told how far an evolution is.

    Raises:
        OptionError: If there is no such solver, or an option of it is not allowed.
    """

    def __init__(
        self,
        problem: Problem,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> None:
        """Check the name and the options."""
        setup = problem.setup.solver
        self.rng, self._progress = rng, progress
        self.name = setup.name
        with in_file(problem.setup.file):
            require_known("solver", self.name, SOLVERS)
            known = [option.name for option in fields(DifferentialEvolution)]
            for name in setup.evolution:
                require_known("option of the solver", name, known)
            self._options = DifferentialEvolution(**setup.evolution)  # type: ignore[arg-type]

    @property
    def searches(self) -> bool:
        """Whether it begins with a search that sees all directions."""
        return self.name in ("de", "hybrid")

    def solve(
        self,
        problem: Problem,
        directions: Directions,
        nominal: Floats,
        previous: Floats | None,
    ) -> Solution:
        """Minimize the cost in some directions.

        Args:
            problem: The problem.
            directions: Directions to fit.
            nominal: Registered parameters of the nominal robot, shape (P,).
            previous: The solution in other directions, within these, shape (P,).
        """
        start = nominal if previous is None else previous
        if self.name == "two-step":
            # Base, tool and instrument alternate with the robot until they agree.
            scales = problem.parameters.scales[:, None]
            first, second = scales * directions.nuisances, scales * directions.robot
            evaluate = problem.linearize, problem.cost
            result = alternation(*evaluate, start, first, second)
            return Solution(**vars(result), evaluator=evaluator(problem))
        searches = self.searches and directions.count > 0
        if self.name == "de" and searches:
            return self._evolve(problem, directions, nominal, start)
        # What other directions have led to needs no search again.
        if not searches or previous is not None:
            return descend(problem, directions, start)
        few = replace(problem, data=problem.data.sample(ROWS))
        solution = self._evolve(few, directions, nominal, start)
        return descend(problem, directions, solution.x).after(solution)

    def _evolve(
        self, problem: Problem, directions: Directions, nominal: Floats, start: Floats
    ) -> Solution:
        """Differential evolution in a box around the nominal robot."""
        scales = problem.parameters.scales
        basis = scales[:, None] * directions.basis
        costs = PopulationCost(problem)
        bounds = _box(problem, directions, nominal)
        first = directions.basis.T @ ((start - nominal) / scales)
        done = 0

        def evaluate(members: Floats) -> Floats:
            nonlocal done
            done += len(members)
            if self._progress is not None:
                self._progress(done / self._options.budget)
            return costs(nominal + members @ basis.T)

        x0 = np.clip(first, *bounds.T)
        best = differential_evolution(evaluate, bounds, self.rng, self._options, x0=x0)
        x = nominal + basis @ best.x
        fun, jac = problem.linearize(x)
        status = _status_of(problem, best, fun, jac @ basis)
        cost, nit, nfev = best.fun, best.nit, best.nfev
        return Solution(x, fun, jac, cost, nit, nfev, status, costs.evaluator, best)


def descend(problem: Problem, directions: Directions, start: Floats) -> Solution:
    """Gauss-Newton in some directions from a start, shape (P,)."""
    basis = problem.parameters.scales[:, None] * directions.basis
    return least_squares(problem, start, basis)


def least_squares(problem: Problem, start: Floats, basis: Floats) -> Solution:
    """Gauss-Newton from a start; very many measurements begin with a sample of them.

    Args:
        problem: The problem.
        start: Start, shape (P,).
        basis: Directions that the parameters may take, shape (P, k).
    """
    if problem.many and len(problem.data) > 2 * SAMPLE * len(problem.blocks):
        # The sample is done in no time and ends a step from the solution.
        few = replace(problem, data=problem.data.sample(SAMPLE))
        start = refine(few, start, basis).x
    return refine(problem, start, basis)


def refine(
    problem: Problem,
    start: Floats,
    basis: Floats,
    tolerance: float = OPTIONS.promised,
    most: int = 100,
) -> Solution:
    """Gauss-Newton from a start that is close; the arguments as in `least_squares`.

    Args:
        problem: The problem.
        start: Start, shape (P,).
        basis: Directions that the parameters may take, shape (P, k).
        tolerance: Part of the cost that a step must promise.
        most: Most steps.
    """
    result = gauss_newton(
        problem.linearize,
        problem.cost,
        start,
        basis,
        tolerance=max(tolerance, ENOUGH) if problem.many else tolerance,
        worthwhile=INVISIBLE / max(known_count(problem), 1),
        max_iterations=most,
        spare=problem.many,
        # What was eliminated completes a step from where it was.
        complete=lambda theta, step: completed(problem.stations(theta), step),
    )
    return Solution(**vars(result), evaluator=evaluator(problem))


def _box(problem: Problem, directions: Directions, nominal: Floats) -> Floats:
    """Bounds of an evolution in its directions, shape (k, 2).

    The linear solution tells how large the errors are, though not where.
    """
    r, J = problem.linearize(nominal)
    A = J @ (problem.parameters.scales[:, None] * directions.basis)
    linear = np.full(A.shape[1], np.inf)
    if np.isfinite(A).all() and np.isfinite(r).all():
        linear = np.abs(np.linalg.lstsq(A, -r, rcond=1e-9)[0])
    parts = np.split(linear, [directions.nuisances.shape[1]])
    sizes = [MARGIN * part.max(initial=0.0) for part in parts]
    half = np.clip(sizes, *np.transpose([NUISANCE_BOX, ROBOT_BOX]))
    return np.repeat(half, list(map(len, parts)))[:, None] * [-1.0, 1.0]


def _status_of(
    problem: Problem, result: EvolutionResult, fun: Floats, A: Floats
) -> Status:
    """An evolution has converged where next to nothing is left to gain.

    A population can meet anywhere, and a limit of generations can come at a minimum.
    Residual, (M,), and Jacobian by directions, (M, k), are those of its best member.
    """
    if result.status not in (Status.GENERATIONS, Status.CONVERGED):
        return result.status
    step = np.linalg.lstsq(A, fun, rcond=None)[0]
    promised = float(fun @ (A @ step)) / 2.0
    # Where the noise is stated, what lies far below it is nothing to gain either.
    noise = 0.5 * known_count(problem) if states_sigmas(problem.data) else 0.0
    if promised <= NEGLIGIBLE * max(result.fun, noise):
        return Status.CONVERGED
    if result.status is Status.CONVERGED:
        return Status.COLLAPSED
    return result.status


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
        >>> chain, rng = calib_pin.load_chain("space6"), np.random.default_rng(0)
        >>> nominal = nominal_problem(chain, "position", Setup())
        >>> zero = np.zeros(len(nominal.parameters))
        >>> exact = calib_pin.simulate(nominal, zero, rng, count=5, noise=0.0)
        >>> problem = replace(nominal, data=exact)
        >>> PopulationCost(problem)(np.array([zero, zero + 1e-3])) > 1e-6
        array([False,  True])
    """

    def __init__(self, problem: Problem, threads: int | None = None) -> None:
        """Compute what does not depend on the parameters."""
        from calib_pin.estimation.many_rows import PopulationPart, Segments

        self._problem, self._threads = problem, Threads(threads)
        self._parts: list[PopulationPart] = []
        self.evaluator = "kernel"
        for block in problem.blocks:
            error, measurement = block.term.error, block.term.measurement
            batches = (
                measurement.batches(block.data, 1.0 / block.table(problem.sigma))
                if compilable(error) and isinstance(measurement, BatchedModel)
                else ()
            )
            if not batches:
                self.evaluator = "loop"
                return
            segments = Segments(error)
            self._parts += [PopulationPart(block, segments, batch) for batch in batches]

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
