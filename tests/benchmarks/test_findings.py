"""Every defect of `scripts/benchmark findings` spoils a job; nothing is calibrated."""

from __future__ import annotations

import pytest

from benchmarks.findings.defect import Defect, Input, job_of
from benchmarks.findings.running import DEFECTS
from benchmarks.verdict.jobs import stream


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.name)
def test_a_defect_spoils_its_job(defect: Defect) -> None:
    models = dict(defect.cells)
    for model, size in models.items():
        job, value = job_of(1, model), defect.sizes[size]
        rows = defect.measured(job, stream(1, 1))
        assert isinstance(defect.spoil(job, rows, stream(1, 3), value), Input)
    assert models
