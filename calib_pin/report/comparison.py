"""The report of a comparison of two calibrations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import calib_pin.report.tables as tables
import calib_pin.validation.comparison as compared
from calib_pin.errors import counted
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.report.accuracy import chain_words, model_words
from calib_pin.report.blocks import Block, Cell, Facts, Line, Tone, note, table
from calib_pin.report.trust import below, findings, judged
from calib_pin.validation.result import CalibrationResult


def comparison_report(result: compared.Comparison) -> Iterator[Block]:
    """Whether the robot changed, where, by which parameters, and the doubts."""
    pair = {"A": result.first, "B": result.second}
    for label, record in pair.items():
        if record.verdict not in TRUSTED:
            reason = below(record.reason, record.findings)
            text = f"{label} ({record.provenance.file}): {reason}"
            yield judged(text, record.verdict)
    yield _verdict(result)
    yield from findings(compared.faults(result), "")
    for label, record in pair.items():
        yield from findings(record.findings, record.reason, label)
    yield from map(note, _doubts(result))
    origins = [(label, _origin(record)) for label, record in pair.items()]
    yield Facts(chain_words(result.first.model), origins)
    yield from _tip_differences(result)
    if result.same_nominal:
        yield from _parameter_changes(result)


def _verdict(result: compared.Comparison) -> Line:
    drift = result.drift
    apart = _size(result, drift.position.rms, drift.orientation.rms)
    if len(result.drifts) > 1:
        apart += f" at the tip of {result.chain}"
    if result.identical:
        return Line("No drift: both predict the same tool points.", "good")
    if drift.explained is None:
        text = f"The tool points are {apart} apart; how much of it is noise is unknown."
        return Line(text, "strong")
    tone: Tone = "good"
    text = "No drift beyond the noise of both: the tool points differ by"
    if result.drifted:
        text, tone = _cause(result), "bad"
    elif result.changed and result.described:
        text = "The robot changed, but not visibly at the tool point, which differs by"
        tone = "bad"
    noise = _size(result, *drift.explained)
    return Line(f"{text} {apart} where the noise of both explains {noise}.", tone)


def _cause(result: compared.Comparison) -> str:
    """The cause of a drift, as far as it is known."""
    trusted = {result.first.verdict, result.second.verdict} <= set(TRUSTED)
    if result.same_rows or not result.same_parameters or not trusted:
        return "The two disagree on the tool point, which differs by"
    other = "" if result.described else ", or was measured at other configurations"
    return f"The robot changed{other}: tool-point drift"


def _size(result: compared.Comparison, position: float, orientation: float) -> str:
    """A drift in words; an orientation only where it is known."""
    pairs = [(position, "m"), (orientation, "rad")][: 1 + result.drift.oriented]
    return " and ".join(tables.amount(*pair) for pair in pairs) + " rms"


def _doubts(result: compared.Comparison) -> Iterator[str]:
    """Other possible causes of the difference."""
    first, second = both = result.first, result.second
    noisy = result.drifted and result.same_parameters and not result.described
    if not result.same_nominal:
        yield "The nominal robots differ: only the tool points are compared."
    elif not result.same_parameters:
        yield "The errors are described by different parameters: so may the same robot."
    if compared.chained(first, second):
        yield "B began with A: the noise of both is not independent."
    if compared.shared_files(first, second):
        yield "They share a measurement file: their noise is not independent."
    elif noisy and None not in map(compared.stated_noise, both):
        yield (
            "Both fits contain errors that no parameter describes: measurements at the "
            "same configurations would settle it."
        )


def _origin(record: CalibrationResult) -> str:
    setup = record.model.setup
    kinds = " + ".join(filter(None, (*setup.parameters, setup.learned)))
    created, file = record.provenance.created, record.provenance.file
    how = f"{model_words(record.model)}, {counted(len(record.fitted), 'measurement')}"
    return f"{file}: {how}, {kinds}{created and f'; {created[:10]}'}"


def _tip_differences(result: compared.Comparison) -> Iterator[Block]:
    """The distance of the tool points, its maximum, and what is no drift."""
    rows, several = [], len(result.drifts) > 1
    for chain, drift in result.drifts.items():
        noise = drift.explained or (math.nan, math.nan)
        stages = [("position", "m", drift.position, noise[0])]
        stages += [("orientation", "rad", drift.orientation, noise[1])]
        for name, unit, accuracy, size in stages[: 1 + result.drift.oriented]:
            *cells, shown = tables.sizes(accuracy, unit)
            of = f"{chain or 'robot'}, {name}" if several else name
            rows.append((of, *cells, tables.quantity(size, unit), shown))
    title = "Tool-point difference over the workspace"
    yield table(title, ("", *tables.SIZES[:-1], "noise rms", tables.UNIT), rows)
    ends, reference = " and ".join(result.drift.absorbed), "Base and tool are known."
    if ends:
        reference = f"A displacement of {ends} between A and B is removed by a fit."
    count = len(result.drift.q)
    yield note(f"{count} random configurations within the joint limits. {reference}")
    if not result.identical:
        yield _farthest(result)


def _farthest(result: compared.Comparison) -> Facts:
    drift, chain = result.drift, result.first.model.of(result.chain).chain
    position = drift.farthest
    x, y, z = (f"{1e3 * value:.1f}" for value in drift.points[position])
    units = [tables.unit_of("rad" if turns else "m") for turns in chain.revolute]
    q = zip(drift.q[position], units, strict=True)
    angles = ", ".join(f"{factor * value:.1f} {unit}" for value, (unit, factor) in q)
    title = f"Largest difference: {tables.amount(drift.drift[position], 'm')}"
    place = f"at {x}, {y}, {z} mm in {chain.base}"
    return Facts(title, [("tool point", place), ("joints", f"at {angles}")])


def _parameter_changes(result: compared.Comparison) -> Iterator[Block]:
    """The differences beyond their uncertainty, and how many agree."""
    bound = f"{compared.BOUND:.0f} standard deviations"
    if result.moved:
        rows = []
        for moved in result.moved:
            *sizes, unit = tables.estimate(moved.change, moved.sigma, moved.unit)
            ratio = Cell(f"{moved.significance:.1f}", moved.significance)
            rows.append((moved.name, *sizes, ratio, unit))
        title = f"Parameters and combinations that differ by more than {bound}"
        titles = ("", "B - A", "std. dev.", "ratio", tables.UNIT)
        yield table(title, titles, rows)
    if not result.differences:
        yield note("No parameter or combination of the robot is identified by both.")
        return
    agree = [d for d in result.differences if d not in result.moved]
    yield note(
        f"Both identify {_numbers(result.differences)} of the robot; {_numbers(agree)} "
        f"agree within {bound} of the difference. By chance, one in 370 does not."
    )


def _numbers(differences: Sequence[compared.Difference]) -> str:
    sums = sum(bool(d.terms) for d in differences)
    alone = counted(len(differences) - sums, "parameter")
    return f"{alone} and {counted(sums, 'combination')}"
