"""Time: the cost of robust estimation on clean measurements, and with outliers."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, between
from benchmarks.verdict.defects import GROSS, spoil
from benchmarks.verdict.jobs import Job, draw, log_uniform, stream
from calib_pin.observations import Measurements

ROWS = 500
"""Measurements of a UR10."""

TURNS = 7
"""Times that each calibration is measured; the shortest counts."""


def run(number: int) -> dict[str, float]:
    """Processor time of calibrations in turns [s]."""
    job = draw(number, robot="example:ur10_robot", model="position", stated=True)
    rng = stream(number, 1)
    rows = job.measured(rng, ROWS)
    index = rng.permutation(ROWS)[: ROWS // 5]
    size = log_uniform(rng, GROSS, len(index))
    bad = spoil(rows, index, size, rng)
    jobs = {
        "squared": (rows, "squared"),
        "auto": (rows, "auto"),
        "outliers": (bad, "auto"),
    }
    for data, loss in jobs.values():
        _seconds(job, data, loss)
    best = dict.fromkeys(jobs, np.inf)
    for _ in range(TURNS):
        for name, (data, loss) in jobs.items():
            best[name] = min(best[name], _seconds(job, data, loss))
    return best


def _seconds(job: Job, rows: Measurements, loss: str) -> float:
    setup = replace(job.setup, loss=loss)
    begin = time.process_time()
    calib_pin.calibrate(job.chain, rows, setup)
    return time.process_time() - begin


def judge(found: Sequence[dict[str, float]]) -> Iterator[Line]:
    """Ratios of the shortest times."""
    best = {name: float(np.median([o[name] for o in found])) for name in found[0]}
    ratio = best["auto"] / best["squared"]
    yield between("clean, auto by squared", ratio, -np.inf, 1.3)
    ratio = best["outliers"] / best["auto"]
    yield between("20 % outliers by clean", ratio, -np.inf, 4.0)
    yield Line("clean, auto", f"{1e3 * best['auto']:.0f} ms of processor time")


CRITERION = Criterion(8, "Time", 3, run, judge, alone=True)
