"""Clean jobs: what is found where there is no defect."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, at_most
from benchmarks.findings.defect import ROBOT
from benchmarks.verdict.coverage import LENGTH, UNMODELED, unmodeled
from benchmarks.verdict.defects import path, spoil
from benchmarks.verdict.jobs import Job, draw, log_uniform, stream
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup

LEARNED = 100
"""Fewest configurations of a job with a learned correction."""

STATIONS = 2
"""Stations of a job with several."""


@dataclass(frozen=True)
class Outcome:
    """What was found on a clean job.

    Attributes:
        number: Number of the job.
        kind: Its peculiarity.
        label: The job in a few words.
        verdict: The verdict.
        findings: Severity, code and message of each finding that is not true.
    """

    number: int
    kind: str
    label: str
    verdict: str
    findings: tuple[tuple[str, str, str], ...]

    def __str__(self) -> str:
        """The outcome, line by line."""
        head = f"job {self.number}: {self.kind} [{self.label}] {self.verdict}"
        return "\n    ".join((head, *(": ".join(found) for found in self.findings)))

    def has(self, *severities: str) -> bool:
        """Whether there is a finding of some severities."""
        return any(severity in severities for severity, _, _ in self.findings)


TRUE: dict[str, tuple[str, ...]] = {
    "outliers": ("outliers",),
    "path": ("one-path", "small-range"),
    "unmodeled": ("model-lacks",),
}
"""Codes of findings that are true of a kind."""

KINDS = (
    "plain",
    "plain",
    "plain",
    "plain",
    "outliers",
    "outliers",
    "stations",
    "unmodeled",
    "unmodeled",
    "path",
    "path",
    "transmission",
    "compliance",
    "learned",
)
"""Peculiarities in turns."""


def run(number: int) -> Outcome:
    """The findings of a clean job of the kind whose turn it is."""
    kind = KINDS[number % len(KINDS)]
    job, rows, setup = _made(kind, number)
    result = calib_pin.calibrate(job.chain, rows, setup)
    findings = tuple(
        (f.severity, f.code, f.message)
        for f in result.findings
        if f.code not in TRUE.get(kind, ())
    )
    return Outcome(number, kind, job.label, result.verdict, findings)


def _made(kind: str, number: int) -> tuple[Job, Measurements | Observations, Setup]:
    """A job of a kind, its measurements and its setup."""
    rng = stream(number, 1)
    if kind == "plain":
        job = draw(number)
        return job, job.measured(rng), job.setup
    names = ("position", "pose", "point-distance")
    if kind == "outliers":
        job = draw(number, multiple=3, least=60)
        rows = job.measured(rng)
        index = rng.permutation(len(rows))[: max(1, len(rows) // 20)]
        size = log_uniform(rng, (5e-3, 1.0), len(index))
        return job, spoil(rows, index, size, rng), job.setup
    if kind == "stations":
        return _stations(number, rng)
    if kind == "unmodeled":
        model = names[int(rng.integers(3))]
        job = draw(number, model=model, multiple=3, least=60, size=1.0, noise=LENGTH)
        job = unmodeled(job, rng, LENGTH * float(rng.uniform(*UNMODELED)))
        return job, job.measured(rng), job.setup
    if kind == "path":
        job = draw(number, model=names[int(rng.integers(3))], multiple=3, least=120)
        return job, job.measured(rng, q=path(job, rng, job.count)), job.setup
    if kind == "learned":
        job = draw(number, model="position", robot="space6", least=LEARNED)
        learned = replace(job.setup, learned="gaussian-process")
        return job, job.measured(rng), learned
    # Gravity pulls at links with a mass alone.
    robot = ROBOT if kind == "compliance" else None
    model = names[int(rng.integers(3))]
    job = draw(number, robot=robot, model=model, multiple=4, least=60)
    return job, job.measured(rng), replace(job.setup, parameters=("placement", kind))


def _stations(number: int, rng: np.random.Generator) -> tuple[Job, Observations, Setup]:
    """A tracker that stood at several places."""
    models = ("position", "pose")
    job = draw(number, model=models[int(rng.integers(2))], multiple=3, least=60)
    blocks = []
    for k in range(STATIONS):
        rows = job.measured(rng, job.count // STATIONS)
        blocks.append(replace(rows, station=f"s{k}"))
    return job, Observations.of(*blocks), job.setup


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """Shares of jobs with findings, and which."""
    for text, limit, severities in (
        ("findings of severity error", 1.0, ("error",)),
        ("findings of severity warning", 3.0, ("warning",)),
    ):
        jobs = [o.number for o in found if o.has(*severities)]
        yield at_most(text, jobs, len(found), limit)
    for kind in dict.fromkeys(KINDS):
        some = [o for o in found if o.kind == kind]
        jobs = [o.number for o in some if o.has("error", "warning")]
        yield Line(kind, f"{len(jobs)} of {len(some)}")
    counts = Counter(
        (severity, code)
        for o in found
        for severity, code in {(s, c) for s, c, _ in o.findings}
    )
    for (severity, code), count in counts.most_common():
        jobs = [o.number for o in found if any(f[1] == code for f in o.findings)]
        yield Line(f"{severity} {code}", f"{count} {jobs[:12]}")


CRITERION = Criterion(100, "Clean jobs", 1000, run, judge)
