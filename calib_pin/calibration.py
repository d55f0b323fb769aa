"""Calibrate a robot from measurements and judge the result.

`calibrate` fits all training rows, checks the fit on rows it has not seen and says
what of the robot can be known. `identify` looks at the structure without measurements.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib_pin.assessment import (
    CHECK,
    estimates,
    fitted_ranks,
    structural_ranks,
    unexplained,
    verdict,
)
from calib_pin.chain import Chain
from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.fit import analyze_structure
from calib_pin.formulation import nominal_problem
from calib_pin.joint_readings import suggest_readings
from calib_pin.ladder import climb
from calib_pin.measurements import AT, Measurements
from calib_pin.progress import Stages, named, portion
from calib_pin.result import (
    Accuracy,
    CalibratedModel,
    CalibrationResult,
    Identification,
    QuantityErrors,
    UrdfResult,
)
from calib_pin.row_errors import RowErrors
from calib_pin.setup import Setup
from calib_pin.splits import FOLDS, folds, shuffled_groups, validation_name
from calib_pin.threads import serial_blas
from calib_pin.tip_accuracy import tip_accuracy
from calib_pin.training import (
    Trained,
    Unseen,
    cross_validate,
    geometry_alone,
    train,
)

__all__ = ["calibrate", "identify"]


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
            `ladder.climb`.
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
    training, unseen, method = _split(measurements, setup, validation, holdout, seed)
    _require_ends(
        setup, (measurements,) if validation is None else (measurements, validation)
    )
    climbed = climb(chain, training, setup, seed, progress) if ladder else None
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

    checks: tuple[Unseen, ...] = ()
    spoiled: tuple[str, ...] = ()
    if not validate:
        method = "none"
    elif unseen is not None:
        checks = (trained.unseen(unseen),)
    else:
        masks = folds(training, trained.fit, seed)
        if climbed is not None:
            checks = climbed.unseen
        elif masks:
            checks = tuple(
                cross_validate(chain, training, setup, masks, seed, checking)
            )
        method = validation_name(training, setup, masks[: len(checks)])
        # A part without which nothing fits tells nothing of the robot.
        spoiled = tuple(check.reason for check in checks if check.reason)
        checks = tuple(check for check in checks if not check.reason)
        method = method if checks else "none"
    fitted = trained.fit
    known = trained.unseen(training)
    errors = tuple(_quantity_errors(trained, known, checks))
    advice = CHECK
    if unexplained(fitted, errors):
        tell = named(progress, "joint readings")
        if suggestion := suggest_readings(chain, training, setup, tell):
            advice = suggestion.text(chain.joints, setup.joints)
    status, reason = verdict(fitted, errors, advice)
    urdf = _urdf(chain, training, trained, unseen if validate else None, seed)
    found, groups = estimates(fitted.problem.parameters, fitted.structure, fitted)
    return CalibrationResult(
        model=CalibratedModel.create(trained.problem, trained.theta),
        reference=CalibratedModel.create(fitted.problem, np.zeros_like(fitted.theta)),
        verdict=status,
        reason=reason,
        parameters=found,
        groups=groups,
        identifiability=fitted_ranks(fitted),
        errors=errors,
        validation=method,
        training=len(training),
        validated=sum(len(check.before) for check in checks),
        chi2=2.0 * fitted.result.cost,
        dof=fitted.dof,
        sigma0=fitted.sigma0,
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
        fitted=_row_errors(trained, training, [known]),
        unseen=_row_errors(trained, training if unseen is None else unseen, checks)
        if checks
        else None,
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
        silent=trained.silent,
        distances=trained.distances
        + tuple(distance for check in checks for distance in check.distances),
        placed=tuple(dict.fromkeys(name for check in checks for name in check.placed)),
        spoiled=spoiled,
    )


@serial_blas
def identify(
    chain: Chain, model: str, setup: Setup | None = None, *, seed: int = 0
) -> Identification:
    """What a robot measured in one way can reveal, without measurements.

    Args:
        chain: The nominal chain.
        model: Name of the measurement model.
        setup: What is estimated and what is known.
        seed: Seed of the random configurations.

    Raises:
        OptionError: If a name does not exist, or the instrument lacks a reference.

    Example:
        >>> import calib_pin
        >>> found = calib_pin.identify(calib_pin.load_chain("pa10"), "pose")
        >>> found.identifiability.rank, found.identifiability.everett
        (34, 34)
    """
    problem = nominal_problem(chain, model, setup or Setup())
    theta = np.zeros(len(problem.parameters))
    found, _ = analyze_structure(problem, theta, np.random.default_rng(seed))
    parameters, groups = estimates(problem.parameters, found)
    return Identification(
        parameters, groups, structural_ranks(problem.parameters, found, chain)
    )


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


def _split(
    measurements: Measurements,
    setup: Setup,
    validation: Measurements | None,
    holdout: float | None,
    seed: int,
) -> tuple[Measurements, Measurements | None, str]:
    """Training rows, unseen rows if there are any, and how they were chosen."""
    if validation is not None and holdout is not None:
        raise OptionError("give validation rows or a holdout, not both")
    training, unseen = measurements.split()
    if len(training) == 0:
        raise InputError("no row is left to fit: all are marked for validation")
    if validation is not None:
        if len(validation) == 0:
            raise InputError("there are no rows to validate with")
        if validation.model != measurements.model:
            raise InputError(
                f"cannot check '{measurements.model}' measurements with "
                f"'{validation.model}' ones"
            )
        return training, validation, "file"
    if holdout is not None:
        if not 0.0 < holdout < 1.0:
            raise OptionError(
                "holdout is out of range", value=holdout, allowed="between 0 and 1"
            )
        labels, order = shuffled_groups(training, setup, seed)
        count = max(1, round(holdout * len(training)))
        size = np.cumsum(np.bincount(labels)[order])
        chosen = np.zeros(len(order), bool)
        chosen[order[: int(np.searchsorted(size, count)) + 1]] = True
        mask = chosen[labels]
        if mask.all():
            raise OptionError("holdout leaves no row to fit", value=holdout)
        return training.rows(~mask), training.rows(mask), "holdout"
    return training, unseen if len(unseen) else None, "set"


def _urdf(
    chain: Chain,
    rows: Measurements,
    trained: Trained,
    unseen: Measurements | None,
    seed: int,
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
    if unseen is not None:
        checks = [geometry.unseen(unseen)]
    else:
        masks = folds(rows, geometry.fit, seed)
        checks = list(cross_validate(chain, rows, setup, masks, seed))
    errors = tuple(_quantity_errors(geometry, geometry.unseen(rows), checks))
    _, reason = verdict(geometry.fit, errors)
    return UrdfResult(
        CalibratedModel.create(geometry.problem, geometry.theta), errors, reason
    )


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
    trained: Trained, known: Unseen, unseen: Sequence[Unseen]
) -> Iterator[QuantityErrors]:
    """Accuracy before and after, on the fitted and on the unseen rows."""
    stages = known.before, known.after
    parts = []
    if unseen:
        parts = [
            np.concatenate([check.before for check in unseen]),
            np.concatenate([check.after for check in unseen]),
        ]
    for quantity in trained.problem.measurement.quantities:
        before, after = (Accuracy.of(quantity.errors(errors)) for errors in stages)
        sizes = [quantity.errors(errors) for errors in parts]
        # Of mixed rows, those that are unseen may all be of another model.
        accuracies = [Accuracy.of(size) for size in sizes if len(size)]
        yield QuantityErrors(
            quantity.name, quantity.unit, before, after, *(accuracies or (None, None))
        )
