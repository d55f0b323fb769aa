"""Findings of what changes in the course of the measurements, at a row or evenly.

A change at a row is a step of its columns, a drift is a ramp of the same ones. A ramp
must explain more than other curves of about the same smoothness do, cosines of two half
waves and more over the files; a step more than bent ramps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import EXACT
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.readings import place_of
from calib_pin.observations import Booleans, Indices
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameterizations.drift import InstrumentDrift
from calib_pin.setup import AXES, ReadingSetup
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.changes import (
    CHANCE,
    Kind,
    Trial,
    changes_of,
    concerned,
    squares,
    surpasses,
)
from calib_pin.validation.findings.quick_fit import Score
from calib_pin.validation.findings.setup_lines import lines_of, written

KINDS: dict[Kind, tuple[str, str, str]] = {
    "station": (
        "instrument-moved",
        "the instrument{} moved",
        "give the two parts different stations (a column 'station', or "
        "--station-per-file)",
    ),
    "tool": (
        "tool-remounted",
        "the tool{} was re-mounted",
        "give the two parts different tools (a column 'tool')",
    ),
    "joint": (
        "joint-rehomed",
        "the zero of joint{} changed",
        "measure anew, or calibrate what was measured before and behind apart",
    ),
}
"""Code, words and remedy of a change, by what changes."""

TRANSFORM = ("x", "y", "z", "rx", "ry", "rz")
"""A new frame in the old one: position and rotation vector."""

LEFT, SURE, LARGE = 0.85, 0.6, 0.3
"""Part of the errors that a drift leaves at most: what bends in real robots leaves 0.88
and more, drifts that cost twice the noise less than 0.8. The part and the errors that
it causes, in expected sizes, from which it takes the trust."""

WAVES = range(2, 10)
"""Half waves of the curves that it is compared with."""

PARTS = (
    "measure the job in parts, each with an entry of its own in a column 'station', or "
    "when everything is warm"
)

Numbers = dict[str, float | str]


def changed(case: Case) -> Iterator[Finding]:
    """Frames and joint zeros that changed at a row, in their order."""
    found = changes_of(case)
    if found is None:
        return
    data, (first, last) = case.data.weighted(np.ones(len(case.data))), found
    rank, told = np.argsort(data.in_order), []
    places: dict[Kind, list[str]] = {kind: [] for kind in KINDS}
    for k in sorted(range(len(last.changes)), key=lambda k: last.changes[k].rank):
        change = last.changes[k]
        at = last.place(k, data, rank)  # It may be one that was not looked at.
        row, behind = _sides(concerned(data, change), rank, at)
        file, line = data.files[row], int(data.lines[row]) or int(rank[row]) + 1
        where = f"after {'line' if file else 'measurement'} {place_of(data, row)}"
        if data.files[behind] != file:
            where = f"between {file} and {data.files[behind]}"
        places[change.kind].append(place_of(data, behind))
        if change.kind == "joint":
            name = data.joints[change.joint]
            size = _shown(case, name, "{:.2g}", abs(change.size))
            numbers: Numbers = {"joint": name, "offset": change.size}
        else:
            name = getattr(data.blocks[data.block_of[row]], change.kind)
            size, numbers = _frame(last, k)
        numbers |= {"file": file, "line": line}
        numbers |= {"rms_before": first.errors, "rms_after": last.errors}
        owner = " at station" if change.kind == "station" else ""
        said = KINDS[change.kind][1].format(f"{owner} '{name}'" if name else "")
        told.append((change.kind, f"{said} {where} ({size})", numbers))
    moved, remounted = tuple(places["station"]), tuple(places["tool"])
    reading = lines_of(ReadingSetup(moved=moved, remounted=remounted))
    setup = {"reading": reading} if reading else {}
    undone = f", or state in the setup file: {written(setup)}" if setup else ""
    for kind, said, numbers in told:
        code, _, remedy = KINDS[kind]
        figure, remedy = "residuals-over-order", remedy + undone
        yield Finding(code, "error", said, numbers, remedy, setup, figure)


def _sides(mine: Booleans, rank: Indices, at: int) -> Indices:
    """The last of some measurements before a rank, and the first one from it on."""
    own = np.flatnonzero(mine)[np.argsort(rank[mine])]
    return own[np.searchsorted(rank[own], at) + np.array([-1, 0])]


def _frame(trial: Trial, k: int) -> tuple[str, Numbers]:
    """How far the frame of a change stands from where it stood."""
    change, (settled, _) = trial.changes[k], trial.problem.rebased(trial.theta)
    data, mine = trial.problem.data, concerned(trial.plain.data, change)[trial.index]
    rows = _sides(mine, trial.rank[trial.index], change.rank)
    one, other = (settled.terms[data.keys[k]] for k in data.block_of[rows])
    A, B = one.error.tool, other.error.tool
    if change.kind == "station":
        # Where the instrument stands, in the base link.
        A, B = one.error.base.inverse(), other.error.base.inverse()
    apart = A.inverse() * B
    distance = float(np.linalg.norm(apart.translation))
    size = f"{distance:.3g} m" if distance >= 0.1 else f"{1e3 * distance:.3g} mm"
    numbers: Numbers = {"distance": distance}
    vector = apart.translation.tolist()
    # Of a single point nobody knows how it is turned.
    if change.kind == "station" or len(one.measurement.quantities) > 1:
        vector += pin.log3(apart.rotation).tolist()
        numbers["angle"] = angle = float(np.linalg.norm(vector[3:]))
        size += f", {np.degrees(angle):.3g} deg"
    return size, numbers | dict(zip(TRANSFORM, vector, strict=False))


def _shown(case: Case, joint: str, form: str, *sizes: float) -> str:
    """Motions of a joint that people read."""
    unit, factor = DISPLAY[case.unit(joint)]
    return f"{form.format(*(factor * size for size in sizes))} {unit}"


def drift(case: Case) -> Iterator[Finding]:
    """A drift of the instrument or of the joints, whichever explains more."""
    fit, found = case.fit, []
    if not (case.informed and fit.rms > EXACT):
        return
    time = (case.rank / max(int(case.rank.max()), 1))[fit.problem.layout.row, None]
    for told, columns, names in _drifts(case):
        score, count = fit.score(columns * time), columns.shape[1]
        waves = np.hstack([columns * np.cos(np.pi * k * time) for k in WAVES])
        if surpasses(fit, squares(fit) * score.left, count, waves, 1):
            # One of more parts takes a part of what a simpler one explains.
            cost = fit.left * np.log(score.left) - count * np.log(CHANCE)
            found.append((cost, told, score, columns * time, names))
    if not found:
        return
    _, told, score, ramp, names = min(found, key=lambda one: one[0])
    first = np.flatnonzero(fit.problem.layout.component == 0)
    left, now = (f.unexplained[1][first] for f in (fit.explaining(ramp), fit))
    before = fit.errors
    after = before * float(np.linalg.norm(left) / np.linalg.norm(now))
    if after > LEFT * before:
        return
    unit = fit.problem.layout.quantities[0].unit
    caused = np.sqrt(max(before**2 - after**2, 0.0))
    large = caused > LARGE * expected_size(unit) and after < SURE * before
    finding = told(case, score, names)
    yield replace(
        finding,
        severity="error" if large else "warning",
        message=f"{finding.message} from the first measurement to the last: without it "
        f"{100 * after / before:.0f} % of the errors are left",
        evidence={**finding.evidence, "rms_before": before, "rms_after": after},
        figure="residuals-over-order",
    )


Told = Callable[[Case, Score, Sequence[str]], Finding]


def _drifts(case: Case) -> Iterator[tuple[Told, Floats, Sequence[str]]]:
    """The kinds of drift: what tells them, their columns and the names of these."""
    fit, problem, joints = case.fit, case.fit.problem, case.data.joints
    terms = [*problem.terms.values()]
    own = terms[0].index[:FRAME]
    values = {tuple(declared(model).columns)[:3] for model in case.data.models}
    if len({term.frames.station for term in terms}) == 1:
        J, scales = fit.linear[1][:, own], problem.parameters.scales[own]
        if problem.parameters.free[own].all():
            if values == {AXES}:
                rotation = terms[0].error.base.rotation
                yield _of_instrument, J[:, :3] / scales[:3] @ rotation.T, AXES
            yield _of_instrument, J, TRANSFORM
        elif values == {("distance",)}:
            yield _of_instrument, 1.0 / problem.sigma[:, None], ("distance",)
    # Of few measurements one joint may stand out, but not six.
    for k in range(len(joints)):
        yield _of_joints, fit.by_joints[:, [k]], joints[k : k + 1]
    yield _of_joints, fit.by_joints, joints


def _of_instrument(case: Case, score: Score, names: Sequence[str]) -> Finding:
    """A displacement of what is measured can be taken out, one that also turns not."""
    parameters, kind, remedy = case.setup.parameters, InstrumentDrift.name, PARTS
    if kind not in parameters:
        lines = written({"parameters": [*parameters, kind]})
        remedy += f"; or estimate it, with the setup lines {lines}"
        if not all(len(block.conditions.time) for block in case.data.blocks):
            remedy += " and a column 'time' [s]"
    said = "the instrument drifts against the robot"
    if names == TRANSFORM:
        return Finding("instrument-drift", "warning", said, remedy=remedy)
    size = float(np.linalg.norm(score.values))
    along = float(np.linalg.norm(score.values / size * score.deviations))
    unit, factor = DISPLAY["m"]
    shown = f"{factor * size:.2g} +- {factor * along:.1g} {unit}"
    reading = {"reading": {"drift": [float(f"{v:.3g}") for v in score.values]}}
    return Finding(
        "instrument-drift",
        "warning",
        f"the measured values drift by {shown}",
        dict(zip(names, score.values.tolist(), strict=True))
        | {"drift": size, "sigma": along},
        f"{remedy}; or state in the setup file: {written(reading)}",
        reading,
    )


def _of_joints(case: Case, score: Score, names: Sequence[str]) -> Finding:
    """Joint positions that drift, as those of a robot that grows warm."""
    worst = int(np.argmax(np.abs(score.values) / score.deviations))
    value, deviation = float(score.values[worst]), float(score.deviations[worst])
    shown = _shown(case, names[worst], "{:.2g} +- {:.1g}", value, deviation)
    return Finding(
        "robot-drift",
        "warning",
        f"the joint positions drift, most of all '{names[worst]}' by {shown}",
        {"joint": names[worst], "drift": value, "sigma": deviation},
        "let the robot warm up before it is measured",
    )
