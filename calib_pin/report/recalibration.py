"""How a calibration has gone on from an older one."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.report.blocks import Block, Cell, Facts, Table, columns
from calib_pin.report.tables import SIZES, amount, known, number, sizes
from calib_pin.validation.result import CalibrationResult, RecalibrationStep

STEPS = 12
"""Calibrations of the history that are listed, the last ones."""


def recalibrated(result: CalibrationResult, *, details: bool = True) -> Iterator[Block]:
    """The errors by the older calibration, the drift, and the history.

    Args:
        result: The calibration.
        details: Also the drift and the history.
    """
    found = result.recalibration
    if found is None:
        return
    day = f" of {found.last.created[:10]}" if found.last.created else ""
    yield Table(
        f"New measurements by the older calibration{day}, before they were fitted",
        columns("", SIZES),
        [
            (Cell(name), *sizes(accuracy, unit, known))
            for name, unit, accuracy in found.errors
        ],
    )
    if not details:
        return
    yield Facts(
        "Drift from one calibration to the next, standard deviation",
        [
            (drift.name, f"{amount(drift.size, 'm')} or {amount(drift.size, 'rad')}")
            for drift in found.last.drifts
        ],
    )
    steps = found.steps[-STEPS:]
    first = len(found.steps) - len(steps) + 1
    yield Table(
        "Calibrations since the first one",
        columns(
            "",
            ("began with that of", "measurements", "chi-square", "dof", "changed"),
            {"began with that of": "word", "changed": "remark"},
        ),
        [_row(number_, step) for number_, step in enumerate(steps, first)],
    )


def _row(position: int, step: RecalibrationStep) -> tuple[Cell, ...]:
    jumps = ", ".join(jump.name or "the whole robot" for jump in step.jumps)
    return (
        Cell(str(position), position),
        Cell(step.created[:10] or step.start or "-"),
        Cell(str(step.measurements), step.measurements),
        Cell(number(step.chi2), step.chi2),
        Cell(str(step.dof), step.dof),
        Cell(jumps or "-"),
    )
