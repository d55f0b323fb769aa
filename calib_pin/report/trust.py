"""Reasons to trust a result or not: outliers, findings, noise, expected accuracy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby

from calib_pin.estimation.evidence import (
    ExpectedAccuracy,
    Finding,
    Severity,
    VarianceComponent,
)
from calib_pin.io.setup import yaml_text
from calib_pin.report.blocks import (
    Block,
    Cell,
    Code,
    Facts,
    Line,
    Names,
    Table,
    Tone,
    columns,
)
from calib_pin.report.tables import number, outlier_cells, significant
from calib_pin.setup import PopulationPrior
from calib_pin.units import DISPLAY
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.findings.setup_lines import written
from calib_pin.validation.result import CalibrationResult

LISTED = 5
"""Outliers that are listed before the rest is only counted."""

TONES: Mapping[Severity, Tone] = {"error": "bad", "warning": "strong", "info": "note"}
"""How a finding is shown, by its severity, the worst first."""


def findings(found: Iterable[Finding], reason: str, of: str = "") -> Iterator[Block]:
    """Findings, errors first, each with its remedy and its lines for the setup file.

    Args:
        found: The findings.
        reason: The reason of the verdict; a message that it holds is not repeated.
        of: The subject, where there are several.
    """
    ordered = sorted(found, key=lambda finding: [*TONES].index(finding.severity))
    # Findings with the same lines follow from one explanation.
    for setup, group in groupby(ordered, key=lambda finding: finding.setup):
        together = list(group)
        for finding in together:
            if finding.message not in reason:
                name = f"{finding.severity.capitalize()}{of and f', {of}'}"
                said = below(advised(finding), together)
                yield Line(f"{name}: {said}.", TONES[finding.severity])
        if setup:
            yield Code("Lines for the setup file", yaml_text(setup))
        for figure in dict.fromkeys(filter(None, (f.figure for f in together))):
            yield Line(f"Shown by the figure '{figure}'.", "note", figure=figure)


def below(text: str, found: Iterable[Finding]) -> str:
    """A text without the lines of findings, which stand below it."""
    for finding in found:
        if finding.setup:
            lines = f"in the setup file: {written(finding.setup)}"
            text = text.replace(f"state {lines}", "state the lines below")
            text = text.replace(f"({lines})", "(the lines below)")
    return text


def advised(finding: Finding) -> str:
    """A finding's message and suggestion."""
    return "; ".join(filter(None, (finding.message, finding.remedy)))


def expected(result: CalibrationResult) -> Iterator[Block]:
    """The expected error of the tool point, at the measurements and elsewhere."""
    several = len(result.accuracies) > 1
    known = [
        (f"{chain or 'robot'}, {place}" if several else where, accuracy)
        for chain, found in result.accuracies.items()
        for place, where, accuracy in (
            ("measured", "where measured", found.measured),
            ("workspace", "over the workspace", found.workspace),
        )
        if accuracy is not None
    ]
    if not known:
        return
    if result.verdict == "no-gain":
        # No correction is made, so that its accuracy is of no interest.
        unit, factor = DISPLAY["m"]
        parts = [f"{significant(factor * a.nominal[0])} {unit} {w}" for w, a in known]
        said = f"Expected tool-point error (rms), uncorrected: {', '.join(parts)}."
        yield Line(said, "note")
        return
    rows = [row for where, accuracy in known for row in _accuracy(where, accuracy)]
    titles = ("nominal", "calibrated", "95 %", "unmodeled", "unit", "better", "at")
    yield Table("Expected tool-point error (rms)", columns("", titles), rows)
    yield Line(
        "95 %: the calibrated robot stays below it in 95 of 100 cases. Unmodeled: the "
        "part that no parameter describes. Better: the probability that the calibrated "
        "robot is more accurate. At: the share of configurations where that "
        "probability is at least 95 %.",
        "note",
    )


def _accuracy(where: str, found: ExpectedAccuracy) -> Iterator[Sequence[Cell]]:
    shown = [Cell(percent(part), part) for part in (found.better, found.share)]
    stages = (found.nominal, found.calibrated, found.bound, found.unmodeled)
    for k, si in enumerate(("m", "rad")):
        sizes = [stage[k] for stage in stages]
        if not math.isfinite(sizes[0]):
            continue
        unit, factor = DISPLAY[si]
        numbers = [Cell(significant(factor * size), size) for size in sizes]
        yield Cell(where), *numbers, Cell(unit), *shown
        where, shown = "", [Cell(""), Cell("")]


def percent(part: float) -> str:
    """Whole percents, but never all or nothing where it is not quite so."""
    if 0.0 < part < 0.01:
        return "< 1 %"
    if 0.99 < part < 1.0:
        return "> 99 %"
    return f"{100 * part:.0f} %"


def noise(result: CalibrationResult) -> Iterator[Block]:
    """The noise of every quantity, stated or assumed and estimated."""
    found = result.statistics.noise
    if not found:
        return
    pure = any(part.pure is not None for part in found)
    titles = ["given", "estimated", "95 % interval", *["repeats"][:pure]]
    yield Table(
        "Noise (1 sigma of a component)",
        columns("", (*titles, "unmodeled", "unit")),
        [_noise(part, pure) for part in found],
    )
    for part in found:
        if said := _doubt(part):
            yield Line(said, "note")


def _noise(part: VarianceComponent, pure: bool) -> Sequence[Cell]:
    known = math.isfinite(part.estimate)
    given, estimate, repeats, unmodeled = (
        Cell(_shown(size, part.unit), size)
        for size in (
            part.given,
            part.estimate if known else None,
            part.pure,
            part.unmodeled,
        )
    )
    low, high = (_shown(end, part.unit) for end in part.interval)
    by = "stated" if part.stated else "assumed"
    return (
        Cell(part.quantity),
        Cell(f"{given.text} {by}", given.value),
        estimate,
        Cell(f"{low} ... {high}" if known else "-"),
        *[repeats][:pure],
        unmodeled,
        Cell(DISPLAY[part.unit][0]),
    )


def _shown(size: float | None, unit: str) -> str:
    if size is None:
        return "-"
    return significant(DISPLAY[unit][1] * size)


def _doubt(part: VarianceComponent) -> str:
    """Doubts about the given standard deviation, and their likely cause."""
    unit = DISPLAY[part.unit][0]
    parts = []
    if part.unmodeled:
        quiet = part.pure if part.pure is not None else part.given
        sizes = [_shown(size, part.unit) for size in (quiet, part.unmodeled)]
        parts.append(f"{sizes[0]} {unit} noise, {sizes[1]} {unit} unmodeled")
    if part.lack_of_fit is not None and part.lack_of_fit < 0.05:
        p = part.lack_of_fit
        parts.append(
            "lack of fit, configurations differ more than their repetitions (p "
            f"{f'= {p:.3f}' if p >= 1e-3 else '< 0.001'})"
        )
    return f"{part.quantity}: {'; '.join(parts)}." if parts else ""


def outliers(result: CalibrationResult) -> Iterator[Block]:
    """Outliers with their weights, the worst of them by name."""
    found = result.statistics.outliers
    if not found:
        return
    caused = any(row.cause for row in found)
    of = columns(
        "", ("normalized residual", "weight", *["cause"][:caused]), {"cause": "remark"}
    )
    rows = [[*outlier_cells(row)][: 3 + caused] for row in found[:LISTED]]
    yield Table(f"Outliers ({len(found)} of {len(result.fitted)})", of, rows)
    if len(found) > LISTED:
        yield Line(f"and {len(found) - LISTED} more in calibration.json", indent=True)


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
    if result.statistics.dof > 0:
        low, high = chi2_interval(result.statistics.dof)
        where = "inside"
        if not low <= result.statistics.chi2 <= high:
            where = "below" if result.statistics.chi2 < low else "above"
        interval = f"{number(low)} ... {number(high)}"
        entries.append(("", f"{where} its 95 % interval {interval}"))
        entries.append(
            ("sigma0", f"{number(result.statistics.sigma0)} times the {sigmas} sigma")
        )
    prior = result.model.setup.prior
    if isinstance(prior, PopulationPrior):
        entries.append(("prior", f"by {prior.robots} robots of this type"))
    title = "Statistics of the parameters, before what is learned"
    yield Facts(title if learned else "Statistics", entries)


def correlated(result: CalibrationResult, most: int = LISTED) -> Iterator[Names]:
    """Strongly correlated estimates; beyond `most` pairs the rest is only counted."""
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
