"""Errors of groups of measurements by a fit of the others, made without one.

With the whitened residual r of a fit, its Jacobian J and the normal matrix `N = J^T J`
of all that is known (measurements, known distances, priors), a fit without the group g
has `N_g = N - J_g^T J_g` and stands `-N_g^-1 (J^T r - J_g^T r_g)` away; the errors of
the group are then `(I - H_gg)^-1 r_g`, where `H_gg = J_g N^-1 J_g^T`, with the
covariance `(I - H_gg)^-1` (Allen 1974; Cook and Weisberg 1982, section 2.2). That is
exact where the problem is linear. Directions, sizes of errors, noise, effects and
weights are those of the fit. What only the group itself tells, as the position of a
socket of its own, is where it puts it.

Where something was learned, it takes the part of the group away from that as well, see
`residual_models.gaussian_process`: the shift of the geometry that belongs to a
correction is found anew with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation import learning
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.fitted import (
    Fit,
    Posterior,
    by_configuration,
    effect_rows,
    shared_variances,
)
from calib_pin.estimation.identifiability import half_covariance, visible_nuisances
from calib_pin.estimation.problem import EXACT, Problem, known_count
from calib_pin.estimation.robust import by_size, spectrum
from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models import LearnedCorrection
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    errors_of_registered,
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
    problem = fitted.problem
    every = np.arange(count := len(problem.data))
    if problem.many:
        # Among so many, no group has a say, and some of them tell the errors.
        every = np.arange(0, count, max(1, count // (FOLDS * MOST)))
        problem = replace(problem, data=problem.data.rows(every))
        before, after = (problem.errors(at) for at in (fitted.before, fitted.theta))
        variance = problem.sigma**2
    else:
        nominal, calibrated = Linear.of(fitted)
        before, _ = press(nominal, labels)
        after, variance = press(calibrated, labels)
    # What cannot be predicted is infinitely wrong.
    before, after = (np.where(np.isnan(e), np.inf, e) for e in (before, after))
    first, second, spread = (
        problem.layout.table(values, len(every))
        for values in (before, after, fitted.unit**2 * variance)
    )
    return ModelErrors(every, first, second, spread)


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
    model: FittedModel, masks: Sequence[NDArray[np.bool_]], seed: int = 0
) -> list[ModelErrors | None]:
    """Errors of each of some groups of measurements by what the others tell.

    Args:
        model: The model of all measurements.
        masks: The groups, shape (N,) each.
        seed: Seed of whatever is learned anew.

    Returns:
        The errors; None where it takes a fit of the others to tell.
    """
    fit, learned = model.fit, model.learned
    if not masks or fit.problem.own_of_stations:
        # The elimination of stations is no sum over groups.
        return [None] * len(masks)
    robots = Linear.of(fit)
    pairs = [_pair(robots, mask, placed=learned is None) for mask in masks]
    effects: Floats | None = None
    anew: Iterator[LearnedCorrection | None] = repeat(None)
    if learned is not None:
        parts = [mask for mask, pair in zip(masks, pairs, strict=True) if pair]
        about, rng = fit.problem.rebased(fit.theta), np.random.default_rng(seed)
        anew = iter(learning.left_out(learned, fit, *about, parts, rng))
    elif not fit.problem.many:
        effects = effect_rows(fit)
    return [
        None if pair is None else _errors(model, robots[1], mask, pair, effects, anew)
        for mask, pair in zip(masks, pairs, strict=True)
    ]


def unusable(fitted: Fit) -> str:
    """Why a fit says little of the robot; empty where it does."""
    if not fitted.structure.scaled:
        return "the absolute scale is unobservable"
    return "" if fitted.result.status.success else "it did not converge"


class Rest(NamedTuple):
    """A fit without a group of measurements.

    Attributes:
        theta: Parameter values, shape (P,).
        inner: K of `N_g^-1 = (F K) (F K)^T`, shape (k, k').
        alone: Positions of the parameters that only the group knows.
    """

    theta: Floats
    inner: Floats
    alone: tuple[int, ...] = ()


def _pair(
    robots: tuple[Linear, Linear], mask: NDArray[np.bool_], *, placed: bool
) -> tuple[Rest, Rest] | None:
    """Nominal and fitted robot without a group of measurements.

    Args:
        robots: Those of all N measurements.
        mask: The group, shape (N,).
        placed: Whether the group may place what only it knows.

    Returns:
        The robots; None where the others do not determine them.
    """
    before, after = (without(robot, mask) for robot in robots)
    if before is None or after is None or (after.alone and not placed):
        return None
    least, most = robots[1].problem.parameters.bounds
    beyond = (after.theta < least) | (after.theta > most)
    return None if beyond.any() else (before, after)


def without(robot: Linear, mask: NDArray[np.bool_]) -> Rest | None:
    """A solution without some measurements.

    Of a reference object that only these name, known distances do not count: they are
    there to be found.

    Args:
        robot: The solution of all N measurements.
        mask: Those that are left out, shape (N,).

    Returns:
        The solution; None where the others do not determine it, or the problem is not
        linear enough to tell, see `BENT`. Of so many measurements that they are not
        linearized one by one, one step is all there is to make.
    """
    problem, F = robot.problem, robot.factor
    if problem.many:
        some = replace(problem, data=problem.data.rows(mask))
        fun, jac = some.linearize(robot.theta)
        count = len(fun) - len(some.further)
        B = jac[:count] @ F
        if (inverse := _inverse(B, 0)) is None:
            return None
        step = inverse[0].T @ (robot.columns.T @ robot.fun - B.T @ fun[:count])
        return Rest(robot.theta - F @ (inverse[0] @ step), inverse[0])
    out, alone = _group(robot, mask[problem.layout.row])
    if (inverse := _inverse(robot.columns[out], int(alone.sum()))) is None:
        return None
    inner, held = inverse
    theta, fun = robot.theta, robot.fun
    for k in range(STEPS):
        step = inner.T @ (robot.columns.T @ np.where(out, 0.0, fun))
        if k and np.linalg.norm(step) <= BENT * max(robot.unit, EXACT):
            break
        theta = theta - F @ (inner @ step)
        fun = problem.residual(theta)
    else:
        return None
    if held.size:
        own = np.flatnonzero(mask[problem.layout.row])
        placed, triangle = np.linalg.qr(robot.columns[own] @ held)
        if np.sum(placed**2, axis=1).max() > 1.0 - ALONE:
            return None  # It says no more than where they are.
        theta = theta - F @ held @ np.linalg.solve(triangle, placed.T @ fun[own])
    return Rest(theta, inner, tuple(np.flatnonzero(alone).tolist()))


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


def _errors(
    model: FittedModel,
    robot: Linear,
    mask: NDArray[np.bool_],
    pair: tuple[Rest, Rest],
    effects: Floats | None,
    anew: Iterator[LearnedCorrection | None],
) -> ModelErrors:
    """Errors of a group by a pair of robots that were fitted without it.

    Args:
        model: The model of all measurements.
        robot: Its geometry.
        mask: The group, shape (N,).
        pair: Nominal and fitted robot without it.
        effects: Effects of gears and compliance in all rows, shape (M, S).
        anew: The next correction that was learned without it.
    """
    fit, (before, after) = model.fit, pair
    rows = fit.problem.data.rows(mask)
    problem, theta, deviations = fit.problem, after.theta, fit.posterior
    if (learned := next(anew)) is not None:
        of_error = np.concatenate([t.of_error for t in problem.terms.values()])
        step = np.zeros_like(theta)
        step[of_error] = (theta - fit.theta)[of_error]
        # What was learned stands on the geometry; where it fades, that remains.
        learned = replace(learned, shift=learned.shift - step)
        problem = learning.with_learned(model.problem, learned)
        theta = model.theta + step
    elif not problem.many:
        deviations = _deviations(fit, robot, after, mask, effects)
    nominal = Registered(replace(fit.problem, data=rows), before.theta)
    calibrated = Registered(replace(problem, data=rows), theta, after.alone)
    given = np.flatnonzero(mask), deviations
    found = errors_of_registered(model, nominal, calibrated, *given)
    return replace(found, reason=unusable(fit))


def _deviations(
    fit: Fit,
    robot: Linear,
    rest: Rest,
    mask: NDArray[np.bool_],
    effects: Floats | None,
) -> Posterior:
    """Deviations of a fit without a group of measurements, see `fitted.posterior`.

    Args:
        fit: The fit of all measurements.
        robot: Its solution.
        rest: That without the group.
        mask: The group, shape (N,).
        effects: Effects of gears and compliance in all rows, shape (M, S).
    """
    problem, layout, noise = fit.problem, fit.problem.layout, fit.posterior.noise
    shared = shared_variances(problem, fit.noise, noise)
    others = robot.columns[: len(layout.row)] @ rest.inner
    others[mask[layout.row]] = 0.0
    moved = robot.factor @ rest.inner
    by_effects = np.zeros((len(moved), 0))
    if effects is not None:
        by_effects = moved @ (others.T @ effects)
    # Where their noise is not one, and repetitions have a part of it in common.
    less = (1.0 - noise + shared)[layout.component]
    if less.any():
        core = np.eye(others.shape[1]) - (others.T * less) @ others
        if shared.any():
            core += by_configuration(problem, others, shared)
        values, V = np.linalg.eigh(core)
        moved = moved @ (V * np.sqrt(np.maximum(values, 0.0)))
    return replace(fit.posterior, by_noise=fit.unit * moved, by_effects=by_effects)
