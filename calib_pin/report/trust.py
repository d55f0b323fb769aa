"""Reasons to trust a result or not: outliers, findings, noise, expected accuracy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby

from calib_pin.errors import counted
from calib_pin.estimation.evidence import (
    ADDING,
    TRUSTED,
    ExpectedAccuracy,
    Finding,
    Severity,
)
from calib_pin.estimation.statistics.distributions import chi2_interval
from calib_pin.io.setup import yaml_text
from calib_pin.report.blocks import Block, Cell, Code, Facts, Line, Tone, note, table
from calib_pin.report.tables import UNIT, number, percent, significant, unit_of
from calib_pin.setup import PopulationPrior
from calib_pin.validation.result import CalibrationResult

FIRST = 3
"""Findings that stand below a verdict."""

TONES: Mapping[Severity, Tone] = {"error": "bad", "warning": "strong", "info": "note"}
"""How a finding is shown, by its severity, the worst first."""

PLACES = ("measured", "workspace")
"""Where an accuracy is expected, by the names in `ToolAccuracy`."""

NEXT = {
    "unchecked": f"measure more configurations: {ADDING} proposes them",
    "untrusted": "check units, joint signs, and base and tip; then measure more or "
    f"other configurations ({ADDING})",
}
"""Next steps where no finding has one, by the verdict."""


def opening(result: CalibrationResult, most: int | None = None) -> Iterator[Block]:
    """The verdict, always first, and the findings; all of them without `most`."""
    yield verdict(result)
    yield from findings(result.findings, result.reason, most=most)


def verdict(result: CalibrationResult) -> Line:
    """The verdict and its reason; a finding among the reasons with its suggestion."""
    reason = result.reason
    for finding in result.findings:
        if advised(finding) not in reason:
            reason = reason.replace(finding.message, advised(finding))
    return judged(below(reason, result.findings), result.verdict)


def judged(reason: str, status: str = "untrusted") -> Line:
    """A verdict as the line that comes first."""
    name = status.replace("-", " ").upper()
    text = f"{name}: {reason.rstrip('.')}."
    return Line(text, "good" if status in TRUSTED else "bad")


def next_step(result: CalibrationResult) -> Iterator[Line]:
    """The next step with a result that must not be trusted."""
    if result.verdict in TRUSTED:
        return
    grave, advice = serious(result), NEXT[result.verdict]
    if any(finding.setup for finding in grave):
        advice = "put the lines above into the setup file, and calibrate again"
    elif remedies := [finding.remedy for finding in grave if finding.remedy]:
        advice = remedies[0]
    yield Line(f"Next: {advice.rstrip('.')}.", "strong")


def serious(result: CalibrationResult) -> list[Finding]:
    """Errors, warnings and what the reason says, the worst first, but no remarks."""
    ordered, reason = _ordered(result.findings), result.reason
    return [f for f in ordered if f.severity != "info" or f.message in reason]


def findings(
    items: Iterable[Finding], reason: str, of: str = "", most: int | None = None
) -> Iterator[Block]:
    """Findings, errors first, each with its remedy and its lines for the setup file.

    Args:
        items: The findings.
        reason: The reason of the verdict; a message that it holds is not repeated.
        of: The subject, where there are several.
        most: How many are told; the rest is counted. None for all.
    """
    ordered = _ordered(items)
    new = [finding for finding in ordered if finding.message not in reason]
    later = [] if most is None else new[most:]
    shown = [finding for finding in ordered if finding not in later]
    # Findings with the same lines follow from one explanation.
    for setup, group in groupby(shown, key=lambda finding: finding.setup):
        together = list(group)
        for finding in together:
            if finding in new:
                name = f"{finding.severity.capitalize()}{of and f', {of}'}"
                text = below(advised(finding), together)
                yield Line(f"{name}: {text}.", TONES[finding.severity])
        if setup:
            yield Code("Lines for the setup file", yaml_text(setup))
        for figure in dict.fromkeys(filter(None, (f.figure for f in together))):
            yield Line(f"Shown by the figure '{figure}'.", "note", figure=figure)
    if later:
        more = counted(len(later), "more finding")
        yield note(f"{more}: see the page, or --details.")


def _ordered(items: Iterable[Finding]) -> list[Finding]:
    return sorted(items, key=lambda finding: [*TONES].index(finding.severity))


def below(text: str, items: Iterable[Finding]) -> str:
    """A text without the lines of findings, which stand below it."""
    for finding in items:
        if finding.setup:
            from calib_pin.validation.findings.sentences import written

            lines = f"state in the setup file: {written(finding.setup)}"
            text = text.replace(lines, "add the lines below to the setup file")
    return text


def advised(finding: Finding) -> str:
    """A finding's message and suggestion."""
    return "; ".join(filter(None, (finding.message, finding.remedy)))


def expected(result: CalibrationResult) -> Iterator[Block]:
    """The expected error of the tool point, at the measurements and elsewhere."""
    rows = list[tuple[Cell | str, ...]]()
    for chain, tool in result.accuracies.items():
        for place in PLACES:
            if (accuracy := getattr(tool, place)) is not None:
                of = f"{chain or 'robot'}, " if len(result.accuracies) > 1 else ""
                rows += _accuracy(of + place, accuracy)
    if not rows:
        return
    titles = ("nominal", "calibrated", "95 %", "unmodeled", UNIT, "better", "at")
    yield table("Expected tool-point error (rms)", ("", *titles), rows)
    yield note(
        "95 %: the calibrated robot stays below it in 95 of 100 cases. Unmodeled: the "
        "part that no parameter describes. Better: the probability that the calibrated "
        "robot is more accurate. At: the share of configurations where that "
        "probability is at least 95 %."
    )


def _accuracy(where: str, error: ExpectedAccuracy) -> Iterator[tuple[Cell | str, ...]]:
    shown = [Cell(percent(part), part) for part in (error.better, error.share)]
    stages = (error.nominal, error.calibrated, error.bound, error.unmodeled)
    for k, si in enumerate(("m", "rad")):
        if math.isfinite(error.nominal[k]):
            numbers = [_digits(stage[k], si) for stage in stages]
            yield where, *numbers, unit_of(si)[0], *shown
            where, shown = "", [Cell("")] * 2


def _digits(size: float | None, unit: str) -> Cell:
    """Two significant digits, a dash for what is not known."""
    if size is None or math.isnan(size):
        return Cell("-")
    return Cell(significant(unit_of(unit)[1] * size), size)


def noise(result: CalibrationResult) -> Iterator[Block]:
    """The noise of every quantity, stated or assumed and estimated."""
    rows = []
    for part in result.statistics.noise:
        sizes = part.given, part.estimate, *part.interval, part.pure, part.unmodeled
        given, *shown = (_digits(x, part.unit) for x in sizes)
        stated = "stated" if part.stated else "assumed"
        first = part.quantity, Cell(f"{given.text} {stated}", part.given)
        rows.append((*first, *shown, unit_of(part.unit)[0]))
    if rows:
        titles = ("given", "estimated", "from", "to", "repeats", "unmodeled", UNIT)
        title = "Noise (1 sigma of a component, with its 95 % interval)"
        yield table(title, ("", *titles), rows)
    for part in result.statistics.noise:
        if part.lack_of_fit is not None and part.lack_of_fit < 0.05:
            more = "configurations differ more than their repetitions"
            yield note(f"{part.quantity}: {more} (p = {part.lack_of_fit:.1g}).")


def statistics(result: CalibrationResult) -> Iterator[Block]:
    """Chi-square, and whether it confirms the standard deviations."""
    fit, setup = result.statistics, result.model.setup
    entries = [("chi-square", f"{number(fit.chi2)} with {fit.dof} dof")]
    if fit.dof > 0:
        low, high = map(number, chi2_interval(fit.dof))
        entries[0] = ("chi-square", f"{entries[0][1]} (95 %: {low} ... {high})")
        sigmas = "stated" if fit.stated_sigma else "assumed"
        entries.append(("sigma0", f"{number(fit.sigma0)} times the {sigmas} sigma"))
    if isinstance(setup.prior, PopulationPrior):
        entries.append(("prior", f"by {setup.prior.robots} robots of this type"))
    title = "Statistics of the parameters, before what is learned"
    yield Facts(title if setup.learned is not None else "Statistics", entries)
