"""Two columns of a file for the same joint: commanded and measured positions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib_pin.errors import CalibPinError
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.formulation import make_problem
from calib_pin.observations import Indices, Measurements, Observations
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import STEPS, Case
from calib_pin.validation.findings.explanations import UNLIKELY
from calib_pin.validation.findings.hypotheses import FITTED
from calib_pin.validation.findings.quick_fit import QuickFit
from calib_pin.validation.findings.setup_lines import written


def joint_sets(case: Case) -> Iterator[Finding]:
    """Other columns of the joints that fit better, or worse, beyond chance."""
    setup = replace(case.setup, learned=None)
    some = case.fit.problem.data
    quantity = case.fit.problem.layout.quantities[0]
    unit, factor = DISPLAY[quantity.unit]
    for other in case.others.joint_sets():
        try:
            here, there = (
                QuickFit.of(make_problem(case.chains, data, setup), STEPS)
                for data in (some, _moved(some, other.data))
            )
        except CalibPinError:
            continue  # The other columns have fewer rows, or no robot is there.
        ratio = here.left * float(np.log(here.rms / there.rms))
        if not (here.redundant and abs(ratio) > UNLIKELY):
            continue
        better, clear = ratio > 0.0, there.rms < FITTED * here.rms
        sizes = [f"{factor * fit.errors:.3g}" for fit in (here, there)]
        ends = dict.fromkeys((other.columns[0], other.columns[-1]))
        columns = " to ".join(f"'{name}'" for name in ends)
        yield Finding(
            "joint-columns",
            ("error" if clear else "warning") if better else "info",
            f"with the joint positions in {columns} the {quantity.name} errors of a "
            f"fit are {sizes[1]} {unit} instead of {sizes[0]} {unit}"
            + ("" if better else ": those that were used are the better ones"),
            {
                "columns": ", ".join(other.columns),
                "rms_before": here.errors,
                "rms_after": there.errors,
                "log_likelihood_ratio": ratio,
            },
            f"state in the setup file: {written(other.stated)}" if better else "",
            other.stated if better else {},
            "residuals-by-joint" if better else "",
        )


def _moved(data: Observations, others: Observations) -> Observations:
    """Measurements with the joint positions that others of the same lines have."""
    of_key = {block.key: block for block in others.blocks}

    def moved(block: Measurements) -> Measurements:
        other = of_key[block.key]
        rows = _same_lines(block, other)
        start = other.start[rows] if other.start.size else other.start
        held = other.conditions.rows(rows)
        return replace(block, q=other.q[rows], start=start, conditions=held)

    return Observations(tuple(map(moved, data.blocks)))


def _same_lines(some: Measurements, whole: Measurements) -> Indices:
    """Rows of a whole that stand in the same lines as some, shape (N,)."""
    rows = np.zeros(len(some), np.int64)
    for file in some.files.distinct:
        own, there = some.files.where(file), np.flatnonzero(whole.files.where(file))
        there = there[np.argsort(whole.lines[there])]
        rows[own] = there[np.searchsorted(whole.lines[there], some.lines[own])]
    return rows
