"""The report of a calibration: its sections, and its short form for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import calib_pin.report.accuracy as accurate
import calib_pin.report.trust as trust
from calib_pin.compiled.threads import serial_blas
from calib_pin.report.blocks import Block, Line, note
from calib_pin.report.breakdown import frame_blocks, parts, still_joints
from calib_pin.report.identification import (
    corrections,
    held,
    identified,
    in_full,
    offsets,
    offsets_alone,
    summary,
)
from calib_pin.report.tables import listed, outlier_table
from calib_pin.report.terminal import plain_text
from calib_pin.validation.result import (
    CalibrationResult,
    Evaluation,
    Identification,
)

LINES = 16
"""Lines of a report that are shown of it first."""

PLACES = "Tool, base, stations and cameras"

LISTED = 5, 200
"""Outliers that a terminal and a page list."""


@serial_blas
def format_report(result: CalibrationResult, *, details: bool = False) -> str:
    """The report of a calibration as plain text of at most 80 columns.

    Args:
        result: The calibration.
        details: Also the statistics, and all parameters and combinations of them.

    Examples:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space7")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space7", "measurements.csv"), chain
        ... )
        >>> result = calib_pin.calibrate(chain, rows, setup)
        >>> print(calib_pin.format_report(result).splitlines()[0])
        GOOD: position error 0.0922 mm rms instead of 25.3 mm on 40 independent held-out
    """
    return plain_text(report(result, details=details))


def brief(result: Any) -> str:
    """The first lines of the report of a result, for its `repr`."""
    # A calibration shows itself without planning and comparison.
    from calib_pin.planning.plan import Plan
    from calib_pin.report.comparison import comparison_report
    from calib_pin.report.plan_text import plan_report
    from calib_pin.validation.comparison import Comparison

    ways: dict[type, Callable[[Any], Iterator[Block]]] = {
        CalibrationResult: report,
        Identification: partial(identified, fitted=False),
        Evaluation: accurate.evaluated,
        Comparison: comparison_report,
        Plan: plan_report,
    }
    lines = plain_text(ways[type(result)](result)).splitlines()
    return "\n".join([*lines[:LINES], *["..."] * (len(lines) > LINES)])


def report(
    result: CalibrationResult,
    *,
    details: bool = False,
    formulae: bool = True,
) -> Iterator[Block]:
    """Verdict, findings, accuracy, frames, identifiability, and what to do next.

    Args:
        result: The calibration.
        details: All sections, instead of what a person sees first.
        formulae: With these also all parameters and combinations of them.
    """
    yield from trust.opening(result, None if details else trust.FIRST)
    yield accurate.subject(result)
    if details:
        for section in sections(result, LISTED[0]):
            if section.key != "measured":
                yield from section.blocks
        if formulae:
            yield from in_full(result, fitted=True)
        yield from trust.next_step(result)
        return
    yield from accurate.accuracy(result, details=False)
    yield from accurate.recalibrated(result, details=False)
    yield from parts(result)
    alone = offsets_alone(result)
    if not alone:
        yield from accurate.moves(result)
    yield from accurate.beyond(result)
    yield from corrections(result)
    yield from frame_blocks(result)
    yield from still_joints(result)
    yield summary(result, advised=not alone)
    if not alone:
        yield from held(result.robot_errors, details=False)
    yield from listed("at a bound", result.solver.at_bounds)
    # Last on the terminal: what is to be typed in, and what to do.
    yield from offsets(result)
    yield from trust.next_step(result)


@dataclass(frozen=True)
class Section:
    """A part of a report: `key` and `title`, its blocks, and names of its figures."""

    key: str
    title: str
    blocks: Sequence[Block]
    figures: tuple[str, ...] = ()


def sections(result: CalibrationResult, most: int = LISTED[1]) -> Iterator[Section]:
    """All that is told of a calibration behind its verdict.

    First what a customer takes home, then what a statistician asks for.

    Args:
        result: The calibration.
        most: How many outliers are listed.
    """
    frames = [*offsets(result), *frame_blocks(result)]
    accuracy = (
        *(accurate.accuracy(result), accurate.recalibrated(result), parts(result)),
        *(accurate.moves(result), trust.expected(result), accurate.beyond(result)),
    )
    remedies = (
        listed(f"identifiable if you {remedy.change}", remedy.parameters)
        for remedy in result.suggestions
    )
    known = identified(result, fitted=True)
    identifiable = (known, still_joints(result), *remedies)
    bounded = listed("at a bound", result.solver.at_bounds)
    noise = trust.noise(result), trust.statistics(result)
    outliers = _outliers(result, most)
    errors = "errors-per-measurement", "tip-accuracy-in-workspace"
    every: tuple[tuple[str, str, Iterable[Iterable[Block]], Sequence[str]], ...] = (
        ("frames", PLACES, [frames or [note(accurate.KNOWN)]], []),
        ("measured", "Measurements", [[accurate.measurement_facts(result)]], []),
        ("findings", "Outliers and findings", [outliers], ["residuals-over-order"]),
        ("accuracy", "Accuracy", accuracy, errors),
        ("identifiability", "Identifiability", identifiable, []),
        ("parameters", "Parameters", [bounded], []),
        ("residuals", "Noise and statistics", noise, ["residuals-by-joint"]),
    )
    for key, title, blocks, figures in every:
        yield Section(key, title, [*chain.from_iterable(blocks)], tuple(figures))


def _outliers(result: CalibrationResult, most: int) -> Iterator[Block]:
    count, on_page = len(result.statistics.outliers), most > LISTED[0]
    if count:
        yield outlier_table(result, most, errors=on_page)
    elif on_page:
        yield Line("No measurement is an outlier.")
    if count > most:
        yield Line(f"and {count - most} more in calibration.json", indent=True)
