"""Over the workspace: never worse than nominal, and as far off as predicted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, at_most, square
from benchmarks.verdict.defects import ROWS, narrow, path, stuck
from benchmarks.verdict.jobs import draw, stream
from benchmarks.verdict.truth import Outcome, judged, refused

MODELS = ("position", "pose", "point-distance")
"""Measurement models that see the tool wherever it is."""

RANGES = {"+-0.2 rad": 0.2, "+-0.5 rad": 0.5, "+-1 rad": 1.0}
"""Half the range of each joint, by name."""

KINDS = (*RANGES, "full range", "path", "stuck joint")


def run(number: int) -> Outcome:
    """A job without gross errors whose configurations are of one kind."""
    kind = KINDS[number % len(KINDS)]
    model = MODELS[number // len(KINDS) % len(MODELS)]
    rng = stream(number, 1)
    multiple, least = rng.uniform(1.5, 4.0), int(rng.integers(ROWS // 2, 2 * ROWS))
    job = draw(number, model=model, multiple=multiple, least=least)
    count = 2 * job.count
    if kind in RANGES:
        q = narrow(job, rng, count, RANGES[kind])
    elif kind == "path":
        q = path(job, rng, count)
    elif kind == "stuck joint":
        q = stuck(job, rng, count, int(rng.integers(1, len(job.chain.joints) - 1)))
    else:
        q = job.chain.random_configurations(count, rng)
    try:
        rows = job.measured(rng, q=q[::2])
        result = calib_pin.calibrate(job.chain, rows, job.setup)
    except Exception as error:
        return refused(job, error, kind)
    return judged(job, result, kind, there=q[1::2])


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """URDFs that are worse than nominal, and predictions beside the truth."""
    worse = [o.number for o in found if o.worse]
    yield at_most("written, and worse than nominal", worse, len(found), 1.0)
    text = "mean square of actual by predicted, workspace"
    yield square(text, [(o.actual / o.predicted) ** 2 for o in found], 0.7, 1.3)
    text = "mean square of actual by predicted, where measured"
    yield square(text, [(o.there / o.expected) ** 2 for o in found], 0.7, 1.3)
    sure = [o for o in found if o.better >= 0.95]
    text = "better than nominal where the result says so with 95 %"
    right = [o.number for o in sure if o.actual < o.nominal]
    yield at_most(text, right, len(sure), 95.0, least=True)
    for kind in KINDS:
        some = [o for o in found if o.kind == kind]
        written = [o for o in some if o.verdict == "good"]
        squares = square("", [(o.actual / o.predicted) ** 2 for o in some])
        gain = [o.actual / o.nominal for o in written]
        yield Line(
            kind,
            f"{len(written)} of {len(some)} written, {sum(o.worse for o in some)} "
            f"worse; mean square {squares.figure}"
            + (f"; {np.median(gain):.2f} of the nominal error" if gain else ""),
        )


CRITERION = Criterion(4, "Over the workspace", 1000, run, judge, least=36)
