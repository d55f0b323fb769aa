"""Findings of instruments that were moved, and of tools that were mounted again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import error_table
from calib_pin.measurement_models.readings import place_of
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.file_order import Job, Kind
from calib_pin.validation.findings.moves import Trial, moved
from calib_pin.validation.findings.setup_lines import lines_of, written

CODES: dict[Kind, str] = {"station": "instrument-moved", "tool": "tool-remounted"}

TRANSFORM = ("x", "y", "z", "rx", "ry", "rz")
"""A new frame in the old one: position and rotation vector."""

REMEDIES: dict[Kind, str] = {
    "station": "give the two parts different stations (a column 'station', or "
    "--station-per-file)",
    "tool": "give the two parts different tools (a column 'tool')",
}

AROUND = 50
"""Measurements on each side of a move among which its line is found."""


def move_findings(case: Case) -> tuple[Finding, ...]:
    """Where instruments were moved and tools mounted again, in their order."""
    found = moved(case)
    return () if found is None else tuple(_findings(case.data, *found))


def _findings(data: Observations, first: Trial, last: Trial) -> Iterator[Finding]:
    every = Job.of(data)
    quantity = first.problem.layout.quantities[0]
    errors = [
        float(np.sqrt(np.mean(quantity.errors(error_table(t.problem, t.theta)) ** 2)))
        for t in (first, last)
    ]
    settled, _ = last.problem.rebased(last.theta)
    firsts: dict[Kind, list[str]] = {"station": [], "tool": []}
    found = []
    for k in sorted(range(len(last.moves)), key=lambda k: last.moves[k].rank):
        kind, _, at = last.moves[k]
        one, other = (settled.terms[key] for key in _sides(last, k))
        if kind == "station":
            # Where the instrument stands, in the base link.
            A, B = one.error.base.inverse(), other.error.base.inverse()
        else:
            A, B = one.error.tool, other.error.tool
        # Of a single point nobody knows how it is turned.
        turns = kind == "station" or len(one.measurement.quantities) > 1
        apart = A.inverse() * B
        vector = [*apart.translation, *(pin.log3(apart.rotation) if turns else ())]
        distance = float(np.linalg.norm(vector[:3]))
        angle = float(np.linalg.norm(vector[3:])) if turns else None
        if len(every.data) > len(last.job.data):
            step = len(every.data) // len(last.job.data)
            at = last.place(k, every.rows(np.abs(every.rank - at) < AROUND + step))
        own = last.concerned(k, every)
        block = every.data.blocks[every.data.block_of[own[0]]].key
        row, next_row = own[np.searchsorted(every.rank[own], at) + np.array([-1, 0])]
        file, line = data.files[row], int(data.lines[row]) or int(every.rank[row]) + 1
        place = f"after {'line' if file else 'measurement'} {line}"
        if len(data.files.distinct) > 1:
            place += f" of {file}"
        if data.files[next_row] != file:
            place = f"between {file} and {data.files[next_row]}"
        firsts[kind].append(place_of(data, next_row))
        found.append(
            Finding(
                CODES[kind],
                "error",
                f"{_subject(kind, block)} {place} ({_size(distance, angle)})",
                {
                    "file": file,
                    "line": line,
                    "distance": distance,
                    **({} if angle is None else {"angle": angle}),
                    **dict(zip(TRANSFORM, map(float, vector), strict=False)),
                    "rms_before": errors[0],
                    "rms_after": errors[1],
                },
                REMEDIES[kind],
                figure="residuals-over-order",
            )
        )
    reading = ReadingSetup(
        moved=tuple(firsts["station"]), remounted=tuple(firsts["tool"])
    )
    setup = {"reading": lines_of(reading)}
    for finding in found:
        remedy = f"{finding.remedy}, or state in the setup file: {written(setup)}"
        yield replace(finding, remedy=remedy, setup=setup)


def _sides(trial: Trial, k: int) -> tuple[BlockKey, BlockKey]:
    """The blocks of the measurements before and after a move."""
    ranks = trial.job.rank[trial.concerned(k, trial.job)]
    after = int(np.searchsorted(ranks, trial.moves[k].rank))
    data = trial.problem.data
    before, behind = (
        data.blocks[int(data.block_of[trial.rank == ranks[place]][0])].key
        for place in (after - 1, after)
    )
    return before, behind


def _subject(kind: Kind, key: BlockKey) -> str:
    """The subject of the sentence, by the name that the measurements give."""
    name = getattr(key, kind)
    if kind == "station":
        told = f" of the station '{name}'" if name else ""
        return f"the instrument{told} moved"
    return f"the tool '{name}' was re-mounted" if name else "the tool was re-mounted"


def _size(distance: float, angle: float | None) -> str:
    """A displacement that people read."""
    found = f"{distance:.3g} m" if distance >= 0.1 else f"{1e3 * distance:.3g} mm"
    return found if angle is None else f"{found}, {np.degrees(angle):.3g} deg"
