"""False trust: jobs with one defect each, and a tool that is where it is said to be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import calib_pin
from benchmarks.criterion import Criterion, Line, at_most, named
from benchmarks.verdict.defects import DEFECTS
from benchmarks.verdict.jobs import draw
from benchmarks.verdict.truth import Outcome, judged, refused


def run(number: int) -> Outcome:
    """A job with the defect whose turn it is."""
    kind = list(DEFECTS)[number % len(DEFECTS)]
    job = draw(number)
    try:
        case = DEFECTS[kind](number)
        job = case.job
        result = calib_pin.calibrate(
            job.chain, case.rows, case.setup, validation=case.validation
        )
    except Exception as error:
        return refused(job, error, kind)
    return judged(job, result, kind, there=case.like)


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """The share of false trust, and what came out of every defect."""
    false = [o.number for o in found if o.false]
    text = "trusted, but twice as far off as predicted"
    yield at_most(text, false, len(found), 1.0)
    crashed = [o.number for o in found if o.verdict == "crash"]
    yield at_most("ended in a traceback", crashed, len(found), 0.0)
    for kind in DEFECTS:
        outcomes = [o for o in found if o.kind == kind]
        counts = Counter(o.verdict for o in outcomes)
        shown = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        if wrong := [o.number for o in outcomes if o.false]:
            shown += f"; false {named(wrong)}"
        yield Line(kind, shown)


CRITERION = Criterion(2, "False trust", 1000, run, judge, least=2 * len(DEFECTS))
