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
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Measurements
from calib_pin.progress import Stages, named, portion
from calib_pin.setup import Setup
from calib_pin.validation.gains import PRESS, gains, press_check
from calib_pin.validation.model_errors import ModelErrors, model_errors
from calib_pin.validation.moved_instrument import FEWEST, registered_if_moved
from calib_pin.validation.splits import Grouping, folds


@dataclass(frozen=True)
class HeldOut:
    """What held-out measurements say of a fitted model.

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
            yield ModelErrors.empty(model.problem.components, error.reason)
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
