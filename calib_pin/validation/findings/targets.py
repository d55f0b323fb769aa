"""A target whose measurements contradict those of all others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.measurement_models.readings import places_of
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import NEIGHBORS
from calib_pin.validation.findings.hypotheses import Hypothesis

FEWEST = 3
"""Fewest measurements of a target that contradict together."""

MOST = 20
"""Most targets that are tried."""


def targets(case: Case) -> Iterator[Hypothesis]:
    """Each of several targets left out; single outliers are found by the fit."""
    data, target = case.data, case.data.target
    counts = np.bincount(target.codes, minlength=len(target.names))
    if len(data) > NEIGHBORS or not 1 < np.count_nonzero(counts) <= MOST:
        return
    for code in np.flatnonzero(counts >= FEWEST).tolist():
        name, rows = target.names[code], np.flatnonzero(target.codes == code).tolist()
        if len(rows) < len(data) / 2:
            yield Hypothesis(
                "target",
                f"the measurements of target '{name}' contradict all others",
                "target",
                ReadingSetup(without=places_of(data, rows)),
                figure="residuals-over-order",
            )
