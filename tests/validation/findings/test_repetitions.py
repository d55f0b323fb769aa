"""Copies are told from repetitions, and repetitions from configurations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.fit import fit_model
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Observations
from calib_pin.setup import ReadingSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.repetitions import repetitions


def found(job, index, noise=1e-4, digits=9, copied=()):
    """Measurements of some rows with noise of their own, and copies of some."""
    data = job.plain.only.rows(np.array(index))
    rng = np.random.default_rng(0)
    values = np.round(data.values + rng.normal(0.0, noise, data.values.shape), digits)
    data = replace(data, values=values)
    data = data.rows(np.array([*range(len(data)), *copied]))
    data = replace(data, lines=np.arange(2, len(data) + 2))
    fitted = fit_model(job.chain, Observations.of(data), Setup(), 0).fit
    return list(repetitions(Case.of(fitted, fitted.problem.chains))), data


def test_repetitions_are_none(moved_job) -> None:
    assert found(moved_job((), ()), [*range(90), *range(20)])[0] == []


def test_copies(moved_job) -> None:
    job = moved_job((), ())
    (finding,), data = found(job, range(90), copied=(3, 3, 50))
    assert finding.code == "copied-measurements"
    assert finding.message == (
        "3 measurements of 93 are copies of others to the last digit, which count "
        "twice: lines 92, 93, 94"
    )
    assert finding.setup == {"reading": {"without": [92, 93, 94]}}
    reading = ReadingSetup(without=("92", "93", "94"))
    assert len(read_otherwise(Observations.of(data), reading)) == 90


def test_few_digits_repeat_by_chance(moved_job) -> None:
    """A grid of 1 mm hides noise of 0.1 mm; one of a nanometer does not."""
    job = moved_job((), ())
    assert found(job, [*range(90), *range(20)], digits=3)[0] == []
    assert found(job, range(90), digits=9, copied=(4,))[0] != []


@pytest.mark.parametrize(
    ("index", "code"),
    [
        (np.repeat(np.arange(10), 6), "few-configurations"),
        (np.append(np.arange(60), np.zeros(90, int)), "one-configuration"),
    ],
)
def test_repetitions_instead_of_configurations(moved_job, index, code) -> None:
    (finding,), _ = found(moved_job((), ()), index)
    assert finding.code == code and finding.severity == "warning"
