"""The report of a calibration for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from calib_pin.compiled.threads import serial_blas
from calib_pin.planning.plan import Plan
from calib_pin.planning.suggestions import Suggestion
from calib_pin.report.accuracy import (
    accuracy,
    beyond,
    evaluated,
    moves,
    opening,
    subject,
)
from calib_pin.report.blocks import Block
from calib_pin.report.breakdown import frames_told, parts
from calib_pin.report.comparison import comparison_report
from calib_pin.report.identification import identified, summary
from calib_pin.report.places import frame_blocks
from calib_pin.report.plan_text import plan_report
from calib_pin.report.recalibration import recalibrated
from calib_pin.report.robot_errors import corrections, held, offsets, offsets_alone
from calib_pin.report.tables import listed
from calib_pin.report.terminal import plain_text
from calib_pin.report.trust import (
    correlated,
    expected,
    noise,
    outliers,
    statistics,
)
from calib_pin.validation.comparison import Comparison
from calib_pin.validation.result import CalibrationResult, Evaluation, Identification

LINES = 16
"""Lines of a report that are shown of it first."""


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
        >>> lines = calib_pin.format_report(result).splitlines()
        >>> print(next(line for line in lines if line.startswith("GOOD")))
        GOOD: position error 0.0922 mm rms instead of 25.3 mm on 40 independent held-out
    """
    return plain_text(report(result, details=details))


def brief(found: Any) -> str:
    """The first lines of the report of a result, for its `repr`."""
    ways: dict[type, Callable[[Any], Iterator[Block]]] = {
        CalibrationResult: report,
        Identification: partial(identified, fitted=False),
        Evaluation: evaluated,
        Comparison: comparison_report,
        Plan: plan_report,
    }
    lines = plain_text(ways[type(found)](found)).splitlines()
    return "\n".join([*lines[:LINES], *["..."] * (len(lines) > LINES)])


def report(
    result: CalibrationResult,
    suggestions: Sequence[Suggestion] = (),
    *,
    details: bool = False,
    formulae: bool = True,
) -> Iterator[Block]:
    """Verdict, accuracy, what was set aside and found, frames, identifiability.

    Args:
        result: The calibration.
        suggestions: Suggested measurements.
        details: Also the statistics, and all errors of the robot.
        formulae: With these also all parameters and combinations of them.
    """
    before, said, behind = opening(result)
    yield from (*before, said, *behind)
    yield subject(result)
    yield from accuracy(result, details=details)
    yield from recalibrated(result, details=details)
    yield from parts(result)
    alone = offsets_alone(result)
    if details or not alone:
        yield from moves(result)
    yield from beyond(result)
    yield from outliers(result)
    if details:
        yield from offsets(result, suggestions)
        yield from expected(result)
        yield from noise(result)
        yield from statistics(result)
    else:
        yield from corrections(result)
    yield from frame_blocks(result, lines=details)
    if details:
        yield from frames_told(result, details=True)
        yield from identified(
            result, fitted=True, suggestions=suggestions, details=formulae
        )
        yield from listed("at a bound", result.solver.at_bounds)
        if formulae:
            yield from correlated(result)
        return
    yield from frames_told(result)
    yield summary(result, () if alone else suggestions)
    if not alone:
        yield from held(result.robot_errors)
    yield from listed("at a bound", result.solver.at_bounds)
    # Last on the terminal: what is to be typed in.
    yield from offsets(result, suggestions)
