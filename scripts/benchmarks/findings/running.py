"""The criteria of findings: every defect, clean jobs, and time."""

from __future__ import annotations

from typing import Any

from benchmarks.criteria import run_criteria
from benchmarks.criterion import Criterion
from benchmarks.findings import clean, joints, order, robot, speed, values
from benchmarks.findings.trial import criterion
from benchmarks.verdict.jobs import SEED

DEFECTS = (*joints.DEFECTS, *values.DEFECTS, *order.DEFECTS, *robot.DEFECTS)
"""All defects."""

CRITERIA: dict[str, Criterion[Any]] = {
    **{d.name: criterion(k, d) for k, d in enumerate(DEFECTS, 1)},
    "clean": clean.CRITERION,
    "time": speed.CRITERION,
}
"""The criteria by name, in the order of their numbers."""


def main() -> None:
    """Run the criteria that the options name, or all; exit status 1 if one fails."""
    run_criteria("findings", CRITERIA, SEED)
