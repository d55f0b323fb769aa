"""The noise of each quantity, and what gears and compliance leave in the residuals.

Standard deviations, stated or assumed, give the ratio of the measurements of one
quantity among each other. Of every quantity the standard deviation of
unit weight is estimated, so that position and orientation, pixels and millimeters are
balanced by the data (Helmert, Foerstner). Known distances,
priors and expected sizes keep the standard deviations that they have.

Where configurations are repeated, the scatter of the repetitions is the pure error;
residuals between configurations beyond it are lack of fit. With squares and degrees of
freedom of the residuals (S, f) and of the repetitions among themselves (S_p, f_p),
noise alone makes

    F = (S - S_p) / (f - f_p) / (S_p / f_p)

a value of Fisher's F; far larger values are lack of fit (Draper and Smith, Applied
Regression Analysis). What the model lacks is the same in all repetitions, a random
effect of the configuration with the variance u of `E[S] = s f + u tr(Z^T R Z)`, where s
is the pure variance, R projects on the residuals and Z sums over repetitions.

Real residuals are not noise: an eccentric gear or a joint that gives under load moves
the tool in the same way whenever the joint stands there again, and a fit bends its
parameters to absorb what it can. Such errors are random effects: amplitudes

    dq_j = sum_k a_jk sin(k q_j) + b_jk cos(k q_j) + c_j tau_j(q),

k = 1, 2, of every joint that turns, all a and b of one unknown size gamma [rad], all
c_j of one size kappa in their expected sizes. They are not estimated but their sizes
are, beside the noise of every quantity, by restricted maximum likelihood; either is
kept where the likelihood ratio says that there is something.

All variances are those of a Gaussian model by restricted maximum likelihood. Values
come in independent blocks,

    y = -X b + Z u,   u_j ~ N(0, s_k) of component k,

with unknown b (which all blocks share), factors Z of the errors, and variances s_k that
are wanted. With V their covariance, P = V^-1 - V^-1 X (X^T V^-1 X)^-1 X^T V^-1 and
V_k = Z_k Z_k^T, what no b explains has

    2 dL / d log s_k = s_k (y^T P V_k P y - tr(P V_k)),

the sum of the squares of u_k by their variance less their redundancy: the equations of
Helmert and Foerstner (Teunissen and Amiri-Simkooei 2008), and of MacKay's evidence
(Bayesian interpolation, 1992), which are the rounds `s_k <- s_k squares / redundancy`.
The information that steps of Newton's method need is the average of the observed and
the expected one, `s_k s_l y^T P V_k P V_l P y / 2` (Gilmour, Thompson and Cullis 1995).

What is known beforehand of a variance, by an inverse chi-square distribution, is like
so many further errors u_k with a sum of squares. Random effects X g are unknowns with
the errors `0 = g - u`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.identifiability import Directions, half_covariance
from calib_pin.estimation.problem import (
    EXACT,
    Problem,
    completed,
    current_units,
    known_values,
    measured_count,
    repeated,
    representative,
    with_response,
)
from calib_pin.estimation.row_blocks import feet
from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    chi_square_tail,
    f_tail,
)
from calib_pin.estimation.terms import Term, assembled, zeroed
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.observations.labels import numbered
from calib_pin.parameterizations import (
    NOTHING,
    PARAMETERIZATIONS,
    parameterization,
    required_keys,
)
from calib_pin.parameterizations.base import owner
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.placement import JointOffset, Placement
from calib_pin.setup import Setup

if TYPE_CHECKING:
    from calib_pin.solvers import LeastSquaresResult

REJECTED = 0.05
"""Probability at which a stated standard deviation is rejected by mistake, of those of
all stations any; part of the errors that are told apart which chance may have made."""

SCARCE, TOO_LARGE = 10.0, 1e-3
"""Redundancy below which one is rejected as too large with less probability: so few
values scatter by a fifth of it by chance, and a calibration would promise as little."""

FEW = 2.0
"""Redundancy below which a variance may be anything, and a quantity keeps its given
ratio to the others."""

LEAST = 1e-3
"""Least part of the largest unit weight: an exact quantity leaves the others a say."""

STATED = 2.0
"""Errors that a size which is stated beforehand is worth against those that show one.

With as few the evidence of a handful of well determined errors prevails."""

REPEATED = 4
"""Degrees of freedom from which repetitions tell the pure error, to a factor of two."""

CHANCE = 0.01
"""Probability at which chance passes for an effect."""

SPARE = 10
"""Values of distinct configurations that must be left over beside what was fitted."""

MOST = 1.5
"""Largest squares that effects may leave in residuals, in those that are found there.

Gears and compliance are only a part of what disturbs a real robot, and likelihood makes
them as large as the rest of it needs. Without a limit, errors on held-out measurements
are predicted three to five times too large on a UR10 and a UR5; with it within 10 %.
"""

ROWS = 2000
"""Measurements that sizes are estimated from; more tell no more of a few dozen
amplitudes."""


# Rows by quantity.


@dataclass(frozen=True)
class Groups:
    """Rows by quantity, in the standard deviations that are given.

    Attributes:
        counts: Measured values of each quantity, shape (K,).
        products: `[A r]^T [A r]` of their columns and residuals, (K, p + 1, p + 1).
        known: The same of rows whose variance is known to be one, shape (p + 1, p + 1).
        current: Variances of the quantities in the units of the problem, shape (K,).
        kind_of: Kind of each random effect: the last columns before the residual are
            those of all S effects in their expected sizes.
    """

    counts: Floats
    products: Floats
    known: Floats
    current: Floats
    kind_of: Sequence[str] = ()

    @cached_property
    def rows(self) -> Floats:
        """Rows with the same products, those known last, (K + 1, p + 1, p + 1)."""
        values, vectors = np.linalg.eigh(np.concatenate([self.products, [self.known]]))
        sizes = np.sqrt(np.maximum(values, 0.0))
        return np.asarray(sizes[:, :, None] * vectors.transpose(0, 2, 1))

    def components(self, kinds: Sequence[str] = ()) -> Components:
        """The quantities as variance components, and behind them kinds of effects.

        Args:
            kinds: Kinds that have a variance; the others are left out.
        """
        count, width = len(self.counts), self.rows.shape[1]
        kind = np.array([kinds.index(k) if k in kinds else KNOWN for k in self.kind_of])
        columns, acting = np.full(width, True), kind != KNOWN
        columns[width - 1 - len(kind) : -1] = acting
        effects = np.eye(width)[width - 1 - len(kind) : -1][acting]
        of_rows = np.repeat([*range(count), KNOWN], width)
        labels = np.append(of_rows, count + kind[acting]).astype(int)
        rows = np.vstack([*self.rows, effects])[:, columns]
        none = np.zeros(len(kinds))
        counts = np.append(self.counts - width, none)
        return Components([ErrorBlock(rows, labels)], counts, np.zeros(len(counts)))

    def estimated(self, kinds: Sequence[str] = ()) -> Variances:
        """Variances of the quantities, and behind them of some kinds of effects."""
        start = np.append(self.current, np.ones(len(kinds)))
        return estimate_variances(self.components(kinds), start)

    def selected(
        self, kinds: Iterable[str], chance: float, always: Sequence[str] = ()
    ) -> tuple[dict[str, float], Variances]:
        """The kinds of effects that raise the likelihood enough, the best one first.

        Args:
            kinds: Kinds to choose from; those without an effect are left out.
            chance: Probability at which chance raises it as much as each must: twice
                its logarithm by chi-square of one variance, or half of the time by
                nothing (Self and Liang 1987).
            always: Kinds that act whether they do or not.

        Returns:
            The variances of those that are chosen, and the model with them.
        """
        remaining = [kind for kind in kinds if kind in self.kind_of]
        gain = 0.5 * chi_square_quantile(1.0, 2.0 * chance)
        chosen, best = [*always], self.estimated(always)
        while remaining:
            models = {kind: self.estimated([*chosen, kind]) for kind in remaining}
            kind = max(models, key=lambda key: models[key].likelihood)
            if models[kind].likelihood - best.likelihood < gain:
                break
            chosen.append(kind)
            remaining.remove(kind)
            best = models[kind]
        variances = dict(zip(chosen, best.values[len(self.counts) :], strict=True))
        return {k: float(v) for k, v in variances.items() if k not in always}, best


def variance_components(
    problem: Problem, result: LeastSquaresResult, basis: Floats
) -> tuple[VarianceComponent, ...]:
    """Estimate the noise of every quantity from a solution.

    Args:
        problem: The problem with the units of the solution.
        result: The solution, with residual and Jacobian.
        basis: Directions that were moved, of the scaled parameters, shape (P, k).
    """
    half = half_covariance(result.jac, basis, problem.parameters)
    groups = by_quantity(problem, result.x, result.fun, result.jac, half)
    model, factors = _test_variances(problem, groups)
    pure_errors = _pure_errors(problem, result.x, leverages(problem, result.jac, half))
    return tuple(
        _component(problem, k, model, float(factors[k]), float(groups.counts[k]), pure)
        for k, pure in enumerate(pure_errors)
    )


def leverages(problem: Problem, jac: Floats, half: Floats) -> Floats:
    """Leverage of every measured value, of very many their mean, shape (M,).

    Args:
        problem: The problem.
        jac: Whitened Jacobian at the solution, shape (M', P).
        half: Factor of the covariance, see `half_covariance`, shape (P, r).
    """
    count = len(problem.layout.row)
    if problem.many:
        return np.full(count, half.shape[1] / max(measured_count(problem), 1))
    return np.asarray(np.sum((jac[:count] @ half) ** 2, axis=1))


def grouped(problem: Problem, rows: Floats, kind_of: Sequence[str] = ()) -> Groups:
    """Rows by quantity.

    Args:
        problem: The problem in whose units the rows are whitened.
        rows: Columns and residual, shape (M, p + 1); first those of the measured
            values, behind them those of what is known beside.
        kind_of: Kinds of the last columns, see `Groups`.
    """
    current, known = current_units(problem) ** 2, rows[len(problem.layout.row) :]
    parts = (rows[at] for at in problem.layout.of_components)
    products = np.array([part.T @ part for part in parts]) * current[:, None, None]
    return Groups(_counts(problem), products, known.T @ known, current, kind_of)


def by_quantity(
    problem: Problem, theta: Floats, fun: Floats, jac: Floats, half: Floats
) -> Groups:
    """The rows of a problem by quantity, in its orthonormal columns.

    Args:
        problem: The problem.
        theta: Where it was linearized, shape (P,).
        fun: Whitened residual there, shape (M,).
        jac: Whitened Jacobian there, shape (M, P); both of a smaller system of very
            many rows.
        half: Factor of the covariance, see `half_covariance`, shape (P, r).
    """
    if not problem.many:
        return grouped(problem, np.column_stack([jac @ half, fun]))
    size, counts, current = half.shape[1] + 1, _counts(problem), current_units(problem)
    products, stations = np.zeros((len(counts), size, size)), problem.stations(theta)
    half = with_response(stations, half)
    settled = completed(stations, np.zeros(len(half)))
    of_keys = problem.layout.of_keys.items()
    quantities = {key: list(dict.fromkeys(index.tolist())) for key, index in of_keys}
    for place in range(max(map(len, quantities.values()))):
        # One quantity of each block is what is left where the others weigh nothing.
        chosen = [index[place] for index in quantities.values() if place < len(index)]
        active = np.isin(np.arange(len(current)), chosen)
        alone = problem
        if not active.all():
            alone = replace(problem, units=np.where(active, current, np.inf))
        factors = alone.factorize(theta)
        for (term, *_), (r, J) in zip(alone.blocks, factors, strict=True):
            if place >= len(quantities[term.key]):
                continue
            k, K = quantities[term.key][place], np.column_stack([J, r])
            change = np.column_stack([half[term.index], settled[term.index]])
            rows = K @ np.vstack([change, np.eye(1, size, size - 1)])
            products[k] += rows.T @ rows
            station = stations.get(term.frames.station)
            if station is not None:
                # What its station absorbs of measurements is no redundancy.
                local = np.flatnonzero(np.isin(term.index, station.local))
                root = station.root[np.searchsorted(station.local, term.index[local])]
                counts[k] -= float(np.sum((J[:, local] @ root) ** 2))
    products *= current[:, None, None] ** 2
    further = problem.further
    known = np.column_stack([further.jacobian(theta) @ half, further.residual(theta)])
    return Groups(counts, products, known.T @ known, current**2)


def _counts(problem: Problem) -> Floats:
    """Measured values of each quantity, those with less weight counted less, (K,)."""
    layout, weight = problem.layout, problem.data.weight[problem.layout.row]
    counts = np.bincount(layout.component, weight, len(layout.components))
    return np.asarray(counts, float)


# What is stated, tested.


def _stated(problem: Problem) -> NDArray[np.bool_]:
    """Whether the measurements or the setup state the noise of a quantity, (K,)."""
    noise, components = problem.setup.noise, problem.layout.components
    without = {(b.model, b.station) for b in problem.data.blocks if b.sigma is None}
    by_rows = [(c.model, c.station) not in without for c in components]
    return np.array([c.quantity.name in noise for c in components]) | by_rows


def _test_variances(problem: Problem, groups: Groups) -> tuple[Variances, Floats]:
    """Estimate the variances of all quantities, and choose those to use.

    Of an instrument at very many stations one or another would be rejected by mistake,
    so that it is tested as one.

    Returns:
        Estimates of all quantities relative to what is given, and the factors of the
        standard deviations to use, shape (K,): one where what is stated stands.
    """
    stated = _stated(problem)
    stations = len({component.station for component in problem.layout.components})
    model = groups.estimated()
    few = model.redundancies < FEW
    if few.all():
        return model, np.sqrt(groups.current)
    pairs = zip(model.values, model.dof, strict=True)
    above = np.array([chi_square_tail(v * f, f) if f >= FEW else 0.5 for v, f in pairs])
    tail = 0.5 * REJECTED / stations
    below = np.where(model.dof < SCARCE, TOO_LARGE / stations, tail)
    stands = (above >= tail) & (above <= 1.0 - below)
    # Each is estimated beside what stands, or shares a variance with the largest.
    labels = np.arange(len(few))
    labels[stated & (few | stands)] = KNOWN
    labels[few & ~stated] = labels[np.argmax(model.redundancies)]
    open_ = labels != KNOWN
    leaders, labels[open_] = np.unique(labels[open_], return_inverse=True)
    rest = groups.components().relabeled(labels)
    variances = estimate_variances(rest, model.values[leaders])
    factors = np.ones(len(few))
    factors[open_] = np.sqrt(variances.values[labels[open_]])
    return model, np.maximum(factors, LEAST * factors.max())


def _interval(variance: float, dof: float) -> tuple[float, float]:
    """The 95 % interval of a variance by its estimate."""
    if dof < FEW:
        return 0.0, np.inf
    tails = 0.5 * REJECTED, 1.0 - 0.5 * REJECTED
    low, high = (variance * dof / chi_square_quantile(dof, tail) for tail in tails)
    return low, high


def _component(
    problem: Problem,
    k: int,
    model: Variances,
    factor: float,
    count: float,
    pure: PureError | None,
) -> VarianceComponent:
    """The noise of quantity k, by variances of all relative to what is given.

    The standard deviation is used with the factor; the count is that of its measured
    values.
    """
    component, stated = problem.layout.components[k], bool(_stated(problem)[k])
    given = problem.given_sigma[problem.layout.of_components[k]]
    size = float(np.sqrt(np.mean(given**2))) if len(given) else np.nan
    redundancy, variance = float(model.redundancies[k]), float(model.values[k])
    low, high = _interval(variance, float(model.dof[k]))
    extra: dict[str, float | None] = {}
    if pure is not None:
        squares, between = variance * redundancy, redundancy - pure.dof
        common = max(squares - pure.variance * redundancy, 0.0)
        common = common / pure.trace if pure.trace > 0.0 else 0.0
        lack, above = None, chi_square_tail(pure.variance * pure.dof, pure.dof)
        if between >= 1.0 and pure.variance > 0.0:
            excess = max(squares - pure.variance * pure.dof, 0.0) / between
            lack = f_tail(excess / pure.variance, between, pure.dof)
        if lack is not None and lack < REJECTED:
            # Residuals of one configuration are one value of what the model lacks.
            variance = pure.variance + common
            low, high = _interval(variance, between)
        extra = {"pure": size * pure.variance**0.5, "unmodeled": size * common**0.5}
        extra |= {"lack_of_fit": lack, "pure_test": 2.0 * min(above, 1.0 - above)}
    elif stated:
        extra = {"unmodeled": size * (variance - 1.0) ** 0.5 if low > 1.0 else 0.0}
    known = redundancy > 0.0
    return VarianceComponent(
        quantity=component.name,
        unit=component.quantity.unit,
        given=size,
        stated=stated,
        factor=factor,
        estimate=size * variance**0.5 if known else np.nan,
        interval=(size * low**0.5, size * high**0.5) if known else (np.nan, np.nan),
        redundancy=redundancy / max(count, 1.0),
        values=count,
        contradicted=known and stated and factor != 1.0,
        **extra,
    )


class PureError(NamedTuple):
    """The pure error of a quantity, relative to the variance that is given.

    Attributes:
        variance: Its variance.
        dof: Its degrees of freedom.
        trace: `tr(Z^T R Z)`, what a unit variance of configurations adds to squares.
    """

    variance: float
    dof: float
    trace: float


def _pure_errors(
    problem: Problem, theta: Floats, leverages: Floats
) -> list[PureError | None]:
    """The pure error of every quantity; None where too few values are repeated.

    Contacts are not measured but made, and say nothing by being repeated.

    Args:
        problem: The problem.
        theta: Its solution, shape (P,).
        leverages: Leverage of every measured value, shape (M,).
    """
    layout, label = problem.layout, repetitions(problem)
    result, many = list[PureError | None](), np.bincount(label)[label]
    if many.max(initial=1) == 1:
        return [None] * len(layout.components)
    weight = problem.data.weight[layout.row]
    residual = zeroed(problem.errors(theta) / problem.given_sigma, weight == 0.0)
    place = label[layout.row] * layout.width + layout.column
    for index in layout.of_components:
        r, w = residual[index], weight[index]
        _, group = numbered(place[index])
        total = np.bincount(group, w)
        mean = np.bincount(group, w * r) / np.where(total > 0.0, total, 1.0)
        squares = float(np.sum(w * (r - mean[group]) ** 2))
        dof = float((w > 0.0).sum() - (total > 0.0).sum())
        # The columns of Z are as long as repetitions are many.
        trace = float(weight[index].sum() - many[layout.row[index]] @ leverages[index])
        enough = dof >= REPEATED
        result.append(PureError(squares / dof, dof, trace) if enough else None)
    return result


def repetitions(problem: Problem) -> NDArray[np.intp]:
    """Label of the configuration of each row, its own for one that is alone, (N,)."""
    used = problem.data.weight > 0.0
    for _, data, rows, _ in problem.blocks:
        # Of contacts the joint positions are measured, and from another start it is
        # another distance.
        if not data.values.shape[1] or data.start.size:
            used[rows] = False
    return np.where(used, repeated(problem), np.arange(len(used), 2 * len(used)))


# Gears and compliance.


@dataclass(frozen=True)
class Systematic:
    """Random effects of joints, of their estimated sizes.

    Attributes:
        errors: The chains with the effects as parameters, by name.
        names: Names of the effects, S of them.
        sizes: Standard deviation of each, shape (S,) [its unit].
        noise: Variance of each quantity beside them, relative to that in the units of
            the problem, shape (K,).
    """

    errors: Mapping[str, ErrorModel]
    names: tuple[str, ...]
    sizes: Floats
    noise: Floats

    @property
    def kinds(self) -> list[str]:
        """Parameterization of each effect."""
        return [name.rsplit(".", 2)[1] for name in self.names]

    def rows(self, problem: Problem, theta: Floats) -> Floats:
        """Whitened residuals that each effect of its size adds, shape (M, S).

        Args:
            problem: A problem with the rows.
            theta: Parameter values at which frames and instrument stand, shape (P,).
        """
        rebased = problem.rebased(theta)[0].terms.values()
        terms, given = assembled([replace(t, error=self._model(t)) for t in rebased])
        plain, data = Setup(noise=problem.setup.noise), problem.data
        effects = Problem(problem.chains, terms, given, data, plain, problem.units)
        _, J = effects.linearize_rows(np.zeros(len(given)))
        columns = [given.index(name) for name in self.names]
        return np.asarray(J[:, columns] * self.sizes)

    def twists(self, term: Term, q: Floats) -> Floats:
        """Body twists of the tool of a term by each effect of its size, (N, 6, S).

        Args:
            term: The term about its solution, see `Terms.rebased`.
            q: Positions of its joints, shape (N, n) [rad, m].
        """
        model = self._model(term)
        _, J = model.jacobian(q, np.zeros(len(model.screws)))
        # Several parameters may be one effect: those of a joint and of its followers.
        names = np.array(model.parameters.names)
        return np.asarray(J @ ((names[:, None] == self.names) * self.sizes))

    def _model(self, term: Term) -> ErrorModel:
        """The effects of the chain of a term about its frames."""
        error = self.errors[term.key.chain]
        return error.with_frames(term.error.base, term.error.tool)


def rows_with_effects(
    sample: Problem,
    theta: Floats,
    basis: Floats,
    effects: Floats,
    kind_of: Sequence[str],
) -> Groups | None:
    """The rows of a problem with random effects; None where they are exact.

    Args:
        sample: The problem, see `sampled`.
        theta: Its solution, shape (P,).
        basis: The directions that were moved, shape (P, k).
        effects: Whitened residuals by all effects in their expected sizes, (M, S).
        kind_of: Kind of each.
    """
    fun, jac = sample.linearize_rows(theta)
    measured = fun[: len(effects)]
    if float(measured @ measured) <= EXACT**2 * measured_count(sample):
        return None
    X = np.zeros((len(fun), len(kind_of)))
    X[: len(effects)] = effects
    half = half_covariance(jac, basis, sample.parameters)
    return grouped(sample, np.column_stack([jac @ half, X, fun]), kind_of)


def systematic(
    problem: Problem, theta: Floats, directions: Directions, whole: Sequence[str] = ()
) -> Systematic | None:
    """Estimate the sizes of what gears and compliance leave in the residuals.

    Args:
        problem: The problem in the units of its solution.
        theta: The solution, shape (P,).
        directions: The directions that were moved.
        whole: Further parameterizations, see `candidates`.

    Returns:
        The effects, or None where nothing shows, all of them are estimated, or the
        nominal robot is where nothing can be measured.
    """
    effects = candidates(problem, whole)
    spare = known_values(problem) - directions.count
    if effects is None or spare < SPARE:
        return None
    sample = replace(problem, data=sampled(problem))
    X = effects.rows(sample, theta)
    if not np.isfinite(X).all():
        return None  # The nominal robot is far away, behind the camera, say.
    groups = rows_with_effects(sample, theta, directions.basis, X, effects.kinds)
    if groups is None:
        return None
    chosen, model = groups.selected(PARAMETERIZATIONS, CHANCE)
    if not chosen:
        return None
    noise = model.values[: len(groups.counts)] / groups.current
    variances = np.array([chosen.get(kind, 0.0) for kind in effects.kinds])
    variances *= min(1.0, MOST * _share(groups, noise, variances))
    kept = np.isin(effects.kinds, [*chosen])
    names = tuple(np.array(effects.names)[kept].tolist())
    sizes = (effects.sizes * np.sqrt(variances))[kept]
    return replace(effects, names=names, sizes=sizes, noise=noise)


def _share(groups: Groups, noise: Floats, variances: Floats) -> float:
    """Squares that noise leaves to effects, by those that these should leave.

    Args:
        groups: The rows with all effects.
        noise: Variances of the quantities by those of the fit, shape (K,).
        variances: Variances of the effects, shape (S,).
    """
    fitted = Variances.at(groups.components(), groups.current)
    ((e, U, _),) = fitted.whitened
    sizes = np.sqrt(np.append(groups.current, 1.0))
    X = np.vstack([*(groups.rows / sizes[:, None, None])])[:, -1 - len(variances) : -1]
    predicted = variances @ (np.sum(X**2, axis=0) - np.sum((U.T @ X) ** 2, axis=0))
    excess = float(e @ e - noise @ fitted.redundancies)
    return max(excess, 0.0) / float(predicted)


def variances(problem: Problem, effects: Systematic | None) -> Floats:
    """Variance of each quantity beside effects, in the units of the problem, (K,)."""
    return np.ones(len(problem.layout.components)) if effects is None else effects.noise


def sampled(problem: Problem, count: int = ROWS) -> Observations:
    """Measurements that effects are estimated from; of many stations those of some."""
    data = problem.data
    if problem.station_parameters:
        kept = set(representative(problem))
        data = Observations(tuple(b for b in data.blocks if b.key in kept))
    return data.sample(count)


def unplaced(setup: Setup) -> list[str]:
    """The places of joints, where none of the parameters moves them."""
    families = [PARAMETERIZATIONS[name] for name in setup.parameters]
    placed = any(f.geometric and f.name != JointOffset.name for f in families)
    return [Placement.name] if families and not placed else []


def candidates(problem: Problem, whole: Sequence[str] = ()) -> Systematic | None:
    """All effects that are not estimated already, in their expected sizes.

    Args:
        problem: The problem.
        whole: Further parameterizations, all of whose parameters are tried.
    """
    setup, chains = problem.setup, problem.chains
    kinds = dict.fromkeys(whole, ("",)) | {
        name: member.effects.components
        for name, member in PARAMETERIZATIONS.items()
        if member.effects is not None and name not in setup.parameters
    }

    def suits(kind: str, chain: Chain) -> bool:
        """Whether a chain can have errors of a kind: something may have to load it."""
        try:
            return bool(parameterization(kind, setup).screws(chain))
        except OptionError:
            return False

    if not {"", NOTHING, *setup.payloads}.issuperset(problem.data.payload.distinct):
        # Nothing is known of what was carried.
        kinds = {k: c for k, c in kinds.items() if "payloads" not in required_keys([k])}
    errors: dict[str, ErrorModel] = {}
    sizes: dict[str, float] = {}
    placed: dict[str, Floats] = {}
    for name, chain in ((name, chains[name]) for name in chains.names):
        loaded = [kind for kind in kinds if suits(kind, chain)]
        error = ErrorModel.create(
            chain, loaded, setup=setup, estimate_base=False, estimate_tool=False
        )
        errors[name] = _at_feet(error, placed)
        if len(setup.payloads) > 1:
            carried = problem.only.error.payload or next(iter(setup.payloads))
            errors[name] = errors[name].carrying(carried)
        turns = dict(zip(map(owner, chain.joints), chain.revolute, strict=True))
        for parameter in errors[name].parameters:
            joint, kind, component = parameter.name.rsplit(".", 2)
            # A mimic joint has the errors of its leader, which may be of no chain.
            acts = component in kinds.get(kind, ()) and turns.get(joint)
            if acts or kind in whole:
                sizes[parameter.name] = parameter.scale
    if not sizes:
        return None
    return Systematic(errors, tuple(sizes), np.array([*sizes.values()]), np.ones(0))


def _at_feet(error: ErrorModel, placed: dict[str, Floats]) -> ErrorModel:
    """Errors of placements at the places that the axes tell, see `feet`.

    Args:
        error: The errors of a chain.
        placed: Twists of those that chains before it have too; its own are added.
    """
    places, screws = feet(error.chain), list(error.screws)
    for k, screw in enumerate(screws):
        name = screw.parameter.name
        if name.rsplit(".", 2)[1] == Placement.name:
            twist = placed.setdefault(name, places[screw.frame - 1] @ screw.twist)
            screws[k] = replace(screw, twist=twist)
    return replace(error, screws=tuple(screws))


Labels = NDArray[np.intp]

KNOWN = -1
"""Label of errors whose variance is one."""

ROUNDS = 100
"""Most steps; five to fifteen are usual."""

LONGEST = 2.0
"""Largest change of the logarithm of a variance in a step."""

DONE = 1e-6
"""Change of the logarithms that ends the iteration: far below their own errors."""

SMALLEST = 1e-8
"""Least variance, as a part of the one it started with: what is zero stays there."""


@dataclass(frozen=True)
class ErrorBlock:
    """Values that share no error with those of other blocks.

    Attributes:
        rows: Columns X and values y, shape (m, q + 1).
        labels: Component of each error, `KNOWN` or 0 to K - 1, shape (n,).
        factors: Values by errors of size one, Z, shape (m, n); None where every value
            has an error of its own.
    """

    rows: Floats
    labels: Labels
    factors: Floats | None = None


@dataclass(frozen=True)
class Components:
    """Blocks whose errors have K unknown variances.

    Attributes:
        blocks: The blocks.
        counts: Number of further errors that are known, shape (K,).
        squares: Sum of their squares, shape (K,).
    """

    blocks: Sequence[ErrorBlock]
    counts: Floats
    squares: Floats

    def relabeled(self, labels: Labels) -> Components:
        """The same where components have variances in common.

        Args:
            labels: New component of each, or `KNOWN`, shape (K,).
        """
        new = np.append(labels, KNOWN)
        blocks = [replace(block, labels=new[block.labels]) for block in self.blocks]
        member = labels[:, None] == np.arange(labels.max() + 1)
        return Components(blocks, self.counts @ member, self.squares @ member)


@dataclass(frozen=True)
class Variances:
    """A Gaussian model at some variances, and what it says of them.

    Attributes:
        values: The variances, shape (K,).
        squares: Sums of the squared errors by their variance, shape (K,).
        redundancies: Redundancy of each component, shape (K,).
        information: Average information of the logarithms of variances, shape (K, K).
        likelihood: Logarithm of the restricted likelihood, up to a constant.
        unknowns: Estimates of b, shape (q,).
        half: H of their covariance H H^T, shape (q, q).
        whitened: `V^-1/2 (y + X b)`, shape (m,), `V^-1/2 X H`, (m, q), and `V^-1/2 Z`
            with errors of their size, (m, n), of every block; the last None where every
            value has an error of its own.
    """

    values: Floats
    squares: Floats
    redundancies: Floats
    information: Floats
    likelihood: float
    unknowns: Floats
    half: Floats
    whitened: Sequence[tuple[Floats, Floats, Floats | None]]

    @staticmethod
    def at(components: Components, values: Floats) -> Variances:
        """The model at variances, shape (K,)."""
        sizes, blocks = np.sqrt(np.append(values, 1.0)), components.blocks
        white = [_whitened(block, sizes[block.labels]) for block in blocks]
        R = _triangle(np.vstack([rows for rows, _, _ in white]))
        q = R.shape[1] - 1
        half = np.asarray(np.linalg.inv(R[:q, :q]), float)
        unknowns = -half @ R[:q, q]
        squares, redundancies = components.squares / values, components.counts.copy()
        information, shared = np.diag(squares), np.zeros((q, len(values)))
        missed = float(squares.sum())
        whitened = []
        for (rows, F, _), block in zip(white, blocks, strict=True):
            e, U = rows @ np.append(unknowns, 1.0), rows[:, :q] @ half
            whitened.append((e, U, F))
            member = (block.labels[:, None] == np.arange(len(values))).astype(float)
            if F is None:
                u, dof, Q = e, 1.0 - np.sum(U**2, axis=1), e[:, None] * member
            else:
                u, dof = F.T @ e, np.sum(F**2, axis=0) - np.sum((U.T @ F) ** 2, axis=0)
                Q = (F * u) @ member
            squares = squares + u**2 @ member
            redundancies += dof @ member
            information += Q.T @ Q
            shared += U.T @ Q
            missed += float(e @ e)
        size = components.counts @ np.log(values) - 2.0 * _logarithm(half)
        size += 2.0 * sum(logarithm for _, _, logarithm in white)
        return Variances(
            values=values,
            squares=squares,
            redundancies=np.maximum(redundancies, 0.0),
            information=0.5 * (information - shared.T @ shared),
            likelihood=-0.5 * float(size + missed),
            unknowns=unknowns,
            half=half,
            whitened=whitened,
        )

    @property
    def covariance(self) -> Floats:
        """Of the unknowns, shape (q, q)."""
        return np.asarray(self.half @ self.half.T)

    @cached_property
    def dof(self) -> Floats:
        """Degrees of freedom of chi-square that varies as the estimates do, (K,).

        That is relative to its mean; of a single component, its redundancy.
        """
        # Where two cannot be told apart the information is rounding.
        inverse = np.linalg.pinv(self.information, rcond=1e-10, hermitian=True)
        least = 2.0 / np.maximum(self.redundancies, 1e-300)
        return np.asarray(2.0 / np.maximum(np.diag(inverse), least))

    def steps(self, lower: Floats, upper: Floats) -> Iterator[Floats]:
        """Steps of the logarithms of variances to try, the boldest first, (K,) each."""
        score = 0.5 * (self.squares - self.redundancies)
        # What has reached a bound and would go on is done.
        end = np.where(score < 0.0, self.values <= lower, self.values >= upper)
        size = np.sqrt(np.maximum(np.diag(self.information), 1e-200))
        N = self.information / np.outer(size, size)
        N[end], N[:, end] = 0.0, 0.0
        step = np.linalg.pinv(N, rcond=1e-10, hermitian=True) @ (score / size) / size
        yield np.clip(step, -LONGEST, LONGEST)
        # Rounds of the expectation always lead uphill, if slowly.
        small = np.finfo(float).tiny
        ratio = np.log((self.squares + small) / (self.redundancies + small))
        step = np.where(end, 0.0, np.clip(ratio, -LONGEST, LONGEST))
        for shorter in 0.3 ** np.arange(8):
            yield shorter * step


def estimate_variances(
    components: Components,
    start: Floats,
    lower: float | Floats | None = None,
    upper: float | Floats = np.inf,
) -> Variances:
    """Maximize the restricted likelihood.

    Args:
        components: The model; its columns have full rank together.
        start: First guesses, positive, shape (K,).
        lower: Least variances, shape (K,); default `SMALLEST` of those guesses.
        upper: Largest ones, shape (K,).
    """
    if lower is None:
        lower = np.maximum(SMALLEST * start, EXACT**2)
    lower, upper = (np.broadcast_to(bound, start.shape) for bound in (lower, upper))
    best = Variances.at(components, start)
    for _ in range(ROUNDS):
        for step in best.steps(lower, upper):
            if np.abs(step).max(initial=0.0) < DONE:
                return best
            values = np.clip(best.values * np.exp(step), lower, upper)
            candidate = Variances.at(components, values)
            if candidate.likelihood >= best.likelihood - DONE:
                break
        else:
            break
        best = candidate
    return best


def _whitened(block: ErrorBlock, sizes: Floats) -> tuple[Floats, Floats | None, float]:
    """Rows and factors by the root of their covariance, with its log-determinant.

    Args:
        block: The block.
        sizes: Standard deviation of each error, shape (n,).
    """
    if block.factors is None:
        return block.rows / sizes[:, None], None, float(np.log(sizes).sum())
    F = block.factors * sizes
    root = _triangle(F.T)
    both = np.linalg.solve(root.T, np.hstack([block.rows, F]))
    rows, F = np.split(both, [block.rows.shape[1]], axis=1)
    return rows, F, _logarithm(root)


def _triangle(A: Floats) -> Floats:
    """Triangular factor R of A = Q R."""
    return np.asarray(np.linalg.qr(A, mode="r"))


def _logarithm(triangle: Floats) -> float:
    """Logarithm of the size of a determinant, by the diagonal."""
    return float(np.log(np.abs(np.diag(triangle))).sum())
