"""The report of a compensation as tables for a terminal, at most 80 columns wide."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from calib_pin.chain import Chain
from calib_pin.compensation import Compensation
from calib_pin.report.tables import number, table
from calib_pin.spatial import Floats
from calib_pin.units import DISPLAY

__all__ = ["accuracy_lines", "compensation_report", "line_list"]

SHOWN = 12
"""Lines that are named before the rest is only counted."""


def compensation_report(
    found: Compensation,
    chain: Chain,
    *,
    motion: bool,
    file: str,
    lines: Sequence[int],
) -> RenderableType:
    """What is commanded, what it is worth, and what cannot be reached.

    Args:
        found: The commands.
        chain: The chain.
        motion: Whether the targets are those of a joint motion.
        file: The file of the targets.
        lines: Line of each target.
    """
    count, reached = len(found), int(found.reached.sum())
    what = "configurations of the nominal robot" if motion else "targets"
    kind = "poses" if found.oriented else "positions only"
    parts: list[RenderableType] = [
        Text(
            f"{chain.robot.name}: {reached} of {count} {what} reached ({kind}), "
            "joint limits kept.",
            style="bold" if reached == count else "bold red",
        )
    ]
    if reached:
        parts += ["", _errors(found), "", *_corrections(found, chain)]
        numbers = np.asarray(lines)
        at_limit = numbers[found.reached & found.at_limit]
        if len(at_limit):
            parts.append(Text(f"A joint stands at its limit in {line_list(at_limit)}."))
        outside = numbers[found.reached & found.outside]
        if len(outside):
            parts.append(
                Text(
                    "Outside the region in which the learned correction was trained, "
                    f"where it fades: {line_list(outside)}.",
                    style="bold red",
                )
            )
    parts += _unreached(found, file, lines)
    joints = len(chain.joints)
    if found.oriented and reached < count and joints < 6:
        parts.append(
            Text(
                f"{joints} joints reach few poses; --position asks for positions only."
            )
        )
    if motion and found.reached.all():
        parts += _jumps(found, lines)
    return Group(*parts)


def accuracy_lines(errors: Mapping[str, Mapping[str, Any]]) -> Iterator[Text]:
    """How far the model itself is off, by what a calibration says of unseen rows.

    Args:
        errors: Unit, mean, max and method by quantity.
    """
    for name, error in errors.items():
        unit, factor = DISPLAY[error["unit"]]
        mean, largest = (number(factor * error[key]) for key in ("mean", "max"))
        yield Text(
            f"On unseen rows ({error['method']}) the model itself is off by {mean} "
            f"{unit} mean, {largest} max ({name}).",
            style="dim",
        )


def line_list(lines: Sequence[int] | np.ndarray) -> str:
    """Line numbers in words."""
    names = [str(int(line)) for line in lines[:SHOWN]]
    more = len(lines) - len(names)
    shown = ", ".join(names) + (f" and {more} more" if more else "")
    return f"line {shown}" if len(lines) == 1 else f"lines {shown}"


def _errors(found: Compensation) -> RenderableType:
    """Errors at the nominal commands and at those that were found."""
    errors = table(
        "Distance from the targets, as the calibrated model has it",
        ("commands", "mean", "max", "unit"),
    )
    errors.columns[1].justify = "left"
    stages = [
        ("position", "m", found.position_before, found.position),
        ("orientation", "rad", found.orientation_before, found.orientation),
    ]
    for name, unit, before, after in stages[: 2 if found.oriented else 1]:
        for robot, sizes in (("nominal", before), ("compensated", after)):
            sizes = sizes[found.reached & np.isfinite(sizes)]
            errors.add_row(name, robot, *_sizes(sizes, unit), DISPLAY[unit][0])
            name = ""
    return errors


def _corrections(found: Compensation, chain: Chain) -> Iterator[RenderableType]:
    sizes = np.abs(found.corrections)
    if not len(sizes):
        return
    joints = table("Joint corrections", ("mean", "max", "unit"))
    for name, revolute, column in zip(
        chain.joints, chain.revolute, sizes.T, strict=True
    ):
        unit = "rad" if revolute else "m"
        joints.add_row(name, *_sizes(column, unit), DISPLAY[unit][0])
    yield joints


def _sizes(sizes: Floats, unit: str) -> tuple[str, str]:
    factor = DISPLAY[unit][1]
    if not len(sizes):
        return "-", "-"
    return number(factor * float(sizes.mean())), number(factor * float(sizes.max()))


def _unreached(
    found: Compensation, file: str, lines: Sequence[int]
) -> Iterator[RenderableType]:
    """Every target that cannot be reached, by line."""
    (missed,) = np.nonzero(~found.reached)
    if not len(missed):
        return
    yield ""
    yield Text("Out of reach, or behind the joint limits:", style="bold")
    for row in missed:
        remains = f"{number(1e3 * found.position[row])} mm"
        if found.oriented:
            unit, factor = DISPLAY["rad"]
            remains += f" and {number(factor * found.orientation[row])} {unit}"
        yield Padding(f"{file}:{lines[int(row)]}: {remains} remain", (0, 0, 0, 2))


def _jumps(found: Compensation, lines: Sequence[int]) -> Iterator[RenderableType]:
    jumps = np.asarray(lines)[found.jumps]
    if len(jumps):
        yield ""
        yield Text(
            "The corrections jump, as near a singularity, from the row before to "
            f"{line_list(jumps)}: the robot would leave the way between them.",
            style="bold red",
        )
