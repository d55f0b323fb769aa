"""What a robust fit has set aside, and the noise of the rest.

The fit has found them, with what they have in common; here they become findings. What
was exchanged is known as a pair of which each fits the values of the other, and what is
in another unit fits with the factor that undoes it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding, Outlier, VarianceComponent
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.robust import exchanged_with
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import (
    measured_lengths,
    place_of,
    places_of,
    scaled,
)
from calib_pin.observations import Indices, Observations, states_sigmas
from calib_pin.parameterizations.base import LENGTH_SCALE
from calib_pin.setup import ConvertedSetup, ReadingSetup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.case import CHANCE, Case, mean_squares, unlikely
from calib_pin.validation.findings.readings import FACTORS
from calib_pin.validation.findings.sentences import (
    NAMED,
    lines_of,
    named,
    shown,
    told,
    without,
    written,
)
from calib_pin.validation.tip_drift import tip_drift

STRETCH, FULL, CONFIGURATIONS = 0.1, 0.9, 6
"""Part of all measurements, part of a stretch of the files, and configurations from
which outliers are one that was measured with something else."""

FITS, LISTED = 4.0, 200
"""Errors, by those of the others, with which a measurement fits in another unit, and
length of the lines that a remedy writes out; all stand in the finding."""

FACTOR = 2.0
"""Estimated by stated standard deviation, or the inverse, from which it is told."""


def outliers(case: Case) -> Iterator[Finding]:
    """Measurements that are set aside; of a whole fit exchanged ones apart."""
    fitted, data = case.fitted, case.data
    if fitted is None:
        data = case.fit.problem.data
        rows = data.in_order[data.weight[data.in_order] == 0.0].tolist()
        why = " that were looked at do not fit the nominal robot as the others do"
        if rows:
            yield _aside("outliers", data, rows, why, {})
        return
    out = [o for o in fitted.robust.outliers if o.weight == 0.0]
    if fitted.robust.squared is None or not out:
        return
    moved = displaced(fitted, fitted.robust.squared)
    numbers: dict[str, Any] = {"displaced": moved, "all": len(data)}
    keeping = f"; keeping them would move the tool point by {shown(moved, 'm')}"
    pairs = _pairs(data, out)
    if pairs:
        places = tuple(places_of(data, pair) for pair in pairs)
        said = f"measurements {' and '.join(places[0])}"
        said += f", and {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
        said += f" fit if exchanged, and were excluded{keeping}"
        lines = {"reading": lines_of(ReadingSetup(exchanged=places))}
        remedy = "exchange their joint positions ('reading: exchanged' in the setup)"
        remedy = "" if len(pairs) <= NAMED else remedy
        numbers |= {"pairs": len(pairs)}
        code = "measurements-exchanged"
        yield told(code, said, numbers, remedy, lines, "over-order")
    alone = [o for o in out if not any(o.row in pair for pair in pairs)]
    if not alone:
        return
    rest = np.array([o.row for o in alone])
    rows = rest[np.argsort(np.argsort(data.in_order)[rest])].tolist()
    code, together = _together(data, rest)
    targets = {data.target[row] for row in rows}
    if len(targets) == 1 and any(targets):
        numbers["target"] = targets.pop()
    causes = [*dict.fromkeys(o.cause for o in alone if o.cause)][:NAMED]
    shared = f" ({', '.join(causes)})" if causes else ""
    why = f" excluded as outliers{shared}{together}{keeping}"
    error, info = bool(together), moved <= LENGTH_SCALE
    yield _aside(code, data, rows, why, numbers, error=error, info=info)


def _aside(
    code: str,
    data: Observations,
    rows: Sequence[int],
    why: str,
    numbers: Mapping[str, Any],
    **severity: bool,
) -> Finding:
    """The finding of measurements, in the order of the files, to leave out."""
    said = f"{named(data, rows)}: {len(rows)} of {len(data)} measurements{why}"
    numbers = {**numbers, "outliers": len(rows), "first": place_of(data, rows[0])}
    remedy, lines = without(data, rows, "measure them again, or leave them out")
    return told(code, said, numbers, remedy, lines, "over-order", **severity)


def _together(data: Observations, rows: Indices) -> tuple[str, str]:
    """Code and words of outliers that are one long stretch of the files.

    There a joint stands still that moves elsewhere, or something else was measured.
    """
    places = np.argsort(data.in_order)[rows]
    many = len(rows) >= STRETCH * len(data)
    few = len(np.unique(data.groups()[rows])) < CONFIGURATIONS
    if few or not many or np.ptp(places) >= len(rows) / FULL:
        return "outliers", ""
    still = (np.ptp(data.q[rows], axis=0) == 0.0) & (np.ptp(data.q, axis=0) > 0.0)
    if still.any():
        names = enumerated([f"'{data.joints[j]}'" for j in np.flatnonzero(still)])
        return "stuck-encoder", f": there the reading of joint {names} does not change"
    words = ", all in one stretch: something else was measured there, such as "
    words += "another robot, tool or station"
    return "outlying-stretch", words


def displaced(fitted: Fit, squared: Fit) -> float:
    """How far two fits have the tool apart, over the workspace, rms [m]."""
    first = CalibratedModel.create(fitted.problem, fitted.theta)
    second = CalibratedModel.create(squared.problem, squared.theta)
    pairs = [(first.of(name), second.of(name)) for name in first.measured_chains]
    return max(tip_drift(*p, base=True, tool=True).position.rms for p in pairs)


def _pairs(data: Observations, out: Sequence[Outlier]) -> list[tuple[int, int]]:
    """Measurements each of which fits the values of the other, in their order."""
    of_cause = {exchanged_with(data, o.row): o.row for o in out}
    partner = {o.row: of_cause[o.cause] for o in out if o.cause in of_cause}
    return [(a, b) for a, b in sorted(partner.items()) if a < b and partner.get(b) == a]


def units_of_some(case: Case) -> Iterator[Finding]:
    """Measurements that were set aside, and fit in another unit."""
    data = case.data
    aside = np.flatnonzero(data.weight == 0.0)
    if case.fitted is None or not 0 < len(aside) < len(data):
        return
    problem, theta = replace(case.fitted.problem, expected=None), case.fitted.theta

    def sizes(data: Observations) -> Floats:
        return np.sqrt(mean_squares(replace(problem, data=data), theta))

    counted, some = sizes(data.rows(data.weight > 0.0)), data.rows(aside)
    usual, now = max(float(np.sqrt(np.mean(counted**2))), 1e-9), sizes(some)
    lengths = [np.full(len(b), measured_lengths(b).sum()) for b in some.blocks]
    values = np.concatenate(lengths)
    best = (unlikely(len(FACTORS)), 0.0, np.zeros(0, np.int64))
    for factor in FACTORS:
        there = scaled(some, np.full(len(some), factor))
        left = np.maximum(sizes(there), usual)
        fits = (left < FITS * usual) & (now > FITS * left)
        ratio = float(np.sum((values * np.log(now / left))[fits]))
        best = max(best, (ratio, factor, aside[fits]), key=lambda found: found[0])
    ratio, factor, rows = best
    if not len(rows):
        return
    rank = np.argsort(data.in_order)
    rows = rows[np.argsort(rank[rows])]
    places = places_of(data, rows.tolist())
    converted = ConvertedSetup(factor, places, True)
    if len(rows) > 1 and np.ptp(rank[rows]) == len(rows) - 1:
        converted = ConvertedSetup(factor, (places[0], places[-1]))
    lines = {"reading": lines_of(ReadingSetup(converted=(converted,)))}
    said = f"{len(rows)} of {len(data)} measurements that were set aside, the first in "
    said += f"line {places[0]}, fit if their lengths are {FACTORS[factor]}"
    numbers = {"factor": factor, "measurements": len(rows), "first": places[0]}
    numbers |= {"log_likelihood_ratio": ratio}
    long = len(written(lines)) >= LISTED
    remedy = "state the lines of this finding in the setup file" if long else ""
    yield told("unit-of-some", said, numbers, remedy, lines)


def noise(case: Case) -> Iterator[Finding]:
    """Stated standard deviations that are far from those of the measurements.

    Too large ones are wrong. Too small ones may leave no room for what no parameter
    describes, gears and compliance; they are wrong where repetitions scatter as much.
    """
    fitted = case.fitted
    known = [(part, *_scatter(part)) for part in (fitted.noise if fitted else ())]
    known = [(part, scatter, sure) for part, scatter, sure in known if scatter > 0.0]
    stated = {part.quantity: float(f"{scatter:.3g}") for part, scatter, _ in known}
    lines: dict[str, Any] = {"noise": stated}
    if states_sigmas(case.data):
        lines["reading"] = {"sigmas": False}
    for part, scatter, repeated in known:
        factor = scatter / part.given
        near = 1.0 / FACTOR < factor < FACTOR
        unclear = factor > 1.0 and not repeated
        # Where that is unclear, there may be more to it than noise.
        wrong = part.stated and part.contradicted and not near
        if not wrong or (unclear and case.doubtful):
            continue
        was, found = (shown(sigma, part.unit) for sigma in (part.given, scatter))
        times = f"{factor:.2g} times too small"
        times = times if factor > 1.0 else f"{1.0 / factor:.2g} times too large"
        said = f"the stated sigma of {part.quantity}, {was}, is {times}: the "
        said, remedy = f"{said}measurements scatter by {found}", ""
        if unclear:
            said = f"the errors of {part.quantity} are {factor:.3g} times the stated "
            said += f"{was}: sigma is too small, or no parameter describes them"
            remedy = "repeat some configurations, which tells noise from unmodeled "
            remedy += "errors"
        # What shows as gears or as lack of fit is no fault of sigma.
        robot = fitted and (fitted.effects is not None or part.pure is not None)
        numbers = {"quantity": part.quantity, "stated": part.given}
        numbers |= {"estimated": scatter, "factor": factor}
        info = bool(unclear and robot)
        yield told("noise", said, numbers, remedy, lines, info=info)


def _scatter(part: VarianceComponent) -> tuple[float, bool]:
    """Standard deviation of a quantity, and whether repetitions tell it."""
    repeated = part.pure is not None and (part.pure_test or 0.0) < CHANCE
    return part.pure if part.pure is not None and repeated else part.estimate, repeated


KINDS = (units_of_some, outliers, noise)
"""What is told of every fit."""
