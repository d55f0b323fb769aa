"""The verdict and the accuracy of a calibration, and what the numbers refer to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.estimation.terms import Terms
from calib_pin.kinematics.joint_columns import drives_of
from calib_pin.parameterizations import outside_urdf
from calib_pin.report.blocks import Block, Cell, Facts, Line, Table, columns
from calib_pin.report.tables import (
    SIZES,
    accuracy_table,
    amount,
    distance_table,
    ladder_table,
    sizes,
)
from calib_pin.report.trust import advised, below, findings
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


def opening(
    result: CalibrationResult,
) -> tuple[Sequence[Block], Line, Sequence[Block]]:
    """The verdict, and the findings before and behind it.

    A reason not to trust the result comes before anything else, else what ails it.
    """
    urgent = [f for f in result.findings if f.severity != "info"]
    others = [f for f in result.findings if f.severity == "info"]
    if result.verdict not in TRUSTED:
        others, urgent = [*urgent, *others], []
    before, behind = ([*findings(f, result.reason)] for f in (urgent, others))
    return before, verdict(result), behind


def verdict(result: CalibrationResult) -> Line:
    """The verdict and its reason; a finding among the reasons with its suggestion."""
    reason = result.reason
    for finding in result.findings:
        if advised(finding) not in reason:
            reason = reason.replace(finding.message, advised(finding))
    return judged(below(reason, result.findings), result.verdict)


def judged(reason: str, status: str = "untrusted") -> Line:
    """A verdict as the line that comes first."""
    name = status.replace("-", " ").upper()
    said = f"{name}: {reason.rstrip('.')}."
    return Line(said, "good" if status in TRUSTED else "bad")


def subject(result: CalibrationResult) -> Line:
    """The robot, its chain, and how it was measured."""
    count = len(result.fitted)
    measured = f"{count} measurement{'s' if count != 1 else ''}"
    search = ""
    if result.solver.history:
        solver = result.solver
        search = f"; {solver.name}, {solver.evaluations} evaluations"
        search += f" ({solver.evaluator})"
    system = result.model
    return Line(
        f"{chain_words(system)}; {model_words(system)}{_places(system)}, {measured} "
        f"fitted{search}",
        "note",
    )


def taken(result: CalibrationResult) -> Facts:
    """The measurements: of which robot, how, how many, and who took them."""
    system, stated, held_out = result.model, result.model.setup.report, result.held_out
    of_terms = [term.frames for term in system.terms.values()]
    measured = f"{len(result.fitted)} measurements"
    if aside := int((result.fitted.rows.weight == 0.0).sum()):
        measured += f", {aside} of them set aside"
    checked = "none: nothing but the fitted measurements is known"
    if held_out is not None:
        which = HELD_OUT.get(result.validation.method, FOLDS)
        checked = f"{len(held_out)} measurements: {which}"
    degrees = stated.temperature
    entries = [
        ("robot", chain_words(system)),
        ("serial number", stated.serial_number),
        ("measured as", model_words(system)),
        ("instrument", stated.instrument),
        ("fitted", measured),
        ("held out", checked),
        *(
            (f"{kind}s", ", ".join(names))
            for kind in ("station", "tool")
            if len(names := sorted({getattr(own, kind) or "-" for own in of_terms})) > 1
        ),
        ("files", ", ".join(result.files)),
        ("operator", stated.operator),
        ("customer", stated.customer),
        ("date", stated.date or ""),
        ("temperature", "" if degrees is None else f"{degrees:g} °C"),
    ]
    return Facts("Measurements", [entry for entry in entries if entry[1]])


def chain_words(system: Terms) -> str:
    """The robot and the ends of its chains, for the line below a verdict."""
    chains = system.chains
    moving = [name for name in chains.names if chains[name].joints]
    joints = f"{chains.robot.name}: {len(drives_of(chains))} joints"
    if len(moving) > LISTED_OWNERS:
        return f"{joints} in {len(moving)} chains"
    ends = [f"from {chains[name].base} to {chains[name].tip}" for name in moving]
    return f"{joints} {' and '.join(ends)}"


def _places(system: Terms) -> str:
    """Numbers of stations and tools, where there are several."""
    of_terms = [term.frames for term in system.terms.values()]
    counts = {
        "stations": len({frames.station for frames in of_terms}),
        "tools": len({frames.tool for frames in of_terms}),
    }
    told = [f"{count} {kind}" for kind, count in counts.items() if count > 1]
    return f" ({', '.join(told)})" if told else ""


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
        yield ladder_table(result.model_selection)
    yield accuracy_table(result.errors, details=details)
    said = []
    if result.validation.method != "none":
        which = HELD_OUT.get(result.validation.method, FOLDS)
        said.append(f"Validation measurements ({result.validation.method}): {which}.")
    if result.model_selection is not None and result.validation.method not in HELD_OUT:
        said.append(
            "The same folds selected the model; separate measurements (--validation) "
            "are a stricter check."
        )
    yield Line(" ".join([*said, *_registered(result)]), "note")
    if result.distances:
        yield distance_table(result.distances)


def _registered(result: CalibrationResult) -> Iterator[str]:
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
    told = [
        f"{len(names)} {kind}s"
        if len(names) > LISTED_OWNERS
        else ", ".join(f"{name} {kind}" for name in names)
        for kind, names in owners.items()
    ]
    yield f"Registered for both (nominal and calibrated): {', '.join(told)}."
    if result.validation.located:
        names = ", ".join(result.validation.located)
        if len(result.validation.located) > 2 * LISTED_OWNERS:
            names = f"{len(result.validation.located)} of them"
        yield f"Estimated from the validation measurements: {names}."
    if result.validation.skipped:
        reasons = " and ".join(dict.fromkeys(result.validation.skipped))
        count = len(result.validation.skipped)
        folds = "fold was" if count == 1 else "folds were"
        yield f"{count} {folds} skipped, because in the fit to the others: {reasons}."


def moves(result: CalibrationResult) -> Iterator[Block]:
    """The largest correction: the corrected robot must look like the nominal one."""
    if result.verdict == "no-gain":
        yield Line("Nothing is corrected: the URDF is the nominal one.", "note")
        return
    geometry = result.geometry or (result.model if result.urdf is None else None)
    corrections = {} if geometry is None else geometry.urdf_corrections()
    if not corrections:
        return
    shifts = {j: float(np.linalg.norm(M.translation)) for j, M in corrections.items()}
    turns = {
        j: float(np.linalg.norm(pin.log3(M.rotation))) for j, M in corrections.items()
    }
    parts = []
    for of_joints, unit in ((shifts, "m"), (turns, "rad")):
        joint = max(of_joints, key=of_joints.__getitem__)
        parts.append(f"{amount(of_joints[joint], unit)} ({joint})")
    yield Line(f"Largest correction of a joint origin: {', '.join(parts)}.", "note")


def beyond(result: CalibrationResult) -> Iterator[Block]:
    """The corrections a URDF cannot hold, and its accuracy without them."""
    if result.rejected:
        yield Line(
            f"The {TITLES[result.rejected]} brings no gain on held-out measurements "
            "and is not used.",
            "note",
        )
    if result.urdf is None or result.verdict == "no-gain":
        return
    setup = result.model.setup
    kinds: list[str] = [name for name in setup.parameters if name in outside_urdf()]
    if setup.learned is not None:
        kinds.append(f"the correction learned by the {TITLES[setup.learned]}")
    said = f"A URDF cannot hold {' and '.join(kinds)}. "
    if result.urdf.reason:
        reason = result.urdf.reason.rstrip(".")
        yield Line(f"{said}No URDF is written: {reason}.", "bad")
        return
    means = []
    for error in result.urdf.errors:
        found = error.validation_after or error.after
        means.append(f"{error.name} {amount(found.mean, error.unit)}")
    which = "fitted" if result.validation.method == "none" else "validation"
    yield Line(
        f"{said}It holds the best geometry without: mean error on {which} "
        f"measurements {', '.join(means)}. `calib-pin compensate` uses everything.",
        "note",
    )


def evaluated(evaluation: Evaluation) -> Iterator[Block]:
    """Accuracy on measurements that were not fitted."""
    if evaluation.verdict != "good":
        yield judged(below(evaluation.reason, evaluation.findings))
    yield from findings(evaluation.findings, evaluation.reason)
    counts = evaluation.counts or (evaluation.rows,) * len(evaluation.errors)
    rows = [
        (Cell(name), Cell(str(count), count), *sizes(accuracy, unit))
        for (name, unit, accuracy), count in zip(evaluation.errors, counts, strict=True)
    ]
    of = columns("", ("measurements", *SIZES), {"measurements": "number"})
    yield Table("Accuracy", of, rows)
    how = (
        "Unknown frames and instrument parameters were registered on these "
        "measurements."
        if evaluation.registered
        else "Nothing was fitted to these measurements."
    )
    if evaluation.located:
        how = (
            "New to the calibration, estimated from these measurements: "
            f"{', '.join(evaluation.located)}. Nothing else was fitted to them."
        )
    if evaluation.outside:
        how += (
            f" {evaluation.outside} measurements lie outside the region in which the "
            "correction was learned; it knows less there."
        )
    yield Line(how, "note")
