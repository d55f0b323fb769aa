"""Clean jobs: what is good must not be refused, and nothing to gain is no fault."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import calib_pin
from benchmarks.verdict.criterion import Criterion, Line, at_most
from benchmarks.verdict.jobs import draw, stream
from benchmarks.verdict.truth import Outcome, judged, refused

__all__ = ["CRITERION"]

PERFECT = 4
"""Every so many jobs the robot is perfect."""


def run(number: int) -> Outcome:
    """A robot with errors, or a perfect one, without any defect of its data."""
    perfect = number % PERFECT == PERFECT - 1
    job = draw(number, perfect=perfect)
    multiple = max(1, job.count // job.minimal)
    group = (f"x {multiple}", job.model, job.robot.removeprefix("example:"))
    kind = "perfect" if perfect else "clean"
    try:
        rows = job.measured(stream(number, 1))
        result = calib_pin.calibrate(job.chain, rows, job.setup)
    except Exception as error:
        return refused(job, error, kind, group)
    return judged(job, result, kind, group)


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """Shares of wrong refusals, and verdicts by kind of job."""
    clean = [o for o in found if o.kind == "clean"]
    perfect = [o for o in found if o.kind == "perfect"]
    wrongly = [
        o.number
        for o in clean
        if o.verdict in ("crash", "refused")
        or (
            o.verdict == "untrusted"
            and o.actual < o.nominal
            and o.actual <= 2.0 * o.predicted
        )
    ]
    yield at_most("clean jobs refused wrongly", wrongly, len(clean), 1.0)
    false = [o.number for o in clean if o.false]
    yield at_most("clean jobs trusted, twice as far off", false, len(clean), 1.0)
    no_gain = [o.number for o in perfect if o.verdict == "no-gain"]
    text = "perfect robots with no gain"
    yield at_most(text, no_gain, len(perfect), 97.0, least=True)
    untrusted = [o.number for o in perfect if o.verdict not in ("no-gain", "unchecked")]
    bad = [o.number for o in perfect if o.number in untrusted and o.verdict != "good"]
    yield at_most("perfect robots untrusted", bad, len(perfect), 0.0)
    for kind, outcomes in (("clean", clean), ("perfect", perfect)):
        for position in range(3):
            yield from verdicts(kind, outcomes, position)


def verdicts(kind: str, outcomes: Sequence[Outcome], position: int) -> Iterator[Line]:
    """Counts of verdicts by one of the groups."""
    for group in sorted({o.group[position] for o in outcomes}):
        counts = Counter(o.verdict for o in outcomes if o.group[position] == group)
        shown = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        yield Line(f"{kind}, {group}", shown)


CRITERION = Criterion(1, "Clean jobs", 1000, run, judge)
