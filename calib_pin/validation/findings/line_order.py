"""Measurements that stand at other lines than their joint positions."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.measurement_models.readings import in_files
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Hypothesis

FARTHEST = 10
"""Most lines by which joint positions may stand elsewhere."""


def line_order(case: Case) -> Iterator[Hypothesis]:
    """Explanations by the order of the joint positions, the likeliest kinds first."""
    longest = max(map(len, in_files(case.data)))
    for lines in range(1, min(FARTHEST, longest // 2) + 1):
        yield shifted(lines)
        yield shifted(-lines)
    yield Hypothesis(
        "lines-reversed",
        "the joint positions stand in reversed order",
        "order of the lines",
        reading=ReadingSetup(reversed=True),
    )


def shifted(lines: int) -> Hypothesis:
    """Joint positions so many lines below their measurement, or above it."""
    unit = "line" if abs(lines) == 1 else "lines"
    where = "below" if lines > 0 else "above"
    return Hypothesis(
        "lines-shifted",
        f"the joint positions stand {abs(lines)} {unit} {where} their measurement",
        "order of the lines",
        reading=ReadingSetup(shift=lines),
    )
