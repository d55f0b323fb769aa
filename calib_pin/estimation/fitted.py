"""A fitted problem: parameters with all that is known of their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib_pin.estimation.directions import Directions
from calib_pin.estimation.evidence import Outlier, VarianceComponent
from calib_pin.estimation.identifiability import Structure
from calib_pin.estimation.posterior import Posterior, posterior
from calib_pin.estimation.problem import Problem, expecting
from calib_pin.estimation.shrinkage import Evidence
from calib_pin.estimation.statistics.systematic import ROWS, Systematic
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import EvolutionResult, LeastSquaresResult


@dataclass(frozen=True)
class Fit:
    """A fitted problem.

    Attributes:
        problem: The problem about its registered references.
        before: Parameters with only the nuisances fitted, shape (P,).
        structure: Structural analysis at nominal geometry.
        directions: The directions that were moved and those left at nominal.
        result: Outcome of the solver.
        rank: Practical rank: nuisance and robot directions that were estimated.
        sigma0: Standard deviation of unit weight; NaN without redundancy.
        noise: The noise of every quantity, as the measurements show it.
        effects: What gears and compliance do that the model does not have; None where
            nothing shows or nobody has looked, see `with_effects`.
        evidence: What the rows say of the size of the robot's errors, and the prior
            that follows; None where they are exact.
        unit: Standard deviation of unit weight of the whitened rows; 1 where the noise
            of the quantities is in the units of the problem.
        singular_values: Of the whitened, scaled Jacobian of the estimated robot
            directions at the solution with the nuisances projected out, descending.
        revealed: Robot directions that nominal geometry hides and that were moved all
            the same, shape (P, k); k is 0 for errors of the expected size.
        solver: Name of the solver.
        evaluator: What evaluated the rows, see `solve.Solution`.
        evolution: The last evolution, if there was one.
        outliers: Measurements that do not fit, worst first, with their weights.
        squared: The fit of all rows alike, where some have lost weight.
        disagreement: Part of the configurations that would have to be set aside, where
            that is so much that none was: no solution has a majority.
    """

    problem: Problem
    before: Floats
    structure: Structure
    directions: Directions
    result: LeastSquaresResult
    rank: int
    sigma0: float
    evidence: Evidence | None
    unit: float
    singular_values: Floats
    revealed: Floats
    solver: str
    evaluator: str
    evolution: EvolutionResult | None
    noise: tuple[VarianceComponent, ...] = ()
    effects: Systematic | None = None
    outliers: tuple[Outlier, ...] = ()
    squared: Fit | None = None
    disagreement: float = 0.0

    @property
    def theta(self) -> Floats:
        """Parameter values, shape (P,)."""
        return self.result.x

    @property
    def dof(self) -> int:
        """Residual components minus the rank."""
        return self.problem.count - self.rank

    @property
    def size(self) -> float | None:
        """Expected size of errors, in scales; None where the rows alone decide."""
        return None if self.evidence is None else self.evidence.expected.size

    @property
    def held(self) -> tuple[Problem, LeastSquaresResult, Floats]:
        """With the prior among the rows: problem, solution, and what moved, (P, k)."""
        if self.evidence is None or not self.evidence.matters:
            return self.problem, self.result, self.directions.basis
        expected = self.evidence.expected
        result = replace(
            self.result,
            fun=np.append(self.result.fun, expected.residual(self.theta)),
            jac=np.vstack([self.result.jac, expected.jacobian(self.theta)]),
        )
        return expecting(self.problem, expected), result, self.directions.every

    @cached_property
    def covariance(self) -> Floats:
        """Of the parameters about the references of the problem, shape (P, P).

        With what the measurements leave open and the prior holds, and with what was
        absorbed of effects that the model does not have; NaN without redundancy.
        """
        return self.deviations.covariance

    @cached_property
    def deviations(self) -> Posterior:
        """How far it can be off, about the references of the problem."""
        return self.posterior(self.problem, self.theta)

    @cached_property
    def likely(self) -> tuple[Posterior, ...]:
        """The same for each of the likely sizes of errors, see `Evidence.sizes`."""
        if self.evidence is None:
            return (self.deviations,)
        sizes = self.evidence.sizes.tolist()
        return tuple(self.posterior(self.problem, self.theta, size) for size in sizes)

    @cached_property
    def registered(self) -> tuple[Floats, Floats]:
        """Whitened residual and Jacobian of the nominal robot, see `before`."""
        return self.problem.factorize(self.before)

    @cached_property
    def settled(self) -> Posterior:
        """How far it can be off, about its solution."""
        return self.posterior(*self.problem.rebased(self.theta))

    @cached_property
    def _by_effects(self) -> Floats | None:
        """What effects that the model does not have add to its residuals, (M, S)."""
        if self.effects is None:
            return None
        few = replace(self.problem, data=self.problem.data.sample(ROWS))
        return self.effects.rows(few, self.theta)

    def posterior(
        self, problem: Problem, theta: Floats, size: float | None = None
    ) -> Posterior:
        """How far the fit can be off, about any references.

        Args:
            problem: The problem about these.
            theta: The solution about them, shape (P,).
            size: Expected size of errors in place of the likeliest one.
        """
        own = problem is self.problem
        found = posterior(
            problem,
            theta,
            self.directions,
            self.noise,
            self.effects,
            self.size if size is None else size,
            (self.result.fun, self.result.jac) if own else None,
            self._by_effects if own else None,
        )
        # Without redundancy nobody knows.
        return replace(found, by_noise=self.unit * found.by_noise)
