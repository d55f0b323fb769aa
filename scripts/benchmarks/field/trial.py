"""One day: calibrated with its mishap and without, beside the truth."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from benchmarks.criterion import NUMBERS, Line, at_most
from benchmarks.field.days import Day, day
from benchmarks.field.mishaps import MISHAPS, NONE, Changed
from benchmarks.findings.defect import Input, given, told
from benchmarks.findings.trial import calibrated, judged_by_file
from benchmarks.verdict.jobs import Job, stream
from calib_pin.errors import CalibPinError
from calib_pin.estimation.evidence import TRUSTED, Finding

WORSE = 1.5
"""How many times as far off as the clean twin a trusted tool may be."""

KEPT = 1.5
"""How many times as far off as the sentence promises it may be then."""

SIZED = re.compile(r"times the noise|that are left are noise")
"""Words of a sentence that tells that more than noise is left, or may be."""

CLAIM = "looks like"
"""Words of a refusal that says what is wrong; others only say that something is."""

SLOWER = 5.0
"""How many times as long a wrong job may take as the right one."""


class Answer(NamedTuple):
    """What calib-pin says of an input; errors are rms over the workspace [m].

    Attributes:
        verdict: The verdict; `refused` where the input was, `crash` for a traceback.
        reason: Its reason, or the message.
        findings: What was found.
        error: True error of the robot that is written, nominal of `no-gain`.
        promised: Expected error of it; NaN where nothing is expected.
        nominal: True error of the nominal robot.
        seconds: Processor time [s].
    """

    verdict: str
    reason: str
    findings: tuple[Finding, ...] = ()
    error: float = np.inf
    promised: float = np.nan
    nominal: float = np.nan
    seconds: float = 0.0

    @property
    def trusted(self) -> bool:
        """Whether the robot may be used."""
        return self.verdict in TRUSTED

    def __str__(self) -> str:
        """The answer in a line."""
        sizes = f"{1e3 * self.error:.3f} mm (promised {1e3 * self.promised:.3f}"
        nominal = f"nominal {1e3 * self.nominal:.3f})"
        return (
            f"{self.verdict}, {sizes}, {nominal}, {self.seconds:.1f} s: {self.reason}"
        )


@dataclass(frozen=True)
class Outcome:
    """The outcome of a day.

    Attributes:
        number: Its number.
        mishap: What went wrong.
        instrument: What measured.
        label: The day in a few words.
        clean: The answer to the clean twin.
        answer: The answer to what went wrong.
        named: Whether a true cause is named.
        wrong: Findings that are not true, code and message.
        hidden: Whether the mishap costs in any case.
    """

    number: int
    mishap: str
    instrument: str
    label: str
    clean: Answer
    answer: Answer
    named: bool = False
    wrong: tuple[str, ...] = ()
    hidden: bool = False

    @property
    def off(self) -> bool:
        """Whether a robot is trusted that is farther off than that of the twin."""
        twin = self.clean
        best = twin.error if twin.trusted else min(twin.error, twin.nominal)
        return self.answer.trusted and self.answer.error > WORSE * best

    @property
    def sized(self) -> bool:
        """Whether the sentence tells how far it is off, or that more than noise is."""
        kept = self.answer.error <= KEPT * self.answer.promised
        told = self.answer.trusted and kept
        return told or bool(SIZED.search(self.answer.reason))

    @property
    def false(self) -> bool:
        """Whether it is trusted falsely."""
        return self.off and not self.named and not self.sized

    @property
    def costly(self) -> bool:
        """Whether the mishap costs the accuracy or the trust."""
        lost = self.clean.trusted and not self.answer.trusted
        return self.mishap != NONE and (self.off or lost or self.hidden)

    @property
    def silent(self) -> bool:
        """Whether a mishap that costs is neither named nor taken for another."""
        return self.costly and not self.named and not self.wrong

    @property
    def refused(self) -> bool:
        """Whether the clean twin was refused although it is better than nominal."""
        twin = self.clean
        missed = twin.verdict == "no-gain" and twin.error > 2.0 * twin.promised
        better = not twin.error > twin.nominal
        return missed or (better and not twin.trusted and twin.verdict != "unchecked")

    def __str__(self) -> str:
        """The outcome, line by line."""
        marks = [name for name in ("false", "named", "costly") if getattr(self, name)]
        head = f"job {self.number}: {self.mishap} [{self.label}] {', '.join(marks)}"
        said = [
            f"{f.severity} {f.code}: {f.message}; {f.remedy}"
            for f in self.answer.findings
        ]
        wrong = [f"not true: {text}" for text in self.wrong]
        twin = [f"    {f.severity} {f.code}: {f.message}" for f in self.clean.findings]
        lines = (head, f"clean {self.clean}", *twin, f"found {self.answer}", *said)
        return "\n    ".join((*lines, *wrong))


def run(number: int, name: str, instruments: tuple[str, ...]) -> Outcome:
    """The outcome of a day with a mishap, measured by one of some instruments."""
    mishap = MISHAPS[name]
    of = day(
        number,
        instruments=tuple(i for i in mishap.instruments if i in instruments),
        layouts=mishap.layouts,
        changes=mishap.changes,
        heavy="compliance" in (mishap.changes or {}).get("parameters", ()),
        least=mishap.least,
    )
    twin = replace(given(of.job, of.rows), robot=of.job.robot)
    clean = answered(of.job, twin)
    if name == NONE:
        return Outcome(number, name, of.instrument, of.label, clean, clean)
    spoiled = mishap.spoil(of.job, of.rows, stream(number, 3))
    return _graded(number, name, of, clean, replace(spoiled, robot=of.job.robot))


def answered(job: Job, asked: Input) -> Answer:
    """The answer to an input."""
    begin = time.process_time()
    try:
        result = calibrated(asked)
    except CalibPinError as error:
        found = (Finding("refused", "error", str(error)),)
        return Answer("refused", str(error), found, seconds=time.process_time() - begin)
    except Exception as error:
        return Answer("crash", f"{type(error).__name__}: {error}")
    seconds = time.process_time() - begin
    robots = [(job, asked.columns)]
    if isinstance(asked, Changed):
        robots += asked.robots
    judged = [
        judged_by_file(one, replace(asked, columns=columns), result)
        for one, columns in robots
    ]
    best = min(judged, key=lambda outcome: outcome.actual)
    as_nominal, expected = result.verdict == "no-gain", result.accuracy.workspace
    return Answer(
        result.verdict,
        result.reason,
        result.findings,
        best.nominal if as_nominal else best.actual,
        expected.nominal.position if as_nominal and expected else best.predicted,
        best.nominal,
        seconds,
    )


def _graded(number: int, name: str, of: Day, clean: Answer, spoiled: Input) -> Outcome:
    """The outcome of a day whose mishap is known."""
    mishap = MISHAPS[name]
    answer = answered(of.job, spoiled)
    naming = [f for f in answer.findings if f.code in mishap.codes]
    sentence = Finding("", "info", answer.reason)
    worded = [
        any(told(word)(f) for word in mishap.words)
        for f in (sentence, *answer.findings)
    ]
    usual = {f.code for f in clean.findings}
    known = {*mishap.codes, *mishap.also, *usual}
    wrong = [
        f"{f.code}{'!' if f in naming else ''}: {f.message}"
        for f in answer.findings
        if (f.severity != "info" and f.code not in known)
        or (f in naming and not spoiled.right(f))
    ]
    wrong = [text for text in wrong if CLAIM in text or not text.startswith("refused")]
    named = any(map(spoiled.right, naming)) or any(worded)
    texts = (of.instrument, of.label)
    return Outcome(
        number, name, *texts, clean, answer, named, tuple(wrong), mishap.hidden
    )


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """The shares that count, and tables by mishap and by instrument."""
    spoiled = [o for o in found if o.mishap != NONE]
    costly = [o for o in spoiled if o.costly]
    numbers = [o.number for o in found if o.false]
    yield at_most("false trust", numbers, len(found), 1.0)
    numbers = [o.number for o in costly if o.named]
    yield at_most("cause named", numbers, len(costly), 90.0, least=True)
    numbers = [o.number for o in spoiled if o.wrong]
    yield at_most("a false cause", numbers, len(spoiled), 2.0)
    numbers = [o.number for o in found if o.refused]
    yield at_most("clean twin refused", numbers, len(found), 1.0)
    numbers = [
        o.number for o in found if "crash" in (o.answer.verdict, o.clean.verdict)
    ]
    yield at_most("ended in a traceback", numbers, len(found), 0.0)
    slow = [
        o.number
        for o in spoiled
        if o.answer.seconds > SLOWER * max(o.clean.seconds, 1.0)
    ]
    yield at_most(f"more than {SLOWER:g} times as slow", slow, len(spoiled), 5.0)
    for title, key in (("mishap", "mishap"), ("instrument", "instrument")):
        yield Line(f"{title:<24}", _HEAD)
        for name in dict.fromkeys(sorted(getattr(o, key) for o in found)):
            some = [o for o in found if getattr(o, key) == name]
            yield Line(f"{name:<24}", _row(some))


_COLUMNS: Mapping[str, str] = {
    "jobs": "",
    "costly": "costly",
    "trusted, off": "off",
    "false trust": "false",
    "named": "named",
    "false cause": "wrong",
    "not named": "silent",
    "clean refused": "refused",
}
_HEAD = " ".join(f"{name:>13}" for name in (*_COLUMNS, "time ratio"))


def _row(some: Sequence[Outcome]) -> str:
    """Counts of some outcomes, and the codes of false causes."""
    counts = [
        sum(bool(getattr(o, key)) for o in some) for key in list(_COLUMNS.values())[1:]
    ]
    times = np.median([o.answer.seconds / max(o.clean.seconds, 1e-3) for o in some])
    cells = " ".join(f"{count:>13}" for count in (len(some), *counts))
    codes = sorted({text.partition(":")[0] for o in some for text in o.wrong})
    return f"{cells} {times:>13.1f} {' '.join(codes[:NUMBERS])}".rstrip()
