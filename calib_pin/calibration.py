"""Calibrate a robot from measurements and judge the result.

`calibrate` fits all training rows, checks the fit on rows it has not seen and says
what of the robot can be known. `identify` looks at the structure without measurements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import OptionError, nearest
from calib_pin.estimation.evidence import ExpectedAccuracy, Finding
from calib_pin.estimation.joint_conventions import suggest_conventions
from calib_pin.estimation.tip_accuracy import tip_accuracy
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import AT, Measurements
from calib_pin.progress import Progress, Stages, named, portion
from calib_pin.setup import Setup
from calib_pin.validation.assessment import estimates, fitted_ranks
from calib_pin.validation.expected_accuracy import expected_accuracy
from calib_pin.validation.held_out import Checked, check, counting, split
from calib_pin.validation.model_selection import select_model
from calib_pin.validation.plausibility import plausibility
from calib_pin.validation.result import (
    Accuracy,
    CalibratedModel,
    CalibrationResult,
    QuantityErrors,
    UrdfResult,
)
from calib_pin.validation.row_errors import RowErrors
from calib_pin.validation.splits import FOLDS
from calib_pin.validation.tip_drift import tip_drift
from calib_pin.validation.training import (
    Trained,
    geometry_alone,
    train,
)
from calib_pin.validation.unseen import Unseen
from calib_pin.validation.verdict import CHECK, Grounds, unexplained, verdict

__all__ = ["calibrate"]

MEASURED, SAMPLES = 100, 300
"""Configurations at which the tool is predicted, measured ones and others."""


@serial_blas
def calibrate(
    chain: Chain,
    measurements: Measurements,
    setup: Setup | None = None,
    *,
    validation: Measurements | None = None,
    holdout: float | None = None,
    validate: bool = True,
    ladder: bool = False,
    seed: int = 0,
    progress: Stages | None = None,
) -> CalibrationResult:
    """Calibrate a chain.

    Args:
        chain: The nominal chain.
        measurements: Measurements; rows marked for validation are not fitted.
        setup: What is estimated and what is known; default six errors of every joint
            placement with base and tool unknown.
        validation: Further rows for validation.
        holdout: Part of the rows, 0 to 1, that is set aside for validation.
        validate: Whether to check the fit on unseen rows; without any of the above
            by cross-validation.
        ladder: Judge models from joint offsets to a learned correction by
            cross-validation, and calibrate with the simplest of the best; see
            `ladder.select_model`.
        seed: Seed of random configurations, searches and splits.
        progress: Told the stage and the part that is done, 0 to 1.

    Returns:
        The result. Look at `verdict` before using it.

    Raises:
        InputError: If the measurements do not fit the model.
        OptionError: If a name in the setup does not exist, the holdout is not
            between 0 and 1, or the rows are too few for what is to be learned.

    Example:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space7")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space7", "measurements.csv"), chain
        ... )
        >>> result = calib_pin.calibrate(chain, rows, setup)
        >>> result.verdict, result.identifiability.structural_rank
        ('good', 34)
    """
    setup = setup or Setup()
    if validation is not None:
        validation = validation.among(measurements.model)
    training, unseen, method = split(measurements, setup, validation, holdout, seed)
    _require_ends(
        setup, (measurements,) if validation is None else (measurements, validation)
    )
    climbed = select_model(chain, training, setup, seed, progress) if ladder else None
    alone = unseen is not None or not validate
    share = 1.0 if alone else 1.0 / (1 + FOLDS)
    if climbed is not None:
        trained = climbed.trained
    else:
        tell = portion(named(progress, "fit"), 0.0, share)
        trained = train(chain, training, setup, seed, tell)

    def checking(stage: str, part: float) -> None:
        if progress is not None:
            progress(stage, share + (1.0 - share) * part)

    checked = check(
        chain,
        training,
        setup,
        trained,
        seed,
        unseen=unseen,
        method=method,
        validate=validate,
        parts=None if climbed is None else climbed.unseen,
        progress=checking,
    )
    checks = checked.parts
    fitted = trained.fit
    known = trained.unseen(training, predict=False)
    judged = _judged(
        chain, trained, known, checked, seed, named(progress, "joint readings")
    )
    urdf = _urdf(chain, training, trained, unseen, seed, validate)
    found, groups = estimates(fitted.problem.parameters, fitted.structure, fitted)
    # Against what the rows state, or what was assumed.
    chi2 = 2.0 * replace(fitted.problem, units=np.zeros(0)).cost(fitted.theta)
    return CalibrationResult(
        model=CalibratedModel.create(trained.problem, trained.theta),
        reference=CalibratedModel.create(fitted.problem, np.zeros_like(fitted.theta)),
        verdict=judged.status,
        reason=judged.reason,
        parameters=found,
        groups=groups,
        identifiability=fitted_ranks(fitted),
        errors=judged.errors,
        validation=checked.method,
        training=len(training),
        validated=sum(len(part.before) for part in checked.counted),
        chi2=chi2,
        dof=fitted.dof,
        sigma0=float(np.sqrt(chi2 / fitted.dof)) if fitted.dof > 0 else np.nan,
        stated_sigma=training.stated,
        outliers=fitted.outliers,
        solver=fitted.solver,
        evaluator=fitted.evaluator,
        history=tuple(
            () if fitted.evolution is None else fitted.evolution.best_history.tolist()
        ),
        status=fitted.result.status,
        at_bounds=tuple(
            fitted.problem.parameters[k].name for k in sorted(fitted.problem.held_at)
        ),
        iterations=fitted.result.nit,
        evaluations=fitted.result.nfev,
        seed=seed,
        covariance=fitted.covariance,
        fitted=_row_errors(trained, counting(training, fitted), [known]),
        unseen=_row_errors(trained, checked.rows, checks) if checks else None,
        tip=tip_accuracy(fitted, trained.problem, trained.theta, seed),
        files=tuple(
            name
            for name in dict.fromkeys(
                measurements.files + (() if validation is None else validation.files)
            )
            if name
        ),
        ladder=None if climbed is None else climbed.ladder,
        urdf=urdf,
        rejected=trained.rejected,
        distances=trained.distances
        + tuple(distance for part in checks for distance in part.distances),
        placed=tuple(dict.fromkeys(name for part in checks for name in part.placed)),
        skipped=checked.skipped,
        gains=checked.gains,
        findings=judged.findings,
        noise=fitted.noise,
        measured=judged.measured,
        workspace=judged.workspace,
        displaced=_displaced(trained, seed),
    )


@serial_blas
def _require_ends(setup: Setup, parts: Sequence[Measurements]) -> None:
    """Refuse known distances between what no row names.

    Raises:
        OptionError: If there are such.
    """
    names = {
        half
        for rows in parts
        for part in rows.parts
        for target in dict.fromkeys(rows.of(part))
        for half in target.split(AT)
    }
    for distance in setup.distances:
        for end in distance.between:
            if end not in names:
                reason = f"'distances' names '{end}', which no row does"
                raise OptionError(
                    f"{reason}{nearest(end, names)}",
                    file=setup.file or None,
                    value=list(distance.between),
                    allowed=", ".join(sorted(filter(None, names))) or None,
                )


def _urdf(
    chain: Chain,
    rows: Measurements,
    trained: Trained,
    unseen: Measurements | None,
    seed: int,
    validate: bool,
) -> UrdfResult | None:
    """The geometry alone, judged like a calibration of its own.

    None where the calibration is nothing but geometry.
    """
    if trained.problem.error.geometric:
        return None
    setup = geometry_alone(chain, rows, trained.fit.problem.setup)
    if not setup.parameters:
        return UrdfResult(None, (), "nothing of this calibration has a place in a URDF")
    if setup.parameters == trained.fit.problem.setup.parameters:
        fitted = trained.fit
        geometry = Trained(fitted, *fitted.problem.at(fitted.theta))
    else:
        geometry = train(chain, rows, setup, seed)
    checked = check(
        chain, rows, setup, geometry, seed, unseen=unseen, validate=validate
    )
    known = geometry.unseen(rows, predict=False)
    judged = _judged(chain, geometry, known, checked, seed)
    return UrdfResult(
        CalibratedModel.create(geometry.problem, geometry.theta),
        judged.errors,
        "" if judged.status == "good" else judged.reason,
    )


@dataclass(frozen=True)
class _Judged:
    """A verdict with what it is based on; see `CalibrationResult`."""

    status: str
    reason: str
    errors: tuple[QuantityErrors, ...]
    findings: tuple[Finding, ...]
    measured: ExpectedAccuracy | None
    workspace: ExpectedAccuracy | None


def _judged(
    chain: Chain,
    trained: Trained,
    known: Unseen,
    checked: Checked,
    seed: int,
    progress: Progress | None = None,
) -> _Judged:
    """Judge what was trained.

    Args:
        chain: The nominal chain.
        trained: It.
        known: Errors of its own rows.
        checked: What held-out rows say of it.
        seed: Seed of configurations.
        progress: Told how far the search for other joint readings is.
    """
    fitted, data = trained.fit, trained.fit.problem.data
    errors = _quantity_errors(trained, known, checked)
    advice = CHECK
    if unexplained(fitted, errors):
        setup = fitted.problem.setup
        if suggestion := suggest_conventions(chain, data, setup, progress):
            advice = suggestion.text(chain.joints, setup.joints)
    findings = checked.findings + plausibility(fitted)
    measured = workspace = None
    if fitted.noise:
        rng = np.random.default_rng(seed)
        kept = data.rows(data.weight > 0.0).sample(MEASURED)
        spread = chain.random_configurations(SAMPLES, rng)
        measured, workspace = (
            expected_accuracy(fitted, trained.problem, trained.theta, q, rng)
            for q in (kept.q, spread)
        )
    groups = data.groups()
    aside = 1.0 - len(np.unique(groups[data.weight > 0.0])) / max(groups.max() + 1, 1)
    status, reason = verdict(
        Grounds(
            fitted,
            errors,
            checked.gains,
            findings,
            workspace,
            max(aside, fitted.disagreement),
            advice,
        )
    )
    return _Judged(status, reason, errors, findings, measured, workspace)


def _displaced(trained: Trained, seed: int) -> float | None:
    """How far the tool would be off with what was set aside [m]; None without it."""
    squared = trained.fit.squared
    if squared is None:
        return None
    first = CalibratedModel.create(trained.fit.problem, trained.fit.theta)
    second = CalibratedModel.create(squared.problem, squared.theta)
    return tip_drift(first, second, base=True, tool=True, seed=seed).position.rms


def _row_errors(
    trained: Trained, rows: Measurements, checks: Sequence[Unseen]
) -> RowErrors:
    """Errors of rows that were looked at in one or several parts."""
    positions = np.concatenate([check.positions for check in checks])
    # In the order of their files.
    order = np.argsort(positions, kind="stable")
    before, after = (
        np.concatenate([getattr(check, stage) for check in checks])[order]
        for stage in ("before", "after")
    )
    rows = rows.rows(positions[order])
    return RowErrors.of(trained.problem, trained.theta, rows, before, after)


def _quantity_errors(
    trained: Trained, known: Unseen, checked: Checked
) -> tuple[QuantityErrors, ...]:
    """Accuracy before and after, on the fitted and on the unseen rows."""
    known = known.counted(trained.fit.problem.data.weight)
    parts = checked.counted
    found = []
    for quantity in trained.problem.measurement.quantities:
        sizes = [quantity.errors(errors) for errors in (known.before, known.after)]
        if parts:
            # Of mixed rows, those that are unseen may all be of another model.
            for stage in ("before", "after"):
                errors = np.concatenate([getattr(part, stage) for part in parts])
                sizes.append(quantity.errors(errors))
        accuracies = [Accuracy.of(size) if len(size) else None for size in sizes]
        before, after, *unseen = accuracies
        assert before is not None and after is not None
        found.append(
            QuantityErrors(
                quantity.name, quantity.unit, before, after, *(unseen or (None, None))
            )
        )
    return tuple(found)
