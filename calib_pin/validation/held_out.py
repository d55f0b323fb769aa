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
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding, Gain
from calib_pin.estimation.fit import FittedModel, fit_model
from calib_pin.estimation.registration import extended
from calib_pin.observations import Observations, grouped
from calib_pin.progress import Stages
from calib_pin.validation.findings.moved_instrument import registered_if_moved
from calib_pin.validation.gains import PRESS, gains
from calib_pin.validation.left_out import left_out, press_check, unusable
from calib_pin.validation.model_errors import ModelErrors, both, model_errors
from calib_pin.validation.splits import FEWEST_HELD_OUT, Grouping, folds
from calib_pin.workers import SERIAL, Workers


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
        apart: Whether the measurements are others than those that were fitted.
    """

    measurements: Observations
    parts: tuple[ModelErrors, ...] = ()
    method: str = "none"
    gains: tuple[Gain, ...] = ()
    findings: tuple[Finding, ...] = ()
    skipped: tuple[str, ...] = ()
    apart: bool = False

    @property
    def counted(self) -> tuple[ModelErrors, ...]:
        """The parts without rejected measurements (weight zero)."""
        return tuple(part.counted(self.measurements.weight) for part in self.parts)


def check(
    model: FittedModel,
    training: Observations,
    seed: int,
    *,
    validation: Observations | None = None,
    method: str = "set",
    validate: bool = True,
    parts: Sequence[ModelErrors] | None = None,
    progress: Stages | None = None,
    workers: Workers = SERIAL,
) -> HeldOut:
    """Check a model on validation measurements, or by cross-validation without any.

    Args:
        model: The model.
        training: The measurements that it was fitted to.
        seed: Seed of the split and of further fits.
        validation: Validation measurements; None for a cross-validation.
        method: How the validation measurements were chosen; see `HeldOut.method`.
        validate: Whether to validate; if not, only the hat matrix is used.
        parts: Errors of a cross-validation with the same folds; None to run it.
        progress: Told the stage and the fraction done.
        workers: Who fits the folds of a cross-validation.
    """
    fitted = model.fit
    training = model.weighted(training)
    grouping = Grouping.of(training, fitted.problem.setup)
    problem = replace(fitted.problem, data=training)
    pressed: tuple[Gain, ...] = ()
    if fitted.dof > 0:  # Without redundancy the hat matrix says nothing.
        press = press_check(fitted, grouping.groups)
        pressed = gains(PRESS, problem, [press], grouping.clusters)
    if not validate:
        return HeldOut(training, gains=pressed)
    if validation is not None:
        found = _checked_on(model, training, validation, method)
        return replace(found, gains=found.gains + pressed, apart=True)
    masks = folds(grouping, fitted, seed)
    if parts is None:
        validated = cross_validate(model, training, masks, seed, progress, workers)
        parts = tuple(validated)
    # A fit that fails without its fold says nothing about the robot.
    kept = tuple(part for part in parts if not part.reason)
    held = np.zeros(len(training), bool)
    for part in kept:
        held[part.positions] = training.weight[part.positions] > 0.0
    if training.rows(held).configurations < FEWEST_HELD_OUT:
        kept = ()
    name = grouping.validation_name(min(len(kept), len(masks)))
    every = gains(name, problem, kept, grouping.clusters) + pressed
    skipped = tuple(part.reason for part in parts if part.reason)
    return HeldOut(training, kept, name, every, skipped=skipped)


def cross_validate(
    whole: FittedModel,
    measurements: Observations,
    masks: Sequence[NDArray[np.bool_]],
    seed: int,
    progress: Stages | None = None,
    workers: Workers = SERIAL,
) -> Iterator[ModelErrors]:
    """Errors of each part of the measurements by a model fitted to the others.

    Args:
        whole: The model fitted to all measurements.
        measurements: The N measurements.
        masks: The parts, each of shape (N,).
        seed: As for `fit_model`.
        progress: Told the stage and the fraction done of all parts.
        workers: Who fits those parts that take a fit.
    """
    found = left_out(whole, masks, seed)
    if whole.fit.problem.many:
        # Their kernels keep all cores busy, and every worker would have a copy.
        workers = SERIAL
    shared = whole, measurements, seed
    left = [mask for mask, one in zip(masks, found, strict=True) if one is None]
    refits = workers.map(_refitted, shared, left)
    for k, one in enumerate(found, 1):
        if progress is not None:
            progress(f"check {k} of {len(found)}", (k - 1) / len(found))
        yield next(refits) if one is None else one


@serial_blas
def _refitted(
    shared: tuple[FittedModel, Observations, int], mask: NDArray[np.bool_]
) -> ModelErrors:
    """Errors of a part of the measurements, of shape (N,), by a fit of the others."""
    (whole, measurements, seed), fit = shared, shared[0].fit
    # Measurements that the fit of all has rejected stay rejected.
    some = measurements.rows(~mask & (measurements.weight > 0.0))
    layout = fit.problem.layout
    try:
        # Where all of them taught nothing, some teach no more.
        known = fit.problem.chains, some, whole.problem.setup
        model = fit_model(*known, seed, effects_of=fit)
        if model.problem.layout.quantities != layout.quantities:
            raise InputError("all others of an instrument are set aside")
        found = model_errors(model, measurements.rows(mask), np.flatnonzero(mask))
    except InputError as error:
        # All other measurements of a reference may be rejected.
        none = np.zeros((0, layout.width))
        return ModelErrors(np.zeros(0, np.intp), none, none, none, reason=error.reason)
    return replace(found, reason=unusable(model.fit))


def _checked_on(
    model: FittedModel, training: Observations, validation: Observations, method: str
) -> HeldOut:
    """The check on validation measurements."""
    findings, part = list[Finding](), None
    q = training.q[training.weight > 0.0]
    labels = grouped(np.concatenate([q, validation.q]))
    new = ~np.isin(labels[len(q) :], labels[: len(q)])
    if repeated := len(new) - int(new.sum()):
        said = f"{repeated} of {len(new)} validation measurements repeat "
        said += "configurations that were fitted and do not count"
        numbers = {"repeated": float(repeated), "all": float(len(new))}
        remedy = "validate with configurations that were not fitted"
        findings.append(
            Finding("repeated-validation", "warning", said, numbers, remedy)
        )
    if new.any():
        pair = both(model, validation.rows(new))
        part, moved = registered_if_moved(model, *pair, np.flatnonzero(new))
        findings += moved
    if part is None:
        return HeldOut(validation, findings=tuple(findings))
    clusters = Grouping.of(validation, model.problem.setup).clusters
    there, _ = extended(model.problem, model.theta, validation)
    found = gains(method, there, [part], clusters)
    return HeldOut(validation, (part,), method, found, tuple(findings))
