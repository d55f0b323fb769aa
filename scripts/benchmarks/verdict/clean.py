"""Clean jobs: good results must not be refused, and no gain is no fault."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import calib_pin
from benchmarks.criterion import Criterion, Line, at_most
from benchmarks.verdict.jobs import draw, stream
from benchmarks.verdict.truth import Outcome, judged, refused

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
    wrongly = [o.number for o in clean if _refused_wrongly(o)]
    yield at_most("clean jobs refused wrongly", wrongly, len(clean), 1.0)
    false = [o.number for o in clean if o.false]
    yield at_most("clean jobs trusted, twice as far off", false, len(clean), 1.0)
    no_gain = [o.number for o in perfect if o.verdict == "no-gain"]
    text = "perfect robots with no gain"
    yield at_most(text, no_gain, len(perfect), 97.0, least=True)
    untrusted = [
        o.number for o in perfect if o.verdict in ("untrusted", "refused", "crash")
    ]
    yield at_most("perfect robots untrusted", untrusted, len(perfect), 0.0)
    for kind, outcomes in (("clean", clean), ("perfect", perfect)):
        for position in range(3):
            yield from _verdicts(kind, outcomes, position)


def _refused_wrongly(outcome: Outcome) -> bool:
    """Whether a good result was refused, or passed off as no gain.

    With as few configurations as determine everything there is nothing to check with,
    and `unchecked` is right; with twice as many it is a refusal.
    """
    if outcome.verdict in ("crash", "refused"):
        return True
    gain = outcome.actual / outcome.nominal
    limit = {
        "untrusted": 1.0,
        "unchecked": 0.0 if outcome.group[0] == "x 1" else 1.0,
        # That noise hides a part of the errors is no fault.
        "no-gain": 0.5,
    }.get(outcome.verdict, 0.0)
    return gain < limit and outcome.actual <= 2.0 * outcome.predicted


def _verdicts(kind: str, outcomes: Sequence[Outcome], position: int) -> Iterator[Line]:
    """Counts of verdicts by one of the groups."""
    for group in sorted({o.group[position] for o in outcomes}):
        counts = Counter(o.verdict for o in outcomes if o.group[position] == group)
        shown = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        yield Line(f"{kind}, {group}", shown)


CRITERION = Criterion(1, "Clean jobs", 1000, run, judge)
