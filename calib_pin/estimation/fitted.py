"""A fitted problem: its parameters, and how far they can be off.

A fit is off by noise, and by what gears and compliance did to it.
About any references, the covariance follows from the residual rows linearized there. A
fit moves by `theta - theta_true = A^+ (X g + e)` where g are the random effects of
joints that the model lacks (`systematic`) and e is noise, part of which may be the same
in all repetitions of a configuration (`variance_components`). At another configuration
the tool is off by

    J A^+ e + (J A^+ X - X_there) g,

less than both terms by themselves: a fit absorbs what it can of the effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib_pin.estimation.directions import (
    Directions,
    half_covariance,
    robot_singular_values,
)
from calib_pin.estimation.evaluators import own_deviations, with_response
from calib_pin.estimation.evidence import Outlier, VarianceComponent
from calib_pin.estimation.identifiability import Structure
from calib_pin.estimation.places import expected_places
from calib_pin.estimation.problem import Problem, current_units, known_count
from calib_pin.estimation.row_blocks import Priors
from calib_pin.estimation.solve import Solution
from calib_pin.estimation.statistics.systematic import ROWS, Systematic, sampled
from calib_pin.estimation.statistics.variance_components import (
    REJECTED,
    by_quantity,
    repetitions,
)
from calib_pin.estimation.terms import Term
from calib_pin.kinematics.spatial import Floats


@dataclass(frozen=True)
class Posterior:
    """Deviations of a fit, about the references of its problem.

    Attributes:
        problem: The problem.
        theta: Parameter values about its references, shape (P,).
        by_noise: Deviations of the parameters by independent noises of deviation one,
            shape (P, r).
        by_effects: The same by the effects of gears and compliance, shape (P, S).
        by_station: The same of parameters that were eliminated, by the noise of their
            own station, shape (P, k); in a column stations are independent.
        systematic: These effects; None for none.
        noise: Variance of a measured value of each quantity at a new configuration,
            relative to that of its row, shape (K,).
    """

    problem: Problem
    theta: Floats
    by_noise: Floats
    by_effects: Floats
    by_station: Floats
    systematic: Systematic | None
    noise: Floats

    @property
    def covariance(self) -> Floats:
        """Covariance of the parameters, shape (P, P)."""
        half = np.column_stack([self.by_noise, self.by_effects])
        result = half @ half.T
        for own in self.problem.own_of_stations.values():
            alone = self.by_station[own]
            result[np.ix_(own, own)] += alone @ alone.T
        return np.asarray(result)

    def twists(self, term: Term, q: Floats, J: Floats) -> Floats:
        """Deviations of the tool of a term as body twists, shape (N, 6, r + S).

        The squares of the last axis add up to variances. Frames, the columns 0 to 5 and
        the last six of the error model, count as what they were fitted to be.

        Args:
            term: The term about its solution, see `Terms.rebased`.
            q: Positions of its joints, shape (N, n) [rad, m].
            J: Body twists there by the parameters of its error model about these
                references, shape (N, 6, p).
        """
        own = term.index[: J.shape[2]]
        parts = [J @ self.by_noise[own]]
        if self.systematic is not None:
            there = self.systematic.twists(term, q)
            parts.append(J @ self.by_effects[own] - there)
        return np.concatenate(parts, axis=2)


def shared_variances(
    problem: Problem, components: Sequence[VarianceComponent], noise: Floats
) -> Floats:
    """Part of the variances of quantities that repetitions have in common, (K,)."""
    result = np.zeros(len(noise))
    if problem.many:
        return result
    current = current_units(problem)
    for k, component in enumerate(components):
        lacking = component.lack_of_fit
        if component.pure is not None and lacking is not None and lacking < REJECTED:
            pure = (component.pure / component.given / current[k]) ** 2
            result[k] = max(float(noise[k]) - pure, 0.0)
    return result


def by_configuration(problem: Problem, U: Floats, shared: Floats) -> Floats:
    """Covariance of errors that repetitions have in common, shape (r, r).

    By orthonormal columns U of the rows, (M, r), and their variances, (K,).
    """
    layout, rank = problem.layout, U.shape[1]
    rows, label = repetitions(problem)
    each = U[: len(layout.row)] * np.sqrt(problem.data.weight)[layout.row, None]
    # Measurements that are no repetitions stand alone.
    of_row = np.arange(len(problem.data)) + len(problem.data)
    of_row[rows] = label
    place = of_row[layout.row] * layout.width + layout.column
    result = np.zeros((rank, rank))
    for k in np.flatnonzero(shared).tolist():
        own = layout.component == k
        groups, group = np.unique(place[own], return_inverse=True)
        summed = np.zeros((len(groups), rank))
        np.add.at(summed, group, each[own])
        result += shared[k] * summed.T @ summed
    return result


@dataclass(frozen=True)
class Evidence:
    """The size of the robot's errors by a least-squares fit.

    Attributes:
        expected: The prior.
        sizes: Standard deviation of every error by it, in scales, shape (P,).
        likely: Sizes in the place of its own that are as likely, shape (K, P).
        matters: Whether it changes the solution by anything to speak of.
        square: Sum of the squared estimates in their standard deviations: chi-square
            of `count` degrees of freedom if the robot is as nominal.
        count: Number of directions that the rows see.
    """

    expected: Priors
    sizes: Floats
    likely: Floats
    matters: bool
    square: float
    count: int


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
        result: Outcome of the solver, with the last evolution, if there was one.
        rank: Practical rank: nuisance and robot directions that were estimated.
        sigma0: Standard deviation of unit weight; NaN without redundancy.
        unit: Standard deviation of unit weight of the whitened residuals; 1 where the
            noise of the quantities is in the units of the problem.
        evidence: Size of the robot's errors by the measurements, and the prior that
            follows; None where they are exact.
        noise: The noise of every quantity, as the measurements show it.
        effects: Gears and compliance that the model does not have; None where nothing
            shows or nobody has looked, see `fit.with_effects`.
        robust: Measurements that were set aside.
    """

    problem: Problem
    before: Floats
    structure: Structure
    directions: Directions
    result: Solution
    rank: int
    sigma0: float
    unit: float
    evidence: Evidence | None = None
    noise: tuple[VarianceComponent, ...] = ()
    effects: Systematic | None = None
    robust: RobustDecision = RobustDecision()

    @property
    def theta(self) -> Floats:
        """Parameter values, shape (P,)."""
        return self.result.x

    @property
    def dof(self) -> int:
        """Residual components minus the rank."""
        return known_count(self.problem) - self.rank

    @property
    def held(self) -> tuple[Problem, Solution, Floats]:
        """With the prior as residual rows: problem, solution, moved basis (P, k)."""
        if self.evidence is None or not self.evidence.matters:
            return self.problem, self.result, self.directions.basis
        problem = replace(self.problem, expected=self.evidence.expected)
        found, further = self.result, problem.further
        own = len(found.fun) - len(self.problem.further)
        fun = np.append(found.fun[:own], further.residual(self.theta))
        jac = np.vstack([found.jac[:own], further.jacobian(self.theta)])
        return problem, replace(found, fun=fun, jac=jac), self.directions.every

    @cached_property
    def singular_values(self) -> Floats:
        """Of the whitened, scaled Jacobian of the estimated robot directions.

        At the solution, with the nuisances projected out, descending.
        """
        parameters = self.problem.parameters
        return robot_singular_values(self.directions, self.result.jac, parameters)

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
        return self.problem.linearize(self.before)

    @cached_property
    def _by_effects(self) -> Floats | None:
        """Residuals by effects that the model does not have, shape (M, S)."""
        if self.effects is None:
            return None
        few = replace(self.problem, data=sampled(self.problem))
        return self.effects.rows(few, self.theta)


def effect_rows(fitted: Fit) -> Floats | None:
    """Whitened residuals by effects that the model does not have, shape (M, S)."""
    if fitted.effects is not None and len(fitted.problem.data) > ROWS:
        return fitted.effects.rows(fitted.problem, fitted.theta)
    return fitted._by_effects  # Of a sample, which has all of them here.


def posterior_about(
    fitted: Fit, problem: Problem, theta: Floats, sizes: Floats | None = None
) -> Posterior:
    """Deviations of a fit about any references.

    Args:
        fitted: The fit.
        problem: Its problem about these.
        theta: The solution about them, shape (P,).
        sizes: Expected size of every error, in scales, in place of the likeliest ones,
            shape (P,).
    """
    own, effects = problem is fitted.problem, fitted.effects
    parameters, result = problem.parameters, fitted.result
    fun, jac = (result.fun, result.jac) if own else problem.linearize(theta)
    stations = problem.stations(theta)
    basis, held = fitted.directions.basis, np.zeros((0, len(theta)))
    if sizes is None and fitted.evidence is not None:
        sizes = fitted.evidence.sizes
    if sizes is not None:
        # Under a prior all errors of the robot move, those too that nominal geometry
        # hides: away from it they show a little.
        alone = parameters.free & ~parameters.nuisance & ~np.isfinite(parameters.priors)
        spread = expected_places(problem, parameters) * sizes
        inverse = np.linalg.solve(spread, np.diag(1.0 / parameters.scales))
        held = np.asarray(inverse[alone])
        basis = np.eye(len(theta))[:, parameters.free]
    half = half_covariance(np.concatenate([jac, held]), basis, parameters)
    noise = np.ones(len(problem.layout.components))
    if effects is not None:
        noise = effects.noise
    shared = shared_variances(problem, fitted.noise, noise)
    core = np.eye(half.shape[1])
    if effects is not None or shared.any():
        rows, prior = by_quantity(problem, theta, fun, jac, half), held @ half
        weights = (noise - shared) / current_units(problem) ** 2
        core = prior.T @ prior + rows.known[:-1, :-1]
        core += np.tensordot(weights, rows.products[:, :-1, :-1], axes=1)
    if shared.any():
        core += by_configuration(problem, jac @ half, shared)
    values, vectors = np.linalg.eigh(core)
    by_noise = half @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    by_effects = np.zeros((len(theta), 0))
    if effects is not None:
        # Of very many rows a sample absorbs as much as all of them.
        few, J, inverse = problem, jac, half
        if len(problem.data) > ROWS:
            few = replace(problem, data=sampled(problem))
            _, J = few.linearize_rows(theta)
            inverse = half_covariance(np.concatenate([J, held]), basis, parameters)
        known = fitted._by_effects if own else None
        X = effects.rows(few, theta) if known is None else known
        by_effects = inverse @ ((J @ inverse)[: len(X)].T @ X)
    # Without redundancy nobody knows, and the unit is not a number.
    by_noise = fitted.unit * with_response(stations, by_noise)
    by_station = fitted.unit * own_deviations(stations, len(theta))
    return Posterior(problem, theta, by_noise, by_effects, by_station, effects, noise)


def likely_posteriors(fitted: Fit) -> tuple[Posterior, ...]:
    """Posteriors for each of the likely sizes of errors, see `Evidence.likely`."""
    if fitted.evidence is None:
        return (fitted.posterior,)
    problem, theta = fitted.problem, fitted.theta
    likely = fitted.evidence.likely
    return tuple(posterior_about(fitted, problem, theta, sizes) for sizes in likely)
