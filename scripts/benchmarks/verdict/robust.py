"""Robustness: fits with gross errors beside fits of the good measurements alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, at_most, between
from benchmarks.verdict.defects import GROSS, spoil
from benchmarks.verdict.jobs import MODELS, draw, log_uniform, stream
from benchmarks.verdict.truth import Outcome, judged, refused
from calib_pin.observations import Observations

SHARES = (0.2, 0.4)
"""Parts of the measurements that are spoiled."""

SURE = 10.0
"""Size from which a gross error must be named, in standard deviations."""

RIGHT = 1.5
"""Error by that of the good measurements alone up to which a solution is the right one:
a few spoiled measurements of the size of the noise may be left, or good ones lost."""


@dataclass(frozen=True)
class Robust:
    """Outcome of a job with gross errors.

    Attributes:
        outcome: With all measurements.
        model: Its measurement model.
        share: Part that is spoiled.
        ratio: Tool error by that of the good measurements alone.
        sure: Number of gross errors of more than ten standard deviations.
        found: How many of these are named.
        good: Number of good measurements.
        blamed: How many of these are named.
    """

    outcome: Outcome
    model: str
    share: float
    ratio: float = np.nan
    sure: int = 0
    found: int = 0
    good: int = 0
    blamed: int = 0

    def __str__(self) -> str:
        """The outcome in one line."""
        return (
            f"{self.outcome}; {100 * self.share:.0f} % spoiled, {self.ratio:.2f} times "
            f"the error, {self.found} of {self.sure} found, {self.blamed} of "
            f"{self.good} blamed"
        )


def run(number: int) -> Robust:
    """A job with gross errors, and the same with the good measurements alone."""
    models = tuple(MODELS)
    model = models[number % len(models)]
    share = SHARES[number // len(models) % len(SHARES)]
    job, rng = draw(number, model=model, multiple=4, least=40), stream(number, 1)
    kind = f"{100 * share:.0f} % spoiled"
    try:
        rows = job.measured(rng)
        # All that is measured in one configuration fails together.
        groups, count = rows.groups(), rows.configurations
        spoiled = np.isin(groups, rng.permutation(count)[: round(share * count)])
        size = log_uniform(rng, GROSS, int(spoiled.sum()))
        bad = spoil(rows, np.flatnonzero(spoiled), size, rng)
        result = calib_pin.calibrate(job.chain, bad, job.setup)
        alone = calib_pin.calibrate(
            job.chain, rows.rows(~spoiled), job.setup, validate=False
        )
    except Exception as error:
        return Robust(refused(job, error, kind), model, share)
    outcome = judged(job, result, kind)
    off = replace(job.problem, data=Observations.of(bad)).errors(job.theta) / job.noise
    size = np.linalg.norm(off.reshape(len(bad), -1), axis=1)
    sure = spoiled & (size > SURE)
    names = np.zeros(len(rows), bool)
    names[[outlier.row for outlier in result.statistics.outliers]] = True
    return Robust(
        outcome=outcome,
        model=model,
        share=share,
        ratio=outcome.actual / judged(job, alone).actual,
        sure=int(sure.sum()),
        found=int((sure & names).sum()),
        good=int((~spoiled).sum()),
        blamed=int((~spoiled & names).sum()),
    )


def judge(found: Sequence[Robust]) -> Iterator[Line]:
    """Errors by those of the good measurements, and what was named."""
    for share in SHARES:
        some = [o for o in found if o.share == share]
        percent = f"{100 * share:.0f} %"
        for model in MODELS:
            ratios = [o.ratio for o in some if o.model == model]
            # A job that ended in an error is no right solution.
            ratio = float(np.median(np.nan_to_num(ratios, nan=99.0))) if ratios else 0.0
            text = f"{percent} spoiled, {model}, median ratio of {len(ratios)}"
            if share == SHARES[0]:
                yield between(text, ratio, -np.inf, 1.15)
                continue
            yield Line(text, f"{ratio:.3f}")
            right = [
                o.outcome.number for o in some if o.model == model and o.ratio <= RIGHT
            ]
            if model in ("pose", "position"):
                text = f"{percent} spoiled, {model}, right solution"
                yield at_most(text, right, len(ratios), 95.0, least=True)
        text = f"{percent} spoiled, trusted, but twice as far off as predicted"
        false = [o.outcome.number for o in some if o.outcome.false]
        yield at_most(text, false, len(some), 0.0)
        yield from _named(percent, some, limited=share == SHARES[0])


def _named(percent: str, some: Sequence[Robust], limited: bool) -> Iterator[Line]:
    """Parts of gross errors and of good measurements that are named."""
    sure, good = sum(o.sure for o in some), sum(o.good for o in some)
    found = 100.0 * sum(o.found for o in some) / max(sure, 1)
    blamed = 100.0 * sum(o.blamed for o in some) / max(good, 1)
    yield Line(
        f"{percent} spoiled, gross errors named",
        f"{found:.2f} % of {sure}",
        "at least 99 %" if limited else "",
        found >= 99.0 if limited else None,
    )
    yield Line(
        f"{percent} spoiled, good measurements named",
        f"{blamed:.2f} % of {good}",
        "at most 0.5 %" if limited else "",
        blamed <= 0.5 if limited else None,
    )


CRITERION = Criterion(
    3, "Robustness", 100 * len(MODELS) * len(SHARES), run, judge, least=28
)
