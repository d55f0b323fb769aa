"""The tables of a comparison of two calibrations, with what they stand for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from calib_pin.report.blocks import Block, Cell, Facts, Line, Table, columns
from calib_pin.report.tables import SIZES, listed, number, quantity
from calib_pin.units import DISPLAY
from calib_pin.validation.calibration_record import CalibrationRecord
from calib_pin.validation.comparison import BOUND, Comparison
from calib_pin.validation.parameter_changes import Difference
from calib_pin.validation.result import Accuracy

__all__ = ["accuracies", "parameter_changes", "tip_differences"]

FAR = 0.01
"""Distance between the tools from which on it matters at which one tips differ [m]."""


def tip_differences(found: Comparison) -> Iterator[Block]:
    """How far the tips are apart, where most, and what is no drift."""
    drift = found.drift
    explained = found.explained or (math.nan, math.nan)
    stages = [
        ("position", "m", drift.position, explained[0]),
        ("orientation", "rad", drift.orientation, explained[1]),
    ]
    rows = []
    for name, unit, accuracy, noise in stages[: 2 if found.oriented else 1]:
        *cells, shown = _sizes(accuracy, unit)
        rows.append((Cell(name), *cells, _known(noise, unit), shown))
    yield Table(
        "Difference of the tip over the workspace",
        columns("", (*SIZES[:-1], "noise rms", SIZES[-1])),
        rows,
    )
    yield Line(" ".join(_how(found)), "note")
    if not found.identical:
        yield _farthest(found)
    yield from _frames(found)


def _how(found: Comparison) -> Iterator[str]:
    """What the differences of the tip stand for."""
    absorbed = found.drift.absorbed
    yield f"{len(found.drift.q)} random configurations within the joint limits."
    if absorbed:
        yield (
            f"A displacement of {' and '.join(absorbed)} between A and B is fitted "
            "away: what a frame can absorb is no drift."
        )
    else:
        yield "Base and tool are known."
    if not found.oriented:
        yield "The rows do not tell orientations."
    shifts = {d.frame: d.shift for d in found.displacements}
    if shifts.get("tool", 0.0) > FAR:
        yield (
            "Compared is the tool of A; the one of B stood elsewhere, and B may know "
            "less of the tip at A's."
        )
    if found.explained is None:
        return
    known = "" if len(absorbed) == 2 else ", base and tool included"
    yield f"Noise is that of both{known}."
    statuses = {
        p.status
        for record in (found.first, found.second)
        for p in record.parameters
        if p.name in record.of_robot
    }
    if "weak" in statuses:
        yield "It does not contain what was left at nominal as too weak."


def _farthest(found: Comparison) -> Facts:
    drift, chain = found.drift, found.first.model.chain
    position = drift.farthest
    x, y, z = (f"{1e3 * value:.1f}" for value in drift.points[position])
    angles = []
    for value, turns in zip(drift.q[position], chain.revolute, strict=True):
        unit, factor = DISPLAY["rad" if turns else "m"]
        angles.append(f"{factor * value:.1f} {unit}")
    if np.all(chain.revolute):
        angles = [*(angle.removesuffix(" deg") for angle in angles[:-1]), angles[-1]]
    return Facts(
        f"It differs most, by {number(1e3 * drift.drift[position])} mm, with",
        [
            ("tip", f"at {x}, {y}, {z} mm in {chain.base}"),
            ("joints", f"at {', '.join(angles)}"),
        ],
    )


def _frames(found: Comparison) -> Iterator[Facts]:
    """Where base and tool stand now: no drift of the robot."""
    seen = {"base": "as the instrument sees it", "tool": "as the tip link sees it"}
    entries = []
    for moved in found.displacements:
        words = f"{number(1e3 * moved.shift)} mm"
        if moved.turn is not None:
            unit, factor = DISPLAY["rad"]
            words += f" and {number(factor * moved.turn)} {unit}"
        entries.append((moved.frame, f"{words}, {seen[moved.frame]}"))
    if entries:
        yield Facts("Stands elsewhere in B, which is no drift of the robot", entries)


def parameter_changes(found: Comparison) -> Iterator[Block]:
    """What differs beyond its uncertainty, and what only one of both knows."""
    if not found.same_nominal:
        return
    if found.moved:
        yield _moved(found)
    yield Line(" ".join(_counted(found)), "note")
    for label, names in zip("AB", found.alone, strict=True):
        yield from listed(f"known by themselves in {label} only", names)


def _moved(found: Comparison) -> Table:
    rows = []
    for difference in found.moved:
        unit, factor = DISPLAY.get(difference.unit, (difference.unit, 1.0))
        rows.append(
            (
                Cell(difference.name),
                Cell(f"{factor * difference.change:+.4f}", difference.change),
                Cell(f"{factor * difference.sigma:.4f}", difference.sigma),
                Cell(f"{difference.significance:.1f}", difference.significance),
                Cell(unit),
            )
        )
    return Table(
        f"Parameters and sums that differ by more than {BOUND:.0f} standard deviations",
        columns("", ("B - A", "std. dev.", "in std. dev.", "unit")),
        rows,
    )


def _counted(found: Comparison) -> Iterator[str]:
    """How many agree, and what is not compared."""
    if found.differences:
        known, agree = (
            _numbers([d for d in found.differences if d.significance <= bound])
            for bound in (math.inf, BOUND)
        )
        yield (
            f"Both know {known} of the robot; {agree} agree within {BOUND:.0f} "
            "standard deviations of the difference. By chance one in 370 lies beyond."
        )
    else:
        yield "There is no parameter and no sum of the robot that both know."
    if found.moved and found.drifted is False:
        yield "What differs moves the tip by no more than noise does."
    if any(found.sums_alone):
        first, second = found.sums_alone
        yield f"{first} sums are known in A only, {second} in B only."
    if any(
        len(record.groups) > len(record.robot_groups)
        for record in (found.first, found.second)
    ):
        yield "Sums with terms of base, tool or instrument are left out."


def _numbers(differences: Sequence[Difference]) -> str:
    sums = sum(bool(d.terms) for d in differences)
    return f"{len(differences) - sums} parameters and {sums} sums"


def accuracies(found: Comparison) -> Iterator[Block]:
    """Accuracy of both beside each other, and how it was validated."""
    pair = (("A", found.first), ("B", found.second))
    errors = {
        (error.name, error.unit): None for _, record in pair for error in record.errors
    }
    rows = []
    for name, unit in errors:
        shown = name
        for which in ("fitted", "unseen"):
            part = which
            for label, record in pair:
                accuracy = _of(record, name, unit, which)
                if accuracy is not None:
                    words = (Cell(shown), Cell(part), Cell(label))
                    rows.append((*words, *_sizes(accuracy, unit)))
                    shown = part = ""
    yield Table("Accuracy", columns("", ("rows", "of", *SIZES), {"of": "word"}), rows)
    said = ", ".join(f"{label} {record.validation}" for label, record in pair)
    if not found.same_rows:
        said += ". The rows are not the same: the numbers are not strictly comparable"
    yield Line(f"Validation: {said}.", "note")


def _of(record: CalibrationRecord, name: str, unit: str, which: str) -> Accuracy | None:
    """The accuracy of a quantity on fitted or unseen rows, where there is one."""
    for error in record.errors:
        if (error.name, error.unit) == (name, unit):
            return error.after if which == "fitted" else error.validation_after
    return None


def _sizes(accuracy: Accuracy, unit: str) -> tuple[Cell, ...]:
    """The cells of `SIZES`; older files lack some."""
    found = (accuracy.mean, accuracy.rms, accuracy.p95, accuracy.max)
    return (*(_known(value, unit) for value in found), Cell(DISPLAY[unit][0]))


def _known(value: float, unit: str) -> Cell:
    return Cell("-") if math.isnan(value) else quantity(value, unit)
