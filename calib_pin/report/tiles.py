"""The headline of a calibration: errors before and after, and their change."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.report.blocks import Cell
from calib_pin.report.tables import percent, significant, unit_of
from calib_pin.validation.result import CalibrationResult

URDF, EVERYTHING = "the URDF alone", "with calib-pin compensate"
"""The ways to use a calibration that is more than a URDF can hold."""

UNUSED = {
    "no-gain": "not used: the URDF stays the nominal one",
    "untrusted": "not to be trusted",
    "unchecked": "not confirmed by held-out measurements",
}
"""Remarks on a headline that is no success, by the verdict."""


@dataclass(frozen=True)
class Step:
    """A size before and after.

    Attributes:
        name: What has to be used for it; empty where there is only one.
        before: The size of the nominal robot.
        after: That of the calibrated one.
        change: Of the size, such as `-47 %`; empty where there is none to tell.
    """

    name: str
    before: Cell
    after: Cell
    change: str


@dataclass(frozen=True)
class Tile:
    """The accuracy of one quantity in large letters.

    Attributes:
        label: What it is a size of.
        steps: One, or that of the URDF alone and that of everything.
        unit: The unit of all sizes.
        remark: A sentence below.
    """

    label: str
    steps: tuple[Step, ...]
    unit: str
    remark: str


def tiles(result: CalibrationResult) -> Iterator[Tile]:
    """Accuracy before and after: of every quantity, and over the workspace.

    Predictions are those of a model that has to be right: of one that must not be
    trusted there are none.
    """
    apart = result.urdf if result.verdict != "no-gain" else None
    alone = {} if apart is None else {e.name: e for e in apart.errors}
    used = result.verdict == "good"
    for error in result.errors:
        unit, factor = unit_of(error.unit)
        which = "held-out" if "validation" in error.stages else "fitted"
        before, after = error.shown
        stages = [("", after)]
        if (urdf := alone.get(error.name)) is not None:
            stages = [(URDF, urdf.shown[1]), (EVERYTHING, after)]
        p95, largest = (significant(factor * x) for x in (after.p95, after.max))
        yield Tile(
            label=f"mean {error.name} error of {which} measurements",
            steps=tuple(
                _step(name, before.mean, stage.mean, error.unit, used=used)
                for name, stage in stages
            ),
            unit=unit,
            remark=UNUSED.get(result.verdict)
            or f"95 % below {p95} {unit}, largest {largest} {unit}",
        )
    if result.verdict not in TRUSTED or result.verdict == "no-gain":
        return
    used_by = URDF * (result.model.setup.learned is not None)
    for chain, tool in result.accuracies.items():
        if (tip := tool.workspace) is not None:
            of = f" of {chain or 'the robot'}" if len(result.accuracies) > 1 else ""
            yield Tile(
                label=f"expected tool-point error{of} over the workspace, rms",
                steps=(_step(used_by, tip.nominal[0], tip.calibrated[0], "m"),),
                unit=unit_of("m")[0],
                remark=f"better than nominal with probability {percent(tip.better)}",
            )


def _step(
    name: str, before: float, after: float, unit: str, *, used: bool = True
) -> Step:
    """Sizes with two significant digits; no change is told of what is not used."""
    factor = unit_of(unit)[1]
    first, last = (Cell(significant(factor * x), x) for x in (before, after))
    return Step(name, first, last, change(before, after) if used else "")


def change(before: float, after: float) -> str:
    """How much more or less a size is, in percent; never all of it by rounding.

    Examples:
        >>> change(0.76, 0.40), change(25.3, 0.09), change(1.0, 1.2), change(0.0, 1.0)
        ('-47 %', '-99.6 %', '+20 %', '')
    """
    if not (math.isfinite(before) and math.isfinite(after) and before > 0.0):
        return ""
    part = 100.0 * (after / before - 1.0)
    if after > 0.0 and part < -99.0:
        return f"{max(math.ceil(10.0 * part) / 10.0, -99.9):.1f} %"
    return f"{round(part):+d} %"
