"""Defects of the order of measurements in time, outliers and repetitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.findings.defect import Defect, Input, line
from benchmarks.verdict.jobs import Job
from calib_pin.estimation.evidence import Finding
from calib_pin.observations import Measurements


def _moved(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """The instrument moved by so much after a third to two thirds of the file."""
    first = int(rng.integers(len(rows) // 3, 2 * len(rows) // 3))
    way = rng.normal(size=3)
    values = rows.values.copy()
    values[first:, :3] += size * way / np.linalg.norm(way)

    def right(finding: Finding) -> bool:
        return abs(int(finding.evidence["line"]) - line(first - 1)) <= 2

    return Input({"measured.csv": replace(rows, values=values)}, job.setup, right=right)


DEFECTS = (
    Defect(
        "moved",
        {"0.5 mm": 5e-4, "5 mm": 5e-3, "3 m": 3.0},
        ("position", "pose"),
        ("instrument-moved",),
        _moved,
    ),
)
