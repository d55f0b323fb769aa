"""Check a fitted model on measurements that were held out, and say what that is worth.

Only measurements that the fit has not used count: those that repeat a fitted
configuration are left out, an instrument that was moved is registered anew, and
measurements that were set aside count neither before nor after. Where too little is
left there is no check.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding, Gain
from calib_pin.estimation.fit import FittedModel, fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import SAMPLE, Problem, distinct_values
from calib_pin.estimation.solve import least_squares
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.progress import Stages, named, portion
from calib_pin.setup import Setup
from calib_pin.validation.gains import PRESS, gains, press_check
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    errors_of_registered,
    model_errors,
    registered,
)
from calib_pin.validation.splits import Grouping, folds


@dataclass(frozen=True)
class HeldOut:
    """The check of a fitted model on held-out measurements.

    Attributes:
        measurements: The measurements that the positions of the parts belong to.
        parts: Errors of held-out measurements; empty without a check.
        method: `set`, `file`, `holdout`, `5-fold`, ..., or `none`.
        gains: Paired tests of these, then those by the hat matrix.
        findings: What is wrong with the held-out measurements.
        skipped: Why folds of a cross-validation were left out.
    """

    measurements: Measurements
    parts: tuple[ModelErrors, ...] = ()
    method: str = "none"
    gains: tuple[Gain, ...] = ()
    findings: tuple[Finding, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def counted(self) -> tuple[ModelErrors, ...]:
        """The parts without measurements that are set aside."""
        return tuple(part.counted(self.measurements.weight) for part in self.parts)


def check(
    chain: Chain,
    training: Measurements,
    setup: Setup,
    model: FittedModel,
    seed: int,
    *,
    validation: Measurements | None = None,
    method: str = "set",
    validate: bool = True,
    parts: Sequence[ModelErrors] | None = None,
    progress: Stages | None = None,
) -> HeldOut:
    """Check a model on validation measurements, or by cross-validation without any.

    Args:
        chain: The nominal chain.
        training: The measurements that were fitted.
        setup: What was estimated, what is known.
        model: The model that was fitted to all of them.
        seed: Seed of the split and of further fits.
        validation: Validation measurements; None for a cross-validation.
        method: How these were chosen.
        validate: Whether to check at all; if not there is the hat matrix alone.
        parts: A cross-validation that was made before.
        progress: Told the stage and how much is done.
    """
    fitted = model.fit
    training = model.weighted(training)
    grouping = Grouping.of(training, setup)
    pressed: tuple[Gain, ...] = ()
    if fitted.dof > 0:  # Without redundancy the hat matrix says nothing.
        press = press_check(fitted, training, grouping.groups)
        pressed = gains(PRESS, fitted.problem, training, [press], grouping.clusters)
    if not validate:
        return HeldOut(training, gains=pressed)
    if validation is not None:
        found = _checked_on(model, training, validation, method)
        return replace(found, gains=found.gains + pressed)
    masks = folds(grouping, fitted, seed)
    if parts is None:
        parts = tuple(
            cross_validate(chain, training, setup, masks, seed, fitted, progress)
        )
    # A fold without which nothing fits tells nothing of the robot.
    kept = tuple(part for part in parts if not part.reason)
    if not _enough(training, kept):
        kept = ()
    name = grouping.validation_name(min(len(kept), len(masks)))
    return HeldOut(
        training,
        kept,
        name,
        gains(name, fitted.problem, training, kept, grouping.clusters) + pressed,
        skipped=tuple(part.reason for part in parts if part.reason),
    )


def cross_validate(
    chain: Chain,
    measurements: Measurements,
    setup: Setup,
    masks: Sequence[NDArray[np.bool_]],
    seed: int,
    whole: Fit,
    progress: Stages | None = None,
) -> Iterator[ModelErrors]:
    """Errors of each part of the measurements by a model fitted to the others.

    Args:
        chain: The nominal chain.
        measurements: The N measurements.
        setup: As for `fit_model`.
        masks: The parts, each of shape (N,).
        seed: As for `fit_model`.
        whole: The fit of all measurements.
        progress: Told the stage and how much of all is done.
    """
    for k, mask in enumerate(masks):
        stage = f"check {k + 1} of {len(masks)}"
        tell = portion(named(progress, stage), k / len(masks), 1.0 / len(masks))
        # What the fit of all measurements has set aside stays there.
        kept = ~mask & (measurements.weight > 0.0)
        some = measurements.rows(kept)
        model = fit_model(chain, some, setup, seed, tell, part_of=(whole, kept))
        reason = ""
        if not model.fit.structure.scaled:
            reason = "the absolute scale is unobservable"
        elif not model.fit.result.status.success:
            reason = "it did not converge"
        try:
            found = model_errors(model, measurements.rows(mask), np.flatnonzero(mask))
        except InputError as error:
            # Of a place all else may be set aside.
            none = np.zeros((0, model.problem.components))
            nowhere = np.zeros(0, np.intp)
            yield ModelErrors(nowhere, none, none, none, reason=error.reason)
        else:
            yield replace(found, reason=reason)


def _checked_on(
    model: FittedModel, training: Measurements, validation: Measurements, method: str
) -> HeldOut:
    """The check on validation measurements."""
    fitted = model.fit
    findings = []
    new = ~_repeated(training, validation)
    if not new.all():
        some = f"{len(new) - int(new.sum())} of {len(new)}"
        findings.append(
            Finding(
                "repeated-validation",
                "warning",
                f"{some} validation measurements repeat configurations that were "
                "fitted and do not count",
                {"repeated": float(len(new) - new.sum()), "all": float(len(new))},
                "validate with configurations that were not fitted",
            )
        )
    rows = validation.rows(new)
    if rows.configurations < FEWEST:
        return HeldOut(validation, findings=tuple(findings))
    part, moved = registered_if_moved(
        model,
        model_errors(model, rows, np.flatnonzero(new)),
        replace(fitted.problem, data=rows),
    )
    if moved is not None:
        findings.append(moved)
    if part is None:
        return HeldOut(validation, findings=tuple(findings))
    clusters = Grouping.of(validation, fitted.problem.setup).clusters
    found = gains(method, fitted.problem, validation, [part], clusters)
    return HeldOut(validation, (part,), method, found, tuple(findings))


def _repeated(training: Measurements, validation: Measurements) -> NDArray[np.bool_]:
    """Mask of measurements at configurations that were fitted, shape (N,)."""
    q = np.concatenate([training.q[training.weight > 0.0], validation.q])
    values = np.zeros((len(q), validation.values.shape[1]))
    labels = Measurements(validation.joints, q, validation.model, values).groups()
    fitted = labels[: len(q) - len(validation)]
    return np.isin(labels[len(fitted) :], fitted)


def _enough(measurements: Measurements, parts: Sequence[ModelErrors]) -> bool:
    """Whether enough distinct configurations are held out to check anything."""
    if not parts:
        return False
    positions = ModelErrors.joined(parts).positions
    held_out = measurements.rows(positions[measurements.weight[positions] > 0.0])
    return held_out.configurations >= FEWEST


MOVED = 4.0
"""Errors with the station of the fit, by those with one of their own, of an
instrument that was moved. UR10 Series B by the stand of Series A has 6 500; the second
day of TIAGo, which counts as it is, 1.14, other rows of one stand 1.0 to 1.1."""

ALIKE = 0.5
"""Largest difference of the moves that nominal and calibrated robot see, by the move.

A robot that errs in another corner of its workspace looks displaced as well, with
ratios of 2 to 8 between corners of 0.4 rad, but each robot in its own way.
"""

FEWEST = 5
"""Distinct configurations without which a registration on itself checks nothing."""


def registered_if_moved(
    model: FittedModel, errors: ModelErrors, problem: Problem
) -> tuple[ModelErrors | None, Finding | None]:
    """Errors of validation measurements, registered on themselves if it was moved.

    With S the sum of squared errors as it is and S' registered, of M values and k
    unknowns of the station, it has moved if `S / M > MOVED^2 S' / (M - k)` for the
    calibrated robot and the nominal one sees about the same move. The F test of the
    same hypothesis, `(S - S') / k` against `S' / (M - k)`, then is far beyond chance.

    Args:
        model: The fitted model.
        errors: The errors as they are.
        problem: Problem of these measurements, for their standard deviations.

    Returns:
        The errors, None where the measurements say no more than where the instrument
        stood; and a finding, None where it stood where it did for the fit.
    """
    rows = problem.data
    before = _registered(model.fit.problem, model.fit.before, rows)
    after = _registered(model.problem, model.theta, rows)
    if after is None or before is None:
        return errors, None
    own = errors_of_registered(model, before, after, errors.positions)
    values, unknowns = problem.values, len(after.refitted)
    left = max(values - unknowns, 1)
    as_is, on_itself = (_chi_square(part.after, problem) for part in (errors, own))
    moved = as_is * left > MOVED**2 * on_itself * values
    if not moved or not _alike(errors, own, problem):
        return errors, None
    numbers = {
        "chi-square as it is": as_is,
        "chi-square registered": on_itself,
        "values": float(values),
        "unknowns": float(unknowns),
    }
    seen = "the instrument had another station for the validation measurements"
    rms = [np.sqrt(square / values) for square in (as_is, on_itself)]
    if distinct_values(problem) <= unknowns or rows.configurations < FEWEST:
        return None, Finding(
            "moved-instrument",
            "warning",
            f"{seen}, which are too few for a check from there: "
            f"{distinct_values(problem)} distinct values, {unknowns} unknowns",
            numbers,
            "measure more validation configurations from one station",
        )
    return own, Finding(
        "moved-instrument",
        "warning",
        f"{seen}: with the station of the fit they are off by {rms[0]:.3g} standard "
        f"deviations, with their own by {rms[1]:.3g}; both robots are registered on "
        "them",
        numbers,
    )


def _registered(
    problem: Problem, theta: Floats, rows: Measurements
) -> Registered | None:
    """A fitted problem with a station by other measurements; None where it is known.

    The base and the instrument's references beside it are estimated; tool and robot
    stay.
    """
    there = registered(problem, theta, rows)
    moved, values = there.problem.rebased(there.theta)
    parameters = moved.parameters
    outer = np.array([p.outer for p in parameters], bool)
    # The base comes first; what stands on the tool stays with the robot.
    outer[:6] |= parameters.nuisance[:6]
    _, J = moved.linearize(values)
    free = np.flatnonzero(outer & parameters.nuisance & parameters.free & J.any(axis=0))
    if len(free) == 0:
        return None
    basis = np.diag(parameters.scales)[:, free]
    plain = replace(moved, setup=replace(moved.setup, distances=()))
    starts = [plain]
    if parameters.free[:6].all() and not moved.data.start.size:
        starts.append(_from_afar(plain, values))
    found = [(least_squares(start, values, basis), start) for start in starts]
    result, start = min(
        found, key=lambda pair: pair[0].cost if np.isfinite(pair[0].cost) else np.inf
    )
    # Known distances count again; they are found, not fitted.
    start = replace(start, setup=moved.setup)
    return Registered(start, result.x, there.new, tuple(free.tolist()))


def _from_afar(problem: Problem, theta: Floats) -> Problem:
    """The problem about a closed-form base, the tool where it is."""
    few = problem.data.sample(SAMPLE)
    F = problem.error.tip_poses(few.q, problem.split(theta)[0], few.payload)
    tool = problem.error.tool
    measurement, base, tool = problem.measurement.register(F, few, None, tool)
    return replace(
        problem,
        error=problem.error.with_frames(base, tool),
        measurement=measurement,
    )


def _alike(errors: ModelErrors, own: ModelErrors, problem: Problem) -> bool:
    """Whether both robots see about the same move, in the median measurement."""
    unit = np.where(np.isfinite(problem.sigma), problem.sigma, np.inf)
    with np.errstate(invalid="ignore"):
        nominal, calibrated = (
            np.nan_to_num((a - b) / unit, posinf=0.0, neginf=0.0)
            for a, b in ((errors.before, own.before), (errors.after, own.after))
        )
    moves = np.linalg.norm(calibrated, axis=1)
    apart = np.linalg.norm(nominal - calibrated, axis=1)
    return bool(np.median(apart) < ALIKE * np.median(moves))


def _chi_square(errors: Floats, problem: Problem) -> float:
    """Sum of squared errors in standard deviations."""
    present = np.isfinite(problem.sigma)
    whitened = errors[present] / problem.sigma[present]
    return float(whitened @ whitened)
