"""Measurements that stand at other lines than their joint positions."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.measurement_models.readings import in_files, postures
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Hypothesis

FARTHEST = 10
"""Most lines by which joint positions may stand elsewhere."""

SEVERAL, NEAREST = 2, 3
"""Lines of a configuration from which these may stand elsewhere together, and how many
of them."""


def line_order(case: Case) -> Iterator[Hypothesis]:
    """Explanations by the order of the joint positions, the likeliest kinds first."""
    longest = max(map(len, in_files(case.data)))
    for lines in range(1, min(FARTHEST, longest // 2) + 1):
        yield shifted(lines)
        yield shifted(-lines)
    count = sum(int(number[-1]) + 1 for number in postures(case.data))
    if SEVERAL * count < len(case.data):
        for k in range(1, min(NEAREST, count // 2) + 1):
            yield shifted(k, "configuration")
            yield shifted(-k, "configuration")
    yield Hypothesis(
        "lines-reversed",
        "the joint positions stand in reversed order",
        "order of the lines",
        reading=ReadingSetup(reversed=True),
    )


def shifted(number: int, of: str = "line") -> Hypothesis:
    """Joint positions so many lines, or configurations, below or above their own."""
    where, far = "below" if number > 0 else "above", abs(number)
    line = ReadingSetup(shift=number)
    return Hypothesis(
        "lines-shifted",
        f"the joint positions stand {far} {of}{'s' * (far > 1)} {where} their "
        "measurement",
        "order of the lines",
        reading=line if of == "line" else ReadingSetup(shift_configurations=number),
    )
