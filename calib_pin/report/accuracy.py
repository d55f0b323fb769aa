"""The accuracy of a calibration, and of the older one that it began with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from calib_pin.errors import counted
from calib_pin.estimation.terms import Terms
from calib_pin.kinematics.joint_columns import drives_of
from calib_pin.parameterizations import outside_urdf
from calib_pin.report.blocks import Block, Cell, Facts, Line, note, table
from calib_pin.report.tables import (
    SIZES,
    accuracy_table,
    amount,
    distance_table,
    ladder,
    number,
    sizes,
)
from calib_pin.report.trust import below, findings, judged
from calib_pin.setup import ReportSetup
from calib_pin.validation.result import CalibrationResult, Evaluation

TITLES = {"network": "network", "gaussian-process": "Gaussian process"}
"""Residual models as they are called in sentences."""

HELD_OUT = {
    "set": "those that the column 'set' marks",
    "file": "those of the validation file",
    "holdout": "those held out of the fit",
    "leave-one-place-out": "each place, predicted by a fit to the others",
}
"""The validation measurements by the method of validation."""

FOLDS = "each fold, predicted by a fit to the other folds"
"""The validation measurements of a cross-validation."""

KNOWN = "Frames and instrument are known; nothing is registered."

LISTED_OWNERS = 3
"""Members of one kind, such as sockets, up to which each is named."""


def subject(result: CalibrationResult) -> Line:
    """The robot, its chain, and how it was measured."""
    solver, search = result.solver, ""
    if solver.history:
        search = f"; {solver.name}, {counted(solver.evaluations, 'evaluation')}"
        search += f" ({solver.evaluator})"
    counts = {kind: len(names) for kind, names in scopes(result.model).items()}
    several = [f"{count} {kind}s" for kind, count in counts.items() if count > 1]
    places = f" ({', '.join(several)})" if several else ""
    measured = counted(len(result.fitted), "measurement")
    return note(
        f"{chain_words(result.model)}; {model_words(result.model)}{places}, {measured} "
        f"fitted{search}"
    )


def measurement_facts(result: CalibrationResult) -> Facts:
    """The measurements: of which robot, how, how many, and who took them."""
    system, report, held_out = result.model, result.model.setup.report, result.held_out
    measured = counted(len(result.fitted), "measurement")
    if aside := int((result.fitted.rows.weight == 0.0).sum()):
        measured += f", {aside} of them set aside"
    which = HELD_OUT.get(result.validation.method, FOLDS)
    checked = "none: nothing but the fitted measurements is known"
    if held_out is not None:
        checked = f"{counted(len(held_out), 'measurement')}: {which}"
    entries = [
        ("robot", chain_words(system)),
        ("serial number", report.serial_number),
        ("measured as", model_words(system)),
        ("instrument", report.instrument),
        ("fitted", measured),
        ("held out", checked),
        *(
            (f"{kind}s", ", ".join(name or "-" for name in names))
            for kind, names in scopes(system).items()
            if len(names) > 1
        ),
        ("files", ", ".join(result.files)),
        ("operator", report.operator),
        ("customer", report.customer),
        ("date", report.date or ""),
        ("temperature", degrees(report)),
    ]
    return Facts("Measurements", [entry for entry in entries if entry[1]])


def degrees(report: ReportSetup) -> str:
    """The temperature of a report; empty if it is not stated."""
    return "" if report.temperature is None else f"{report.temperature:g} °C"


def chain_words(system: Terms) -> str:
    """The robot and the ends of its chains, for the line below a verdict."""
    chains = system.chains
    moving = [name for name in chains.names if chains[name].joints]
    joints = f"{chains.robot.name}: {counted(len(drives_of(chains)), 'joint')}"
    if len(moving) > LISTED_OWNERS:
        return f"{joints} in {len(moving)} chains"
    ends = [f"from {chains[name].base} to {chains[name].tip}" for name in moving]
    return f"{joints} {' and '.join(ends)}"


def scopes(system: Terms) -> dict[str, list[str]]:
    """Names of stations and tools, sorted."""
    frames = [term.frames for term in system.terms.values()]
    return {
        "station": sorted({pair.station for pair in frames}),
        "tool": sorted({pair.tool for pair in frames}),
    }


def model_words(system: Terms) -> str:
    """The measurement models, each once."""
    return " + ".join(dict.fromkeys(key.model for key in system.terms))


def accuracy(result: CalibrationResult, *, details: bool = True) -> Iterator[Block]:
    """Model selection, accuracy and known distances, and what they refer to.

    Args:
        result: The calibration.
        details: Also the accuracy on fitted measurements, where others were held out.
    """
    if result.model_selection is not None:
        yield from ladder(result.model_selection)
    yield accuracy_table(result.errors, details=details)
    notes = []
    if result.validation.method != "none":
        which = HELD_OUT.get(result.validation.method, FOLDS)
        notes.append(f"Validation measurements ({result.validation.method}): {which}.")
    if result.model_selection is not None and result.validation.method not in HELD_OUT:
        notes.append(
            "The same folds selected the model; separate measurements (--validation) "
            "are a stricter check."
        )
    yield note(" ".join([*notes, *_registration_notes(result)]))
    if result.distances:
        yield distance_table(result.distances)


def _registration_notes(result: CalibrationResult) -> Iterator[str]:
    """Sentences on what was registered for the nominal robot as well."""
    of_robot = {p.name for p in result.model.given if not p.nuisance}
    owners: dict[str, dict[str, None]] = {}
    for parameter in result.parameters:
        if parameter.status != "fixed" and parameter.name not in of_robot:
            owner, kind, _ = parameter.name.rsplit(".", 2)
            owners.setdefault(kind, {})[owner] = None
    if not owners:
        yield KNOWN
        return
    lists = [
        f"{len(names)} {kind}s"
        if len(names) > LISTED_OWNERS
        else ", ".join(f"{name} {kind}" for name in names)
        for kind, names in owners.items()
    ]
    yield f"Registered for both (nominal and calibrated): {', '.join(lists)}."
    if located := result.validation.located:
        few = len(located) <= 2 * LISTED_OWNERS
        names = ", ".join(located) if few else f"{len(located)} of them"
        yield f"Estimated from the validation measurements: {names}."
    if skipped := result.validation.skipped:
        folds = "fold was" if len(skipped) == 1 else "folds were"
        reasons = " and ".join(dict.fromkeys(skipped))
        yield f"{len(skipped)} {folds} skipped: in the fit to the others, {reasons}."


def moves(result: CalibrationResult) -> Iterator[Block]:
    """The largest correction: the corrected robot must look like the nominal one."""
    if result.verdict == "no-gain":
        yield note("Nothing is corrected: the URDF is the nominal one.")
        return
    geometry = result.geometry or (result.model if result.urdf is None else None)
    corrections = {} if geometry is None else geometry.urdf_corrections()
    if not corrections:
        return
    names, poses = zip(*corrections.items(), strict=True)
    vectors = [(M.translation, pin.log3(M.rotation)) for M in poses]
    norms = np.linalg.norm(vectors, axis=2).T
    parts = [
        f"{amount(float(size.max()), unit)} ({names[size.argmax()]})"
        for size, unit in zip(norms, ("m", "rad"), strict=True)
    ]
    yield note(f"Largest correction of a joint origin: {', '.join(parts)}.")


def beyond(result: CalibrationResult) -> Iterator[Block]:
    """The corrections a URDF cannot hold, and its accuracy without them."""
    if result.rejected:
        yield note(
            f"The {TITLES[result.rejected]} brings no gain on held-out measurements "
            "and is not used."
        )
    if result.urdf is None or result.verdict == "no-gain":
        return
    setup = result.model.setup
    kinds: list[str] = [name for name in setup.parameters if name in outside_urdf()]
    if setup.learned is not None:
        kinds.append(f"the correction learned by the {TITLES[setup.learned]}")
    sentence = f"A URDF cannot hold {' and '.join(kinds)}. "
    if result.urdf.reason:
        reason = result.urdf.reason.rstrip(".")
        yield Line(f"{sentence}No URDF is written: {reason}.", "bad")
        return
    means = []
    for error in result.urdf.errors:
        means.append(f"{error.name} {amount(error.shown[1].mean, error.unit)}")
    which = "fitted" if result.validation.method == "none" else "validation"
    yield note(
        f"{sentence}It holds the best geometry without: mean error on {which} "
        f"measurements {', '.join(means)}. `calib-pin compensate` uses everything."
    )


def evaluated(evaluation: Evaluation) -> Iterator[Block]:
    """Accuracy on measurements that were not fitted."""
    if evaluation.verdict != "good":
        reason = below(evaluation.reason, evaluation.findings)
        yield judged(reason, evaluation.verdict)
    yield from findings(evaluation.findings, evaluation.reason)
    counts = evaluation.counts or (evaluation.rows,) * len(evaluation.errors)
    rows = [
        (name, count, *sizes(accuracy, unit))
        for (name, unit, accuracy), count in zip(evaluation.errors, counts, strict=True)
    ]
    yield table("Accuracy", ("", "measurements", *SIZES), rows)
    how = "Nothing was fitted to these measurements."
    if evaluation.registered:
        how = "Unknown frames and instrument parameters were registered on these rows."
    if evaluation.located:
        how = (
            "New to the calibration, estimated from these measurements: "
            f"{', '.join(evaluation.located)}. Nothing else was fitted to them."
        )
    if evaluation.outside:
        how += (
            f" Outside the region in which the correction was learned, where it "
            f"knows less: {counted(evaluation.outside, 'measurement')}."
        )
    yield note(how)


STEPS = 12
"""Calibrations of the history that are listed, the last ones."""


def recalibrated(result: CalibrationResult, *, details: bool = True) -> Iterator[Block]:
    """The errors by the older calibration, the drift, and the history.

    Args:
        result: The calibration.
        details: Also the drift and the history.
    """
    history = result.recalibration
    if history is None:
        return
    day = f" of {history.last.created[:10]}" if history.last.created else ""
    yield table(
        f"New measurements by the older calibration{day}, before they were fitted",
        ("", *SIZES),
        [(name, *sizes(accuracy, unit)) for name, unit, accuracy in history.errors],
    )
    if not details:
        return
    drifts = [
        (drift.name, f"{amount(drift.size, 'm')} or {amount(drift.size, 'rad')}")
        for drift in history.last.drifts
    ]
    yield Facts("Drift from one calibration to the next, standard deviation", drifts)
    rows, first = [], max(len(history.steps) - STEPS, 0)
    for place, step in enumerate(history.steps[first:], first + 1):
        begun = step.created[:10] or step.start or "-"
        numbers = step.measurements, Cell(number(step.chi2), step.chi2), step.dof
        jumps = ", ".join(jump.name or "the whole robot" for jump in step.jumps)
        rows.append((place, begun, *numbers, jumps or "-"))
    titles = "began with that of|word", "measurements", "chi-square", "dof"
    title = "Calibrations since the first one"
    yield table(title, ("", *titles, "changed|remark"), rows)
