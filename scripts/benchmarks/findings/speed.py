"""Time: the cost of findings on clean measurements, by that of the calibration."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any
from unittest import mock

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, between
from benchmarks.findings.defect import NOISE, ROBOT
from benchmarks.verdict.jobs import draw, stream
from calib_pin.validation import judgement
from calib_pin.validation.findings import find

COUNTS = (60, 1000)
"""Numbers of measurements."""


def run(number: int) -> dict[int, tuple[float, float]]:
    """Processor time of findings and of the whole calibration [s], by measurements."""
    job = draw(
        number, robot=ROBOT, model="position", size=1.0, noise=NOISE, stated=False
    )
    found = {}
    for count in COUNTS:
        rows = job.measured(stream(number, 1), count)
        calib_pin.calibrate(job.chain, rows, job.setup)  # Compiles, and fills caches.
        seconds: list[float] = []
        with mock.patch.object(judgement, "find", partial(_timed, find, seconds)):
            _timed(calib_pin.calibrate, seconds, job.chain, rows, job.setup)
        found[count] = sum(seconds[:-1]), seconds[-1]
    return found


def _timed(work: Callable[..., Any], seconds: list[float], *given: Any) -> Any:
    begin = time.process_time()
    result = work(*given)
    seconds.append(time.process_time() - begin)
    return result


def judge(found: Sequence[dict[int, tuple[float, float]]]) -> Iterator[Line]:
    """Medians of the ratios."""
    for count in COUNTS:
        ratios = [o[count][0] / (o[count][1] - o[count][0]) for o in found]
        text = f"findings by the rest, {count} measurements"
        yield between(text, float(np.median(ratios)), -np.inf, 0.1)
        find, whole = np.median([o[count] for o in found], axis=0)
        shown = f"{1e3 * find:.0f} of {1e3 * whole:.0f} ms"
        yield Line(f"processor time, {count} measurements", shown)


CRITERION = Criterion(101, "Time of findings", 20, run, judge, least=5, alone=True)
