"""Least squares in one choice of directions after the other, until the choice stands.

The robot moves only in directions that the rows can tell, judged by the standard
deviation of unit weight, which is known after a fit only. At the solution those are
taken back that only looked determined from afar, and those added that the errors
themselves have made visible.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.directions import RANK, Directions, appearing, pruned
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import Solved, Solver, descend
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import ParameterSet
from calib_pin.solvers import LeastSquaresResult

SURPRISE = 10.0
"""Gain in chi-square per direction beyond what chance gives once in six hundred."""


@dataclass(frozen=True)
class Solution:
    """A solve in given directions, and what its Jacobian says of them.

    Attributes:
        directions: The directions.
        found: What the solver found.
        rank: Rank of the Jacobian in the directions.
        sigma0: Standard deviation of unit weight; NaN without redundancy.
    """

    directions: Directions
    found: Solved
    rank: int
    sigma0: float

    @property
    def result(self) -> LeastSquaresResult:
        """Outcome of the solver."""
        return self.found.result


def judge(problem: Problem, directions: Directions, found: Solved) -> Solution:
    """Rank and standard deviation of unit weight of what a solver has found."""
    if problem.many:
        # They were solved by normal equations, which cannot tell the rank.
        fun, jac = problem.factorize(found.result.x)
        found = replace(found, result=replace(found.result, fun=fun, jac=jac))
    basis = problem.parameters.scales[:, None] * directions.basis
    triangle = np.linalg.qr(found.result.jac @ basis, mode="r")
    s = np.linalg.svd(triangle, compute_uv=False)
    rank = int((s > RANK * s.max(initial=0.0)).sum())
    dof = problem.count - rank
    return Solution(
        directions=directions,
        found=found,
        rank=rank,
        sigma0=float(np.sqrt(2.0 * found.result.cost / dof)) if dof > 0 else np.nan,
    )


class Stages:
    """Solutions in one choice of directions after the other; the last one counts.

    Args:
        problem: The registered problem.
        solver: The solver.
        nominal: Registered parameters of the nominal robot, shape (P,).
    """

    def __init__(self, problem: Problem, solver: Solver, nominal: Floats) -> None:
        """Begin without a solution."""
        self.solutions: list[Solution] = []
        self.revealed = np.zeros((len(nominal), 0))
        self.nit = self.nfev = 0
        self._problem, self._solver, self._nominal = problem, solver, nominal

    def grow(
        self, directions: Directions, choose: Callable[[float], Directions]
    ) -> None:
        """Solve and choose anew by what the fit says of sigma0, until that stands."""
        tried: set[int] = set()
        while directions.count not in tried:
            tried.add(directions.count)
            sigma0 = self._solve(directions).sigma0
            if np.isfinite(sigma0):
                directions = choose(sigma0)

    def prune(self) -> None:
        """Take directions back that only looked determined from afar."""
        while np.isfinite((last := self.solutions[-1]).sigma0):
            directions = pruned(
                last.directions,
                last.result.jac,
                self._problem.parameters,
                last.sigma0,
            )
            if directions.count == last.directions.count:
                break
            self._solve(directions)

    def extend(self, negligible: float) -> None:
        """Move directions that the errors have made visible, if that explains much.

        With noise, errors of their expected size explain nothing, and the robot stays
        within the directions of its nominal geometry.

        Args:
            negligible: Cost that rounding leaves of exact rows.
        """
        last, problem = self.solutions[-1], self._problem
        if not np.isfinite(last.sigma0) or last.result.cost <= negligible:
            return
        more, promised = appearing(
            last.directions,
            last.result.jac,
            last.result.fun,
            problem.parameters,
            last.sigma0,
        )
        surprise = SURPRISE * more.shape[1]
        # What they explain no longer counts as noise.
        rest = 2.0 * last.result.cost - promised
        if promised * (problem.count - last.rank) <= surprise * rest:
            return
        robot = np.column_stack([last.directions.robot, more])
        directions = replace(last.directions, robot=robot)
        # Here Gauss-Newton tells what there is to gain, whatever the solver.
        found = self._judged(directions, descend(problem, directions, last.result.x))
        gain = 2.0 * (last.result.cost - found.result.cost)
        if gain > surprise * found.sigma0**2:
            self.revealed = more
            if self._solver.name == "de":
                self._solve(directions)
            else:
                self.solutions.append(found)

    def _solve(self, directions: Directions) -> Solution:
        previous = None
        if self.solutions:
            parameters = self._problem.parameters
            previous = _within(self.solutions[-1], directions, parameters)
        found = self._solver.solve(self._problem, directions, self._nominal, previous)
        self.solutions.append(self._judged(directions, found))
        return self.solutions[-1]

    def _judged(self, directions: Directions, found: Solved) -> Solution:
        self.nit += found.result.nit
        self.nfev += found.result.nfev
        return judge(self._problem, directions, found)


def _within(
    solution: Solution, directions: Directions, parameters: ParameterSet
) -> Floats:
    """A solution within other directions; the rest returns to nominal."""
    x = solution.result.x
    kept = directions.basis @ (directions.basis.T @ (x / parameters.scales))
    stay = parameters.nuisance | ~parameters.free
    return np.where(stay, x, parameters.scales * kept)
