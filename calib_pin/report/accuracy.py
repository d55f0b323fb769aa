"""The accuracy of a calibration, and of the older one that it began with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from calib_pin.errors import counted, enumerated
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

LISTED_CHAINS = 3
"""Chains up to which the ends of each are named."""

ROOM = 120
"""Characters of names in a sentence; the others are counted."""


def subject(result: CalibrationResult) -> Line:
    """The robot, its chain, and how it was measured."""
    scoped = scopes(result.model).items()
    places = ", ".join(f"{len(names)} {kind}s" for kind, names in scoped)
    measured = counted(len(result.fitted), "measurement")
    return note(
        f"{chain_words(result.model)}; {model_words(result.model)}"
        f"{places and f' ({places})'}, {measured} fitted"
    )


def measurement_facts(result: CalibrationResult) -> Facts:
    """The measurements: of which robot, how, how many, and who took them."""
    system, report, check = result.model, result.model.setup.report, result.validation
    measured, aside = counted(len(result.fitted), "measurement"), result.fitted.rows
    measured += f", {np.count_nonzero(aside.weight == 0.0)} of them set aside"
    entries = [
        ("robot", chain_words(system)),
        ("serial number", report.serial_number),
        ("measured as", model_words(system)),
        ("instrument", report.instrument),
        ("fitted", measured),
        ("held out", f"{counted(check.count, 'measurement')} ({check.method})"),
        *((f"{kind}s", ", ".join(names)) for kind, names in scopes(system).items()),
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
    ends = [f"from {chains[name].base} to {chains[name].tip}" for name in moving]
    where = " and ".join(ends)
    if len(moving) > LISTED_CHAINS:
        where = f"in {len(moving)} chains"
    return f"{chains.robot.name}: {counted(len(drives_of(chains)), 'joint')} {where}"


def scopes(system: Terms) -> dict[str, list[str]]:
    """Names of stations and tools, sorted, where there are several."""
    frames = [term.frames for term in system.terms.values()]
    stations = sorted({pair.station for pair in frames})
    tools = sorted({pair.tool for pair in frames})
    named = {"station": stations, "tool": tools}
    return {kind: names for kind, names in named.items() if len(names) > 1}


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
    method, notes = result.validation.method, []
    if method != "none":
        which = HELD_OUT.get(method, FOLDS)
        notes = [f"Validation measurements ({method}): {which}."]
    if result.model_selection is not None and method not in HELD_OUT:
        notes.append("The same folds selected the model; --validation is stricter.")
    yield note(" ".join([*notes, *_registration_notes(result)]))
    if result.distances:
        yield distance_table(result.distances)


def _registration_notes(result: CalibrationResult) -> Iterator[str]:
    """Sentences on what was registered for the nominal robot as well."""
    of_robot = {p.name for p in result.model.given if not p.nuisance}
    free = {p.name for p in result.parameters if p.status != "fixed"} - of_robot
    ordered = (p.name.rsplit(".", 2)[:2] for p in result.parameters if p.name in free)
    if owners := dict.fromkeys(map(" ".join, ordered)):
        names = enumerated(owners, ROOM)
        yield f"Registered for both (nominal and calibrated): {names}."
    else:
        yield KNOWN
    if located := result.validation.located:
        names = enumerated(located, ROOM)
        yield f"Estimated from the validation measurements: {names}."
    if skipped := result.validation.skipped:
        reasons = " and ".join(dict.fromkeys(skipped))
        count = counted(len(skipped), "fold")
        yield f"Without {count}: in the fit to the others, {reasons}."


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
        name = TITLES[result.rejected]
        yield note(f"The {name} brings no gain on held-out measurements: not used.")
    if result.urdf is None or result.verdict == "no-gain":
        return
    setup = result.model.setup
    kinds: list[str] = [name for name in setup.parameters if name in outside_urdf()]
    if setup.learned is not None:
        kinds.append(f"the correction learned by the {TITLES[setup.learned]}")
    sentence = f"A URDF cannot hold {' and '.join(kinds)}."
    if result.urdf.reason:
        reason = result.urdf.reason.rstrip(".")
        yield Line(f"{sentence} No URDF is written: {reason}.", "bad")
        return
    errors = ((e.name, amount(e.shown[1].mean, e.unit)) for e in result.urdf.errors)
    yield note(
        f"{sentence} It holds the best geometry without: mean error "
        f"{', '.join(map(' '.join, errors))}. `calib-pin compensate` uses everything."
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
        names = ", ".join(evaluation.located)
        how = f"Estimated from these measurements, and nothing else: {names}."
    yield note(how)
    if evaluation.outside:
        count = counted(evaluation.outside, "measurement")
        yield note(f"{count} outside the region in which the correction was learned.")


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
    yield table(
        "New measurements by the older calibration, before they were fitted",
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
    rows = []
    for place, step in [*enumerate(history.steps, 1)][-STEPS:]:
        begun = step.created[:10] or step.start or "-"
        numbers = step.measurements, Cell(number(step.chi2), step.chi2), step.dof
        jumps = ", ".join(jump.name or "the whole robot" for jump in step.jumps)
        rows.append((place, begun, *numbers, jumps or "-"))
    titles = "began with that of|word", "measurements", "chi-square", "dof"
    title = "Calibrations since the first one"
    yield table(title, ("", *titles, "changed|remark"), rows)
