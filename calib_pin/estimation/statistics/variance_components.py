"""The noise of each quantity, as the residuals of a fit show it.

What rows state of their standard deviations, or what is assumed, gives the ratio of
the rows of one quantity among each other. Of every quantity the standard deviation of
unit weight is estimated, so that position and orientation, pixels and millimeters are
balanced by the data (Helmert, Foerstner; see `restricted_likelihood`). Known distances,
priors and expected sizes keep the standard deviations that they have.

Where configurations are repeated, the scatter of the repetitions is the pure error, and
what a fit leaves between configurations beyond it is lack of fit (see `repetitions`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import half_covariance
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.estimation.statistics.repetitions import PureError, pure_errors
from calib_pin.estimation.statistics.restricted_likelihood import (
    Groups,
    Variances,
    estimate_variances,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.solvers import LeastSquaresResult

REJECTED = 0.05
"""Probability at which a stated standard deviation is rejected by mistake."""

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
    quantities = problem.measurement.quantities
    half = half_covariance(result.jac, basis, problem.parameters)
    groups = by_quantity(problem, result.x, result.fun, result.jac, half)
    stated = np.array([_stated(problem, quantity) for quantity in quantities])
    found, used = _tested(groups, stated, current_units(problem) ** 2)
    repeated = pure_errors(problem, result.x, _leverages(problem, result, half))
    return tuple(
        _component(problem, k, found, float(used[k]), groups.counts, repeated[k])
        for k in range(len(quantities))
    )


def units(components: tuple[VarianceComponent, ...], problem: Problem) -> Floats:
    """Standard deviations of unit weight, see `Problem.units`, shape (d,)."""
    result = np.ones(problem.components)
    pairs = zip(components, problem.measurement.quantities, strict=True)
    for component, quantity in pairs:
        result[quantity.columns] = component.factor
    return result


def grouped(problem: Problem, rows: Floats) -> Groups:
    """Rows by quantity, in the standard deviations that are given.

    Args:
        problem: The problem in whose units the rows are whitened.
        rows: Columns and residual, shape (M, p + 1); first those of the measured
            values, behind them those of what is known beside.
    """
    size, width = problem.components, rows.shape[1]
    count = len(problem.data) * size
    measured, known = rows[:count].reshape(-1, size, width), rows[count:]
    parts = [
        measured[:, quantity.columns].reshape(-1, width)
        for quantity in problem.measurement.quantities
    ]
    products = np.array([part.T @ part for part in parts])
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
        jac: Whitened Jacobian there, shape (M, P); both of a square system of very
            many rows.
        half: Factor of the covariance, see `half_covariance`, shape (P, r).
    """
    if not problem.many:
        return grouped(problem, np.column_stack([jac @ half, fun]))
    # Those of one quantity are what is left where the others weigh nothing.
    quantities, current = problem.measurement.quantities, component_units(problem)
    further = len(problem.further)
    systems = [(fun, jac)]
    if len(quantities) > 1:
        systems = []
        for quantity in quantities:
            alone = np.full(problem.components, np.inf)
            alone[quantity.columns] = current[quantity.columns]
            systems.append(replace(problem, units=alone).linearize(theta))
    rows = [np.column_stack([J @ half, r]) for r, J in systems]
    parts = [part[: len(part) - further] for part in rows]
    products = np.array([part.T @ part for part in parts])
    products *= current_units(problem)[:, None, None] ** 2
    known = rows[0][len(rows[0]) - further :]
    return Groups(_counts(problem), products, known.T @ known)


def _leverages(problem: Problem, result: LeastSquaresResult, half: Floats) -> Floats:
    """Leverage of every measured value, of very many their mean, shape (N, d)."""
    shape = len(problem.data), problem.components
    if problem.many:
        return np.full(shape, half.shape[1] / max(problem.values, 1))
    found = np.sum((result.jac[: shape[0] * shape[1]] @ half) ** 2, axis=1)
    return np.asarray(found.reshape(shape))


def _counts(problem: Problem) -> Floats:
    """Measured values of each quantity, those with less weight counted less, (K,)."""
    present = problem.data.weight[:, None] * np.isfinite(problem.given_sigma)
    return np.array(
        [present[:, q.columns].sum() for q in problem.measurement.quantities]
    )


def component_units(problem: Problem) -> Floats:
    """Unit weight of every component, shape (d,)."""
    return problem.units if len(problem.units) else np.ones(problem.components)


def current_units(problem: Problem) -> Floats:
    """Standard deviation of unit weight of every quantity, shape (K,)."""
    quantities = problem.measurement.quantities
    return component_units(problem)[[quantity.columns.start for quantity in quantities]]


def _stated(problem: Problem, quantity: Quantity) -> bool:
    """Whether the rows or the setup state the noise of a quantity."""
    if (quantity.noise or quantity.name) in problem.setup.noise:
        return True
    sigma = problem.data.sigma
    return sigma is not None and not bool(np.isnan(sigma[:, quantity.columns]).any())


def _tested(
    groups: Groups, stated: NDArray[np.bool_], start: Floats
) -> tuple[Variances, Floats]:
    """Estimate the variances of all quantities, and choose those to use.

    Args:
        groups: The quantities.
        stated: Which have a stated variance, shape (K,).
        start: First guesses of the variances, shape (K,).

    Returns:
        Estimates of all quantities relative to what is given, and the factors of the
        standard deviations to use, shape (K,): one where what is stated stands.
    """
    found = estimate_variances(groups, start)
    # Where two quantities cannot be told apart the information is rounding.
    found = replace(found, dof=np.minimum(found.dof, groups.counts))
    few = found.redundancies < FEW
    if few.all():
        return found, np.sqrt(start)
    intervals = [
        variance_interval(v, f) for v, f in zip(found.values, found.dof, strict=True)
    ]
    stands = np.array([low <= 1.0 <= high for low, high in intervals])
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
    """What holds a variance in 95 of 100 cases, by its estimate."""
    if dof < 0.5:
        return 0.0, np.inf
    tails = 0.5 * REJECTED, 1.0 - 0.5 * REJECTED
    low, high = (variance * dof / chi_square_quantile(dof, tail) for tail in tails)
    return low, high


def _component(
    problem: Problem,
    k: int,
    found: Variances,
    factor: float,
    counts: Floats,
    pure: PureError | None,
) -> VarianceComponent:
    """What is known of the noise of quantity k.

    Args:
        problem: The problem.
        k: Position of the quantity.
        found: Estimated variances of all, relative to what is given.
        factor: Factor of the standard deviation that is used.
        counts: Measured values of each quantity, shape (K,).
        pure: Pure error of its repetitions, None where there are too few.
    """
    quantity = problem.measurement.quantities[k]
    given = problem.given_sigma[:, quantity.columns]
    given = given[np.isfinite(given)]
    size = float(np.sqrt(np.mean(given**2))) if len(given) else np.nan
    redundancy, stated = float(found.redundancies[k]), _stated(problem, quantity)
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
        quantity=quantity.name,
        unit=quantity.unit,
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
