"""The criteria of the verdict."""

from __future__ import annotations

from typing import Any

from benchmarks.criteria import run_criteria
from benchmarks.criterion import Criterion
from benchmarks.verdict import (
    clean,
    components,
    coverage,
    real,
    robust,
    speed,
    trust,
    workspace,
)
from benchmarks.verdict.jobs import SEED

CRITERIA: dict[str, Criterion[Any]] = {
    "clean": clean.CRITERION,
    "trust": trust.CRITERION,
    "robust": robust.CRITERION,
    "workspace": workspace.CRITERION,
    "components": components.CRITERION,
    "coverage": coverage.CRITERION,
    "real": real.CRITERION,
    "time": speed.CRITERION,
}
"""The criteria by name, in the order of their numbers."""


def main() -> None:
    """Run the criteria that the options name, or all; exit status 1 if one fails."""
    run_criteria("verdict", CRITERIA, SEED)
