"""Chi-square of the residuals, and correlations of the estimates."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.report.blocks import Block, Facts, Line, Names
from calib_pin.report.tables import number
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.result import CalibrationResult

LISTED = 5
"""Correlated pairs that are listed before the rest is only counted."""


def statistics(result: CalibrationResult) -> Iterator[Block]:
    """Chi-square, and whether it confirms the standard deviations."""
    learned = result.model.setup.learned is not None
    sigmas = "stated" if result.statistics.stated_sigma else "assumed"
    entries = [
        (
            "chi-square",
            f"{number(result.statistics.chi2)} with {result.statistics.dof} dof",
        )
    ]
    remark = ""
    if result.statistics.dof > 0:
        low, high = chi2_interval(result.statistics.dof)
        where = "inside"
        if result.statistics.chi2 < low:
            where, remark = "below", "sigma may be too large."
        elif result.statistics.chi2 > high:
            where = "above"
            remark = "sigma too small, outliers, or unmodeled errors."
        interval = f"{number(low)} ... {number(high)}"
        entries.append(("", f"{where} its 95 % interval {interval}"))
    if result.statistics.dof > 0:
        entries.append(
            ("sigma0", f"{number(result.statistics.sigma0)} times the {sigmas} sigma")
        )
    title = "Statistics of the parameters, before what is learned"
    yield Facts(title if learned else "Statistics", entries)
    if remark and result.statistics.stated_sigma and not learned:
        said = f"Chi-square {where} its 95 % interval: {remark}"
        yield Line(said, indent=True)


def correlated(result: CalibrationResult, most: int = LISTED) -> Iterator[Names]:
    """Strongly correlated estimates.

    Args:
        result: The result.
        most: Number of pairs that are listed before the rest is only counted.
    """
    pairs = result.identifiability.correlated
    if pairs:
        names = {g.expression: f"combination {g.number}" for g in result.groups}
        entries = [
            f"{value:+.3f}  {names.get(first, first)}  |  {names.get(second, second)}"
            for first, second, value in pairs[:most]
        ]
        if len(pairs) > most:
            entries.append(f"and {len(pairs) - most} more pairs in calibration.json")
        yield Names("Correlations, abs(rho) > 0.95", entries)
