"""Lengths in another unit than their column says: all of them, or some."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.readings import (
    measured_lengths,
    place_of,
    places_of,
    scaled,
)
from calib_pin.observations import Indices, Observations
from calib_pin.setup import ConvertedSetup, ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import UNLIKELY
from calib_pin.validation.findings.hypotheses import Hypothesis
from calib_pin.validation.findings.setup_lines import lines_of, written

FACTORS = {
    1e-3: "mm read as m",
    1e-2: "cm read as m",
    0.0254: "inches read as m",
    0.3048: "feet read as m",
    0.9144: "yards read as m",
    1e3: "m read as mm",
    10.0: "cm read as mm",
    25.4: "inches read as mm",
    1.0 / 25.4: "mm read as inches",
    1.0 / 0.0254: "m read as inches",
    1.0 / 0.3048: "m read as feet",
    0.1: "mm read as cm",
    100.0: "m read as cm",
    0.5: "counted there and back",
    2.0: "halves of what they should be",
}
"""Mistakes of a unit by the factor that undoes them."""

FITS = 4.0
"""Errors, by those of the others, with which a measurement fits in another unit."""

LISTED = 200
"""Length of the setup lines that a remedy writes out; all stand in the file."""


def units(case: Case) -> Iterator[Hypothesis]:
    """Other units of all measured lengths."""
    blocks = [b for b in case.data.blocks if not declared(b.model).contact]
    if any(measured_lengths(block).any() for block in blocks):
        for factor, words in FACTORS.items():
            yield Hypothesis(
                "unit",
                f"the measured lengths are {words}",
                "unit of lengths",
                ReadingSetup(scale=factor),
                gross=True,
            )


def units_of_some(case: Case) -> Iterator[Finding]:
    """Measurements that were set aside, and fit in another unit."""
    if case.fitted is None:
        return
    problem, data = case.fitted.problem, case.data
    aside = np.flatnonzero(data.weight == 0.0)
    if not len(aside) or len(aside) == len(data):
        return
    theta = case.fitted.theta
    some = data.rows(aside)
    counted = _sizes(problem, data.rows(data.weight > 0.0), theta)
    usual = max(float(np.sqrt(np.mean(counted**2))), 1e-9)
    now = _sizes(problem, some, theta)
    values = np.concatenate(
        [np.full(len(b), measured_lengths(b).sum()) for b in some.blocks]
    )
    best = (UNLIKELY + np.log(len(FACTORS)), 0.0, np.zeros(0, np.int64))
    for factor in FACTORS:
        there = scaled(some, np.full(len(some), factor))
        left = np.maximum(_sizes(problem, there, theta), usual)
        fits = (left < FITS * usual) & (now > FITS * left)
        ratio = float(np.sum((values * np.log(now / left))[fits]))
        best = max(best, (ratio, factor, aside[fits]), key=lambda found: found[0])
    ratio, factor, rows = best
    if not len(rows):
        return
    reading = ReadingSetup(converted=(_converted(data, rows, factor),))
    lines = {"reading": lines_of(reading)}
    text = written(lines)
    first = place_of(data, _in_order(data, rows)[0])
    yield Finding(
        "unit-of-some",
        "warning",
        f"{len(rows)} of {len(data)} measurements that were set aside, the first in "
        f"line {first}, fit if their lengths are {FACTORS[factor]}",
        {
            "factor": factor,
            "measurements": float(len(rows)),
            "first": first,
            "log_likelihood_ratio": ratio,
        },
        f"state in the setup file: {text}"
        if len(text) < LISTED
        else "state the lines of this finding in the setup file",
        lines,
    )


def _in_order(data: Observations, rows: Indices) -> list[int]:
    """Measurements in the order of their files."""
    rank = np.argsort(data.in_order)
    return [int(row) for row in rows[np.argsort(rank[rows])]]


def _converted(data: Observations, rows: Indices, factor: float) -> ConvertedSetup:
    """The setup that converts some measurements."""
    ordered, rank = _in_order(data, rows), np.argsort(data.in_order)
    if len(rows) > 1 and np.ptp(rank[rows]) == len(rows) - 1:
        ends = (place_of(data, ordered[0]), place_of(data, ordered[-1]))
        return ConvertedSetup(factor, ends)
    return ConvertedSetup(factor, places_of(data, ordered), True)


def _sizes(problem: Problem, data: Observations, theta: Floats) -> Floats:
    """Size of the residual of each measurement, in standard deviations, shape (N,)."""
    problem = replace(problem, data=data, expected=None)
    sigma = problem.layout.table(problem.given_sigma, len(data))
    table = error_table(problem, theta) / sigma
    return np.asarray(np.sqrt(np.nanmean(np.minimum(table**2, 1e12), axis=1)))
