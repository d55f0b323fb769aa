"""Findings of what changes in the course of the measurements, at a row or evenly.

A change at a row is a step of its columns, a drift is a ramp of the same ones. A ramp
must explain more than other curves of about the same smoothness do, cosines of two half
waves and more over the files, a step more than bent ramps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import EXACT
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.readings import place_of
from calib_pin.observations import Measurements
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameterizations.drift import InstrumentDrift
from calib_pin.setup import AXES, ReadingSetup
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.changes import (
    Job,
    Kind,
    Trial,
    changes_of,
    squares,
    surpasses,
)
from calib_pin.validation.findings.quick_fit import QuickFit, Score
from calib_pin.validation.findings.setup_lines import lines_of, written

CODES: dict[Kind, str] = {
    "station": "instrument-moved",
    "tool": "tool-remounted",
    "joint": "joint-rehomed",
}
KEYS: dict[Kind, str] = {"station": "moved", "tool": "remounted"}
"""Codes of changes, and keys of `reading` that undo them."""

REMEDIES: dict[Kind, str] = {
    "station": "give the two parts different stations (a column 'station', or "
    "--station-per-file)",
    "tool": "give the two parts different tools (a column 'tool')",
    "joint": "measure anew, or calibrate what was measured before and behind apart",
}

TRANSFORM = ("x", "y", "z", "rx", "ry", "rz")
"""A new frame in the old one: position and rotation vector."""

AROUND = 50
"""Measurements on each side of a change among which its line is found."""

LEFT, SURE, LARGE = 0.85, 0.6, 0.3
"""Part of the errors that a drift leaves at most: what bends in real robots leaves 0.88
and more, drifts that cost twice the noise less than 0.8. The part and the errors that
it causes, in expected sizes, from which it takes the trust."""

WAVES = range(2, 10)
"""Half waves of the curves that it is compared with."""

NORMAL = 1.96
"""Half of the 95 % interval, in standard deviations."""

STRETCH = 0.1
"""Part of all measurements from which outliers in one stretch are something else."""

PARTS = (
    "measure the job in parts, each with an entry of its own in a column 'station', or "
    "when everything is warm"
)


def changed(case: Case) -> tuple[Finding, ...]:
    """Frames and joint zeros that changed at a row, in their order."""
    found = changes_of(case)
    return () if found is None else tuple(_steps(case, *found))


def _steps(case: Case, first: Trial, last: Trial) -> Iterator[Finding]:
    """What changed at a row, with its size, its line and the lines that undo it."""
    data, found = case.data, list[Finding]()
    every = Job.of(last.job.plain, data, np.argsort(data.in_order))
    places: dict[str, list[str]] = {key: [] for key in KEYS.values()}
    errors = {"rms_before": first.errors, "rms_after": last.errors}
    for k in sorted(range(len(last.changes)), key=lambda k: last.changes[k].rank):
        kind, at = last.changes[k].kind, last.changes[k].rank
        if len(every.rank) > len(last.job.rank):
            step = len(every.rank) // len(last.job.rank)
            near = np.abs(every.rank - at) < AROUND + step
            at = last.place(k, Job.of(every.plain, data.rows(near), every.rank[near]))
        own = np.flatnonzero(every.concerned(last.changes[k]))
        own = own[np.argsort(every.rank[own])]
        rows = own[np.searchsorted(every.rank[own], at) + np.array([-1, 0])]
        if kind in KEYS:
            places[KEYS[kind]].append(place_of(data, rows[1]))
        row = rows[1 if kind == "joint" else 0]
        file, line = data.files[row], int(data.lines[row]) or int(every.rank[row]) + 1
        where = f"{'line' if file else 'measurement'} {line}"
        where += f" of {file}" if len(data.files.distinct) > 1 else ""
        where = f"at {where}" if kind == "joint" else f"after {where}"
        if kind != "joint" and data.files[rows[1]] != file:
            where = f"between {file} and {data.files[rows[1]]}"
        block = data.blocks[data.block_of[row]]
        told, sized, numbers = (
            _joint(case, last, k) if kind == "joint" else _frame(last, k, block)
        )
        found.append(
            Finding(
                CODES[kind],
                "error",
                f"{told} {where}{sized}",
                {"file": file, "line": line, **numbers, **errors},
                REMEDIES[kind],
                figure="residuals-over-order",
            )
        )
    lines = lines_of(
        ReadingSetup(moved=tuple(places["moved"]), remounted=tuple(places["remounted"]))
    )
    for finding in found:
        if lines:
            undone = f"or state in the setup file: {written({'reading': lines})}"
            setup, remedy = {"reading": lines}, f"{finding.remedy}, {undone}"
            finding = replace(finding, remedy=remedy, setup=setup)
        yield finding


def _joint(case: Case, trial: Trial, k: int) -> tuple[str, str, dict[str, float | str]]:
    """Words and numbers of a joint that stands elsewhere."""
    change = trial.changes[k]
    name = case.data.joints[change.joint]
    shown = _shown(case, name, "{:.2g}", abs(change.size))
    numbers: dict[str, float | str] = {"joint": name, "offset": change.size}
    return f"the zero of joint '{name}' changed by {shown}", "", numbers


def _shown(case: Case, joint: str, form: str, *sizes: float) -> str:
    """Motions of a joint that people read."""
    turning = dict(zip(case.chains.joints, case.chains.revolute, strict=True))
    unit, factor = DISPLAY["rad" if turning.get(joint, True) else "m"]
    return f"{form.format(*(factor * size for size in sizes))} {unit}"


def _frame(
    trial: Trial, k: int, block: Measurements
) -> tuple[str, str, dict[str, float | str]]:
    """Words and numbers of a frame that stands elsewhere.

    Args:
        trial: The measurements with their changes.
        k: Position of the change.
        block: A block of the measurements behind it, by its own names.
    """
    change, (settled, _) = trial.changes[k], trial.problem.rebased(trial.theta)
    data, rank = trial.problem.data, trial.job.rank[trial.index]
    own = np.flatnonzero(trial.job.concerned(change)[trial.index])
    own = own[np.argsort(rank[own])]
    behind = int(np.searchsorted(rank[own], change.rank))
    one, other = (
        settled.terms[data.keys[data.block_of[row]]]
        for row in own[[behind - 1, behind]]
    )
    A, B = one.error.tool, other.error.tool
    if change.kind == "station":
        # Where the instrument stands, in the base link.
        A, B = one.error.base.inverse(), other.error.base.inverse()
    apart = A.inverse() * B
    distance = float(np.linalg.norm(apart.translation))
    size = f"{distance:.3g} m" if distance >= 0.1 else f"{1e3 * distance:.3g} mm"
    evidence: dict[str, float | str] = {"distance": distance}
    vector = apart.translation.tolist()
    # Of a single point nobody knows how it is turned.
    if change.kind == "station" or len(one.measurement.quantities) > 1:
        turn = pin.log3(apart.rotation)
        evidence["angle"] = angle = float(np.linalg.norm(turn))
        size, vector = f"{size}, {np.degrees(angle):.3g} deg", [*vector, *turn.tolist()]
    evidence |= dict(zip(TRANSFORM, vector, strict=False))
    name = getattr(block, change.kind)
    if change.kind == "station":
        named = f" of the station '{name}'" if name else ""
        return f"the instrument{named} moved", f" ({size})", evidence
    named = f" '{name}'" if name else ""
    return f"the tool{named} was re-mounted", f" ({size})", evidence


def drift(case: Case) -> Iterator[Finding]:
    """A drift of the instrument or of the joints, whichever explains more."""
    fit, found = case.fit, []
    if not (case.informed and fit.rms > EXACT):
        return
    time = (case.rank / max(int(case.rank.max()), 1))[fit.problem.layout.row, None]
    for told, columns in _drifts(case, time):
        ramp = columns * time
        score = fit.score(ramp)
        waves = [columns * np.cos(np.pi * k * time) for k in WAVES]
        count = ramp.shape[1]
        left = squares(fit) * score.left
        if surpasses(fit, left, count, np.hstack(waves), 1):
            after = _errors_without(fit, ramp)
            cost = fit.left * np.log(score.left) + count * np.log(fit.left)
            found.append((cost, told, score, after))
    if not found:
        return
    _, told, score, after = min(found, key=lambda one: one[0])
    if after > LEFT * fit.errors:
        return
    unit = fit.problem.layout.quantities[0].unit
    caused = np.sqrt(max(fit.errors**2 - after**2, 0.0))
    large = caused > LARGE * expected_size(unit) and after < SURE * fit.errors
    finding = told(case, score)
    yield replace(
        finding,
        severity="error" if large else "warning",
        message=f"{finding.message} from the first measurement to the last: without it "
        f"{100 * after / fit.errors:.0f} % of the errors are left",
        evidence={**finding.evidence, "rms_before": fit.errors, "rms_after": after},
        figure="residuals-over-order",
    )


Told = Callable[[Case, Score], Finding]


def _drifts(case: Case, time: Floats) -> Iterator[tuple[Told, Floats]]:
    """The kinds of drift: its finding, and the columns of its displacement."""
    fit, problem = case.fit, case.fit.problem
    terms = [*problem.terms.values()]
    own = terms[0].index[:FRAME]
    columns = {tuple(declared(model).columns)[:3] for model in case.data.models}
    if len({term.frames.station for term in terms}) == 1:
        J = fit.linear[1][:, own]
        if problem.parameters.free[own].all():
            if columns == {AXES}:
                moved = J[:, :3] / problem.parameters.scales[own[:3]]
                yield _of_values, moved @ terms[0].error.base.rotation.T
            yield _of_instrument, J
        elif columns == {("distance",)}:
            yield _of_values, 1.0 / problem.sigma[:, None]
    if len(case.data.joints) > 1:
        # Of few measurements one joint may stand out, but not six.
        X, (_, r) = fit.beyond(fit.by_joints * time), fit.unexplained
        along = np.abs(r @ X) / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        joint = int(np.argmax(along))
        yield partial(_of_joints, first=joint), fit.by_joints[:, [joint]]
    yield _of_joints, fit.by_joints


def _of_values(case: Case, score: Score) -> Finding:
    """A displacement of what is measured, which can be taken out."""
    size = float(np.linalg.norm(score.values))
    along = float(np.linalg.norm(score.values / size * score.deviations))
    unit, factor = DISPLAY["m"]
    shown = (size, size - NORMAL * along, size + NORMAL * along)
    way, low, high = (f"{factor * x:.2g} {unit}" for x in shown)
    names = AXES if len(score.values) == len(AXES) else ("distance",)
    lines = {"reading": {"drift": [float(f"{v:.3g}") for v in score.values]}}
    return Finding(
        "instrument-drift",
        "warning",
        f"the measured values drift by {way} (95 %: {low} to {high})",
        {
            **dict(zip(names, score.values.tolist(), strict=True)),
            "drift": size,
            "sigma": along,
        },
        f"{_remedy(case)}; or state in the setup file: {written(lines)}",
        lines,
    )


def _of_instrument(case: Case, score: Score) -> Finding:
    """A drift of an instrument that also turns, or sees more than positions."""
    said = "the instrument drifts against the robot"
    return Finding("instrument-drift", "warning", said, remedy=_remedy(case))


def _of_joints(case: Case, score: Score, first: int = 0) -> Finding:
    """Joint positions that drift, as those of a robot that grows warm, from one on."""
    worst = int(np.argmax(np.abs(score.values) / score.deviations))
    value, deviation = float(score.values[worst]), float(score.deviations[worst])
    joint = case.data.joints[first + worst]
    shown = _shown(case, joint, "{:.2g} +- {:.1g}", value, deviation)
    return Finding(
        "robot-drift",
        "warning",
        f"the joint positions drift, most of all '{joint}' by {shown}",
        {"joint": joint, "drift": value, "sigma": deviation},
        "let the robot warm up before it is measured",
    )


def _remedy(case: Case) -> str:
    """How to measure without it, or how to let a walk of the instrument be fitted."""
    names, kind = case.setup.parameters, InstrumentDrift.name
    if kind in names:
        return PARTS
    lines = written({"parameters": [*names, kind]})
    timed = all(len(block.conditions.time) for block in case.data.blocks)
    state = "" if timed else " and a column 'time' [s]"
    return f"{PARTS}; or estimate it, with the setup lines {lines}{state}"


def _errors_without(fit: QuickFit, columns: Floats) -> float:
    """Errors of the first quantity that further columns leave, rms [its unit]."""
    first = np.flatnonzero(fit.problem.layout.component == 0)
    left, now = (f.unexplained[1][first] for f in (fit.explaining(columns), fit))
    return fit.errors * float(np.linalg.norm(left) / np.linalg.norm(now))
