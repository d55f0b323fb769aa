"""The tables of a comparison of two calibrations, and what they refer to."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from calib_pin.report.blocks import Block, Cell, Facts, Line, Table, columns
from calib_pin.report.tables import SIZES, amount, known, listed, sizes, uncertain
from calib_pin.units import DISPLAY
from calib_pin.validation.comparison import (
    BOUND,
    Comparison,
    Difference,
    robot_groups,
    robot_parameters,
)
from calib_pin.validation.result import Accuracy, CalibrationResult

FAR = 0.01
"""Distance between the tools from which it matters which of them is compared [m]."""


def tip_differences(found: Comparison) -> Iterator[Block]:
    """The distance of the tool points, its maximum, and what is no drift."""
    drift = found.drift
    explained = found.explained or (math.nan, math.nan)
    stages = [
        ("position", "m", drift.position, explained[0]),
        ("orientation", "rad", drift.orientation, explained[1]),
    ]
    rows = []
    for name, unit, accuracy, noise in stages[: 2 if found.oriented else 1]:
        *cells, shown = sizes(accuracy, unit, known)
        rows.append((Cell(name), *cells, known(noise, unit), shown))
    yield Table(
        "Tool-point difference over the workspace",
        columns("", (*SIZES[:-1], "noise rms", SIZES[-1])),
        rows,
    )
    yield Line(" ".join(_how(found)), "note")
    if not found.identical:
        yield _farthest(found)
    yield from _frames(found)


def _how(found: Comparison) -> Iterator[str]:
    """Sentences on what the differences refer to."""
    absorbed = found.drift.absorbed
    yield f"{len(found.drift.q)} random configurations within the joint limits."
    if absorbed:
        yield (
            f"A displacement of {' and '.join(absorbed)} between A and B is removed "
            "by a fit: it is no drift of the robot."
        )
    else:
        yield "Base and tool are known."
    if not found.oriented:
        yield "The measurements contain no orientations."
    shifts = {d.frame: d.shift for d in found.displacements}
    if shifts.get("tool", 0.0) > FAR:
        yield (
            "The tool point of A is compared; that of B was elsewhere, and B may be "
            "less certain at A's."
        )
    if found.explained is None:
        return
    ends = "" if len(absorbed) == 2 else ", base and tool included"
    yield f"The noise is that of both calibrations{ends}."
    statuses = {
        p.status
        for record in (found.first, found.second)
        for p in record.parameters
        if p.name in robot_parameters(record)
    }
    if "weak" in statuses:
        yield "It excludes weakly observable directions, which were held at nominal."


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
        f"Largest difference: {amount(drift.drift[position], 'm')}",
        [
            ("tool point", f"at {x}, {y}, {z} mm in {chain.base}"),
            ("joints", f"at {', '.join(angles)}"),
        ],
    )


def _frames(found: Comparison) -> Iterator[Facts]:
    """The displacements of base and tool, which are no drift of the robot."""
    relative = {"base": "the instrument", "tool": "the tip link"}
    entries = []
    for moved in found.displacements:
        words = amount(moved.shift, "m")
        if moved.turn is not None:
            words += f" and {amount(moved.turn, 'rad')}"
        words += f", relative to {relative[moved.frame]}"
        entries.append((moved.frame, words))
    if entries:
        yield Facts("Displaced in B, which is no drift of the robot", entries)


def parameter_changes(found: Comparison) -> Iterator[Block]:
    """The differences beyond their uncertainty, and what only one calibration has."""
    if not found.same_nominal:
        return
    if found.moved:
        yield _moved(found)
    yield Line(" ".join(_counted(found)), "note")
    for label, names in zip("AB", found.alone, strict=True):
        yield from listed(f"identifiable in {label} only", names)


def _moved(found: Comparison) -> Table:
    rows = []
    for difference in found.moved:
        unit, factor = DISPLAY.get(difference.unit, (difference.unit, 1.0))
        rows.append(
            (
                Cell(difference.name),
                *uncertain(difference.change, difference.sigma, factor),
                Cell(f"{difference.significance:.1f}", difference.significance),
                Cell(unit),
            )
        )
    return Table(
        f"Parameters and combinations that differ by more than {BOUND:.0f} standard "
        "deviations",
        columns("", ("B - A", "std. dev.", "ratio", "unit")),
        rows,
    )


def _counted(found: Comparison) -> Iterator[str]:
    """Sentences on how many agree, and what is not compared."""
    if found.differences:
        both, agree = (
            _numbers([d for d in found.differences if d.significance <= bound])
            for bound in (math.inf, BOUND)
        )
        yield (
            f"Both identify {both} of the robot; {agree} agree within {BOUND:.0f} "
            "standard deviations of the difference. By chance, one in 370 does not."
        )
    else:
        yield "No parameter and no combination of the robot is identified by both."
    if found.moved and found.drifted is False:
        yield "The differences move the tool point by no more than noise does."
    if any(found.sums_alone):
        first, second = found.sums_alone
        yield f"{first} combinations are identified in A only, {second} in B only."
    if any(
        len(record.groups) > len(robot_groups(record))
        for record in (found.first, found.second)
    ):
        yield "Combinations with terms of base, tool or instrument are left out."


def _numbers(differences: Sequence[Difference]) -> str:
    sums = sum(bool(d.terms) for d in differences)
    return f"{len(differences) - sums} parameters and {sums} combinations"


def accuracies(found: Comparison) -> Iterator[Block]:
    """Accuracy of both beside each other, and how it was validated."""
    pair = (("A", found.first), ("B", found.second))
    errors = {
        (error.name, error.unit): None for _, record in pair for error in record.errors
    }
    rows = []
    for name, unit in errors:
        shown = name
        for which in ("fitted", "validation"):
            part = which
            for label, record in pair:
                accuracy = _of(record, name, unit, which)
                if accuracy is not None:
                    words = (Cell(shown), Cell(part), Cell(label))
                    # Older files lack some of the sizes.
                    rows.append((*words, *sizes(accuracy, unit, known)))
                    shown = part = ""
    titles = ("measurements", "of", *SIZES)
    yield Table("Accuracy", columns("", titles, {"of": "word"}), rows)
    said = ", ".join(f"{label} {record.validation.method}" for label, record in pair)
    if not found.same_rows:
        said += ". The measurements differ: the numbers are not strictly comparable"
    yield Line(f"Validation: {said}.", "note")


def _of(record: CalibrationResult, name: str, unit: str, which: str) -> Accuracy | None:
    """The accuracy of a quantity on fitted or validation measurements, if known."""
    for error in record.errors:
        if (error.name, error.unit) == (name, unit):
            return error.after if which == "fitted" else error.validation_after
    return None
