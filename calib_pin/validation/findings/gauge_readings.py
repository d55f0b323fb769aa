"""Deviations of contacts that count the other way, or by another factor.

A dial gauge is positive where it is pushed in, a deviation is positive away from the
surface, and planes have normals that point to either side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding
from calib_pin.measurement_models import declared
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.setup_lines import written

CHANCE = 1e-6
"""Probability that readings of the right sign are told."""

OPPOSITE = -1.0
"""Factor of readings with which they fit best if they count the other way."""

NEAR = 0.5
"""By how much it may be missed: half-way to those that say nothing."""


def gauge_readings(case: Case) -> Iterator[Finding]:
    """Places whose contacts fit far better with readings of the opposite sign."""
    if not case.informed:
        return
    # A place that is wrong as a whole has been set aside.
    data, things = case.fit.problem.data, case.fit.problem.data.things()
    share = np.bincount(things, data.weight > 0.0) / np.bincount(things).clip(1)
    data = data.weighted(np.where(share[things] < 0.5, 1.0, data.weight))
    problem = replace(case.fit.problem, data=data)
    fit, touched = replace(case.fit, problem=problem), {}
    for _, block, _, values in problem.blocks:
        stated = declared(block.model)
        if not stated.contact or not block.values.any():
            continue
        for name, axis in product(block.target.distinct, stated.components):
            column = np.zeros(problem.layout.row.shape)
            along = np.array(stated.components) == axis
            own = block.target.where(name)[:, None] & along
            column[values] = np.where(own, -block.values, 0.0).ravel()
            words = name or stated.naming.noun, axis * (len(stated.components) > 1)
            touched[" ".join(words).strip()] = column / problem.sigma
    if not touched:
        return
    score = fit.score(np.column_stack([*touched.values()]))
    factors = dict(zip(touched, 1.0 + score.values, strict=True))
    wrong = [n for n, factor in factors.items() if abs(factor - OPPOSITE) < NEAR]
    if score.chance > CHANCE or not wrong:
        return
    every = len(wrong) == len(factors)
    lines = {"reading": {"opposite": True}} if every else {}
    yield Finding(
        "gauge-sign",
        "error",
        f"the gauge readings at {enumerated(wrong)} have the opposite sign: they fit "
        f"best times {np.mean([factors[name] for name in wrong]):.2g}",
        {"left": score.left, "chance": score.chance, **factors},
        f"state in the setup file: {written(lines)}"
        if lines
        else "state these planes with normals that point the other way, or exchange "
        "'deviation' and 'dial' in the names of their columns",
        lines,
    )
