"""The report of a calibration for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from calib_pin.compiled.threads import serial_blas
from calib_pin.planning.suggestions import Suggestion
from calib_pin.report.accuracy import accuracy, beyond, moves, opening, subject
from calib_pin.report.blocks import Block
from calib_pin.report.breakdown import parts, told
from calib_pin.report.identification import identified
from calib_pin.report.places import frame_blocks
from calib_pin.report.tables import listed
from calib_pin.report.terminal import plain_text
from calib_pin.report.trust import (
    correlated,
    expected,
    noise,
    outliers,
    statistics,
)
from calib_pin.validation.result import CalibrationResult


@serial_blas
def format_report(result: CalibrationResult) -> str:
    """The report of a calibration as plain text of at most 80 columns.

    Example:
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
    return plain_text(report(result))


def report(
    result: CalibrationResult, suggestions: Sequence[Suggestion] = ()
) -> Iterator[Block]:
    """Verdict, accuracy, noise and outliers, then identifiability and parameters."""
    before, said, behind = opening(result)
    yield from (*before, said, *behind)
    yield subject(result)
    yield from accuracy(result)
    yield from parts(result)
    yield from moves(result)
    yield from frame_blocks(result)
    yield from expected(result)
    yield from beyond(result)
    yield from noise(result)
    yield from statistics(result)
    yield from outliers(result)
    yield from told(result)
    yield from identified(result, fitted=True, suggestions=suggestions)
    yield from listed("at a bound", result.solver.at_bounds)
    yield from correlated(result)
