"""The judgement of a fitted model: its accuracy, what is wrong with it, the verdict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.evidence import ExpectedAccuracy, Finding
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.joint_conventions import suggest_conventions
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.progress import Progress
from calib_pin.validation.expected_accuracy import expected_accuracy
from calib_pin.validation.held_out import HeldOut
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.plausibility import plausibility
from calib_pin.validation.result import Accuracy, QuantityErrors
from calib_pin.validation.verdict import CHECK, Grounds, unexplained, verdict

MEASURED, SAMPLES = 100, 300
"""Configurations at which the tool is predicted, measured ones and others."""


@dataclass(frozen=True)
class Judgement:
    """A verdict with what it is based on; see `CalibrationResult`."""

    status: str
    reason: str
    errors: tuple[QuantityErrors, ...]
    findings: tuple[Finding, ...]
    measured: ExpectedAccuracy | None
    workspace: ExpectedAccuracy | None


def judge(
    chain: Chain,
    model: FittedModel,
    fitted_errors: ModelErrors,
    held_out: HeldOut,
    seed: int,
    progress: Progress | None = None,
) -> Judgement:
    """Judge a fitted model.

    Args:
        chain: The nominal chain.
        model: The model.
        fitted_errors: Errors of the measurements that were fitted.
        held_out: What held-out measurements say of it.
        seed: Seed of configurations.
        progress: Told how far the search for other joint conventions is.
    """
    fitted, data = model.fit, model.fit.problem.data
    errors = _quantity_errors(model, fitted_errors, held_out)
    advice = CHECK
    if unexplained(fitted, errors):
        setup = fitted.problem.setup
        if suggestion := suggest_conventions(chain, data, setup, progress):
            advice = suggestion.text(chain.joints, setup.joints)
    findings = held_out.findings + plausibility(fitted)
    counting = data.weight > 0.0
    measured = workspace = None
    if fitted.noise:
        rng = np.random.default_rng(seed)
        kept = data.rows(counting).sample(MEASURED)
        spread = chain.random_configurations(SAMPLES, rng)
        measured, workspace = (
            expected_accuracy(fitted, model.problem, model.theta, q, rng)
            for q in (kept.q, spread)
        )
    groups = data.groups()
    aside = 1.0 - len(np.unique(groups[counting])) / max(groups.max() + 1, 1)
    status, reason = verdict(
        Grounds(
            fitted,
            errors,
            held_out.gains,
            findings,
            workspace,
            max(aside, fitted.robust.disagreement),
            advice,
        )
    )
    return Judgement(status, reason, errors, findings, measured, workspace)


def _quantity_errors(
    model: FittedModel, fitted_errors: ModelErrors, held_out: HeldOut
) -> tuple[QuantityErrors, ...]:
    """Accuracy before and after, of the fitted and of the held-out measurements."""
    known = fitted_errors.counted(model.fit.problem.data.weight)
    parts = held_out.counted
    checked = ModelErrors.joined(parts) if parts else None
    found = []
    for quantity in model.problem.measurement.quantities:
        before, after = _accuracies(quantity, known)
        assert before is not None and after is not None
        validation = (None, None) if checked is None else _accuracies(quantity, checked)
        found.append(
            QuantityErrors(quantity.name, quantity.unit, before, after, *validation)
        )
    return tuple(found)


def _accuracies(
    quantity: Quantity, errors: ModelErrors
) -> tuple[Accuracy | None, Accuracy | None]:
    """Accuracy before and after; None where no measurement has the quantity."""
    # Of mixed measurements, those held out may all be of another model.
    before, after = (
        Accuracy.of(sizes) if len(sizes) else None
        for sizes in map(quantity.errors, (errors.before, errors.after))
    )
    return before, after
