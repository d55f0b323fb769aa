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
from calib_pin.estimation.solve import Solution
from calib_pin.estimation.statistics.systematic import ROWS, Systematic
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import LeastSquaresResult


@dataclass(frozen=True)
class RobustDecision:
    """Measurements that robust estimation has set aside, or why it has not.

    Attributes:
        outliers: Measurements that do not fit, worst first, with their weights.
        squared: The fit of all measurements alike, where some have lost weight.
        disagreement: Part of the configurations that would have to be set aside, where
            that is so much that none was: no solution has a majority.
    """

    outliers: tuple[Outlier, ...] = ()
    squared: Fit | None = None
    disagreement: float = 0.0


@dataclass(frozen=True)
class Fit:
    """A fitted problem.

    Attributes:
        problem: The problem about its registered references.
        before: Parameters with only the nuisances fitted, shape (P,).
        structure: Structural analysis at nominal geometry.
        directions: The directions that were moved and those held at nominal.
        solution: Outcome of the solver, with the last evolution, if there was one.
        rank: Practical rank: nuisance and robot directions that were estimated.
        sigma0: Standard deviation of unit weight; NaN without redundancy.
        evidence: Size of the robot's errors by the measurements, and the prior that
            follows; None where they are exact.
        unit: Standard deviation of unit weight of the whitened residuals; 1 where the
            noise of the quantities is in the units of the problem.
        singular_values: Of the whitened, scaled Jacobian of the estimated robot
            directions at the solution with the nuisances projected out, descending.
        noise: The noise of every quantity, as the measurements show it.
        effects: Gears and compliance that the model does not have; None where nothing
            shows or nobody has looked, see `fit.with_effects`.
        robust: Measurements that were set aside.
    """

    problem: Problem
    before: Floats
    structure: Structure
    directions: Directions
    solution: Solution
    rank: int
    sigma0: float
    evidence: Evidence | None
    unit: float
    singular_values: Floats
    noise: tuple[VarianceComponent, ...] = ()
    effects: Systematic | None = None
    robust: RobustDecision = RobustDecision()

    @property
    def result(self) -> LeastSquaresResult:
        """The solution as the solver found it."""
        return self.solution.result

    @property
    def theta(self) -> Floats:
        """Parameter values, shape (P,)."""
        return self.result.x

    @property
    def dof(self) -> int:
        """Residual components minus the rank."""
        return self.problem.count - self.rank

    @property
    def held(self) -> tuple[Problem, LeastSquaresResult, Floats]:
        """With the prior as residual rows: problem, solution, moved basis (P, k)."""
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
        return self.posterior.covariance

    @cached_property
    def posterior(self) -> Posterior:
        """Deviations of the parameters about the references of the problem."""
        return posterior_about(self, self.problem, self.theta)

    @cached_property
    def registered(self) -> tuple[Floats, Floats]:
        """Whitened residual and Jacobian of the nominal robot, see `before`."""
        return self.problem.factorize(self.before)

    @cached_property
    def _by_effects(self) -> Floats | None:
        """Residuals by effects that the model does not have, shape (M, S)."""
        if self.effects is None:
            return None
        few = replace(self.problem, data=self.problem.data.sample(ROWS))
        return self.effects.rows(few, self.theta)


def posterior_about(
    fitted: Fit, problem: Problem, theta: Floats, size: float | None = None
) -> Posterior:
    """Deviations of a fit about any references.

    Args:
        fitted: The fit.
        problem: Its problem about these.
        theta: The solution about them, shape (P,).
        size: Expected size of errors, in scales, in place of the likeliest one.
    """
    own = problem is fitted.problem
    if size is None and fitted.evidence is not None:
        size = fitted.evidence.expected.size
    found = posterior(
        problem,
        theta,
        fitted.directions,
        fitted.noise,
        fitted.effects,
        size,
        (fitted.result.fun, fitted.result.jac) if own else None,
        fitted._by_effects if own else None,
    )
    # Without redundancy nobody knows.
    return replace(found, by_noise=fitted.unit * found.by_noise)


def likely_posteriors(fitted: Fit) -> tuple[Posterior, ...]:
    """Posteriors for each of the likely sizes of errors, see `Evidence.sizes`."""
    if fitted.evidence is None:
        return (fitted.posterior,)
    problem, theta = fitted.problem, fitted.theta
    sizes = fitted.evidence.sizes.tolist()
    return tuple(posterior_about(fitted, problem, theta, size) for size in sizes)
