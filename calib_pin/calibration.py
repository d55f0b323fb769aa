"""Calibrate a robot from measurements and judge the result.

`calibrate` splits the measurements, fits a model to one part, checks it on measurements
that were held out, and judges it; then the same for the geometry that a URDF can hold.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

import calib_pin.estimation.formulation as formulation
import calib_pin.validation.assessment as assessment
import calib_pin.validation.model_errors as model_errors
from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.fit import fit_model, time_course, with_time_course
from calib_pin.estimation.fitted import Fit, as_weighted
from calib_pin.estimation.problem import tool_points
from calib_pin.kinematics.chains import Chains, Robots
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import as_stated
from calib_pin.observations import AT, Measurements, Observations, states_sigmas
from calib_pin.parameterizations import outside_urdf
from calib_pin.progress import Stages, named, portion
from calib_pin.setup import ReadingSetup, Setup
from calib_pin.setup.values import SMALLEST, Value
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings import explained
from calib_pin.validation.findings.calibrations import older_calibration
from calib_pin.validation.findings.case import Others
from calib_pin.validation.held_out import HeldOut, check
from calib_pin.validation.joint_errors import encoder_steps
from calib_pin.validation.judgement import Judgement, examine, judge, unexplained
from calib_pin.validation.model_selection import USES, select_model
from calib_pin.validation.result import (
    CalibrationResult,
    MeasurementErrors,
    NamedArray,
    SolverSummary,
    Statistics,
    UrdfResult,
    Validation,
)
from calib_pin.validation.robot_state import resume
from calib_pin.validation.splits import FOLDS, split
from calib_pin.workers.base import SERIAL, Workers


@serial_blas
def calibrate(
    chains: Robots,
    measurements: Measurements | Observations,
    setup: formulation.Stated = None,
    *,
    validation: Measurements | Observations | None = None,
    holdout: float | None = None,
    validate: bool = True,
    ladder: bool = False,
    use: str = USES[0],
    seed: int = 0,
    progress: Stages | None = None,
    others: Others = tuple,
    workers: Workers = SERIAL,
    start: CalibrationResult | None = None,
    process_noise: Annotated[float, Value("m, rad", SMALLEST)] | None = None,
) -> CalibrationResult:
    """Calibrate a robot.

    Args:
        chains: The nominal chain, all chains that were measured, or the name or file
            of the robot.
        measurements: Measurements; those marked for validation are not fitted.
        setup: Estimated and known quantities, or the keys of a setup file; default six
            errors of every joint placement with base and tool unknown.
        validation: Further measurements, for validation.
        holdout: Part of the measurements, 0 to 1, that is held out for validation.
        validate: Whether to check the fit on held-out measurements; without any of the
            above by cross-validation.
        ladder: Whether to select among models from joint offsets to a learned
            correction by cross-validation, and to use the simplest of the best; see
            `model_selection.select_model`.
        use: Where the selected model must hold: `near` the fitted configurations,
            `away` from them, or `both`.
        seed: Seed of random configurations, searches and splits.
        progress: Told the stage and the part that is done, 0 to 1.
        others: Other robots that may have been measured.
        workers: Who fits folds and candidates; the result is the same.
        start: An older calibration of the robot to go on from, with the same
            parameters; see `validation.robot_state`.
        process_noise: How far each error of the geometry may have drifted since then,
            standard deviation [m, rad]; default as the measurements show it.

    Returns:
        The result. Look at `verdict` before using it.

    Raises:
        InputError: If the measurements do not fit the model, or there are some to
            validate with of something that was not fitted.
        OptionError: If a name in the setup does not exist, the holdout is not
            between 0 and 1, or measurements are too few to learn from.

    Examples:
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
    setup = formulation.setup_of(setup)
    sources = [source for source in (measurements, validation) if source is not None]
    given = [as_stated(Observations.of(source), setup.reading) for source in sources]
    # It has been obeyed now, and says nothing of other files.
    setup = replace(setup, reading=ReadingSetup())
    chains, (data, *more) = formulation.fitting(chains, setup, *given)
    further = more[0] if more else None
    steps = {j: n for j, n in data.conditions.steps.items() if j in chains.joints}
    setup = replace(setup, encoder_steps={**steps, **setup.encoder_steps})
    encoder_steps(setup, chains.joints)
    training, held, method = split(data, setup, further, holdout, seed)
    _require_ends(chains, setup, training, held)
    begun = None
    if start is not None or process_noise is not None:
        setup, begun = resume(chains, training, setup, start, process_noise, ladder)
    original = setup
    setup = with_time_course(chains, training, setup, seed)
    if held is not None:
        formulation.require_conditions(held, setup)
    share = 1.0 if held is not None or not validate else 1.0 / (1 + FOLDS)
    selection, parts = None, None

    def checking(stage: str, part: float) -> None:
        if progress is not None:
            progress(stage, share + (1.0 - share) * part)

    with explained(chains, training, setup, others):
        if ladder:
            selection, fitted, parts = select_model(
                chains, training, setup, seed, progress, workers, use
            )
            # What hid a drift of the instrument may be explained now.
            chosen = fitted.problem.setup
            chosen = replace(chosen, drift=original.drift, thermal=original.thermal)
            chosen = with_time_course(chains, training, chosen, seed)
            if time_course(chosen) != time_course(setup):
                setup, parts = chosen, None
                fitted = fit_model(chains, training, setup, seed)
        else:
            tell = portion(named(progress, "fit"), 0.0, share)
            fitted = fit_model(chains, training, setup, seed, tell)
        errors = model_errors.fitted_errors(fitted, training)
        tell = named(progress, "joint readings")
        accuracies, faults = examine(fitted, seed, tell, others)
        # Fits to parts of what no robot explains are slow, and say nothing.
        counted = errors.counted(fitted.problem.data.weight)
        sizes = model_errors.quantity_errors(fitted.problem.layout.quantities, counted)
        hopeless = bool(faults.causes or unexplained(fitted, sizes))
        hopeless &= held is None and not ladder
        held_out = check(
            fitted,
            training,
            seed,
            validation=held if validate else None,
            method=method,
            parts=parts if validate and not hopeless else (),
            progress=checking,
            workers=workers,
        )
    judgement = judge(fitted, errors, held_out, accuracies, faults)
    files = [*data.files.distinct, *(further.files.distinct if further else ())]
    result = replace(
        _result(training, errors, held_out, judgement, seed),
        files=tuple(filter(None, dict.fromkeys(files))),
        model_selection=selection,
        urdf=_urdf(training, held, seed, validate, judgement, workers),
        recalibration=begun,
    )
    if start is not None:
        findings = older_calibration(start, result)
        result = replace(result, findings=(*findings, *result.findings))
    return result


def _result(
    training: Observations,
    errors: model_errors.ModelErrors,
    held_out: HeldOut,
    judgement: Judgement,
    seed: int,
) -> CalibrationResult:
    """The result of a fit, from its steps."""
    fitted = judgement.fitted
    parameters, groups = assessment.estimates(
        fitted.problem.parameters, fitted.structure, fitted
    )
    checked = (
        model_errors.ModelErrors.joined(held_out.parts) if held_out.parts else None
    )
    # Against the sigma that is stated, or was assumed.
    chi2 = 2.0 * replace(fitted.problem, units=np.zeros(0)).cost(fitted.theta)
    names = [parameter.name for parameter in parameters]
    return CalibrationResult(
        model=CalibratedModel.create(*fitted.solved),
        reference=CalibratedModel.create(fitted.problem, np.zeros_like(fitted.theta)),
        verdict=judgement.verdict[0],
        reason=judgement.verdict[1],
        parameters=parameters,
        groups=groups,
        identifiability=assessment.fitted_ranks(fitted),
        robot_errors=assessment.robot_errors(fitted.problem, fitted.structure, fitted),
        errors=judgement.errors,
        validation=Validation(
            method=held_out.method,
            count=sum(len(part.before) for part in held_out.counted),
            located=checked.registered if checked else (),
            skipped=held_out.skipped,
        ),
        solver=SolverSummary(
            name=fitted.problem.setup.solver.name,
            evaluator=fitted.result.evaluator,
            status=fitted.result.status.value,
            iterations=fitted.result.nit,
            evaluations=fitted.result.nfev,
            history=()
            if fitted.result.evolution is None
            else tuple(fitted.result.evolution.best_history.tolist()),
            at_bounds=tuple(names[k] for k in sorted(fitted.problem.held_at)),
            seed=seed,
        ),
        statistics=Statistics(
            chi2=chi2,
            dof=fitted.dof,
            sigma0=float(np.sqrt(chi2 / fitted.dof)) if fitted.dof > 0 else np.nan,
            stated_sigma=states_sigmas(training),
            noise=fitted.noise,
            outliers=fitted.robust.outliers,
            gains=held_out.gains,
        ),
        **vars(assessment.breakdown(fitted, errors, judgement.accuracies)),
        covariance=NamedArray.of(fitted.covariance, names, names),
        fitted=_measurement_errors(
            fitted,
            as_weighted(fitted, training),
            errors,
            assessment.measurement_leverages(fitted),
        ),
        held_out=None
        if checked is None
        else _measurement_errors(fitted, held_out.measurements, checked),
        rejected="" if fitted.learned else fitted.problem.setup.learned or "",
        distances=errors.distances + (checked.distances if checked else ()),
        findings=judgement.findings,
    )


def _require_ends(
    chains: Chains, setup: Setup, training: Observations, held: Observations | None
) -> None:
    """Refuse known distances between what no measurement names.

    Raises:
        OptionError: If there are such.
    """
    if not setup.distances:
        return
    targets = {block.key: block.target.distinct for block in training.blocks}
    terms, _ = formulation.make_terms(chains, targets, setup)
    fitted = {half for names in targets.values() for t in names for half in t.split(AT)}
    new = set[str]()
    for block in held.blocks if held is not None else ():
        ends = {half for t in block.target.distinct for half in t.split(AT)} - fitted
        new |= ends | {f"{block.station}/{name}" for name in ends}
    formulation.require_known(terms.values(), setup, fitted, new)


def _urdf(
    training: Observations,
    held: Observations | None,
    seed: int,
    validate: bool,
    judgement: Judgement,
    workers: Workers,
) -> UrdfResult | None:
    """The geometry alone, judged like a calibration of its own.

    None where the calibration is nothing but geometry; without a model where that is
    not to be trusted. Without a gain it is the nominal robot.
    """
    fitted = judgement.fitted
    if judgement.verdict[0] == "no-gain":
        nominal = CalibratedModel.create(fitted.problem, fitted.before)
        return UrdfResult((), "", nominal)
    if all(term.error.geometric for term in fitted.solved.problem.terms.values()):
        return None
    if judgement.verdict[0] == "untrusted":
        return UrdfResult((), "the calibration is untrusted")
    setup = replace(fitted.problem.setup, learned=None)
    names = tuple(n for n in setup.parameters if n not in outside_urdf())
    if not names:
        return UrdfResult((), "nothing of this calibration has a place in a URDF")
    geometry = replace(fitted, learned=None)
    if names != setup.parameters:
        # A gear ratio and an offset may nearly cancel: alone it needs its own fit.
        chains = fitted.problem.chains
        setup = formulation.with_parameters(chains, training, setup, names)
        geometry = fit_model(chains, training, setup, seed)
    held, parts = (held, None) if validate else (None, ())
    held_out = check(
        geometry, training, seed, validation=held, parts=parts, workers=workers
    )
    errors = model_errors.fitted_errors(geometry, training)
    known = examine(geometry, seed, seek=False)
    geometric = judge(geometry, errors, held_out, *known)
    return UrdfResult(
        geometric.errors,
        "" if geometric.verdict[0] == "good" else geometric.verdict[1],
        CalibratedModel.create(*geometry.solved),
    )


def _measurement_errors(
    fitted: Fit,
    measurements: Observations,
    errors: model_errors.ModelErrors,
    leverage: Floats | None = None,
) -> MeasurementErrors:
    """Errors with their measurements, in the order of these."""
    errors = errors.at(np.argsort(errors.positions, kind="stable"))
    rows = measurements.rows(errors.positions)
    registered = model_errors.registered(*fitted.solved, rows)
    problem, theta = registered.problem, registered.theta
    points, points_of = [], tool_points(problem, theta)
    for (term, *_), tips in zip(problem.blocks, points_of, strict=True):
        error, of_robot = term.error, term.values(theta)[0]
        to_base = (error.base * error.corrections(of_robot)[0]).inverse()
        points.append(tips @ to_base.rotation.T + to_base.translation)
    return MeasurementErrors(
        rows=rows,
        quantities=problem.layout.quantities,
        before=errors.before,
        after=errors.after,
        sigma=problem.layout.table(problem.sigma, len(rows)),
        points=np.concatenate(points),
        leverage=np.full(len(rows), np.nan) if leverage is None else leverage,
    )
