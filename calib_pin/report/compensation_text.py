"""The report of a compensation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from calib_pin.control.compensation import Compensation
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.kinematics.spatial import Floats
from calib_pin.report.blocks import Block, Line, Names, Table, Tone, note, table
from calib_pin.report.tables import UNIT, amount, measures

SHOWN = 12
"""Lines that are named; the rest is counted."""


def compensation_report(
    result: Compensation, chain: Chain, *, motion: bool, file: str, lines: Sequence[int]
) -> Iterator[Block]:
    """The targets reached, the errors that remain, and the targets out of reach.

    A motion has joint positions as targets; `lines` are those of the targets in a file.
    """
    count, reached = len(result), int(result.reached.sum())
    what = "configurations of the nominal robot" if motion else "targets"
    kind = "poses" if result.oriented else "positions only"
    yield Line(
        f"{chain.robot.name}: {reached} of {count} {what} reached ({kind}), "
        "joint limits kept.",
        "strong" if reached == count else "bad",
    )
    numbers = np.asarray(lines)
    if reached:
        yield from _tables(result, chain)
        at = numbers[result.reached & result.at_limit]
        yield from _line_note(at, "A joint is at its limit in {}.", "plain")
        yield from _line_note(
            numbers[result.reached & result.outside],
            "Outside the region in which the learned correction was trained, where it "
            "knows less: {}.",
        )
    if result.sides.any():
        yield Line(
            "Lost motion is made up for as the commands follow one another. Until a "
            "joint has moved once, it is taken to stand in the middle of its lost "
            "motion."
        )
    entries = []
    for row in np.flatnonzero(~result.reached):
        remains = amount(result.position[row], "m")
        if result.oriented:
            remains += f" and {amount(result.orientation[row], 'rad')}"
        entries.append(f"{file}:{lines[int(row)]}: {remains} remain")
    if entries:
        yield Names("Out of reach, or behind the joint limits:", entries)
    joints = len(JointColumns.of(chain).joints)
    if result.oriented and reached < count and joints < 6:
        yield Line(
            f"{joints} joints reach few poses; --position asks for positions only."
        )
    if motion and result.reached.all():
        yield from _line_note(
            numbers[result.jumps],
            "Discontinuity in joint space, as near a singularity, between {} and the "
            "line before: the robot would leave its path.",
        )


def hasty_lines(lines: Sequence[int]) -> Iterator[Line]:
    """Lines to which a joint would move faster than it can."""
    yield from _line_note(
        lines,
        "By the times of the file a joint moves faster than the URDF allows to {}.",
    )


def accuracy_lines(errors: Mapping[str, Mapping[str, Any]]) -> Iterator[Line]:
    """The error of the model itself on validation measurements, by quantity."""
    for name, error in errors.items():
        mean, largest = (amount(error[key], error["unit"]) for key in ("mean", "max"))
        yield note(
            f"Error of the model itself on validation measurements ({error['method']}, "
            f"{name}): mean {mean}, max {largest}."
        )


def line_list(lines: Sequence[int] | np.ndarray) -> str:
    """Line numbers in words."""
    names = [str(int(line)) for line in lines[:SHOWN]]
    more = len(lines) - len(names)
    shown = ", ".join(names) + (f" and {more} more" if more else "")
    return f"line {shown}" if len(lines) == 1 else f"lines {shown}"


def _line_note(
    lines: Sequence[int] | np.ndarray, sentence: str, tone: Tone = "bad"
) -> Iterator[Line]:
    """A sentence on some lines of the file, if there are any."""
    if len(lines):
        yield Line(sentence.format(line_list(lines)), tone)


def _tables(result: Compensation, chain: Chain) -> Iterator[Table]:
    """Errors at the nominal commands and at those that were found, and corrections."""
    stages = [
        ("position", "m", result.position_before, result.position),
        ("orientation", "rad", result.orientation_before, result.orientation),
    ]
    rows = []
    for name, unit, before, after in stages[: 2 if result.oriented else 1]:
        for label, errors in (("nominal", before), ("compensated", after)):
            usable = result.reached & np.isfinite(errors)
            rows.append((name, label, *_sizes(errors[usable], unit)))
    title = "Distance from the targets, by the calibrated model"
    yield table(title, ("", "commands|word", "mean", "max", UNIT), rows, grouped=1)
    drives = JointColumns.of(chain)
    sizes = np.abs(drives.values(result.corrections + drives.offsets))
    columns = zip(drives.joints, drives.revolute, sizes.T, strict=True)
    rows = [(name, *_sizes(x, "rad" if turns else "m")) for name, turns, x in columns]
    if len(sizes):
        yield table("Joint corrections", ("", "mean", "max", UNIT), rows)


def _sizes(sizes: Floats, unit: str) -> tuple[object, ...]:
    known = (float(sizes.mean()), float(sizes.max())) if len(sizes) else (np.nan,) * 2
    return measures(unit, *known)
