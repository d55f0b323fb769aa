"""The report of a comparison of two calibrations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import calib_pin.report.tables as tables
import calib_pin.validation.comparison as compared
from calib_pin.errors import counted
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.report.accuracy import chain_words, model_words
from calib_pin.report.blocks import Block, Cell, Facts, Line, note, table
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
    yield from tip_differences(result)
    yield from parameter_changes(result)


def _verdict(result: compared.Comparison) -> Line:
    drift, where = result.drift, _worst_chain(result)
    apart = _size(result, drift.position.rms, drift.orientation.rms)
    if result.identical:
        return Line("No drift: both predict the same tool points.", "good")
    if drift.explained is None:
        return Line(
            f"The tool points{where} are {apart} rms apart; the files do not "
            "say how much of it is noise.",
            "strong",
        )
    noise = _size(result, *drift.explained)
    if result.drifted:
        beyond = f"{apart} rms{where} where the noise of both explains {noise}."
        return Line(f"{_cause(result)} {beyond}", "bad")
    within = f"{apart} rms{where} where noise explains {noise}."
    if result.changed and result.described:
        leading, name = result.differences[0], result.differences[0].name
        if leading.terms:
            name = f"a combination with {leading.terms[0].parameter}"
        far = tables.amount(leading.change, leading.unit)
        return Line(
            f"The robot changed, but not visibly at the tool point: {name} by {far}, "
            f"{leading.significance:.0f} standard deviations; the tool points differ "
            f"by {within}",
            "bad",
        )
    text = "No drift beyond the noise of both: the tool points differ by"
    return Line(f"{text} {within}", "good")


def _worst_chain(result: compared.Comparison) -> str:
    """Of several chains the one that drifted most."""
    return f" at the tip of {result.chain}" if len(result.drifts) > 1 else ""


def _cause(result: compared.Comparison) -> str:
    """The cause of a drift, as far as it is known."""
    trusted = {result.first.verdict, result.second.verdict} <= set(TRUSTED)
    if result.same_rows or not result.same_parameters or not trusted:
        return "The two disagree on the tool point, which differs by"
    other = "" if result.described else ", or was measured at other configurations"
    return f"The robot changed{other}: tool-point drift"


def _size(result: compared.Comparison, position: float, orientation: float) -> str:
    """A drift in words; an orientation only where it is known."""
    pairs = [(position, "m"), (orientation, "rad")][: 2 if result.drift.oriented else 1]
    return " and ".join(tables.amount(*pair) for pair in pairs)


def _doubts(result: compared.Comparison) -> Iterator[str]:
    """Other possible causes of the difference."""
    first, second = both = result.first, result.second
    noisy = result.drifted and result.same_parameters and not result.described
    known = None not in map(compared.stated_noise, both)
    if not result.same_nominal:
        yield (
            "The nominal robots differ: only the tool points are compared, not the "
            "parameters, which refer to different robots."
        )
    if result.same_rows:
        changed = ": not the robot but the fit changed, and their noise is not "
        how = " in the same way" if result.identical else f"{changed}independent"
        yield f"Both fit the same measurements{how}."
        return
    if result.same_nominal and not result.same_parameters:
        yield (
            "The errors are described by different parameters, which can cause a "
            "difference without any change of the robot."
        )
    if compared.chained(first, second):
        yield (
            "B began with A: it tells what the new measurements have changed, and the "
            "noise of both is not independent."
        )
    if compared.shared_files(first, second):
        yield "They share a measurement file: their noise is not independent."
    elif noisy and known:
        yield (
            "Both fits contain errors that no parameter describes, which differ from "
            "configuration to configuration: measurements at the same configurations "
            "would settle it."
        )


def _origin(record: CalibrationResult) -> str:
    setup = record.model.setup
    kinds = " + ".join(filter(None, (*setup.parameters, setup.learned)))
    created, file = record.provenance.created, record.provenance.file
    how = f"{model_words(record.model)}, {counted(len(record.fitted), 'measurement')}"
    return f"{file}: {how}, {kinds}{created and f'; {created[:10]}'}"


def tip_differences(result: compared.Comparison) -> Iterator[Block]:
    """The distance of the tool points, its maximum, and what is no drift."""
    rows = []
    for chain, drift in result.drifts.items():
        noise = drift.explained or (math.nan, math.nan)
        of = f"{chain or 'robot'}, " if len(result.drifts) > 1 else ""
        stages = [("position", "m", drift.position, noise[0])]
        if result.drift.oriented:
            stages.append(("orientation", "rad", drift.orientation, noise[1]))
        for name, unit, accuracy, size in stages:
            *cells, shown = tables.sizes(accuracy, unit)
            rows.append((of + name, *cells, tables.quantity(size, unit), shown))
    title = "Tool-point difference over the workspace"
    yield table(title, ("", *tables.SIZES[:-1], "noise rms", tables.UNIT), rows)
    yield note(" ".join(_reference_notes(result)))
    if not result.identical:
        yield _farthest(result)


def _reference_notes(result: compared.Comparison) -> Iterator[str]:
    """Sentences on what the differences refer to."""
    absorbed = result.drift.absorbed
    yield f"{len(result.drift.q)} random configurations within the joint limits."
    of = f"A displacement of {' and '.join(absorbed)} between A and B is removed by a "
    yield f"{of}fit: it is no drift." if absorbed else "Base and tool are known."
    if not result.drift.oriented:
        yield "The measurements contain no orientations."
    if result.drift.explained is None:
        return
    ends = "" if len(absorbed) == 2 else ", base and tool included"
    yield f"The noise is that of both calibrations{ends}."
    if result.first.identifiability.weak or result.second.identifiability.weak:
        yield "It excludes weakly observable directions, which were held at nominal."


def _farthest(result: compared.Comparison) -> Facts:
    drift, chain = result.drift, result.first.model.of(result.chain).chain
    position = drift.farthest
    x, y, z = (f"{1e3 * value:.1f}" for value in drift.points[position])
    units = [tables.unit_of("rad" if turns else "m") for turns in chain.revolute]
    q = zip(drift.q[position], units, strict=True)
    angles = ", ".join(f"{factor * value:.1f} {unit}" for value, (unit, factor) in q)
    largest = tables.amount(drift.drift[position], "m")
    facts = {"tool point": f"at {x}, {y}, {z} mm in {chain.base}"}
    facts["joints"] = f"at {angles}"
    return Facts(
        f"Largest difference{_worst_chain(result)}: {largest}", [*facts.items()]
    )


def parameter_changes(result: compared.Comparison) -> Iterator[Block]:
    """The differences beyond their uncertainty."""
    if not result.same_nominal:
        return
    if result.moved:
        rows = []
        for moved in result.moved:
            *sizes, unit = tables.estimate(moved.change, moved.sigma, moved.unit)
            ratio = Cell(f"{moved.significance:.1f}", moved.significance)
            rows.append((moved.name, *sizes, ratio, unit))
        title = "Parameters and combinations that differ by more than "
        title += f"{compared.BOUND:.0f} standard deviations"
        titles = ("", "B - A", "std. dev.", "ratio", tables.UNIT)
        yield table(title, titles, rows)
    yield note(" ".join(_agreement(result)))


def _agreement(result: compared.Comparison) -> Iterator[str]:
    """Sentences on how many agree, and what is not compared."""
    if result.differences:
        agree = [d for d in result.differences if d not in result.moved]
        yield (
            f"Both identify {_numbers(result.differences)} of the robot; "
            f"{_numbers(agree)} agree within {compared.BOUND:.0f} standard deviations "
            "of the difference. By chance, one in 370 does not."
        )
    else:
        yield "No parameter and no combination of the robot is identified by both."
    if result.moved and result.drifted is False:
        yield "The differences move the tool point by no more than noise does."
    both = result.first, result.second
    if any(len(record.groups) > len(compared.robot_groups(record)) for record in both):
        yield "Combinations with terms of base, tool or instrument are left out."


def _numbers(differences: Sequence[compared.Difference]) -> str:
    sums = sum(bool(d.terms) for d in differences)
    alone = counted(len(differences) - sums, "parameter")
    return f"{alone} and {counted(sums, 'combination')}"
