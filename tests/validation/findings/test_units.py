"""Lengths in another unit than their columns say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.measurement_models.readings import read_otherwise, scaled
from calib_pin.observations import Observations
from calib_pin.setup import ConvertedSetup, ReadingSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import explain
from calib_pin.validation.findings.hypotheses import finding
from calib_pin.validation.findings.units import units, units_of_some

Job = Callable[..., Any]


def case_of(job: Any, data: Observations) -> Case:
    fitted = fit(make_problem(job.chain, data, Setup()), np.random.default_rng(0))
    return Case.of(fitted, fitted.problem.chains)


@pytest.mark.parametrize("factor", [0.3048, 0.0254, 1e3])
def test_all_lengths(quick_case: Job, moved_job: Job, factor: float) -> None:
    job = moved_job((), (), 40)
    case = quick_case(job.chain, scaled(job.plain, np.full(40, 1.0 / factor)))
    explanation = explain(case, (units,))
    assert explanation is not None
    (one,) = finding(case, explanation)
    assert one.code == "unit" and one.setup == {"reading": {"scale": factor}}


def test_lengths_in_the_right_unit(moved_job: Job) -> None:
    job = moved_job((), (), 40)
    case = case_of(job, job.plain)
    assert explain(case, (units,)) is None and not [*units_of_some(case)]


@pytest.mark.parametrize("model", ["position", "pose"])
@pytest.mark.parametrize(
    ("rows", "lines", "each"),
    [((5, 17, 30), ("7", "19", "32"), True), (range(30, 35), ("32", "36"), False)],
)
def test_some_lengths(
    moved_job: Job, model: str, rows: list[int], lines: tuple[str, ...], each: bool
) -> None:
    job = moved_job((), (), 50, model=model)
    factors = np.ones(50)
    factors[list(rows)] = 1.0 / 0.3048
    spoiled = scaled(job.plain, factors)
    (one,) = units_of_some(case_of(job, spoiled))
    assert (one.code, one.severity) == ("unit-of-some", "warning")
    assert "feet" in one.message and one.evidence["first"] == lines[0]
    converted = ConvertedSetup(0.3048, lines, each)
    plain = {"factor": 0.3048, "lines": [int(line) for line in lines]}
    plain |= {"each": True} if each else {}
    assert one.setup == {"reading": {"converted": [plain]}}
    again = read_otherwise(spoiled, ReadingSetup(converted=(converted,)))
    np.testing.assert_allclose(again.only.values, job.plain.only.values, rtol=1e-12)


def test_outliers_are_no_unit(moved_job: Job) -> None:
    job = moved_job((), (), 50)
    (block,) = job.plain.blocks
    values = block.values.copy()
    values[[3, 20, 44]] += np.random.default_rng(1).normal(size=(3, 3))
    case = case_of(job, Observations.of(replace(block, values=values)))
    assert (case.data.weight == 0.0).sum() == 3 and not [*units_of_some(case)]
