"""Accuracy of a robot or a calibration on measurements that were not fitted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import calib_pin.estimation.formulation as formulation
from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError, InputError
from calib_pin.estimation.evidence import Finding, rms
from calib_pin.estimation.problem import Problem, distinct_values, error_table
from calib_pin.kinematics.chains import Chains, Robots
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import as_stated
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.validation.findings import explained, find
from calib_pin.validation.findings.case import CHANCE, Case, Others, by_chance, subset
from calib_pin.validation.findings.sentences import finding, shown
from calib_pin.validation.judgement import CHECK, error_limit, summary, too_large
from calib_pin.validation.model_errors import (
    Registered,
    located_names,
    registered,
    registered_anew,
)
from calib_pin.validation.result import Accuracy, CalibrationResult, Evaluation

MOVED = 0.5
"""Part of the errors that a registration may leave to be worth a word."""

BEYOND = 3.0
"""Errors, by those that a calibration promises, from which it no longer holds.

Other measurements of three real robots stay below the promise.
"""


@serial_blas
def evaluate(
    robot: Robots | CalibratedModel,
    measurements: Measurements | Observations,
    setup: formulation.Stated = None,
    *,
    registration: bool = False,
    others: Others = tuple,
) -> Evaluation:
    """Accuracy of a robot on measurements, all of them counted.

    A chain knows no frames: base, tool and instrument are registered on these. A
    calibrated model is taken as it is, unless registration is asked for.

    Args:
        robot: A chain, nominal or corrected, or a calibrated model.
        measurements: The measurements.
        setup: Known quantities of frames and instrument, for a chain.
        registration: Register a calibrated model on these measurements.
        others: Other robots that may have been measured.

    Raises:
        InputError: If the measurements do not fit the model.
    """
    if isinstance(robot, CalibratedModel):
        chains, plain = robot.chains, robot.setup
    else:
        plain = formulation.setup_of(setup)
        chains = Chains.of(robot, plain)
    rows = as_stated(Observations.of(measurements), plain.reading)
    chains, (rows,) = formulation.fitting(chains, plain, rows)
    model = robot if isinstance(robot, CalibratedModel) else chains
    with explained(chains, rows, plain, others):
        ready = registered_robot(model, rows, plain, registration=registration)
    sizes = error_sizes(ready.problem, ready.theta)
    errors = tuple((name, unit, Accuracy.of(size)) for name, unit, size in sizes)
    findings = _findings(chains, rows, plain, others)
    if not ready.registered:
        findings += tuple(_unregistered(model, rows))
    reason = ready.reason or summary([f for f in findings if f.severity == "error"])
    large = (f"{text}; {CHECK}" for error in errors if (text := too_large(*error)))
    reason = reason or next(large, "")
    outside = (
        CalibratedChain(term.error, ready.theta, plain).outside(data.q).sum()
        for term, data, _, _ in ready.problem.blocks
    )
    return Evaluation(
        errors,
        rows=len(rows),
        registered=ready.registered,
        verdict="untrusted" if reason else "good",
        reason=reason,
        outside=int(sum(outside)),
        located=ready.located,
        counts=tuple(len(size) for *_, size in sizes),
        findings=findings,
    )


def no_longer_holds(result: CalibrationResult, check: Evaluation) -> Iterator[Finding]:
    """Errors far beyond those that a calibration has promised, of the worst quantity.

    Args:
        result: The calibration.
        check: Its accuracy on other measurements.
    """
    nominal, workspace = result.verdict == "no-gain", result.accuracy.workspace
    promised = {e.name: e.shown[0 if nominal else 1].rms for e in result.errors}
    if workspace is not None and "position" in promised:
        # Elsewhere it has promised less.
        promised["position"] = max(promised["position"], workspace.bound.position)
    codes = {f.code for f in check.findings}
    beyond = [
        (error.rms / known, name, unit, error.rms, known)
        for name, unit, error in check.errors
        if (known := promised.get(name, 0.0)) and error.rms > BEYOND * known
    ]
    if not beyond or "frames-moved" in codes:
        return
    times, name, unit, rms, known = max(beyond)
    text = f"{name} errors of {shown(rms, unit, 3)} rms are {times:.2g} times those "
    text += f"that the calibration promises, {shown(known, unit, 3)}: the robot, its "
    text += "tool or the instrument has changed"
    remedy = "measure ten configurations and calibrate with --start"
    numbers = {"rms": rms, "promised": known}
    yield finding("old-calibration-no-longer-holds", text, numbers, remedy)


def error_sizes(problem: Problem, theta: Floats) -> list[tuple[str, str, Floats]]:
    """Name, unit and sizes of the errors of each quantity that was measured."""
    table = error_table(problem, theta)
    rows = ((q.name, q.unit, q.errors(table)) for q in problem.layout.quantities)
    return [row for row in rows if len(row[2])]


def _findings(
    chains: Chains, rows: Observations, setup: Setup, others: Others
) -> tuple[Finding, ...]:
    """The faults that measurements show with the nominal robot and errors of it.

    A calibration would be wrong about measurements that are read wrongly, too. That a
    few configurations determine no errors is no fault here, where none are estimated.
    """
    try:
        case = Case.of_robot(chains, rows, setup, others)
    except (CalibPinError, np.linalg.LinAlgError):
        # They are too few, or have no derivative, or only the calibration knows more.
        return ()
    findings = find(case)
    both = *findings.causes, *findings.others
    return tuple(f for f in both if f.code != "few-configurations")


def _unregistered(
    robot: Robots | CalibratedModel, rows: Observations
) -> Iterator[Finding]:
    """Frames or an instrument that are not where a calibration has seen them."""
    sample, _ = subset(rows)
    here, again = (
        registered_robot(robot, sample, registration=anew) for anew in (False, True)
    )
    tables = [error_sizes(at.problem, at.theta) for at in (here, again)]
    sizes = [
        (name, unit, rms(was), rms(now))
        for (name, unit, was), (_, _, now) in zip(*tables, strict=True)
    ]
    # Of several instruments one may have moved.
    name, unit, before, after = max(sizes, key=lambda row: row[2] / max(row[3], 1e-300))
    if again.reason or not after < MOVED * before:
        return
    # Whatever stands where, what few measurements have told about it is not left.
    was, now = (2.0 * at.problem.cost(at.theta) for at in (here, again))
    dof = distinct_values(again.problem) - again.used_up
    if by_chance(was, now, again.used_up, dof) > CHANCE:
        return
    text = "base, tool or instrument stand elsewhere than at the calibration: "
    text += f"registered on these measurements, the {name} errors fall from "
    text += f"{shown(before, unit, 3)} to {shown(after, unit, 3)} rms"
    numbers = {"rms_before": before, "rms_after": after}
    remedy, large = "evaluate with --register", before > error_limit(here.problem, unit)
    yield finding("frames-moved", text, numbers, remedy, error=large)


def registered_robot(
    robot: Robots | CalibratedModel,
    rows: Observations,
    setup: Setup | None = None,
    *,
    registration: bool = False,
) -> Registered:
    """Prepare a robot for measurements, to which its unknown frames are fitted.

    Args:
        robot: A chain, whose frames are always registered, or a calibrated model.
        rows: The measurements.
        setup: Known quantities of frames and instrument, for a chain.
        registration: Whether those of a calibrated model are registered as well.

    Raises:
        InputError: If there are no measurements, or they do not fit the model.
    """
    if len(rows) == 0:
        raise InputError("there are no measurements to evaluate")
    if isinstance(robot, CalibratedModel):
        formulation.require_conditions(rows, robot.setup, of_robot=True)
        return registered(robot.problem(rows), robot.theta, rows, registration)
    plain = replace(setup or Setup(), parameters=(), fixed=(), bounds={}, prior={})
    problem = formulation.make_problem(robot, rows, plain)
    none = np.zeros(len(problem.parameters))
    return registered_anew(problem, none, located_names(problem))
