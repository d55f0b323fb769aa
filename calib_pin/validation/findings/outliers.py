"""Measurements that robust estimation has set aside, and which of them are exchanged.

The fit has found them, with what they have in common; here they become findings. What
was exchanged is known as a pair of which each fits the values of the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding, Outlier, Severity
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.robust import exchanged_with
from calib_pin.measurement_models.readings import place_of
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations.base import LENGTH_SCALE
from calib_pin.setup import ReadingSetup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.places import NAMED, named, without
from calib_pin.validation.findings.setup_lines import lines_of, written
from calib_pin.validation.tip_drift import tip_drift

STRETCH, FULL, CONFIGURATIONS = 0.1, 0.9, 6
"""Part of all measurements, part of a stretch of the files, and configurations from
which outliers are one that was measured with something else."""


def outliers(case: Case) -> Iterator[Finding]:
    """Measurements that are set aside; of a whole fit exchanged ones apart."""
    fitted = case.fitted
    if fitted is None:
        yield from _far(case.fit.problem.data)
        return
    if fitted.robust.squared is None:
        return
    out = [o for o in fitted.robust.outliers if o.weight == 0.0]
    if not out:
        return
    data, moved = case.data, displaced(fitted, fitted.robust.squared)
    numbers: dict[str, float | str] = {"displaced": moved, "all": float(len(data))}
    severity: Severity = "warning" if moved > LENGTH_SCALE else "info"
    with_them = f"with them the tool point would move by {1e3 * moved:.2g} mm"
    pairs = _pairs(data, out)
    if pairs:
        places = tuple((place_of(data, a), place_of(data, b)) for a, b in pairs)
        lines = {"reading": lines_of(ReadingSetup(exchanged=places))}
        yield Finding(
            "measurements-exchanged",
            "warning",
            f"{_told(data, pairs)} fit if exchanged, and were set aside; {with_them}",
            {**numbers, "pairs": float(len(pairs))},
            f"state in the setup file: {written(lines)}"
            if len(pairs) <= NAMED
            else "exchange their joint positions ('reading: exchanged' in the setup)",
            lines,
            "residuals-over-order",
        )
    paired = {row for pair in pairs for row in pair}
    alone = [o for o in out if o.row not in paired]
    if not alone:
        return
    rest = np.array([o.row for o in alone])
    rows = rest[np.argsort(np.argsort(data.in_order)[rest])].tolist()
    code, together = _together(data, rest)
    severity = "error" if together else severity
    targets = {data.target[row] for row in rows}
    if len(targets) == 1 and any(targets):
        numbers["target"] = targets.pop()
    causes = [*dict.fromkeys(o.cause for o in alone if o.cause)]
    shared = f" ({', '.join(causes[:NAMED])})" if causes else ""
    yield Finding(
        code,
        severity,
        f"{named(data, rows)}{shared}: {len(rows)} of {len(data)} measurements "
        f"{'does' if len(rows) == 1 else 'do'} not fit and "
        f"{'was' if len(rows) == 1 else 'were'} set aside{together}; {with_them}",
        {**numbers, "outliers": float(len(rows)), "first": place_of(data, rows[0])},
        *without(data, rows, "measure them again, or leave them out"),
        figure="residuals-over-order",
    )


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


def _far(data: Observations) -> Iterator[Finding]:
    """Measurements that the nominal robot fits far worse than the others."""
    rows = data.in_order[data.weight[data.in_order] == 0.0].tolist()
    if rows:
        yield Finding(
            "outliers",
            "warning",
            f"{named(data, rows)}: {len(rows)} of {len(data)} measurements that were "
            f"looked at {'does' if len(rows) == 1 else 'do'} not fit the nominal robot "
            "as the others do",
            {"outliers": float(len(rows)), "first": place_of(data, rows[0])},
            *without(data, rows, "measure them again, or leave them out"),
            figure="residuals-over-order",
        )


def displaced(fitted: Fit, squared: Fit) -> float:
    """How far two fits have the tool apart, over the workspace, rms [m]."""
    first, second = (
        CalibratedModel.create(fit.problem, fit.theta) for fit in (fitted, squared)
    )
    return max(
        tip_drift(first.of(n), second.of(n), base=True, tool=True).position.rms
        for n in first.measured_chains
    )


def _pairs(data: Observations, out: Sequence[Outlier]) -> list[tuple[int, int]]:
    """Measurements each of which fits the values of the other, in their order."""
    of_cause = {exchanged_with(data, o.row): o.row for o in out}
    partner = {o.row: of_cause[o.cause] for o in out if o.cause in of_cause}
    return [(a, b) for a, b in sorted(partner.items()) if a < b and partner.get(b) == a]


def _told(data: Observations, pairs: Sequence[tuple[int, int]]) -> str:
    (a, b), more = pairs[0], len(pairs) - 1
    of = "the measurements of lines" if data.files[a] else "measurements"
    told = f"{of} {place_of(data, a)} and {place_of(data, b)}"
    return told + (f", and {more} more pair{'s' if more > 1 else ''}," if more else "")
