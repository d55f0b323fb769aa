"""Calibrate a robot from measurements and judge the result.

`calibrate` fits all training rows, checks the fit on rows it has not seen and says
what of the robot can be known. `evaluate` measures the accuracy of a robot or a
calibration on other data. `identify` looks at the structure without measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.assessment import (
    estimates,
    fitted_ranks,
    outliers,
    registration_reason,
    structural_ranks,
    verdict,
)
from calib_pin.chain import Chain
from calib_pin.error_model import ErrorModel
from calib_pin.errors import InputError, OptionError
from calib_pin.fit import Fit, analyze_structure, fit, register
from calib_pin.measurement_models import measurement_model
from calib_pin.measurements import Measurements
from calib_pin.problem import Problem, frame_pose
from calib_pin.result import (
    Accuracy,
    CalibratedModel,
    CalibrationResult,
    Evaluation,
    Identification,
    QuantityErrors,
)
from calib_pin.setup import Setup
from calib_pin.spatial import Floats

__all__ = ["calibrate", "evaluate", "identify", "make_problem", "nominal_problem"]

FOLDS = 5
"""Parts of a cross-validation."""

FEWEST = 4
"""Configurations of every target without which there is no cross-validation."""


def make_problem(chain: Chain, data: Measurements, setup: Setup) -> Problem:
    """Error model, measurement model and data of a setup put together.

    A measuring frame of its own exists for positions and poses. A ranger measures
    against a plane given in the base, which is known unless the setup frees it.

    Raises:
        OptionError: If a name in the setup does not exist.
    """
    model = measurement_model(data.model, setup, data.target)
    base, tool = setup.base_frame.estimate, setup.tool_frame.estimate
    error = ErrorModel.create(
        chain,
        setup.parameters,
        estimate_base=model.measuring_frame if base is None else base,
        estimate_tool=True if tool is None else tool,
    )
    return Problem(error, model, data, setup)


def calibrate(
    chain: Chain,
    measurements: Measurements,
    setup: Setup | None = None,
    *,
    validation: Measurements | None = None,
    holdout: float | None = None,
    validate: bool = True,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
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
        seed: Seed of random configurations, searches and splits.
        progress: Told the stage and the part that is done, 0 to 1.

    Returns:
        The result. Look at `verdict` before using it.

    Raises:
        InputError: If the measurements do not fit the model.
        OptionError: If a name in the setup does not exist or the holdout is not
            between 0 and 1.

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
    training, unseen, method = _split(measurements, validation, holdout, seed)
    stages = 1 if unseen is not None or not validate else 1 + FOLDS

    def run(rows: Measurements, stage: int) -> Fit:
        furthest = 0.0

        def report(part: float) -> None:
            # A solver may search several times.
            nonlocal furthest
            furthest = max(furthest, part)
            if progress is not None:
                name = f"check {stage} of {FOLDS}" if stage else "fit"
                progress(name, (stage + furthest) / stages)

        report(0.0)
        problem = make_problem(chain, rows, setup)
        return fit(problem, np.random.default_rng(seed), progress=report)

    fitted = run(training, 0)
    checks: list[tuple[Floats, Floats]] = []
    if not validate:
        method = "none"
    elif unseen is not None:
        checks = [_unseen_errors(fitted, unseen)]
    else:
        folds = _folds(training, fitted, seed)
        for k, rows in enumerate(folds, 1):
            part = run(training.rows(~rows), k)
            checks.append(_unseen_errors(part, training.rows(rows)))
        method = f"{len(folds)}-fold" if folds else "none"
    errors = tuple(_quantity_errors(fitted, checks))
    status, reason = verdict(fitted, errors)
    found, groups = estimates(fitted.problem.parameters, fitted.structure, fitted)
    return CalibrationResult(
        model=CalibratedModel.create(fitted.problem, fitted.theta),
        reference=CalibratedModel.create(fitted.problem, np.zeros_like(fitted.theta)),
        verdict=status,
        reason=reason,
        parameters=found,
        groups=groups,
        identifiability=fitted_ranks(fitted),
        errors=errors,
        validation=method,
        training=len(training),
        validated=sum(len(before) for before, _ in checks),
        chi2=2.0 * fitted.result.cost,
        dof=fitted.dof,
        sigma0=fitted.sigma0,
        stated_sigma=training.sigma is not None,
        outliers=outliers(fitted),
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
        files=tuple(
            name
            for name in dict.fromkeys(
                measurements.files + (() if validation is None else validation.files)
            )
            if name
        ),
    )


def evaluate(
    robot: Chain | CalibratedModel,
    measurements: Measurements,
    setup: Setup | None = None,
    *,
    registration: bool = False,
) -> Evaluation:
    """Accuracy of a robot on measurements, all rows counted.

    A chain knows no frames: base, tool and instrument are registered on these rows. A
    calibrated model is taken as it is, unless registration is asked for.

    Args:
        robot: A chain, nominal or corrected, or a calibrated model.
        measurements: The rows.
        setup: What is known of frames and instrument, for a chain.
        registration: Register a calibrated model on these rows.

    Raises:
        InputError: If the measurements do not fit the model.
    """
    if isinstance(robot, CalibratedModel):
        problem = robot.problem(measurements)
        theta = np.concatenate(
            [robot.theta, np.zeros(len(robot.measurement.parameters))]
        )
    else:
        setup = replace(setup or Setup(), parameters=(), fixed=(), bounds={}, prior={})
        problem = make_problem(robot, measurements, setup)
        theta = np.zeros(len(problem.parameters))
        registration = True
    if len(measurements) == 0:
        raise InputError("there are no rows to evaluate")
    reason = ""
    if registration:
        problem, result = register(problem, theta)
        theta = result.x
        reason = registration_reason(problem, result)
    residual = problem.errors(theta)
    return Evaluation(
        errors=tuple(
            (quantity.name, quantity.unit, Accuracy.of(quantity.errors(residual)))
            for quantity in problem.measurement.quantities
        ),
        rows=len(measurements),
        registered=registration,
        verdict="untrusted" if reason else "good",
        reason=reason,
    )


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


def nominal_problem(chain: Chain, model: str, setup: Setup) -> Problem:
    """A problem without rows, about the frames and instrument that the setup gives.

    Raises:
        OptionError: If the instrument needs a reference that the setup lacks.
    """
    data = Measurements(
        joints=chain.joints,
        q=np.zeros((len(setup.planes) or 1, len(chain.joints))),
        model=model,
        values=np.zeros((len(setup.planes) or 1, 1)),
        target=tuple(setup.planes) or ("",),
    )
    problem = make_problem(chain, data, setup)
    missing = problem.measurement.missing
    if missing:
        raise OptionError(f"a {model} study without measurements: {missing}")
    frames = frame_pose(setup.base_frame), frame_pose(setup.tool_frame)
    return replace(problem, error=problem.error.with_frames(*frames))


def _split(
    measurements: Measurements,
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
        labels, order = _shuffled_groups(training, seed)
        count = max(1, round(holdout * len(training)))
        size = np.cumsum(np.bincount(labels)[order])
        chosen = np.zeros(len(order), bool)
        chosen[order[: int(np.searchsorted(size, count)) + 1]] = True
        mask = chosen[labels]
        if mask.all():
            raise OptionError("holdout leaves no row to fit", value=holdout)
        return training.rows(~mask), training.rows(mask), "holdout"
    return training, unseen if len(unseen) else None, "set"


def _shuffled_groups(
    rows: Measurements, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Group of each row, (N,), and the groups of repetitions in random order."""
    order = np.random.default_rng(seed).permutation(rows.configurations)
    return rows.groups(), order


def _folds(rows: Measurements, fitted: Fit, seed: int) -> list[NDArray[np.bool_]]:
    """Masks of the parts of a cross-validation; none where the rows do not suffice.

    What is fitted without a part must still determine the robot and every plane.
    """
    labels, order = _shuffled_groups(rows, seed)
    if len(order) < FOLDS:
        return []
    fold = np.empty(len(order), np.int64)
    fold[order] = np.arange(len(order)) % FOLDS
    targets = np.array(rows.target)
    masks = []
    for k in range(FOLDS):
        mask = fold[labels] == k
        rest = rows.rows(~mask)
        values = rest.configurations * fitted.problem.components
        if values <= fitted.structure.rank or any(
            rows.rows(~mask & (targets == name)).configurations < FEWEST
            for name in set(rows.target)
        ):
            return []
        masks.append(mask)
    return masks


def _unseen_errors(part: Fit, rows: Measurements) -> tuple[Floats, Floats]:
    """Errors of unseen rows before and after a fit, shape (N, d) each."""
    problem = replace(part.problem, data=rows)
    return problem.errors(part.before), problem.errors(part.theta)


def _quantity_errors(
    fitted: Fit, checks: Sequence[tuple[Floats, Floats]]
) -> Iterator[QuantityErrors]:
    """Accuracy before and after, on the fitted and on the unseen rows."""
    stages = [fitted.problem.errors(theta) for theta in (fitted.before, fitted.theta)]
    unseen = [np.concatenate(parts) for parts in zip(*checks, strict=True)]
    for quantity in fitted.problem.measurement.quantities:
        before, after = (Accuracy.of(quantity.errors(errors)) for errors in stages)
        accuracies = [Accuracy.of(quantity.errors(errors)) for errors in unseen]
        yield QuantityErrors(
            quantity.name, quantity.unit, before, after, *(accuracies or (None, None))
        )
