"""The key numbers of a calibration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from calib_pin.report.blocks import Cell
from calib_pin.report.tables import quantity
from calib_pin.report.trust import percent
from calib_pin.units import DISPLAY
from calib_pin.validation.result import CalibrationResult


@dataclass(frozen=True)
class Tile:
    """The accuracy of one quantity in large letters."""

    label: str
    before: Cell
    after: Cell
    unit: str
    remark: str


def tiles(result: CalibrationResult) -> Iterator[Tile]:
    """Accuracy before and after: of every quantity, and over the workspace."""
    for error in result.errors:
        before, after, which = error.before, error.after, "fitted"
        if error.validation_before and error.validation_after:
            before, after = error.validation_before, error.validation_after
            which = "validation"
        unit = error.unit
        yield Tile(
            label=f"mean {error.name} error, {which} measurements",
            before=quantity(before.mean, unit),
            after=quantity(after.mean, unit),
            unit=DISPLAY[unit][0],
            remark=f"95 % below {quantity(after.p95, unit).text}, "
            f"largest {quantity(after.max, unit).text} {DISPLAY[unit][0]}",
        )
    for chain, tool in result.accuracies.items():
        found = tool.workspace
        if found is not None and result.verdict != "no-gain":
            several = len(result.accuracies) > 1
            of = f" of {chain or 'the robot'}" if several else ""
            yield Tile(
                label=f"expected tool-point error{of} over the workspace, rms",
                before=quantity(found.nominal[0], "m"),
                after=quantity(found.calibrated[0], "m"),
                unit=DISPLAY["m"][0],
                remark=f"better than nominal: {percent(found.better)}",
            )
