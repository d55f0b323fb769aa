"""Fits: least squares, balanced and bounded, and how far they can be off.

The robot moves only in directions that its structure shows at nominal geometry and that
the measurements can tell, judged by the standard deviation of unit weight. That is
known after a fit only, so the choice is repeated until it stands; a better fit admits
more directions, with noise-free measurements in the end all of them. At the solution
those are taken back that only looked determined from afar (a tool point that turns out
to lie on the last axis, for one), and those added that the errors themselves have made
visible. Parameters that run out of their bounds are held there, and fits alternate with
estimates of the unit weights of the quantities.

Measurements in a corner of the workspace determine some directions of the error space
well and others hardly. To estimate the latter freely makes the robot worse everywhere
else; to leave them alone by a hard cut makes it a matter of a threshold. Here every
error of the robot has a normal prior about nominal, and the solution is the mode of the
posterior. Of all estimates it has the least expected error at every configuration. The
size of errors, one for each kind of parameter (placement, compliance, ...), is told by
the measurements where they can (evidence, or type II maximum likelihood: MacKay,
Bayesian interpolation, 1992): what a kind shows nowhere does not grow where the
measurements do not see it.

About any references, the covariance follows from the residual rows linearized there. A
fit moves by `theta - theta_true = A^+ (X g + e)` where g are the random effects of
joints that the model lacks (`variance_components`) and e is noise, part of which may be
the same in all repetitions of a configuration. At another configuration the tool is off
by

    J A^+ e + (J A^+ X - X_there) g,

less than both terms by themselves: a fit absorbs what it can of the effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.evidence import Outlier, VarianceComponent
from calib_pin.estimation.identifiability import (
    RANK,
    WEAK,
    Directions,
    Structure,
    column_space,
    half_covariance,
    nuisance_basis,
    practical_directions,
    projected,
    rounding,
    visible_directions,
)
from calib_pin.estimation.nominal import analyze_structure, register
from calib_pin.estimation.problem import (
    EXACT,
    Problem,
    Station,
    absorbed,
    current_units,
    known_count,
    with_response,
)
from calib_pin.estimation.row_blocks import Priors, expected_places
from calib_pin.estimation.solve import (
    INVISIBLE,
    Solution,
    Solver,
    descend,
    least_squares,
    refine,
)
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.estimation.statistics.variance_components import (
    KNOWN,
    REJECTED,
    STATED,
    Components,
    ErrorBlock,
    Systematic,
    by_quantity,
    estimate_variances,
    repetitions,
    sampled,
    systematic,
    variance_components,
    variances,
)
from calib_pin.estimation.terms import Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations, states_sigmas
from calib_pin.residual_models.base import LearnedCorrection
from calib_pin.solvers import Status


@dataclass(frozen=True)
class Posterior:
    """Deviations of a fit, about the references of its problem.

    Attributes:
        by_noise: Deviations of the parameters by independent noises of deviation one,
            shape (P, r).
        by_effects: The same by the effects of gears and compliance, shape (P, S).
        stations: What was eliminated, with the noise of its own station beside these.
        unit: Standard deviation of unit weight of that.
        systematic: The effects of gears and compliance; None for none.
        noise: Variance of a measured value of each quantity at a new configuration,
            relative to that of its row, shape (K,).
    """

    by_noise: Floats
    by_effects: Floats
    stations: Sequence[Station]
    unit: float
    systematic: Systematic | None
    noise: Floats

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of the parameters, shape (P, P).

        With what the measurements leave open and the prior holds, and with what was
        absorbed of effects that the model does not have; NaN without redundancy.
        """
        half = np.column_stack([self.by_noise, self.by_effects])
        result = half @ half.T
        for station in self.stations:
            alone = self.unit * station.root
            result[np.ix_(station.local, station.local)] += alone @ alone.T
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
        index = term.index[: J.shape[2]]
        parts = [J @ self.by_noise[index]]
        if self.systematic is not None:
            effects = self.systematic.twists(term, q)
            parts.append(J @ self.by_effects[index] - effects)
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

    By orthonormal columns U of the rows, (M, r), which are the same for all n
    repetitions of a configuration, and their variances, (K,): the square of their sum
    is n times the sum of their squares.
    """
    layout, label = problem.layout, repetitions(problem)
    repeated = np.bincount(label, problem.data.weight)[label]
    sizes = np.sqrt(shared[layout.component] * repeated[layout.row])
    each = sizes[:, None] * U[: len(layout.row)]
    return np.asarray(each.T @ each)


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


class Solved(NamedTuple):
    """A problem, and parameter values theta about its references, shape (P,)."""

    problem: Problem
    theta: Floats


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
        learned: The correction that was learned of what the fit leaves; None for none,
            as where the residual model of the setup found nothing to correct.
    """

    problem: Problem
    before: Floats
    structure: Structure
    directions: Directions
    result: Solution
    rank: int
    sigma0: float
    unit: float = 1.0
    evidence: Evidence | None = None
    noise: tuple[VarianceComponent, ...] = ()
    effects: Systematic | None = None
    robust: RobustDecision = RobustDecision()
    learned: LearnedCorrection | None = None

    @property
    def theta(self) -> Floats:
        """Parameter values, shape (P,)."""
        return self.result.x

    @cached_property
    def solved(self) -> Solved:
        """Its problem about the solution, with the learned correction."""
        problem, theta = self.problem.rebased(self.theta)
        if self.learned is not None:
            return Solved(problem.learning(self.learned), theta)
        plain = replace(problem, setup=replace(problem.setup, learned=None))
        return Solved(plain, theta)

    @property
    def dof(self) -> int:
        """Residual components minus the rank."""
        return known_count(self.problem) - self.rank

    @property
    def covariance(self) -> Floats:
        """Of the parameters about the references of the problem, shape (P, P)."""
        return self.posterior.covariance

    @cached_property
    def posterior(self) -> Posterior:
        """Deviations of the parameters about the references of the problem."""
        sizes = None if self.evidence is None else self.evidence.sizes
        return posterior_with(self, sizes)

    @cached_property
    def likely_posteriors(self) -> tuple[Posterior, ...]:
        """Posteriors for each of the likely sizes of errors, see `Evidence.likely`."""
        if self.evidence is None:
            return (self.posterior,)
        return tuple(posterior_with(self, sizes) for sizes in self.evidence.likely)

    @cached_property
    def effect_rows(self) -> Floats:
        """Whitened residuals by effects that the model does not have, shape (M, S)."""
        if self.effects is None:
            return np.zeros((len(self.problem.layout.row), 0))
        return self.effects.rows(self.problem, self.theta)

    @cached_property
    def _absorbing(self) -> tuple[Floats, Floats]:
        """Jacobian, (M, P), and residuals by effects, (M, S); of very many rows some.

        These absorb as much of effects as all of them do.
        """
        if not self.problem.many:
            return self.result.jac, self.effect_rows
        few = replace(self, problem=replace(self.problem, data=sampled(self.problem)))
        return few.problem.linearize_rows(self.theta)[1], few.effect_rows


def with_prior(fitted: Fit) -> tuple[Problem, Solution, Floats]:
    """A fit with its prior as residual rows: problem, solution, moved basis (P, k)."""
    if fitted.evidence is None or not fitted.evidence.matters:
        return fitted.problem, fitted.result, fitted.directions.basis
    problem = replace(fitted.problem, expected=fitted.evidence.expected)
    result = _of_problem(fitted.result, fitted.problem, problem)
    return problem, result, fitted.directions.full_basis


def as_weighted(fitted: Fit, measurements: Observations) -> Observations:
    """The measurements of a fit, with no weight where it has set them aside."""
    aside = fitted.problem.data.weight == 0.0
    return measurements.weighted(np.where(aside, 0.0, measurements.weight))


def posterior_with(fitted: Fit, sizes: Floats | None) -> Posterior:
    """Deviations of a fit.

    Args:
        fitted: The fit.
        sizes: Expected size of every error, in scales, shape (P,); None where the
            measurements alone decide.
    """
    problem, theta, effects = fitted.problem, fitted.theta, fitted.effects
    parameters, fun, jac = problem.parameters, fitted.result.fun, fitted.result.jac
    basis, held = fitted.directions.basis, np.zeros((0, len(theta)))
    if sizes is not None:
        # Under a prior all errors of the robot move, those too that nominal geometry
        # hides: away from it they show a little.
        alone = parameters.free & ~parameters.nuisance & ~np.isfinite(parameters.priors)
        spread = expected_places(problem, parameters) * sizes
        inverse = np.linalg.solve(spread, np.diag(1.0 / parameters.scales))
        held = np.asarray(inverse[alone])
        basis = np.eye(len(theta))[:, parameters.free]
    half = half_covariance(np.concatenate([jac, held]), basis, parameters)
    noise = variances(problem, effects)
    shared = shared_variances(problem, fitted.noise, noise)
    core, by_effects = np.eye(half.shape[1]), np.zeros((len(theta), 0))
    less = (1.0 - noise + shared) / current_units(problem) ** 2
    if less.any():
        products = by_quantity(problem, theta, fun, jac, half).products
        core -= np.tensordot(less, products[:, :-1, :-1], axes=1)
    if shared.any():
        core += by_configuration(problem, jac @ half, shared)
    if effects is not None:
        J, X = fitted._absorbing
        inverse = half_covariance(np.concatenate([J, held]), basis, parameters)
        by_effects = inverse @ ((J @ inverse)[: len(X)].T @ X)
    values, vectors = np.linalg.eigh(core)
    by_noise = half @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    # Without redundancy nobody knows, and the unit is not a number.
    stations, unit = problem.stations(theta), fitted.unit
    by_noise = unit * with_response(stations, by_noise)
    apart = tuple(stations.values())
    return Posterior(by_noise, by_effects, apart, unit, effects, noise)


SURPRISE = 10.0
"""Gain in chi-square per direction beyond what chance gives once in six hundred."""

LEAST, MOST = 1e-3, 1e3
"""Bounds of sizes, in scales."""

PARTS = 3
"""Sizes that stand for the distribution where predictions are averaged over it."""

CLEAR = 10.0
"""Deviation of a direction, by that of the last of the best determined quarter, from
which it counts as evidence by more than noise.

The worse a direction is determined, the more of what the model lacks it collects: gears
with the size that noise alone allows made other motions of a real UR10 worse than
nominal (1.2 mm rms; 0.51 to 0.52 mm with any limit from 3 to 30).
"""

VISIBLE = 1e-9
"""Part of the largest singular value below which the rows do not see a direction; its
square is the part of the cost of the nominal robot below which all is explained."""

STANDS = 0.01
"""Change of the ratios of unit weights at which they stand: a third of the deviation
with which five hundred values tell one, and a change of no weight that matters. As many
posterior deviations must a parameter want to leave its bound inwards."""

LIKE = 1.5
"""Logarithm of the change of a ratio up to which a fit goes on where it stands, in the
directions that it has chosen."""

ROUNDS = 6
"""Most fits of an alternation; two are usual."""


def balanced(problem: Problem, solver: Solver) -> Fit:
    """Alternate fits and estimates of unit weights until their ratios stand.

    A common factor of all measurements changes no solution where nothing else is known;
    then the fit is converted, not repeated.

    Args:
        problem: The problem, not registered.
        solver: The solver.

    Returns:
        The fit, with the noise of its quantities.
    """
    fitted = bounded(problem, solver)
    for _ in range(ROUNDS):
        if not (fitted.dof > 0 and fitted.sigma0 > EXACT):
            break
        current = current_units(fitted.problem)
        noise = variance_components(*with_prior(fitted))
        change = np.array([c.factor for c in noise]) / current
        alone = len(fitted.problem.further) == 0
        common = float(np.exp(np.mean(np.log(change)))) if alone else 1.0
        relative = np.abs(np.log(change / common)).max()
        # A search that was cut short, or told when to end, is not carried on.
        if relative < STANDS or fitted.result.status is not Status.CONVERGED:
            fitted = _rescaled(fitted, common)
            break
        if relative < LIKE:
            fitted = fit_in_units(fitted, current * change)
        else:
            fitted = bounded(replace(problem, units=current * change), solver)
    if fitted.dof > 0 and fitted.unit > EXACT:
        fitted = replace(fitted, noise=variance_components(*with_prior(fitted)))
    return fitted


def fit_in_units(fitted: Fit, units: Floats) -> Fit:
    """A fit in other units, shape (K,), in its directions from where it stands."""
    problem = replace(fitted.problem, units=units)
    before = least_squares(problem, fitted.before, nuisance_basis(problem.parameters))
    result = descend(problem, fitted.directions, fitted.theta).after(before)
    last = replace(fitted, problem=problem, before=before.x)
    return shrunk(_fit_of(last, fitted.directions, result.after(fitted.result)))


def _rescaled(fitted: Fit, factor: float) -> Fit:
    """A fit in units that are all multiplied by one factor."""
    result, units = fitted.result, factor * current_units(fitted.problem)
    fun, jac = result.fun / factor, result.jac / factor
    result = replace(result, fun=fun, jac=jac, cost=result.cost / factor**2)
    problem, sigma0 = replace(fitted.problem, units=units), fitted.sigma0 / factor
    return replace(fitted, problem=problem, result=result, sigma0=sigma0, unit=1.0)


def bounded(problem: Problem, solver: Solver) -> Fit:
    """Register a problem and fit it under the bounds of its parameters.

    A parameter that runs out of its bounds is held there and leaves the set, so that
    the directions are chosen anew without it: another member of its group may take
    over what it must not. It is let go once if the cost pulls it back inside.
    """
    problem, before = register(problem, np.zeros(len(problem.parameters)))
    lower, upper = problem.parameters.bounds
    released = set[int]()
    while True:
        fitted = fit_in_stages(problem, before, solver)
        held, x = dict(problem.held_at), fitted.theta
        excess = np.maximum(lower - x, x - upper) / problem.parameters.scales
        excess[~problem.parameters.free] = 0.0
        if excess.max(initial=0.0) > 0.0:
            # The worst ones together: the others may come back inside without them.
            bounds = np.clip(x, lower, upper)
            for k in np.flatnonzero(excess > 0.5 * excess.max()).tolist():
                held[k] = float(bounds[k])
        else:
            pulls = _pulls(fitted)
            sides = {k: 1.0 if v == upper[k] else -1.0 for k, v in held.items()}
            inward = {k for k, s in sides.items() if s * pulls[k] > STANDS} - released
            if not inward:
                return fitted
            released |= inward
            held = {k: v for k, v in held.items() if k not in inward}
        problem = replace(problem, held_at=held)


def _pulls(fitted: Fit) -> dict[int, float]:
    """How far the cost wants held parameters to fall, in their posterior deviations.

    With the moved directions projected out of its column, a parameter let go would
    move by gradient / curvature, and would have the deviation sigma0 / curvature^0.5.
    """
    problem, result = fitted.problem, fitted.result
    held = list(problem.held_at)
    basis = fitted.directions.basis
    Q = result.jac @ half_covariance(result.jac, basis, problem.parameters)
    columns = result.jac[:, held]
    alone = columns - Q @ (Q.T @ columns)
    size = np.linalg.norm(alone, axis=0)
    # Where the moved directions can do what it does, rounding is left.
    seen = size > rounding(result.jac) * np.linalg.norm(columns, axis=0)
    unit = size * max(np.nan_to_num(fitted.sigma0), 1e-300)
    pulls = np.where(seen, result.fun @ alone / np.where(seen, unit, 1.0), 0.0)
    return dict(zip(held, pulls.tolist(), strict=True))


def fit_in_stages(problem: Problem, before: Solution, solver: Solver) -> Fit:
    """Fit a registered problem, without regard to bounds.

    Args:
        problem: The problem.
        before: Its registration with the robot at nominal.
        solver: The solver.
    """
    parameters, terms = problem.parameters, problem.terms.values()
    nominal = np.where(parameters.free, before.x, 0.0)
    nominal[list(problem.held_at)] = list(problem.held_at.values())
    r, J = before.fun, before.jac
    if problem.held_at:
        r, J = problem.linearize(nominal)
    reference = np.zeros(len(parameters))
    if any(term.measurement.declaration.contact for term in terms):
        # What is touched must be where the tool can touch it.
        reference = np.where(parameters.nuisance, nominal, 0.0)
    structure, at_zero = analyze_structure(problem, reference, solver.rng)
    visible = visible_directions(at_zero, parameters)
    count = known_count(problem) - absorbed(problem)
    # A search takes errors for which the linear prediction of sigma0 is no good.
    sigma0 = 0.0 if solver.searches else None
    directions = practical_directions(J, r, count, parameters, visible, sigma0)
    last = Fit(problem, before.x, structure, directions, before, 0, np.nan)
    tried = set[int]()

    def fit_along(directions: Directions) -> Fit:
        previous = None
        if last.rank:
            # Within other directions; the rest returns to nominal.
            basis, x = directions.basis, last.theta / parameters.scales
            kept = parameters.scales * (basis @ (basis.T @ x))
            stay = parameters.nuisance | ~parameters.free
            previous = np.where(stay, last.theta, kept)
        result = solver.solve(problem, directions, nominal, previous)
        if not np.isfinite(result.cost):
            # Without some directions, points may be behind a camera there.
            result = solver.solve(problem, directions, nominal, None)
        return _fit_of(last, directions, result.after(last.result))

    while directions.count not in tried:
        tried.add(directions.count)
        last = fit_along(directions)
        if np.isfinite(last.sigma0):
            sigma0 = last.sigma0
            directions = practical_directions(J, r, count, parameters, visible, sigma0)
    while np.isfinite(last.sigma0):
        # Some only looked determined from afar; they join the weak ones.
        fun, jac, robot = last.result.fun, last.result.jac, last.directions.robot
        chosen = practical_directions(jac, fun, count, parameters, robot, last.sigma0)
        if chosen.count == last.directions.count:
            break
        weak = np.column_stack([last.directions.weak, chosen.weak])
        last = fit_along(replace(chosen, weak=weak))
    if last.result.cost > VISIBLE**2 * before.cost:
        last = _with_revealed(last)
    return shrunk(last)


def _fit_of(last: Fit, directions: Directions, result: Solution) -> Fit:
    """The fit of a solution: its rank and its standard deviation of unit weight.

    Args:
        last: A fit of the same problem.
        directions: The directions that were moved.
        result: The solution.
    """
    problem = last.problem
    basis = problem.parameters.scales[:, None] * directions.basis
    triangle = np.linalg.qr(result.jac @ basis, mode="r")
    s = np.linalg.svd(triangle, compute_uv=False)
    rank = int((s > RANK * s.max(initial=0.0)).sum()) + absorbed(problem)
    dof = known_count(problem) - rank
    unit = sigma0 = float(np.sqrt(2.0 * result.cost / dof)) if dof > 0 else np.nan
    if len(problem.units) or (states_sigmas(problem.data) and not np.isfinite(sigma0)):
        unit = 1.0
    given = problem, last.before, last.structure, directions
    return Fit(*given, result, rank, sigma0, unit)


def _with_revealed(last: Fit) -> Fit:
    """A fit that moves directions which the errors have made visible, if worthwhile.

    Special geometry hides them at nominal: parallel or intersecting axes. Away from it
    they show, the more the larger the errors are. With noise, errors of their expected
    size explain nothing, and the robot stays within its nominal directions.
    """
    problem, directions, result = last.problem, last.directions, last.result
    parameters = problem.parameters
    if not np.isfinite(last.sigma0):
        return last
    robot = np.eye(len(parameters))[:, parameters.free & ~parameters.nuisance]
    known = np.column_stack([directions.robot, directions.weak])
    hidden = column_space(robot - known @ (known.T @ robot))
    A = result.jac * parameters.scales
    Q, columns = column_space(A @ directions.basis), A @ hidden
    rest = columns - Q @ (Q.T @ columns)
    U, s, Vt = np.linalg.svd(rest, full_matrices=False)
    shown = s * WEAK > last.sigma0
    more = hidden @ Vt[shown].T
    # Rounding must not move, by 1e-20, parameters that nothing moves.
    more[np.abs(more) < 1e-13] = 0.0
    promised = float(np.sum((U[:, shown].T @ result.fun) ** 2))
    surprise = SURPRISE * more.shape[1]
    # What they explain no longer counts as noise.
    if promised * last.dof <= surprise * (2.0 * result.cost - promised):
        return last
    robot = np.column_stack([directions.robot, more])
    directions = replace(directions, robot=robot, revealed=more.shape[1])
    # Here Gauss-Newton tells what there is to gain, whatever the solver.
    solution = descend(problem, directions, result.x).after(result)
    fitted = _fit_of(last, directions, solution)
    gain = 2.0 * (result.cost - solution.cost)
    return fitted if gain > surprise * fitted.sigma0**2 else last


def expected_sizes(
    values: Floats, variances: Floats, half: Floats, kinds: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """The size of errors of each kind by their evidence, in scales.

    Estimates `b ~ N(0, sum_k tau_k^2 H_k H_k^T + diag(v))`; tau^2 itself is about 1
    beforehand (inverse chi-square with `STATED` degrees of freedom).

    Args:
        values: Estimates b, shape (k,).
        variances: Their variances v, shape (k,).
        half: What errors, one scale large, contribute to them: H, shape (k, p).
        kinds: Kind of each error, 0 to K - 1, shape (p,).

    Returns:
        The most likely sizes, shape (K,), and for each kind the middles of `PARTS`
        equally likely parts of its distribution beside the others, (K, PARTS).

    Examples:
        >>> none = np.zeros(0)
        >>> expected_sizes(none, none, np.zeros((0, 3)), np.zeros(3, int))[0]
        array([1.])
    """
    count, deviations = int(kinds.max(initial=-1)) + 1, np.sqrt(variances)
    block = ErrorBlock(
        rows=(values / deviations)[:, None],
        labels=np.append(np.full(len(values), KNOWN), kinds),
        factors=np.hstack([np.eye(len(values)), half / deviations[:, None]]),
    )
    prior = np.full(count, STATED)
    components = Components([block], prior, prior)
    model = estimate_variances(components, np.ones(count), LEAST**2, MOST**2)
    # Beside the others at their likeliest sizes chi-square is as wide as this.
    dof = 2.0 * np.diag(model.information)
    middles = (np.arange(PARTS) + 0.5) / PARTS
    ratios = [[f / chi_square_quantile(f, middle) for middle in middles] for f in dof]
    parts = np.sqrt(model.values[:, None] * np.reshape(ratios, (count, PARTS)))
    # Steps of 2 % are far finer than any is known, and rounding moves no solution.
    return 10.0 ** np.round(0.5 * np.log10(model.values), 2), parts


def shrunk(fitted: Fit) -> Fit:
    """The mode of the posterior from a least-squares fit, with the evidence for it.

    Where the rows are exact or tell nothing there is none. Residual and Jacobian are
    without the rows of the prior.
    """
    problem, result, unit = fitted.problem, fitted.result, fitted.unit
    if not unit > EXACT or fitted.rank == 0:
        return fitted
    evidence = expected_errors(fitted)
    # A search that was cut short, or met far from a minimum, stays what it is.
    led = Status.CONVERGED, Status.ITERATIONS, Status.STALLED
    if not evidence.matters or result.status not in led:
        return replace(fitted, evidence=replace(evidence, matters=False))
    # Whitened like the rows, whose unit weight is not in their standard deviations.
    expected = replace(evidence.expected, rows=evidence.expected.rows * unit)
    basis = problem.parameters.scales[:, None] * fitted.directions.full_basis
    held = replace(problem, expected=expected)
    solution = _of_problem(refine(held, result.x, basis), held, problem)
    return replace(fitted, evidence=evidence, result=solution.after(result))


def _of_problem(solution: Solution, last: Problem, problem: Problem) -> Solution:
    """The solution of a problem with the further rows of another, of the same rows."""
    count, further = len(solution.fun) - len(last.further), problem.further
    fun = np.append(solution.fun[:count], further.residual(solution.x))
    jac = np.vstack([solution.jac[:count], further.jacobian(solution.x)])
    return replace(solution, fun=fun, jac=jac, cost=0.5 * float(fun @ fun))


def expected_errors(fitted: Fit) -> Evidence:
    """The prior of the robot's directions by the evidence of a least-squares fit.

    What has a prior of its own has no other.
    """
    parameters, directions = fitted.problem.parameters, fitted.directions
    theta, unit = fitted.theta, fitted.unit
    V = np.column_stack([directions.robot, directions.weak])
    V = V * ~np.isfinite(parameters.priors)[:, None]
    present = np.unique(parameters.kinds[V.any(axis=1)])
    mask = np.isin(parameters.kinds, present)
    kinds = np.searchsorted(present, parameters.kinds[mask])
    A = fitted.result.jac * parameters.scales
    system = projected(np.column_stack([A @ V, fitted.result.fun]), A, parameters)
    triangle = np.asarray(np.linalg.qr(system, mode="r"))
    U, s, Wt = np.linalg.svd(triangle[:, :-1], full_matrices=False)
    seen = s > VISIBLE * s.max(initial=0.0)
    s, Wt = s[seen], Wt[seen]
    deviations = unit / s
    current = Wt @ (V.T @ (theta / parameters.scales))
    # At the least squares what was moved has no gradient; what was not, has.
    values = current - (U[:, seen].T @ triangle[:, -1]) / s
    quarter = np.quantile(deviations**2, 0.25) if len(s) else np.inf
    beside = deviations**2 * (1.0 + deviations**2 / (CLEAR**2 * quarter))
    places = expected_places(fitted.problem, parameters)
    half = Wt @ V.T @ places
    of_kinds, parts = expected_sizes(values, beside, half[:, mask], kinds)
    sizes, likely = np.ones(len(V)), np.ones((PARTS, len(V)))
    sizes[mask], likely[:, mask] = of_kinds[kinds], parts[kinds].T
    P, t, _ = np.linalg.svd(half * sizes / deviations[:, None], full_matrices=False)
    shrinkage = (P * (t / np.hypot(1.0, t)) ** 2) @ P.T
    change = shrinkage @ (values / deviations) - current / deviations
    shift = change / np.sqrt(np.diag(shrinkage))
    return Evidence(
        expected=Priors.expected(V, sizes, parameters.scales, places),
        sizes=sizes,
        likely=likely,
        matters=bool(np.abs(shift).max(initial=0.0) > INVISIBLE),
        square=float(np.sum((values / deviations) ** 2)),
        count=len(values),
    )


@dataclass(frozen=True)
class RobotRows:
    """Equations `W theta = c` for the errors of a robot, with noise of deviation one.

    It is the likelihood of the robot alone: priors are left out, frames and instrument
    projected out. Measurements that repeat a configuration, and effects of gears and
    compliance that the model lacks, have errors in common and tell less than as many
    independent ones.

    Attributes:
        robot: The parameters that are errors of the robot and free, shape (P,), K of
            them.
        rows: W for these divided by their scales, shape (r, K).
        values: c, shape (r,).
        along: How each measured value enters these, shape (r, M): the M whitened
            residuals of the problem times it are `W theta - c`.
    """

    robot: NDArray[np.bool_]
    rows: Floats
    values: Floats
    along: Floats


def robot_rows(
    problem: Problem, theta: Floats, components: Sequence[VarianceComponent]
) -> RobotRows:
    """The equations for the robot that the measurements of a problem amount to.

    Args:
        problem: The problem, in the units of its noise.
        theta: Parameter values near its solution, shape (P,); linearized there.
        components: The noise of every quantity.
    """
    parameters, layout = problem.parameters, problem.layout
    robot = parameters.free & ~parameters.nuisance
    fun, jac = problem.linearize_rows(theta)
    # Priors are the last rows.
    count, measured = len(fun) - len(problem.further.priors), len(layout.row)
    A = jac[:count] * parameters.scales
    system = projected(np.column_stack([A[:, robot], fun[:count]]), A, parameters)
    U, s, Vt = np.linalg.svd(system[:, :-1], full_matrices=False)
    shown = s > VISIBLE * s.max(initial=0.0)
    U, rows = U[:, shown], s[shown, None] * Vt[shown]
    values = rows @ (theta / parameters.scales)[robot] - U.T @ system[:, -1]
    unit = np.eye(len(parameters))
    nuisances, basis = unit[:, parameters.free & parameters.nuisance], unit[:, robot]
    seen = basis @ Vt[shown].T
    effects = systematic(problem, theta, Directions(nuisances, seen, seen[:, :0]))
    noise = variances(problem, effects)
    shared = shared_variances(problem, components, noise)
    of_row = np.ones(len(U))
    of_row[:measured] = (noise - shared)[layout.component]
    Q = (U.T * of_row) @ U + by_configuration(problem, U, shared)
    if effects is not None:
        X = U[:measured].T @ effects.rows(problem, theta)
        Q += X @ X.T
    half = np.linalg.cholesky(Q)
    whitened = (np.linalg.solve(half, part) for part in (rows, values, U[:measured].T))
    return RobotRows(robot, *whitened)
