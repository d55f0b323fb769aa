"""Targets whose measurements contradict those of others: one, or groups of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from typing import Literal

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.measurement_models.readings import places_of
from calib_pin.observations import Observations, apart
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import NEIGHBORS
from calib_pin.validation.findings.hypotheses import Hypothesis
from calib_pin.validation.findings.robot import ABSORBED

FEWEST = 3
"""Fewest measurements of a target that contradict together, and points of a board."""

MOST = 20
"""Most targets that are tried."""

FRAMES: tuple[Literal["station", "tool"], ...] = ("station", "tool")
"""Frames that targets may stand in, and columns that tell them apart."""

GROUPS = 5
"""Most groups of targets that are tried; each has a frame of its own to fit."""


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


def target_frames(case: Case) -> Iterator[Hypothesis]:
    """Groups of targets each of which has a frame of its own: boards at places, say."""
    for group in _groups(case.data):
        names = Counter(group.values())
        # Of fewer points a frame of their own is none: they are known elsewhere.
        if not 1 < len(names) <= GROUPS or min(names.values()) < FEWEST:
            continue
        for frame in FRAMES:
            yield Hypothesis(
                "target-frames",
                f"the targets {enumerated([f'{name}/..' for name in names])} do not "
                "fit together, and each fits alone",
                "frames of targets",
                change=partial(_apart, group=group, frame=frame),
                advice=f"give each a {frame} of its own (a column '{frame}')",
                absorbs=ABSORBED,
            )


def _groups(data: Observations) -> Iterator[dict[str, str]]:
    """Groups of targets by the first part of their names, and of those seen together.

    By name of the target.
    """
    from scipy.sparse import coo_array  # Slow to import.
    from scipy.sparse.csgraph import connected_components

    names, target = data.target.distinct, data.target
    if all("/" in name for name in names):
        yield {name: name.rpartition("/")[0] for name in names}
    pairs, count = (target.codes, data.groups() + len(target.names)), len(target.names)
    size = (count + data.configurations,) * 2
    seen = coo_array((np.ones(len(data)), pairs), shape=size)
    label = dict(zip(target.names, connected_components(seen)[1][:count], strict=True))
    first = {label[name]: name for name in reversed(names)}
    yield {name: first[label[name]] for name in names}


def _apart(
    data: Observations, group: dict[str, str], frame: Literal["station", "tool"]
) -> Observations:
    """Measurements whose groups of targets have a station, or a tool, of their own."""
    return apart(data, frame, data.target.map(group.__getitem__))[0]
