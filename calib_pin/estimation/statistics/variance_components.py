"""The noise of each quantity, as the residuals of a fit show it.

Standard deviations, stated or assumed, give the ratio of the measurements of one
quantity among each other. Of every quantity the standard deviation of
unit weight is estimated, so that position and orientation, pixels and millimeters are
balanced by the data (Helmert, Foerstner; see `restricted_likelihood`). Known distances,
priors and expected sizes keep the standard deviations that they have.

Where configurations are repeated, the scatter of the repetitions is the pure error;
residuals between configurations beyond it are lack of fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import half_covariance
from calib_pin.estimation.evaluators import with_response
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.problem import (
    Problem,
    current_units,
    measured_count,
    repeated,
)
from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    chi_square_tail,
    f_tail,
)
from calib_pin.estimation.statistics.restricted_likelihood import (
    KNOWN,
    Block,
    Components,
    Variances,
    estimate_variances,
)
from calib_pin.estimation.terms import Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import LeastSquaresResult

REJECTED = 0.05
"""Probability at which a stated standard deviation is rejected by mistake, of those of
all stations any."""

LEAST_DOF = 0.5
"""Degrees of freedom below which an estimated variance tells nothing."""

FEW = 2.0
"""Redundancy below which a quantity keeps its given ratio to the others: a variance
estimated from one value may be anything."""

LEAST = 1e-3
"""Least part of the largest unit weight: an exact quantity leaves the others a say."""

REPEATED = 4
"""Degrees of freedom from which repetitions tell the pure error, to a factor of two."""


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
        return Components([Block(rows, labels)], counts, np.zeros(len(counts)))

    def estimated(self, kinds: Sequence[str] = ()) -> Variances:
        """Variances of the quantities, and behind them of some kinds of effects."""
        start = np.append(self.current, np.ones(len(kinds)))
        return estimate_variances(self.components(kinds), start)

    def selected(
        self, kinds: Iterable[str], gain: float, always: Sequence[str] = ()
    ) -> tuple[dict[str, float], Variances]:
        """The kinds of effects that raise the likelihood enough, the best one first.

        Args:
            kinds: Kinds to choose from; those without an effect are left out.
            gain: Twice the logarithm of the likelihood that each must bring.
            always: Kinds that act whether they do or not.

        Returns:
            The variances of those that are chosen, and the model with them.
        """
        left = [kind for kind in kinds if kind in self.kind_of]
        chosen, best = [*always], self.estimated(always)
        while left:
            tried = {kind: self.estimated([*chosen, kind]) for kind in left}
            kind = max(tried, key=lambda key: tried[key].likelihood)
            if tried[kind].likelihood - best.likelihood < 0.5 * gain:
                break
            chosen.append(kind)
            left.remove(kind)
            best = tried[kind]
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
    found, factors = _tested(problem, groups)
    count = len(problem.layout.row)
    # Of very many values the mean leverage.
    leverages = np.full(count, half.shape[1] / max(measured_count(problem), 1))
    if not problem.many:
        leverages = np.sum((result.jac[:count] @ half) ** 2, axis=1)
    return tuple(
        _component(problem, k, found, float(factors[k]), float(groups.counts[k]), pure)
        for k, pure in enumerate(pure_errors(problem, result.x, leverages))
    )


def grouped(problem: Problem, rows: Floats, kind_of: Sequence[str] = ()) -> Groups:
    """Rows by quantity.

    Args:
        problem: The problem in whose units the rows are whitened.
        rows: Columns and residual, shape (M, p + 1); first those of the measured
            values, behind them those of what is known beside.
        kind_of: Kinds of the last columns, see `Groups`.
    """
    current, known = current_units(problem) ** 2, rows[len(problem.layout.row) :]
    own = (rows[at] for at in problem.layout.of_components)
    products = np.array([part.T @ part for part in own]) * current[:, None, None]
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
    size, counts = half.shape[1] + 1, _counts(problem)
    products = np.zeros((len(counts), size, size))
    stations = problem.stations(theta)
    half = with_response(stations, half)
    settled, deviation = with_response(stations, np.zeros((len(half), 1))), {}
    for station in stations:
        settled[station.own, 0] = station.settled
        deviation.update(dict.fromkeys(station.own.tolist(), station))
    for k, term, K in _by_quantity(problem, theta):
        change = np.column_stack([half[term.index], settled[term.index]])
        columns = np.vstack([change, np.eye(1, size, size - 1)])
        products[k] += columns.T @ K @ columns
        # What its station absorbs of measurements is no redundancy.
        met = (deviation.get(position) for position in term.index.tolist())
        for station in {id(s): s for s in met if s}.values():
            mine = np.flatnonzero(np.isin(term.index, station.own))
            root = station.root[np.searchsorted(station.own, term.index[mine])]
            counts[k] -= float(np.sum(root * (K[np.ix_(mine, mine)] @ root)))
    current, further = current_units(problem) ** 2, problem.further
    products *= current[:, None, None]
    known = np.column_stack([further.jacobian(theta) @ half, further.residual(theta)])
    return Groups(counts, products, known.T @ known, current)


def _by_quantity(problem: Problem, theta: Floats) -> Iterator[tuple[int, Term, Floats]]:
    """Products of columns of each quantity of each block, by its own parameters."""
    current, of_keys = current_units(problem), problem.layout.of_keys
    firsts = {
        key: list(dict.fromkeys(found.tolist())) for key, found in of_keys.items()
    }
    most = max(map(len, firsts.values()))
    for place in range(most):
        # The quantities are what is left where the others weigh nothing.
        chosen = {found[place] for found in firsts.values() if place < len(found)}
        alone = problem
        if most > 1:
            kept = np.isin(np.arange(len(current)), list(chosen))
            alone = replace(problem, units=np.where(kept, current, np.inf))
        factors = alone.factorize(theta)
        for block, (r, J) in zip(alone.blocks, factors, strict=True):
            found = firsts[block.term.key]
            if place < len(found):
                A = np.column_stack([J, r])
                yield found[place], block.term, A.T @ A


def _counts(problem: Problem) -> Floats:
    """Measured values of each quantity, those with less weight counted less, (K,)."""
    layout, weight = problem.layout, problem.data.weight[problem.layout.row]
    counts = np.bincount(layout.component, weight, len(layout.components))
    return np.asarray(counts, float)


def _stated(problem: Problem) -> NDArray[np.bool_]:
    """Whether the measurements or the setup state the noise of a quantity, (K,)."""
    noise, components = problem.setup.noise, problem.layout.components
    without = {(b.model, b.station) for b in problem.data.blocks if b.sigma is None}
    by_rows = [(c.model, c.station) not in without for c in components]
    return np.array([c.quantity.name in noise for c in components]) | by_rows


def _tested(problem: Problem, groups: Groups) -> tuple[Variances, Floats]:
    """Estimate the variances of all quantities, and choose those to use.

    Of an instrument at very many stations one or another would be rejected by mistake,
    so that it is tested as one.

    Returns:
        Estimates of all quantities relative to what is given, and the factors of the
        standard deviations to use, shape (K,): one where what is stated stands.
    """
    stated = _stated(problem)
    stations = len({component.station for component in problem.layout.components})
    found = groups.estimated()
    few = found.redundancies < FEW
    if few.all():
        return found, np.sqrt(groups.current)
    tail = 0.5 * REJECTED / stations
    above = [
        chi_square_tail(v * f, f) if f >= LEAST_DOF else 0.5
        for v, f in zip(found.values, found.dof, strict=True)
    ]
    stands = np.abs(np.array(above) - 0.5) <= 0.5 - tail
    # Each is estimated beside what stands, or shares a variance with the largest.
    labels = np.arange(len(few))
    labels[stated & (few | stands)] = KNOWN
    labels[few & ~stated] = labels[np.argmax(found.redundancies)]
    open_ = labels != KNOWN
    leaders, labels[open_] = np.unique(labels[open_], return_inverse=True)
    rest = groups.components().relabeled(labels)
    variances = estimate_variances(rest, found.values[leaders])
    factors = np.ones(len(few))
    factors[open_] = np.sqrt(variances.values[labels[open_]])
    return found, np.maximum(factors, LEAST * factors.max())


def variance_interval(variance: float, dof: float) -> tuple[float, float]:
    """The 95 % interval of a variance by its estimate."""
    if dof < LEAST_DOF:
        return 0.0, np.inf
    tails = 0.5 * REJECTED, 1.0 - 0.5 * REJECTED
    low, high = (variance * dof / chi_square_quantile(dof, tail) for tail in tails)
    return low, high


def _component(
    problem: Problem,
    k: int,
    found: Variances,
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
    redundancy, variance = float(found.redundancies[k]), float(found.values[k])
    known = redundancy > 0.0
    squares, lack, unmodeled = variance * redundancy, None, None
    low, high = variance_interval(variance, float(found.dof[k]))
    if pure is not None:
        lack, unmodeled = pure.lack_of_fit(squares, redundancy)
        if lack is not None and lack < REJECTED:
            # Residuals of one configuration are one value of what the model lacks.
            variance = pure.variance + unmodeled
            low, high = variance_interval(variance, redundancy - pure.dof)
    elif stated:
        unmodeled = variance - 1.0 if low > 1.0 else 0.0
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
        pure=None if pure is None else size * pure.variance**0.5,
        unmodeled=None if unmodeled is None else size * unmodeled**0.5,
        lack_of_fit=lack,
        pure_test=None if pure is None else pure.test,
    )


@dataclass(frozen=True)
class PureError:
    """The pure error of a quantity, relative to the variance that is given.

    Repetitions tell noise from what the model lacks. With squares and degrees of
    freedom of the residuals (S, f) and of the repetitions among themselves (S_p, f_p),
    noise alone makes

        F = (S - S_p) / (f - f_p) / (S_p / f_p)

    a value of Fisher's F; far larger values are lack of fit (Draper and Smith, Applied
    Regression Analysis). What the model lacks is the same in all repetitions, a random
    effect of the configuration with the variance u of `E[S] = s f + u tr(Z^T R Z)`,
    where s is the pure variance, R projects on the residuals and Z sums over
    repetitions.

    Attributes:
        variance: Its variance.
        dof: Its degrees of freedom.
        trace: `tr(Z^T R Z)`, what a unit variance of configurations adds to squares.
    """

    variance: float
    dof: float
    trace: float

    @property
    def test(self) -> float:
        """Probability of a value so far from the given one by chance, two-sided."""
        above = chi_square_tail(self.variance * self.dof, self.dof)
        return 2.0 * min(above, 1.0 - above)

    def lack_of_fit(
        self, squares: float, redundancy: float
    ) -> tuple[float | None, float]:
        """The excess over noise between configurations.

        Args:
            squares: Sum of squares of all residuals.
            redundancy: Their degrees of freedom.

        Returns:
            Probability that noise leaves more, None where nothing is left over; and the
            variance of what configurations have in common.
        """
        between, noise = redundancy - self.dof, self.variance
        common = max(squares - noise * redundancy, 0.0)
        common = common / self.trace if self.trace > 0.0 else 0.0
        if between < 1.0 or noise <= 0.0:
            return None, common
        excess = max(squares - noise * self.dof, 0.0)
        return f_tail(excess / between / noise, between, self.dof), common


def pure_errors(
    problem: Problem, theta: Floats, leverages: Floats
) -> tuple[PureError | None, ...]:
    """The pure error of every quantity; None where too few values are repeated.

    Contacts are not measured but made, and say nothing by being repeated.

    Args:
        problem: The problem.
        theta: Its solution, shape (P,).
        leverages: Leverage of every measured value, shape (M,).
    """
    layout, count = problem.layout, len(problem.layout.components)
    used, label = repetitions(problem)
    sizes = np.bincount(label)
    if not (sizes > 1).any():
        return (None,) * count
    weight = problem.data.weight[layout.row]
    residual = problem.errors(theta) / problem.given_sigma
    # Repetitions of a row, and its configuration, of all those that are used.
    many, of_row = np.ones(len(problem.data)), np.full(len(problem.data), -1)
    many[used], of_row[used] = sizes[label], label
    place = of_row[layout.row] * layout.width + layout.column
    found: list[PureError | None] = []
    for k in range(count):
        own = layout.component == k
        rows = own & (of_row[layout.row] >= 0)
        r, w = residual[rows], weight[rows]
        _, group = np.unique(place[rows], return_inverse=True)
        total = np.bincount(group, w)
        mean = np.bincount(group, w * r) / np.where(total > 0.0, total, 1.0)
        squares = float(np.sum(w * (r - mean[group]) ** 2))
        dof = float((w > 0.0).sum() - (total > 0.0).sum())
        # The columns of Z are as long as repetitions are many.
        trace = weight[own].sum() - many[layout.row[own]] @ leverages[own]
        enough = dof >= REPEATED
        found.append(PureError(squares / dof, dof, float(trace)) if enough else None)
    return tuple(found)


def repetitions(problem: Problem) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows that can be repetitions, and the configuration of each, shape (n,) both."""
    labels = repeated(problem)
    used = problem.data.weight > 0.0
    for _, data, own, _ in problem.blocks:
        # Of contacts the joint positions are measured, and from another start it is
        # another distance.
        if not data.values.shape[1] or data.start.size:
            used[own] = False
    rows = np.flatnonzero(used)
    return rows, np.unique(labels[rows], return_inverse=True)[1]
