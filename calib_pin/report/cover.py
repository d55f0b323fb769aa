"""The first page of a report for a customer: what it says, wherever it is laid out."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.kinematics.robot import Robot
from calib_pin.report.acceptance_text import TONES, doubt_lines, ends, limit_lines
from calib_pin.report.accuracy import degrees
from calib_pin.report.blocks import Cell, Line, Table, Tone, note, table
from calib_pin.report.figures import Drawn
from calib_pin.report.tables import UNIT, amount, measures
from calib_pin.report.tiles import Tile, tiles
from calib_pin.report.trust import verdict
from calib_pin.setup import LimitSetup, ReportSetup
from calib_pin.validation.acceptance import Acceptance, judged, limits, measured, worst
from calib_pin.validation.result import CalibrationResult

CERTIFIED = (
    "In the terms of ISO 9283. A certified test needs the standard itself, which also "
    "says which poses, speeds and loads there must be."
)

SUMMARIES: Mapping[str, str] = {
    "fail": "A stated limit is not met.",
    "undecided": "The test does not decide on every limit: more visits do.",
    "pass": "All stated limits are met.",
    "": "There is nothing to pass: no limit was stated.",
}
"""Sentences by the status of all limits together, the worst first."""

QUANTITIES = {
    "AP": "pose accuracy AP, worst pose",
    "RP": "pose repeatability RP, worst pose",
    "AD": "distance accuracy AD, worst pair",
    "orientation": "orientation accuracy, worst axis",
}

PICTURES = ("robot-errors", "cumulative-errors", "errors-per-measurement")
"""Figures of a calibration that a customer gets."""

ROBOTS = {"nominal": "before", "calibrated": "after"}


@dataclass(frozen=True)
class Cover:
    """The first page.

    Attributes:
        title: Kind of the report.
        status: The verdict in a word or two.
        tone: Its tone.
        sentences: The verdict in sentences, and facts that must be known beside it.
        robot: Name of the robot.
        facts: Names and values of measurements, conditions and people; an empty value
            is filled in by hand.
        figures: The pictures; those for which there is no room stand behind it.
        entries: Entries of the user; it has a date.
        numbers: The key numbers, before and after.
        headline: Key numbers in large letters, instead of a table.
        remark: A sentence below everything else; empty for none.
    """

    title: str
    status: str
    tone: Tone
    sentences: Sequence[Line]
    robot: str
    facts: Sequence[tuple[str, str]]
    figures: Sequence[Drawn]
    entries: ReportSetup
    numbers: Table | None = None
    headline: Sequence[Tile] = ()
    remark: str = ""


def acceptance_cover(
    tests: Mapping[str, Acceptance],
    limit: LimitSetup,
    robot: Robot,
    entries: ReportSetup,
    about: str,
    figure: Drawn | None = None,
) -> Cover:
    """The first page of an acceptance test.

    Args:
        tests: The test by the robot that the commanded poses are of.
        limit: What must be reached.
        robot: The robot.
        entries: What the user stated, with a date.
        about: The robot, the poses and the frame, in a sentence.
        figure: The picture.
    """
    *_, last = tests.values()
    results = {name: status for name, status, *_ in judged(last, limit)}
    status = next((s for s in SUMMARIES if s in results.values()), "")
    sentences, doubts = [*limit_lines(last, limit)], [*doubt_lines(last)]
    if not doubts or status == "fail":
        sentences.insert(0, Line(SUMMARIES[status]))
    rows, bounds = [], limits(limit)
    # The worst of each quantity by robot, with its limit.
    for key, (intervals, unit) in measured(last).items():
        worsts = [worst(measured(t)[key][0]).value for t in tests.values()]
        allowed, _ = bounds.get(key, (math.nan, unit))
        *cells, most, shown = measures(unit, *worsts, allowed)
        cells += [Cell(ends(worst(intervals), unit)), most, shown]
        status_of = results.get(key, "").upper()
        rows.append((QUANTITIES[key], *cells, status_of))
    robots = (ROBOTS.get(name, "found") for name in tests)
    titles = ("", *robots, "95 %", "limit", UNIT, "status|word")
    # The standard asks for them.
    conditions = _conditions(entries, load=entries.load, speed=entries.speed)
    return Cover(
        title="Acceptance test",
        status=status.upper() or "NO LIMIT STATED",
        tone=TONES.get(status, "strong"),
        sentences=[*sentences, *doubts],
        robot=robot.name,
        facts=[
            *_facts(robot, entries, limit),
            *((name, words or "not stated") for name, words in conditions.items()),
        ],
        figures=[] if figure is None else [figure],
        entries=entries,
        numbers=table("Results", titles, rows),
        remark=f"{about} {CERTIFIED}",
    )


def calibration_cover(
    result: CalibrationResult, entries: ReportSetup, drawn: Sequence[Drawn] = ()
) -> Cover:
    """The first page of a calibration."""
    robot, limit = result.model.chains.robot, result.model.setup.limit
    figures = {figure.name: figure for figure in drawn}
    line = verdict(result)
    status, _, reason = line.text.partition(": ")
    sentences = [Line(reason[:1].upper() + reason[1:])]
    if result.verdict not in TRUSTED:
        sentences.insert(0, Line("This calibration must not be trusted.", "bad"))
    if limit != LimitSetup():
        sentences.append(note("Whether the limit is met an acceptance test tells."))
    return Cover(
        title="Calibration report",
        status=status,
        tone=line.tone,
        sentences=sentences,
        robot=robot.name,
        facts=[*_facts(robot, entries, limit), *_conditions(entries).items()],
        figures=[figures[name] for name in PICTURES if name in figures],
        entries=entries,
        headline=[*tiles(result)],
    )


def _facts(
    robot: Robot, entries: ReportSetup, limit: LimitSetup
) -> list[tuple[str, str]]:
    """The facts."""
    parts = (
        f"{name} {amount(most, unit)}" for name, (most, unit) in limits(limit).items()
    )
    return [
        ("robot", robot.name),
        ("serial number", entries.serial_number),
        ("file", Path(robot.file).name or robot.file),
        ("SHA-256", hashlib.sha256(robot.source).hexdigest()),
        ("limit", ", ".join(parts) or "no limit was stated"),
        ("date", entries.date or ""),
        ("customer", entries.customer),
        ("operator", entries.operator),
    ]


def _conditions(entries: ReportSetup, **more: str) -> dict[str, str]:
    """The conditions of the measurements; empty where they are not stated."""
    known = {"instrument": entries.instrument, "temperature": degrees(entries)}
    return known | more
