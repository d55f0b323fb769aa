"""Measurements that robust estimation has set aside, and which of them are exchanged.

The fit has found them, with what they have in common; here they become findings. What
was exchanged is known as a pair of which each fits the values of the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding, Outlier
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.robust import exchanged_with
from calib_pin.measurement_models.readings import place_of, places_of
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations.base import LENGTH_SCALE
from calib_pin.setup import ReadingSetup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.sentences import NAMED, named, shown, told, without
from calib_pin.validation.findings.setup_lines import lines_of
from calib_pin.validation.tip_drift import tip_drift

STRETCH, FULL, CONFIGURATIONS = 0.1, 0.9, 6
"""Part of all measurements, part of a stretch of the files, and configurations from
which outliers are one that was measured with something else."""


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
