"""Promises away from where it was measured, beside the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

import calib_pin
from benchmarks.criterion import Line, at_most, square
from benchmarks.field.days import day
from benchmarks.verdict.jobs import stream
from benchmarks.verdict.truth import WORKSPACE, position_error
from calib_pin.errors import CalibPinError

INSTRUMENTS = ("tracker", "poses", "wire")
"""What measures in any region."""

LOW, HIGH, SHARE = 0.8, 1.25, 90.0
"""Limits of the true error by the promised one, and the part [%] within them."""

COVERED = 95.0
"""Part [%] of the true errors that is below the bound of the promise."""


@dataclass(frozen=True)
class Outcome:
    """A promise beside the truth; errors are rms tool positions [m].

    Attributes:
        number: Number of the job.
        label: The job in a few words.
        model: The model that was chosen.
        verdict: The verdict, with its reason.
        actual: True error of the calibrated robot over the workspace.
        nominal: That of the nominal one.
        promised: Expected error; NaN where nothing is expected.
        here: True error by the expected one, in the region.
        bound: Its bound with 95 % confidence.
        honest: Probability that a true error is within the limits of the expected one,
            by how far the bound is above that.
    """

    number: int
    label: str
    model: str
    verdict: str
    reason: str
    actual: float = np.nan
    nominal: float = np.nan
    promised: float = np.nan
    here: float = np.nan
    bound: float = np.nan
    honest: float = np.nan

    @property
    def ratio(self) -> float:
        """The true error by the promised one."""
        return self.actual / self.promised

    def __str__(self) -> str:
        """The outcome in a line."""
        sizes = " ".join(f"{1e3 * x:.3f}" for x in (self.actual, self.promised))
        return (
            f"job {self.number}: [{self.label}] {self.model}: {self.verdict}, actual "
            f"and promised {sizes} mm, nominal {1e3 * self.nominal:.3f} mm, in the "
            f"region {self.here:.2f}: {self.reason}"
        )


def run(number: int) -> Outcome:
    """A day in one region, every other one with the search for a model."""
    of, ladder = day(number, instruments=INSTRUMENTS, layouts=("region",)), number % 2
    job, setup = of.job, of.job.setup
    if ladder:
        setup = replace(setup, parameters=("placement",))
    try:
        result = calib_pin.calibrate(job.chain, of.rows, setup, ladder=bool(ladder))
    except CalibPinError as error:
        return Outcome(number, of.label, "", "refused", str(error))
    selection = result.model_selection
    model = "as stated"
    if selection is not None:
        model = selection.candidates[selection.chosen].name
    q = job.chain.random_configurations(WORKSPACE, stream(number, 99))
    accuracy = result.accuracy
    promised = here = bound = honest = np.nan
    if accuracy.workspace is not None:
        promised = accuracy.workspace.calibrated[0]
        bound = accuracy.workspace.bound[0]
        honest = within(bound / promised)
    if accuracy.measured is not None:
        there = position_error(job, result.model, of.rows.q)
        here = there / accuracy.measured.calibrated[0]
    return Outcome(
        number,
        of.label,
        model,
        result.verdict,
        result.reason,
        position_error(job, result.model, q),
        position_error(job, None, q),
        promised,
        here,
        bound,
        honest,
    )


def within(bound: float) -> float:
    """Probability that an error is within the limits of its root mean square.

    Its square is distributed as chi-square, of as many degrees of freedom as its 95 %
    quantile tells: a region leaves a few directions open, and the error is theirs.

    Args:
        bound: The root of this quantile, by the root mean square.
    """

    def beyond(log: float) -> float:
        return float(chi2.ppf(0.95, np.exp(log)) / np.exp(log)) - bound**2

    if not 1.0 < bound < 1.9:
        return np.nan
    dof = np.exp(brentq(beyond, np.log(1.0), np.log(1e5)))
    return float(np.diff(chi2.cdf(dof * np.array([LOW, HIGH]) ** 2, dof))[0])


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """The share of promises that are kept, and models that are worse than nominal."""
    worse = [o.number for o in found if o.verdict == "good" and o.actual > o.nominal]
    yield at_most("good, and worse than nominal away", worse, len(found), 0.0)
    groups = {
        "promised": [o for o in found if np.isfinite(o.ratio)],
        "promised and good": [
            o for o in found if np.isfinite(o.ratio) and o.verdict == "good"
        ],
    }
    for name, some in groups.items():
        kept = [o.number for o in some if LOW <= o.ratio <= HIGH]
        text = f"{name}: truth within {LOW:g} to {HIGH:g} of it"
        yield at_most(text, kept, len(some), SHARE, least=True)
        below = [o.number for o in some if o.actual <= o.bound]
        text = f"{name}: truth below its bound"
        yield at_most(text, below, len(some), COVERED, least=True)
        honest = 100.0 * float(np.nanmean([o.honest for o in some] or [np.nan]))
        yield Line(f"{name}: by the promises themselves", f"{honest:.0f} %")
        ratios = np.array([o.ratio for o in some] or [np.nan])
        spread = " ".join(f"{x:.2f}" for x in np.quantile(ratios, (0.05, 0.5, 0.95)))
        yield Line(f"{name}: 5, 50 and 95 % of the ratios", spread)
        yield square(f"{name}: mean square of the ratio", [o.ratio**2 for o in some])
    yield square("in the region: mean square", [o.here**2 for o in found])
    for model in sorted({o.model for o in found}):
        some = [o for o in found if o.model == model]
        middle = np.median([o.ratio for o in some])
        good = sum(o.verdict == "good" for o in some)
        bad = sum(o.verdict == "good" and o.actual > o.nominal for o in some)
        shown = f"{len(some)} jobs, {good} good, {bad} of them worse than nominal"
        yield Line(model or "refused", f"{shown}, middle of the ratios {middle:.2f}")
