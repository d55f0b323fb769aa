"""What a calibration is worth: verdict, accuracy, and what the numbers stand for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.parameterizations import beyond_geometry
from calib_pin.report.blocks import Block, Cell, Line, Table, columns
from calib_pin.report.tables import (
    SIZES,
    accuracy_table,
    distance_table,
    ladder_table,
    number,
    sizes,
)
from calib_pin.report.trust import advised, set_aside
from calib_pin.units import DISPLAY
from calib_pin.validation.result import CalibrationResult, Evaluation

__all__ = [
    "accuracy",
    "beyond",
    "evaluated",
    "judged",
    "moves",
    "opening",
    "subject",
    "verdict",
]

TITLES = {"network": "network", "gaussian-process": "Gaussian process"}
"""What residual models are called in sentences."""

UNSEEN = {
    "set": "those that the column 'set' marks",
    "file": "those of the validation file",
    "holdout": "those that were set aside",
    "leave-one-place-out": "every place, by a fit of the others",
}
"""What the unseen rows are, by the way of the validation."""

FOLDS = "every part of the rows, by a fit of the other parts"
"""What they are in a cross-validation."""

LISTED_OWNERS = 3
"""Members of one kind, such as sockets, that are named before they are counted."""


def opening(result: CalibrationResult) -> Sequence[Line]:
    """What comes first: what was set aside, and the verdict.

    A reason not to trust the result comes before anything else.
    """
    lines = [*set_aside(result), verdict(result)]
    return lines if result.verdict in TRUSTED else lines[::-1]


def verdict(result: CalibrationResult) -> Line:
    """The verdict and its reason, of a finding with what to do about it."""
    reason = result.reason
    for finding in result.findings:
        if advised(finding) not in reason:
            reason = reason.replace(finding.message, advised(finding))
    return judged(reason, result.verdict)


def judged(reason: str, status: str = "untrusted") -> Line:
    """A verdict as the line that comes first."""
    name = status.replace("-", " ").upper()
    said = f"{name}: {reason.rstrip('.')}."
    return Line(said, "good" if status in TRUSTED else "bad")


def subject(result: CalibrationResult) -> Line:
    """Which robot was measured in which way."""
    model = result.model
    chain, count = model.chain, result.training
    rows = f"{count} row{'s' if count != 1 else ''}"
    search = ""
    if result.history:
        search = (
            f"; {result.solver}, {result.evaluations} evaluations ({result.evaluator})"
        )
    return Line(
        f"{chain.robot.name}: {len(chain.joints)} joints from {chain.base} to "
        f"{chain.tip}; {model.measurement.name}, {rows} fitted{search}",
        "note",
    )


def accuracy(result: CalibrationResult) -> Iterator[Block]:
    """Ladder, accuracy and known distances, with what they stand for."""
    if result.ladder is not None:
        yield ladder_table(result.ladder)
    yield accuracy_table(result.errors)
    said = []
    if result.validation != "none":
        rows = UNSEEN.get(result.validation, FOLDS)
        said.append(f"Unseen rows ({result.validation}): {rows}.")
    if result.ladder is not None and result.validation not in UNSEEN:
        said.append(
            "The same parts have chosen the model; rows of their own (--validation) "
            "are the stricter check."
        )
    yield Line(" ".join([*said, *_registered(result)]), "note")
    if result.distances:
        yield distance_table(result.distances)


def _registered(result: CalibrationResult) -> Iterator[str]:
    """What is fitted even where the robot is nominal."""
    of_robot = {p.name for p in result.model.error.parameters if not p.nuisance}
    owners: dict[str, dict[str, None]] = {}
    for parameter in result.parameters:
        if parameter.status != "fixed" and parameter.name not in of_robot:
            owner, kind, _ = parameter.name.rsplit(".", 2)
            owners.setdefault(kind, {})[owner] = None
    if not owners:
        yield "Frames and instrument are known, nothing is registered."
        return
    told = [
        f"{len(names)} {kind}s"
        if len(names) > LISTED_OWNERS
        else ", ".join(f"{name} {kind}" for name in names)
        for kind, names in owners.items()
    ]
    yield f"Fitted in either case: {', '.join(told)}."
    if result.placed:
        names = ", ".join(result.placed)
        if len(result.placed) > 2 * LISTED_OWNERS:
            names = f"{len(result.placed)} of them"
        yield f"Placed by the unseen rows that name them: {names}."
    if result.skipped:
        reasons = " and ".join(dict.fromkeys(result.skipped))
        count = len(result.skipped)
        parts = "part of the check is" if count == 1 else "parts of the check are"
        yield f"{count} {parts} left out, for in the fit without: {reasons}."


def moves(result: CalibrationResult) -> Iterator[Block]:
    """How far the corrected robot is from the nominal one: it must look like it."""
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
        shown, factor = DISPLAY[unit]
        parts.append(f"{number(factor * of_joints[joint])} {shown} ({joint})")
    yield Line(f"Joint origins move by up to {' and '.join(parts)}.", "note")


def beyond(result: CalibrationResult) -> Iterator[Block]:
    """What a URDF cannot hold, and how good it is without."""
    if result.rejected:
        yield Line(
            f"The {TITLES[result.rejected]} found nothing that holds on held-out "
            "measurements: nothing is corrected.",
            "note",
        )
    if result.urdf is None or result.verdict == "no-gain":
        return
    setup = result.model.setup
    kinds: list[str] = [name for name in setup.parameters if name in beyond_geometry()]
    if setup.learned is not None:
        kinds.append(f"what the {TITLES[setup.learned]} has learned")
    said = f"A URDF cannot hold {' and '.join(kinds)}. "
    if result.urdf.reason:
        yield Line(f"{said}None is written: {result.urdf.reason.rstrip('.')}.", "bad")
        return
    means = []
    for error in result.urdf.errors:
        found = error.validation_after or error.after
        shown, factor = DISPLAY[error.unit]
        means.append(f"{error.name} {number(factor * found.mean)} {shown}")
    rows = "fitted" if result.validation == "none" else "unseen"
    yield Line(
        f"{said}It gets the best geometry without: mean error on {rows} rows "
        f"{', '.join(means)}. `calib-pin compensate` uses all.",
        "note",
    )


def evaluated(evaluation: Evaluation) -> Iterator[Block]:
    """Accuracy on rows that were not fitted."""
    if evaluation.verdict != "good":
        yield judged(evaluation.reason)
    counts = evaluation.counts or (evaluation.rows,) * len(evaluation.errors)
    rows = [
        (Cell(name), Cell(str(count), count), *sizes(accuracy, unit))
        for (name, unit, accuracy), count in zip(evaluation.errors, counts, strict=True)
    ]
    of = columns("", ("rows", *SIZES), {"rows": "number"})
    yield Table("Accuracy", of, rows)
    how = (
        "What is unknown of base, tool and instrument was registered on these rows."
        if evaluation.registered
        else "Nothing was fitted to these rows."
    )
    if evaluation.placed:
        how = (
            f"New to the calibration, and placed by these rows: "
            f"{', '.join(evaluation.placed)}. Nothing else was fitted to them."
        )
    if evaluation.outside:
        how += (
            f" {evaluation.outside} rows lie outside the region in which the "
            "correction was learned; there it fades to zero."
        )
    yield Line(how, "note")
