"""What was set aside is a finding with its lines; exchanged measurements are pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.fit import fit_model
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Observations
from calib_pin.setup import ReadingSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.outliers import outliers


def found(job, data):
    fitted = fit_model(job.chain, data, Setup(), 0).fit
    return list(outliers(Case.of(fitted, fitted.problem.chains)))


def with_values(data, values):
    return Observations.of(replace(data.only, values=values))


def test_a_clean_job_has_none(moved_job) -> None:
    job = moved_job((), ())
    assert found(job, job.plain) == []


@pytest.mark.parametrize(("size", "severity"), [(0.01, "info"), (1.0, "warning")])
def test_lines_and_what_they_would_do(moved_job, size, severity) -> None:
    job = moved_job((), ())
    values = job.plain.only.values.copy()
    values[[10, 20]] += size
    (finding,) = found(job, with_values(job.plain, values))
    assert finding.code == "outliers" and finding.severity == severity
    assert finding.message.startswith("lines 12, 22: 2 of 90 measurements do not fit")
    moved = finding.evidence["displaced"]
    assert f"would move by {1e3 * moved:.2g} mm" in finding.message
    assert finding.setup == {"reading": {"without": [12, 22]}}
    assert "without: [12, 22]" in finding.remedy


def test_exchanged_measurements_are_read_back(moved_job) -> None:
    job = moved_job((), ())
    values = job.plain.only.values.copy()
    values[[10, 20, 30, 31, 50]] = values[[20, 10, 31, 30, 50]] + [
        [0],
        [0],
        [0],
        [0],
        [1],
    ]
    data = with_values(job.plain, values)
    exchanged, other = found(job, data)
    assert exchanged.code == "measurements-exchanged"
    assert exchanged.message.startswith(
        "the measurements of lines 12 and 22, and 1 more pair, fit if exchanged"
    )
    assert exchanged.setup == {"reading": {"exchanged": [[12, 22], [32, 33]]}}
    assert other.setup == {"reading": {"without": [52]}}
    pairs = tuple((str(a), str(b)) for a, b in exchanged.setup["reading"]["exchanged"])
    reading = ReadingSetup(exchanged=pairs, without=("52",))
    assert found(job, read_otherwise(data, reading)) == []


def test_many_are_counted(moved_job) -> None:
    job = moved_job((), ())
    values = job.plain.only.values.copy()
    values[5:25] += np.random.default_rng(0).normal(0.0, 0.3, (20, 3))
    (finding,) = found(job, with_values(job.plain, values))
    assert finding.message.startswith(
        "lines 7, 8, 9 and 17 more (lines 7 to 26): 20 of"
    )
    assert len(finding.message) < 300 and len(finding.remedy) < 300
