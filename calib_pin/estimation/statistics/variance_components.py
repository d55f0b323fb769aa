"""The noise of each quantity, as the residuals of a fit show it.

Standard deviations, stated or assumed, give the ratio of the measurements of one
quantity among each other. Of every quantity the standard deviation of
unit weight is estimated, so that position and orientation, pixels and millimeters are
balanced by the data (Helmert, Foerstner; see `restricted_likelihood`). Known distances,
priors and expected sizes keep the standard deviations that they have.

Where configurations are repeated, the scatter of the repetitions is the pure error;
residuals between configurations beyond it are lack of fit (see `pure_error`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import half_covariance
from calib_pin.estimation.elimination import with_response
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    chi_square_tail,
)
from calib_pin.estimation.statistics.pure_error import PureError, pure_errors
from calib_pin.estimation.statistics.restricted_likelihood import (
    Groups,
    Variances,
    estimate_variances,
)
from calib_pin.estimation.system import Part
from calib_pin.estimation.variants import in_units
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
    found, used = _tested(problem, groups)
    stated = _stated(problem)
    repeated = pure_errors(problem, result.x, _leverages(problem, result, half))
    return tuple(
        _component(
            problem, k, found, float(used[k]), bool(stated[k]), groups.counts, pure
        )
        for k, pure in enumerate(repeated)
    )


def unit_weights(problem: Problem, result: LeastSquaresResult, basis: Floats) -> Floats:
    """Standard deviations of unit weight, see `Problem.units`, shape (K,).

    Arguments as for `variance_components`.
    """
    half = half_covariance(result.jac, basis, problem.parameters)
    groups = by_quantity(problem, result.x, result.fun, result.jac, half)
    return _tested(problem, groups)[1]


def grouped(problem: Problem, rows: Floats) -> Groups:
    """Rows by quantity, in the standard deviations that are given.

    Args:
        problem: The problem in whose units the rows are whitened.
        rows: Columns and residual, shape (M, p + 1); first those of the measured
            values, behind them those of what is known beside.
    """
    layout = problem.layout
    measured, known = np.split(rows, [len(layout.row)])
    products = np.zeros((len(layout.components), rows.shape[1], rows.shape[1]))
    for k in range(len(products)):
        part = measured if len(products) == 1 else measured[layout.component == k]
        products[k] = part.T @ part
    products *= current_units(problem)[:, None, None] ** 2
    return Groups(_counts(problem), products, known.T @ known)


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
    for k, part, K in _by_quantity(problem, theta):
        change = np.column_stack([half[part.index], settled[part.index]])
        columns = np.vstack([change, np.eye(1, size, size - 1)])
        products[k] += columns.T @ K @ columns
        # What its station absorbs of measurements is no redundancy.
        for station in {
            id(s): s for p in part.index if (s := deviation.get(int(p)))
        }.values():
            mine = np.flatnonzero(np.isin(part.index, station.own))
            root = station.root[np.searchsorted(station.own, part.index[mine])]
            counts[k] -= float(np.sum(root * (K[np.ix_(mine, mine)] @ root)))
    products *= current_units(problem)[:, None, None] ** 2
    further = problem.further
    known = np.column_stack([further.jacobian(theta) @ half, further.residual(theta)])
    return Groups(counts, products, known.T @ known)


def _by_quantity(problem: Problem, theta: Floats) -> Iterator[tuple[int, Part, Floats]]:
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
            alone = in_units(problem, np.where(kept, current, np.inf))
        products = alone.products(theta)
        for block, K in zip(alone.blocks, products, strict=True):
            found = firsts[block.part.key]
            if place < len(found):
                yield found[place], block.part, K


def _leverages(problem: Problem, result: LeastSquaresResult, half: Floats) -> Floats:
    """Leverage of every measured value, of very many their mean, shape (M,)."""
    count = len(problem.layout.row)
    if problem.many:
        return np.full(count, half.shape[1] / max(problem.values, 1))
    return np.asarray(np.sum((result.jac[:count] @ half) ** 2, axis=1))


def _counts(problem: Problem) -> Floats:
    """Measured values of each quantity, those with less weight counted less, (K,)."""
    layout = problem.layout
    weight = problem.data.weight[layout.row]
    return np.asarray(
        np.bincount(layout.component, weight, len(layout.components)), float
    )


def current_units(problem: Problem) -> Floats:
    """Standard deviation of unit weight of every quantity, shape (K,)."""
    if len(problem.units):
        return problem.units
    return np.ones(len(problem.layout.components))


def _stated(problem: Problem) -> NDArray[np.bool_]:
    """Whether the measurements or the setup state the noise of a quantity, (K,)."""
    without = {
        (block.model, block.station)
        for block in problem.data.blocks
        if block.sigma is None
    }
    return np.array(
        [
            c.quantity.name in problem.setup.noise
            or (c.model, c.station) not in without
            for c in problem.layout.components
        ]
    )


def _tested(problem: Problem, groups: Groups) -> tuple[Variances, Floats]:
    """Estimate the variances of all quantities, and choose those to use.

    Of an instrument at very many stations one or another would be rejected by mistake,
    so that it is tested as one.

    Returns:
        Estimates of all quantities relative to what is given, and the factors of the
        standard deviations to use, shape (K,): one where what is stated stands.
    """
    stated, start = _stated(problem), current_units(problem) ** 2
    stations = len({component.station for component in problem.layout.components})
    found = estimate_variances(groups, start)
    # Where two quantities cannot be told apart the information is rounding.
    found = replace(found, dof=np.minimum(found.dof, groups.counts))
    few = found.redundancies < FEW
    if few.all():
        return found, np.sqrt(start)
    tail = 0.5 * REJECTED / stations
    above = [
        chi_square_tail(v * f, f) if f >= LEAST_DOF else 0.5
        for v, f in zip(found.values, found.dof, strict=True)
    ]
    stands = np.abs(np.array(above) - 0.5) <= 0.5 - tail
    held = stated & (few | stands)
    values, kept = found.values, few & ~stated
    if kept.any() or (held.any() and not held.all()):
        # Each is estimated beside what stands, or shares a variance with the largest.
        leader = np.where(kept, np.argmax(found.redundancies), np.arange(len(few)))
        leaders, position = np.unique(leader[~held[leader]], return_inverse=True)
        rest = groups.given(held[leader])
        joined = np.eye(len(leaders))[position].T
        values = np.ones(len(few))
        values[~held[leader]] = estimate_variances(
            Groups(
                joined @ rest.counts,
                np.tensordot(joined, rest.products, axes=1),
                rest.known,
            ),
            found.values[leaders],
        ).values[position]
    factors = np.where(held, 1.0, np.sqrt(values))
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
    stated: bool,
    counts: Floats,
    pure: PureError | None,
) -> VarianceComponent:
    """The noise of quantity k, by variances of all relative to what is given.

    The standard deviation is used with the factor; the counts are the measured values
    of each quantity, shape (K,).
    """
    component = problem.layout.components[k]
    given = problem.given_sigma[problem.layout.of_components[k]]
    size = float(np.sqrt(np.mean(given**2))) if len(given) else np.nan
    redundancy = float(found.redundancies[k])
    variance, dof = float(found.values[k]), float(found.dof[k])
    squares, lack, unmodeled = variance * redundancy, None, None
    low, high = variance_interval(variance, dof)
    if pure is not None:
        lack = pure.lack_of_fit(squares, redundancy)
        unmodeled = pure.unmodeled(squares, redundancy)
        if lack is not None and lack < REJECTED:
            # Residuals of one configuration are one value of what the model lacks.
            variance = pure.variance + unmodeled
            low, high = variance_interval(variance, redundancy - pure.dof)
    elif stated:
        unmodeled = variance - 1.0 if low > 1.0 else 0.0
    known = redundancy > 0.0
    return VarianceComponent(
        quantity=component.name,
        unit=component.quantity.unit,
        given=size,
        stated=stated,
        factor=factor,
        estimate=size * variance**0.5 if known else np.nan,
        interval=(size * low**0.5, size * high**0.5) if known else (np.nan, np.nan),
        redundancy=redundancy / max(float(counts[k]), 1.0),
        values=float(counts[k]),
        contradicted=known and stated and factor != 1.0,
        pure=None if pure is None else size * pure.variance**0.5,
        unmodeled=None if unmodeled is None else size * unmodeled**0.5,
        lack_of_fit=lack,
        pure_test=None if pure is None else pure.test,
    )
