"""Errors of groups of measurements by a fit of the others, made without one.

With the whitened residual r of a fit, its Jacobian J and the normal matrix `N = J^T J`
of all that is known (measurements, known distances, priors), a fit without the group g
has `N_g = N - J_g^T J_g` and stands `-N_g^-1 (J^T r - J_g^T r_g)` away; the errors of
the group are then `(I - H_gg)^-1 r_g`, where `H_gg = J_g N^-1 J_g^T`, with the
covariance `(I - H_gg)^-1` (Allen 1974; Cook and Weisberg 1982, section 2.2). That is
exact where the problem is linear. Directions, sizes of errors, noise, effects and
weights are those of the fit. What only the group itself tells, as the position of a
socket of its own, is where it puts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.directions import half_covariance, visible_nuisances
from calib_pin.estimation.fitted import (
    Fit,
    by_configuration,
    effect_rows,
    shared_variances,
)
from calib_pin.estimation.problem import EXACT, Problem, error_table, known_count
from calib_pin.estimation.robust.studentized import by_size, spectrum
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    found_distances,
    predicted_variance,
)
from calib_pin.validation.splits import FOLDS, MOST

UNDETERMINED = 1e-9
"""Part of a group that the others predict, below which they do not: rounding."""

ALONE = 1e-6
"""The same from which a group holds all that is known of something."""

BENT = 0.1
"""Length of a further step of a fit without a group, in standard deviations, from which
the problem is not linear enough."""

STEPS = 3
"""Most steps of such a fit with the normal matrix of the first."""


@dataclass(frozen=True)
class Linear:
    """A solution with the residual rows linearized about it.

    Attributes:
        problem: The problem.
        theta: The solution, shape (P,).
        fun: Whitened residual, the M components of the N measurements first, (M',).
        jac: Its Jacobian J, shape (M', P).
        factor: F of `N^-1 = F F^T`, shape (P, k).
        columns: `J F`, shape (M', k).
        unit: Standard deviation of unit weight.
    """

    problem: Problem
    theta: Floats
    fun: Floats
    jac: Floats
    factor: Floats
    columns: Floats
    unit: float

    @classmethod
    def of(cls, fitted: Fit) -> tuple[Linear, Linear]:
        """The nominal robot, its frames registered, and the fitted one."""
        problem, parameters = fitted.problem, fitted.problem.parameters
        fun, J = fitted.registered
        F = half_covariance(J, visible_nuisances(J, parameters), parameters)
        unit = float(np.sqrt(fun @ fun / max(known_count(problem) - F.shape[1], 1)))
        nominal = cls(problem, fitted.before, fun, J, F, J @ F, unit)
        problem, held, moved = fitted.held
        J, F = held.jac, half_covariance(held.jac, moved, parameters)
        return nominal, cls(problem, held.x, held.fun, J, F, J @ F, fitted.unit)


def press_check(fitted: Fit, labels: NDArray[np.int64]) -> ModelErrors:
    """Errors of each of many small groups, as far as the problem is linear.

    Args:
        fitted: The fit of all measurements.
        labels: Group of each, shape (N,).
    """
    problem, layout = fitted.problem, fitted.problem.layout
    every = np.arange(count := len(problem.data))
    if problem.many:
        # Among so many, no group has a say, and some of them tell the errors.
        every = np.arange(0, count, max(1, count // (FOLDS * MOST)))
        problem = replace(problem, data=problem.data.rows(every))
        layout, count = problem.layout, len(every)
        before, after = (problem.errors(at) for at in (fitted.before, fitted.theta))
        variance = problem.sigma**2
    else:
        nominal, calibrated = Linear.of(fitted)
        before, _ = press(nominal, labels)
        after, variance = press(calibrated, labels)
    return ModelErrors(
        every,
        layout.table(_or_infinite(before), count),
        layout.table(_or_infinite(after), count),
        layout.table(fitted.unit**2 * variance, count),
    )


@serial_blas
def press(robot: Linear, labels: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Errors of each group of measurements by the first step of a fit of the others.

    Args:
        robot: The solution.
        labels: Group of each measurement, shape (N,).

    Returns:
        Errors and, for noise of unit weight, their variances, shape (M,) each.
    """
    problem, label = robot.problem, labels[robot.problem.layout.row]
    count = len(label)
    whitened, variance = robot.fun[:count].copy(), np.ones(count)
    for at in by_size(label):
        U, squares = spectrum(robot.columns[at])
        left = 1.0 - squares
        known = left > UNDETERMINED
        gain = np.where(known, 1.0 / np.where(known, left, 1.0), 0.0) - 1.0
        along = gain * np.einsum("gms,gm->gs", U, whitened[at])
        whitened[at] += np.einsum("gms,gs->gm", U, along)
        variance[at] += np.einsum("gms,gs->gm", U**2, gain)
    with np.errstate(invalid="ignore"):  # Of those that are set aside.
        return whitened * problem.sigma, variance * problem.sigma**2


@serial_blas
def left_out(
    fitted: Fit, masks: Sequence[NDArray[np.bool_]]
) -> list[ModelErrors | None]:
    """Errors of each of some groups of measurements by a fit of the others.

    Args:
        fitted: The fit of all measurements.
        masks: The groups, shape (N,) each.

    Returns:
        The errors; None where it takes a fit of the others to tell.
    """
    problem = fitted.problem
    if not masks or problem.own_of_stations:
        # The elimination of stations is no sum over groups.
        return [None] * len(masks)
    robots = Linear.of(fitted)
    if problem.many:
        found = [_of_many(fitted, robots, mask) for mask in masks]
    else:
        effects = effect_rows(fitted)
        found = [_of_rows(fitted, robots, effects, mask) for mask in masks]
    reason = unusable(fitted)
    return [None if one is None else replace(one, reason=reason) for one in found]


def unusable(fitted: Fit) -> str:
    """Why a fit says little of the robot; empty where it does."""
    if not fitted.structure.scaled:
        return "the absolute scale is unobservable"
    return "" if fitted.result.status.success else "it did not converge"


class Rest(NamedTuple):
    """A fit without a group of measurements, of m residual components.

    Attributes:
        theta: Parameter values, shape (P,).
        errors: Errors of the group, shape (m,).
        inner: K of `N_g^-1 = (F K) (F K)^T`, shape (k, k').
        placed: Orthonormal basis of what the group tells of parameters that only it
            knows, shape (m, l).
        alone: These parameters, shape (P,).
    """

    theta: Floats
    errors: Floats
    inner: Floats
    placed: Floats
    alone: NDArray[np.bool_]

    def beside(self, values: Floats) -> Floats:
        """The rest of values of the group, shape (m, s), when these are placed."""
        return np.asarray(values - self.placed @ (self.placed.T @ values))


def without(robot: Linear, own: NDArray[np.bool_]) -> Rest | None:
    """A solution without some measurements.

    Of a reference object that only these name, known distances do not count: they are
    there to be found.

    Args:
        robot: The solution of all.
        own: Those of the M residual components that are left out, shape (M,).

    Returns:
        The solution; None where the others do not determine it, or the problem is not
        linear enough to tell, see `BENT`.
    """
    problem, count = robot.problem, len(own)
    out, alone = _group(robot, own)
    inverse = _inverse(robot.columns[out], int(alone.sum()))
    if inverse is None:
        return None
    inner, held = inverse
    theta, fun = robot.theta, np.where(out, 0.0, robot.fun)
    finite = np.isfinite(problem.sigma)
    for k in range(STEPS):
        step = inner.T @ (robot.columns.T @ fun)
        if k and np.linalg.norm(step) <= BENT * max(robot.unit, EXACT):
            break
        theta = theta - robot.factor @ (inner @ step)
        errors = problem.errors(theta)
        fun[:count] = np.divide(errors, problem.sigma, np.zeros(count), where=finite)
        fun[count:] = problem.further.residual(theta)
        r, fun[out] = fun[:count][own], 0.0
    else:
        return None
    placed, triangle = np.linalg.qr(robot.columns[:count][own] @ held)
    if held.size:
        if np.sum(placed**2, axis=1).max() > 1.0 - ALONE:
            return None  # It says no more than where they are.
        theta = theta - robot.factor @ held @ np.linalg.solve(triangle, placed.T @ r)
        errors = problem.errors(theta)
    return Rest(theta, errors[own], inner, placed, alone)


def _group(
    robot: Linear, own: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The residual rows that are left out, (M',), and what only they know, (P,)."""
    count = len(own)
    out = np.append(own, np.zeros(len(robot.fun) - count, bool))
    known = slice(count, count + len(robot.problem.further.distances))
    seen = robot.jac != 0.0
    elsewhere = ~out
    elsewhere[known] = False
    alone = seen[out].any(axis=0) & ~seen[elsewhere].any(axis=0)
    alone &= robot.problem.parameters.free
    out[known] = seen[known][:, alone].any(axis=1)
    return out, alone


def _inverse(B: Floats, alone: int) -> tuple[Floats, Floats] | None:
    """Factor of `(1 - B^T B)^-1`, shape (k, k'), and what has none, shape (k, l).

    None where these are not as many directions as parameters that are alone.
    """
    left, Q = np.linalg.eigh(np.eye(B.shape[1]) - B.T @ B)
    if np.count_nonzero(left < ALONE) != alone:
        return None
    return Q[:, alone:] / np.sqrt(left[alone:]), Q[:, :alone]


def _of_rows(
    fitted: Fit,
    robots: tuple[Linear, Linear],
    effects: Floats | None,
    mask: NDArray[np.bool_],
) -> ModelErrors | None:
    """Errors of some measurements, shape (N,), whose rows are there.

    The effects of gears and compliance are given in all rows, shape (M, S).
    """
    problem, layout = fitted.problem, fitted.problem.layout
    own = mask[layout.row]
    before, after = (without(robot, own) for robot in robots)
    if before is None or after is None or _beyond(problem, after.theta):
        return None

    def table(values: Floats) -> Floats:
        every = np.empty(len(own))
        every[own] = _or_infinite(values)
        return layout.table(every, len(mask))[mask]

    names = zip(problem.parameters.names, after.alone, strict=True)
    anew = dict.fromkeys(name.rsplit(".", 2)[0] for name, only in names if only)
    return ModelErrors(
        np.flatnonzero(mask),
        table(before.errors),
        table(after.errors),
        table(_variance(fitted, robots[1], effects, own, after)),
        found_distances(
            Registered(problem, before.theta),
            Registered(problem, after.theta),
            [d for d in problem.setup.known if anew.keys() >= set(d.between)],
        ),
        tuple(anew),
    )


def _variance(
    fitted: Fit,
    robot: Linear,
    effects: Floats | None,
    own: NDArray[np.bool_],
    rest: Rest,
) -> Floats:
    """Variance of the errors of a group, as of measurements that were not fitted, (m,).

    See `predicted_variance`.
    """
    problem, layout = fitted.problem, fitted.problem.layout
    noise = np.ones(len(layout.components))
    if fitted.effects is not None:
        noise = fitted.effects.noise
    shared = shared_variances(problem, fitted.noise, noise)
    others = robot.columns[: len(own)] @ rest.inner
    uncertain = others[own]
    others[own] = 0.0
    result = np.zeros(len(uncertain))
    if effects is not None:
        moved = effects[own] - uncertain @ (others.T @ effects[: len(own)])
        result += np.sum(rest.beside(moved) ** 2, axis=1)
    # Where their noise is not one, and repetitions have a part of it in common.
    less = (1.0 - noise + shared)[layout.component]
    if less.any():
        core = np.eye(others.shape[1]) - (others.T * less) @ others
        if shared.any():
            core += by_configuration(problem, others, shared)
        values, V = np.linalg.eigh(core)
        uncertain = uncertain @ (V * np.sqrt(np.maximum(values, 0.0)))
    alone = noise[layout.component[own]] * (1.0 - np.sum(rest.placed**2, axis=1))
    spread = np.sum(rest.beside(uncertain) ** 2, axis=1)
    result += fitted.unit**2 * (alone + spread)
    return np.asarray(result * problem.sigma[own] ** 2)


def _of_many(
    fitted: Fit, robots: tuple[Linear, Linear], mask: NDArray[np.bool_]
) -> ModelErrors | None:
    """Errors of some of so many measurements that one step is all there is to make."""
    problem = replace(fitted.problem, data=fitted.problem.data.rows(mask))
    thetas = []
    for robot in robots:
        fun, jac = problem.linearize(robot.theta)
        own = slice(len(fun) - len(problem.further))
        B = jac[own] @ robot.factor
        inverse = _inverse(B, 0)
        if inverse is None:
            return None
        step = inverse[0].T @ (robot.columns.T @ robot.fun - B.T @ fun[own])
        thetas.append(robot.theta - robot.factor @ (inverse[0] @ step))
    before, after = thetas
    if _beyond(problem, after):
        return None
    variance = predicted_variance(fitted, problem, after)
    return ModelErrors(
        np.flatnonzero(mask),
        error_table(problem, before),
        error_table(problem, after),
        problem.layout.table(variance, len(problem.data)),
    )


def _beyond(problem: Problem, theta: Floats) -> bool:
    """Whether parameter values are beyond their bounds."""
    least, most = problem.parameters.bounds
    return bool(((theta < least) | (theta > most)).any())


def _or_infinite(errors: Floats) -> Floats:
    """Errors, infinite where a measurement cannot be predicted."""
    return np.where(np.isnan(errors), np.inf, errors)
