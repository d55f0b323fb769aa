"""The first page of a report for a customer: what it says, wherever it is laid out."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.kinematics.robot import Robot
from calib_pin.report.acceptance_text import (
    PATH,
    TONES,
    doubt_lines,
    ends,
    limit_lines,
)
from calib_pin.report.accuracy import degrees
from calib_pin.report.blocks import Line, Table, Tone, table
from calib_pin.report.figures import Drawn
from calib_pin.report.tables import UNIT, amount, quantity, unit_of
from calib_pin.report.tiles import Tile, tiles
from calib_pin.report.trust import verdict
from calib_pin.setup import LimitSetup, ReportSetup
from calib_pin.validation.acceptance import Acceptance, judged, measured, worst
from calib_pin.validation.result import CalibrationResult

CERTIFIED = (
    "In the terms of ISO 9283. A certified test needs the standard itself, which also "
    "says which poses, speeds and loads there must be."
)

NO_LIMIT = "no limit was stated"

SAID: Mapping[str, str] = {
    "pass": "All stated limits are met.",
    "fail": "A stated limit is not met.",
    "undecided": "The test does not decide on every limit: more visits do.",
    "": "There is nothing to pass: no limit was stated.",
}
"""Sentences by the status of all limits together."""

QUANTITIES = {
    "AP": "pose accuracy AP, worst pose",
    "RP": "pose repeatability RP, worst pose",
    "AT": "path accuracy AT",
    "RT": "path repeatability RT",
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
        said: The verdict in sentences, and what must be known beside it.
        robot: Name of the robot.
        facts: Names and values of what was measured, how, when and by whom; an empty
            value is filled in by hand.
        numbers: The key numbers, before and after.
        remark: A sentence below everything else; empty for none.
        figures: The pictures; those for which there is no room stand behind it.
        entries: What the user stated; it has a date.
        headline: Key numbers in large letters, instead of a table.
    """

    title: str
    status: str
    tone: Tone
    said: Sequence[Line]
    robot: str
    facts: Sequence[tuple[str, str]]
    numbers: Table
    remark: str
    figures: Sequence[Drawn]
    entries: ReportSetup
    headline: Sequence[Tile] = ()

    @property
    def day(self) -> str:
        """The date of the report, year-month-day."""
        return self.entries.date or ""

    @property
    def made(self) -> str:
        """The program that made it."""
        return program()


def program() -> str:
    """The program and its version, as pages name it."""
    return f"calib-pin {version('calib_pin')}"


def acceptance_cover(
    found: Mapping[str, Acceptance],
    limit: LimitSetup,
    robot: Robot,
    entries: ReportSetup,
    about: str,
    *,
    path: bool = False,
    figure: Drawn | None = None,
) -> Cover:
    """The first page of an acceptance test.

    Args:
        found: The test by the robot that the commanded poses are of.
        limit: What must be reached.
        robot: The robot.
        entries: What the user stated, with a date.
        about: The robot, the poses and the frame, in a sentence.
        path: Whether the poses are points of a path.
        figure: The picture.
    """
    *_, (_, last) = found.items()
    statuses = {status for _, status, *_ in judged(last, limit)}
    status = next((s for s in ("fail", "undecided", "pass") if s in statuses), "")
    said, doubts = [*limit_lines(last, limit, path=path)], [*doubt_lines(last)]
    if not doubts or status == "fail":
        said.insert(0, Line(SAID[status]))
    return Cover(
        title="Acceptance test",
        status=status.upper() or "NO LIMIT STATED",
        tone=TONES.get(status, "strong"),
        said=[*said, *doubts],
        robot=robot.name,
        facts=_facts(robot, entries, limit, PATH if path else {}),
        numbers=_tested(found, limit, path),
        remark=f"{about} {CERTIFIED}",
        figures=[] if figure is None else [figure],
        entries=entries,
    )


def calibration_cover(
    result: CalibrationResult, entries: ReportSetup, drawn: Sequence[Drawn] = ()
) -> Cover:
    """The first page of a calibration."""
    robot, limit = result.model.chains.robot, result.model.setup.limit
    figures = {figure.name: figure for figure in drawn}
    line = verdict(result)
    status, _, reason = line.text.partition(": ")
    said = [Line(reason[:1].upper() + reason[1:])]
    if result.verdict not in TRUSTED:
        said.insert(0, Line("This calibration must not be trusted.", "bad"))
    if limit != LimitSetup():
        said.append(Line("Whether the limit is met an acceptance test tells.", "note"))
    return Cover(
        title="Calibration report",
        status=status,
        tone=line.tone,
        said=said,
        robot=robot.name,
        facts=_facts(robot, entries, limit),
        numbers=Table("Results", (), ()),
        remark="",
        figures=[figures[name] for name in PICTURES if name in figures],
        entries=entries,
        headline=[*tiles(result)],
    )


def _facts(
    robot: Robot,
    entries: ReportSetup,
    limit: LimitSetup,
    renamed: Mapping[str, str] | None = None,
) -> list[tuple[str, str]]:
    """The facts; quantities of the limits of a test may have other names."""
    conditions = [
        ("instrument", entries.instrument),
        ("temperature", degrees(entries)),
    ]
    if renamed is not None:  # The standard asks for them.
        conditions += [("load", entries.load), ("speed", entries.speed)]
        conditions = [(name, words or "not stated") for name, words in conditions]
    limits = [
        f"{(renamed or {}).get(name, name)} {size}" for name, size in _limits(limit)
    ]
    return [
        ("robot", robot.name),
        ("serial number", entries.serial_number),
        ("file", Path(robot.file).name or robot.file),
        ("SHA-256", hashlib.sha256(robot.source).hexdigest()),
        ("limit", ", ".join(limits) or NO_LIMIT),
        ("date", entries.date or ""),
        ("customer", entries.customer),
        ("operator", entries.operator),
        *conditions,
    ]


def _limits(limit: LimitSetup) -> Iterator[tuple[str, str]]:
    for name, allowed, unit in (
        ("AP", limit.position, "m"),
        ("RP", limit.repeatability, "m"),
        ("AD", limit.distance, "m"),
        ("orientation", limit.orientation, "rad"),
    ):
        if allowed is not None:
            yield name, amount(allowed, unit)


def _tested(found: Mapping[str, Acceptance], limit: LimitSetup, path: bool) -> Table:
    """The worst of each quantity by robot, with its limit."""
    *_, (_, last) = found.items()
    results = {name: (s, allowed) for name, s, _, allowed, _ in judged(last, limit)}
    rows = []
    for key, (intervals, unit) in measured(last).items():
        own = worst(intervals)
        worsts = (worst(measured(t)[key][0]).value for t in found.values())
        status, allowed = results.get(key, ("", None))
        rows.append(
            (
                QUANTITIES[PATH.get(key, key) if path else key],
                *(quantity(value, unit) for value in worsts),
                ends(own, unit),
                "-" if allowed is None else quantity(allowed, unit),
                unit_of(unit)[0],
                status.upper(),
            )
        )
    robots = (ROBOTS.get(name, "found") for name in found)
    titles = ("", *robots, "95 %", "limit", UNIT, "status|word")
    return table("Results", titles, rows)
