"""Validation of a fitted model on held-out measurements, with its significance.

Only measurements that the fit has not used count: those that repeat a fitted
configuration are left out, an instrument that was moved or stands at a new station is
registered anew, and rejected measurements count for neither the nominal nor the
calibrated robot. If too few are left there is no check.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding, Gain
from calib_pin.estimation.fit import fit_model, learned_without
from calib_pin.estimation.fitted import (
    Fit,
    Posterior,
    as_weighted,
    by_configuration,
    shared_variances,
    with_prior,
)
from calib_pin.estimation.identifiability import half_covariance, visible_nuisances
from calib_pin.estimation.nominal import extended
from calib_pin.estimation.problem import EXACT, Problem, known_count
from calib_pin.estimation.robust import by_size, spectrum
from calib_pin.estimation.statistics.distributions import student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Booleans, Indices, Observations, grouped
from calib_pin.progress import Stages
from calib_pin.residual_models import LearnedCorrection
from calib_pin.validation.findings.moved_instrument import registered_if_moved
from calib_pin.validation.findings.sentences import finding
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    both,
    errors_of_registered,
    model_errors,
)
from calib_pin.validation.splits import FEWEST_HELD_OUT, FOLDS, MOST, Grouping, folds
from calib_pin.workers.base import SERIAL, Workers

ALONE = 1e-6
"""Part of a group that the others predict, below which it holds all that is known of
something."""

BENT, STEPS = 0.1, 3
"""Length of a further step of a fit without a group, in standard deviations, from which
the problem is not linear enough, and most steps."""

ALL, PRESS = "all", "press"
"""The quantity that stands for all of them, whitened, and the check by the hat
matrix."""


@dataclass(frozen=True)
class Linear:
    """A solution with the residual rows linearized about it.

    Attributes:
        problem: The problem.
        theta: The solution, shape (P,).
        fun: Whitened residual, the M components of the N measurements first, (M',).
        factor: F of `N^-1 = F F^T`, shape (P, k).
        columns: `J F` with the Jacobian J of the residual, shape (M', k).
        unit: Standard deviation of unit weight.
    """

    problem: Problem
    theta: Floats
    fun: Floats
    factor: Floats
    columns: Floats
    unit: float

    @classmethod
    def of(cls, fitted: Fit) -> tuple[Linear, Linear]:
        """The nominal robot, its frames registered, and the fitted one."""
        problem, parameters = fitted.problem, fitted.problem.parameters
        fun, J = problem.linearize(fitted.before)
        F = half_covariance(J, visible_nuisances(J, parameters), parameters)
        unit = float(np.sqrt(fun @ fun / max(known_count(problem) - F.shape[1], 1)))
        nominal = cls(problem, fitted.before, fun, F, J @ F, unit)
        problem, held, moved = with_prior(fitted)
        F = half_covariance(held.jac, moved, parameters)
        return nominal, cls(problem, held.x, held.fun, F, held.jac @ F, fitted.unit)


def press_check(fitted: Fit, labels: Indices) -> ModelErrors:
    """Errors of each of many small groups, as far as the problem is linear.

    Args:
        fitted: The fit of all measurements.
        labels: Group of each, shape (N,).
    """
    problem = fitted.problem
    positions = np.arange(count := len(problem.data))
    if problem.many:
        # Among so many, no group has a say, and some of them tell the errors.
        positions = positions[:: max(1, count // (FOLDS * MOST))]
        problem = replace(problem, data=problem.data.rows(positions))
        tables = *map(problem.errors, (fitted.before, fitted.theta)), problem.sigma**2
    else:
        (before, _), calibrated = (press(robot, labels) for robot in Linear.of(fitted))
        tables = before, *calibrated
    # What cannot be predicted is infinitely wrong.
    before, after = (np.where(np.isnan(e), np.inf, e) for e in tables[:2])
    flat = before, after, fitted.unit**2 * tables[2]
    before, after, variance = (problem.layout.table(f, len(positions)) for f in flat)
    return ModelErrors(positions, before, after, variance)


@serial_blas
def press(robot: Linear, labels: Indices) -> tuple[Floats, Floats]:
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
    for index in by_size(label):
        U, squares = spectrum(robot.columns[index])
        remainder = 1.0 - squares
        known = remainder > 1e-9  # Below, the others do not predict it: rounding.
        gain = np.where(known, 1.0 / np.where(known, remainder, 1.0), 0.0) - 1.0
        along = gain * np.einsum("gms,gm->gs", U, whitened[index])
        whitened[index] += np.einsum("gms,gs->gm", U, along)
        variance[index] += np.einsum("gms,gs->gm", U**2, gain)
    with np.errstate(invalid="ignore"):  # Of those that are set aside.
        return whitened * problem.sigma, variance * problem.sigma**2


@serial_blas
def left_out(
    fit: Fit, masks: Sequence[Booleans], seed: int = 0
) -> list[ModelErrors | None]:
    """Errors of each of some groups of measurements by what the others tell.

    Args:
        fit: The fit of all measurements.
        masks: The groups, shape (N,) each.
        seed: Seed of whatever is learned anew.

    Returns:
        The errors; None where it takes a fit of the others to tell.
    """
    result: list[ModelErrors | None] = [None] * len(masks)
    if not masks or fit.problem.station_parameters:
        # The elimination of stations is no sum over groups.
        return result
    nominal, fitted = Linear.of(fit)
    solutions = dict[int, tuple[Floats, Floats, Floats]]()
    for k, mask in enumerate(masks):
        first, second = solution_without(nominal, mask), solution_without(fitted, mask)
        if first is not None and second is not None:
            solutions[k] = first[0], *second
    corrections = dict[int, LearnedCorrection]()
    if fit.learned is not None:
        parts, rng = [masks[k] for k in solutions], np.random.default_rng(seed)
        retrained = learned_without(fit.learned, fit, parts, rng)
        corrections = dict(zip(solutions, retrained, strict=True))
    for k, (uncalibrated, theta, inner) in solutions.items():
        problem, deviations = fit.problem, fit.posterior
        if k in corrections:
            of_error = np.concatenate([t.of_error for t in problem.terms.values()])
            step = np.zeros_like(theta)
            step[of_error] = (theta - fit.theta)[of_error]
            # What was learned stands on the geometry; where it fades, that remains.
            correction = replace(corrections[k], shift=corrections[k].shift - step)
            problem = fit.solved.problem.learning(correction)
            theta = fit.solved.theta + step
        elif not problem.many:
            deviations = _deviations(fit, fitted, inner, masks[k])
        both = (fit.problem, uncalibrated), (problem, theta)
        data = fit.problem.data.rows(masks[k])
        before, after = (Registered(replace(p, data=data), x) for p, x in both)
        given = before, after, np.flatnonzero(masks[k]), deviations
        errors = errors_of_registered(fit, *given)
        result[k] = replace(errors, reason=unusable(fit))
    return result


def unusable(fitted: Fit) -> str:
    """Why a fit says little of the robot; empty where it does."""
    if not fitted.structure.scaled:
        return "the absolute scale is unobservable"
    return "" if fitted.result.status.success else "it did not converge"


def solution_without(robot: Linear, mask: Booleans) -> tuple[Floats, Floats] | None:
    """A solution without a group of measurements.

    Args:
        robot: The solution of all N measurements.
        mask: Those that are left out, shape (N,).

    Returns:
        Parameter values, shape (P,), and K of `N_g^-1 = (F K) (F K)^T`, shape (k, k');
        None where the others do not determine them, as the place of a socket that only
        these name, or the problem is not linear enough to tell, see `BENT`. Of so many
        measurements that they are not linearized one by one, one step is all there is
        to make.
    """
    problem, F, fun = robot.problem, robot.factor, robot.fun
    group = replace(problem, data=problem.data.rows(mask))
    r, jac = group.linearize(robot.theta)
    count = len(r) - len(group.further)
    B = jac[:count] @ F
    # N_g = 1 - B^T B in the columns of F.
    values, Q = np.linalg.eigh(np.eye(B.shape[1]) - B.T @ B)
    if (values < ALONE).any():
        return None
    inner, theta = Q / np.sqrt(values), robot.theta
    for k in range(STEPS):
        step = inner.T @ (robot.columns.T @ fun - B.T @ r[:count])
        if k and np.linalg.norm(step) <= BENT * max(robot.unit, EXACT):
            break
        theta = theta - F @ (inner @ step)
        if problem.many:
            break
        fun, r = problem.residual(theta), group.residual(theta)
    else:
        return None
    least, most = problem.parameters.bounds
    inside = ((theta >= least) & (theta <= most)).all()
    return (theta, inner) if inside else None


def _deviations(fit: Fit, robot: Linear, inner: Floats, mask: Booleans) -> Posterior:
    """Deviations of a fit without a group of measurements, see `fitted.posterior`.

    Args:
        fit: The fit of all measurements.
        robot: Its solution.
        inner: K of that without the group, see `solution_without`.
        mask: The group, shape (N,).
    """
    problem, layout, noise = fit.problem, fit.problem.layout, fit.posterior.noise
    shared = shared_variances(problem, fit.noise, noise)
    count, moved = len(layout.row), robot.factor @ inner
    others = robot.columns[:count] @ inner
    others[mask[layout.row]] = 0.0
    by_effects = moved @ (others.T @ fit.effect_rows)
    # Where their noise is not one, and repetitions have a part of it in common.
    less = (1.0 - noise + shared)[layout.component]
    if less.any():
        core = np.eye(others.shape[1]) - (others.T * less) @ others
        core += by_configuration(problem, others, shared)
        values, V = np.linalg.eigh(core)
        moved = moved @ (V * np.sqrt(np.maximum(values, 0.0)))
    return replace(fit.posterior, by_noise=fit.unit * moved, by_effects=by_effects)


def gains(
    method: str,
    problem: Problem,
    checks: Sequence[ModelErrors],
    labels: Indices,
) -> tuple[Gain, ...]:
    """Test held-out errors before and after, of all quantities and of each.

    Measurements that are set aside do not count.

    Args:
        method: How they were held out.
        problem: The problem of the N measurements that the positions belong to, in the
            units of the fit; its standard deviations whiten.
        checks: Errors of held-out measurements, part by part.
        labels: Label of each in the test, shape (N,); those of one label are one
            observation.
    """
    if not checks:
        return ()
    layout, joined = problem.layout, ModelErrors.joined(checks)
    joined = joined.at(problem.data.weight[joined.positions] > 0.0)
    sigma = layout.table(problem.sigma, len(problem.data))[joined.positions]
    label = labels[joined.positions]
    present = np.isfinite(sigma)
    # By what the fit predicts of each: a point near the plane of a camera moves by
    # hundreds of pixels for nothing, and would outweigh all others.
    larger = np.maximum(np.nan_to_num(joined.variance, posinf=0.0), sigma**2)
    unit = np.sqrt(larger, where=present, out=np.ones(sigma.shape))
    squares = (joined.after / unit) ** 2, joined.variance / unit**2
    # Lengths; of all, root mean square over the components: one for noise alone.
    whole = unit * np.sqrt(present.sum(axis=1))[:, None]
    tests = []
    quantities = (ALL, slice(None)), *((q.name, q.columns) for q in layout.quantities)
    for name, columns in quantities:
        mask = present[:, columns]
        rows, scale = mask.any(axis=1), whole if name == ALL else 1.0
        if not rows.any():
            continue
        errors = ((e / scale)[rows, columns] for e in (joined.before, joined.after))
        masked = (np.where(mask[rows], e, 0.0) for e in errors)
        old, new = (np.linalg.norm(e, axis=1) for e in masked)
        square, predicted = (float(np.sum(s[:, columns][mask])) for s in squares)
        # Where it predicts nothing, all values were needed to fit.
        ratio = float(np.sqrt(square / predicted)) if predicted > 0.0 else float("nan")
        tests.append(Gain(method, name, *paired_test(old, new, label[rows]), ratio))
    return tuple(tests)


def paired_test(
    before: Floats, after: Floats, label: Indices
) -> tuple[int, float, float, float, float]:
    """Number, mean and deviation of gains, and the chances that it is none, or no loss.

    Student's t of the mean over the labels. Where neither robot predicts a row, nothing
    is gained there; where only one does, the mean is infinite and settles it.
    """
    with np.errstate(invalid="ignore"):
        gain = np.nan_to_num(before - after, posinf=np.inf, neginf=-np.inf)
        label = np.unique(label, return_inverse=True)[1].reshape(-1)
        means = np.bincount(label, gain) / np.bincount(label)
    count, mean = len(means), float(means.mean())
    deviation, t = float("nan"), 0.0
    if count > 1 and np.isfinite(mean):
        deviation = float(means.std(ddof=1) / np.sqrt(count))
    if mean != 0.0 and (count > 1 or np.isinf(mean)):
        t = mean / deviation if deviation > 0.0 else float(np.copysign(np.inf, mean))
    dof = max(count - 1, 1)
    return count, mean, deviation, student_tail(t, dof), student_tail(-t, dof)


@dataclass(frozen=True)
class HeldOut:
    """The check of a fitted model on held-out measurements.

    Attributes:
        measurements: The measurements that the positions of the parts belong to.
        parts: Errors of held-out measurements; empty without a check.
        method: `set`, `file`, `holdout`, `5-fold`, ..., or `none`.
        gains: Paired tests on the parts, then those by the hat matrix (PRESS).
        findings: Defects of the held-out measurements.
        skipped: Reason for each skipped fold of a cross-validation.
    """

    measurements: Observations
    parts: tuple[ModelErrors, ...] = ()
    method: str = "none"
    gains: tuple[Gain, ...] = ()
    findings: tuple[Finding, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def counted(self) -> tuple[ModelErrors, ...]:
        """The parts without rejected measurements (weight zero)."""
        return tuple(part.counted(self.measurements.weight) for part in self.parts)


def check(
    fitted: Fit,
    training: Observations,
    seed: int,
    *,
    validation: Observations | None = None,
    method: str = "set",
    parts: Sequence[ModelErrors] | None = None,
    progress: Stages | None = None,
    workers: Workers = SERIAL,
) -> HeldOut:
    """Check a model on validation measurements, or by cross-validation without any.

    Args:
        fitted: The fit.
        training: The measurements that it was fitted to.
        seed: Seed of the split and of further fits.
        validation: Validation measurements; None for a cross-validation.
        method: How the validation measurements were chosen; see `HeldOut.method`.
        parts: Errors of a cross-validation with the same folds; None to run it. With
            none of them only the hat matrix is used.
        progress: Told the stage and the fraction done.
        workers: Who fits the folds of a cross-validation.
    """
    training = as_weighted(fitted, training)
    grouping = Grouping.of(training, fitted.problem.setup)
    problem, result = replace(fitted.problem, data=training), HeldOut(training)
    if validation is not None:
        result = _check_on(fitted, training, validation, method)
    else:
        if parts is None:
            masks = folds(grouping, fitted, seed)
            parts = [*cross_validate(fitted, training, masks, seed, progress, workers)]
        # A fit that fails without its fold says nothing about the robot.
        usable = tuple(part for part in parts if not part.reason)
        held = [
            part.positions[training.weight[part.positions] > 0.0] for part in usable
        ]
        joined = np.concatenate([np.zeros(0, np.intp), *held])
        if training.rows(joined).configurations < FEWEST_HELD_OUT:
            usable = ()
        name = grouping.validation_name(len(usable))
        tests = gains(name, problem, usable, grouping.clusters)
        skipped = tuple(part.reason for part in parts if part.reason)
        result = HeldOut(training, usable, name, tests, skipped=skipped)
    if fitted.dof > 0:  # Without redundancy the hat matrix says nothing.
        press = press_check(fitted, grouping.groups)
        tests = gains(PRESS, problem, [press], grouping.clusters)
        result = replace(result, gains=result.gains + tests)
    return result


def cross_validate(
    whole: Fit,
    measurements: Observations,
    masks: Sequence[Booleans],
    seed: int,
    progress: Stages | None = None,
    workers: Workers = SERIAL,
) -> Iterator[ModelErrors]:
    """Errors of each part of the measurements by a model fitted to the others.

    Args:
        whole: The fit of all measurements.
        measurements: The N measurements.
        masks: The parts, each of shape (N,).
        seed: As for `fit_model`.
        progress: Told the stage and the fraction done of all parts.
        workers: Who fits those parts that take a fit.
    """
    parts = left_out(whole, masks, seed)
    if whole.problem.many:
        # Their kernels keep all cores busy, and every worker would have a copy.
        workers = SERIAL
    shared = whole, measurements, seed
    remaining = [mask for mask, part in zip(masks, parts, strict=True) if part is None]
    refits = workers.map(_refit_errors, shared, remaining)
    for k, part in enumerate(parts, 1):
        if progress is not None:
            progress(f"check {k} of {len(parts)}", (k - 1) / len(parts))
        yield next(refits) if part is None else part


@serial_blas
def _refit_errors(shared: tuple[Fit, Observations, int], mask: Booleans) -> ModelErrors:
    """Errors of a part of the measurements, of shape (N,), by a fit of the others."""
    whole, measurements, seed = shared
    # Measurements that the fit of all has rejected stay rejected.
    others = measurements.rows(~mask & (measurements.weight > 0.0))
    layout = whole.problem.layout
    try:
        # Where all of them taught nothing, some teach no more.
        known = whole.problem.chains, others, whole.solved.problem.setup
        fitted = fit_model(*known, seed, effects_of=whole)
        if fitted.problem.layout.quantities != layout.quantities:
            raise InputError("all others of an instrument are set aside")
        errors = model_errors(fitted, measurements.rows(mask), np.flatnonzero(mask))
    except InputError as error:
        # All other measurements of a reference may be rejected.
        none = np.zeros((0, layout.width))
        return ModelErrors(np.zeros(0, np.intp), none, none, none, reason=error.reason)
    return replace(errors, reason=unusable(fitted))


def _check_on(
    fitted: Fit, training: Observations, validation: Observations, method: str
) -> HeldOut:
    """The check on validation measurements."""
    findings, parts = list[Finding](), list[ModelErrors]()
    q = np.concatenate([training.q[training.weight > 0.0], validation.q])
    old, seen = np.split(grouped(q), [len(q) - len(validation)])
    new = ~np.isin(seen, old)
    if repeated := len(new) - int(new.sum()):
        text = f"{repeated} of {len(new)} validation measurements repeat fitted "
        text += "configurations and do not count"
        remedy = "validate with configurations that were not fitted"
        numbers = {"repeated": repeated, "all": len(new)}
        findings.append(finding("repeated-validation", text, numbers, remedy))
    if new.any():
        pair = both(fitted, validation.rows(new))
        parts, moved = registered_if_moved(fitted, *pair, np.flatnonzero(new))
        findings += moved
    if not parts:
        return HeldOut(validation, findings=tuple(findings))
    clusters = Grouping.of(validation, fitted.problem.setup).clusters
    problem, _ = extended(*fitted.solved, validation)
    tests = gains(method, problem, parts, clusters)
    return HeldOut(validation, tuple(parts), method, tests, tuple(findings))
