"""How a calibration has gone on from an older one."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.report.blocks import Block, Cell, Facts, table
from calib_pin.report.tables import SIZES, amount, number, sizes
from calib_pin.validation.result import CalibrationResult

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
    yield table(
        f"New measurements by the older calibration{day}, before they were fitted",
        ("", *SIZES),
        [(name, *sizes(accuracy, unit)) for name, unit, accuracy in found.errors],
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
    first = max(len(found.steps) - STEPS, 0)
    yield table(
        "Calibrations since the first one",
        (
            *("", "began with that of|word", "measurements"),
            *("chi-square", "dof", "changed|remark"),
        ),
        [
            (
                place,
                step.created[:10] or step.start or "-",
                step.measurements,
                Cell(number(step.chi2), step.chi2),
                step.dof,
                ", ".join(jump.name or "the whole robot" for jump in step.jumps) or "-",
            )
            for place, step in enumerate(found.steps[first:], first + 1)
        ],
    )
