"""The report of a compensation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from calib_pin.control.compensation import Compensation
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.ways import Passage
from calib_pin.report.blocks import Block, Cell, Line, Names, Table, table
from calib_pin.report.tables import UNIT, amount, measures

SHOWN = 12
"""Lines that are named; the rest is counted."""


def compensation_report(
    found: Compensation,
    chain: Chain,
    *,
    motion: bool,
    file: str,
    lines: Sequence[int],
) -> Iterator[Block]:
    """The targets reached, the errors that remain, and the targets out of reach.

    A motion has joint positions as targets; `lines` are those of the targets in a file.
    """
    count, reached = len(found), int(found.reached.sum())
    what = "configurations of the nominal robot" if motion else "targets"
    kind = "poses" if found.oriented else "positions only"
    yield Line(
        f"{chain.robot.name}: {reached} of {count} {what} reached ({kind}), "
        "joint limits kept.",
        "strong" if reached == count else "bad",
    )
    if reached:
        yield _errors(found)
        yield from _corrections(found, chain)
        numbers = np.asarray(lines)
        at_limit = numbers[found.reached & found.at_limit]
        if len(at_limit):
            yield Line(f"A joint is at its limit in {line_list(at_limit)}.")
        outside = numbers[found.reached & found.outside]
        if len(outside):
            yield Line(
                "Outside the region in which the learned correction was trained, "
                f"where it knows less: {line_list(outside)}.",
                "bad",
            )
    if found.sides.any():
        yield Line(
            f"Lost motion is made up for as the commands follow one another: joints "
            f"turn back {found.reversals} times. Until a joint has moved once, it is "
            "taken to stand in the middle of its lost motion."
        )
    yield from _unreached(found, file, lines)
    joints = len(JointColumns.of(chain).joints)
    if found.oriented and reached < count and joints < 6:
        yield Line(
            f"{joints} joints reach few poses; --position asks for positions only."
        )
    if motion and found.reached.all():
        yield from _jumps(found, lines)


def ways_report(
    found: Compensation, passage: Passage, lines: Sequence[int], shut: Sequence[int]
) -> Iterator[Line]:
    """Collisions at targets and between them; `shut` are lines without a way."""
    colliding = np.asarray(lines)[found.collides]
    if len(colliding):
        yield Line(
            "Something touches there, and at all other solutions that were found: "
            f"{line_list(colliding)}.",
            "bad",
        )
    if len(shut):
        yield Line(
            f"No free way from the command before was found to {line_list(shut)}.",
            "bad",
        )
    elif passage.vias:
        several = passage.vias > 1
        yield Line(
            f"Straight ways between commands collide; {passage.vias} via "
            f"configuration{'s' * several} lead{'s' * (not several)} around what is "
            "in the way, as the nominal robot and the clearance have it."
        )
        if found.sides.any():
            yield Line(
                "Lost motion is made up for as on straight ways: behind a via "
                "configuration joints may come from the other side.",
                "bad",
            )
    elif not len(colliding):
        yield Line("Nothing touches at the commands and on straight ways between them.")


def hasty_lines(lines: Sequence[int]) -> Iterator[Line]:
    """Lines to which a joint would move faster than it can."""
    if lines:
        yield Line(
            "By the times of the file a joint moves faster than the URDF allows to "
            f"{line_list(lines)}.",
            "bad",
        )


def accuracy_lines(errors: Mapping[str, Mapping[str, Any]]) -> Iterator[Line]:
    """The error of the model itself on validation measurements, by quantity."""
    for name, error in errors.items():
        mean, largest = (amount(error[key], error["unit"]) for key in ("mean", "max"))
        yield Line(
            f"Error of the model itself on validation measurements ({error['method']}, "
            f"{name}): mean {mean}, max {largest}.",
            "note",
        )


def line_list(lines: Sequence[int] | np.ndarray) -> str:
    """Line numbers in words."""
    names = [str(int(line)) for line in lines[:SHOWN]]
    more = len(lines) - len(names)
    shown = ", ".join(names) + (f" and {more} more" if more else "")
    return f"line {shown}" if len(lines) == 1 else f"lines {shown}"


def _errors(found: Compensation) -> Table:
    """Errors at the nominal commands and at those that were found."""
    stages = [
        ("position", "m", found.position_before, found.position),
        ("orientation", "rad", found.orientation_before, found.orientation),
    ]
    rows = []
    for name, unit, before, after in stages[: 2 if found.oriented else 1]:
        for robot, sizes in (("nominal", before), ("compensated", after)):
            sizes = sizes[found.reached & np.isfinite(sizes)]
            rows.append((name, robot, *_sizes(sizes, unit)))
            name = ""
    title = "Distance from the targets, by the calibrated model"
    return table(title, ("", "commands|word", "mean", "max", UNIT), rows)


def _corrections(found: Compensation, chain: Chain) -> Iterator[Table]:
    drives = JointColumns.of(chain)
    sizes = np.abs(drives.values(found.corrections + drives.offsets))
    if not len(sizes):
        return
    rows = [
        (name, *_sizes(column, "rad" if revolute else "m"))
        for name, revolute, column in zip(
            drives.joints, drives.revolute, sizes.T, strict=True
        )
    ]
    yield table("Joint corrections", ("", "mean", "max", UNIT), rows)


def _sizes(sizes: Floats, unit: str) -> tuple[Cell, ...]:
    known = (float(sizes.mean()), float(sizes.max())) if len(sizes) else (np.nan,) * 2
    return measures(unit, *known)


def _unreached(found: Compensation, file: str, lines: Sequence[int]) -> Iterator[Names]:
    """Every target that cannot be reached, by line."""
    (missed,) = np.nonzero(~found.reached)
    entries = []
    for row in missed:
        remains = amount(found.position[row], "m")
        if found.oriented:
            remains += f" and {amount(found.orientation[row], 'rad')}"
        entries.append(f"{file}:{lines[int(row)]}: {remains} remain")
    if entries:
        yield Names("Out of reach, or behind the joint limits:", entries)


def _jumps(found: Compensation, lines: Sequence[int]) -> Iterator[Line]:
    jumps = np.asarray(lines)[found.jumps]
    if len(jumps):
        yield Line(
            "Discontinuity in joint space, as near a singularity, between "
            f"{line_list(jumps)} and the line before: the robot would leave its path.",
            "bad",
        )
