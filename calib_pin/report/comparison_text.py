"""The report of a comparison of two calibrations."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.report.accuracy import chain_words, judged
from calib_pin.report.blocks import Block, Facts, Line
from calib_pin.report.comparison_tables import (
    accuracies,
    parameter_changes,
    tip_differences,
)
from calib_pin.report.tables import amount, number
from calib_pin.units import DISPLAY
from calib_pin.validation.comparison import Comparison, stated_noise
from calib_pin.validation.result import CalibrationResult


def comparison_report(found: Comparison) -> Iterator[Block]:
    """Whether the robot changed, where, by which parameters, and the doubts."""
    pair = (("A", found.first), ("B", found.second))
    for label, record in pair:
        if record.verdict not in TRUSTED:
            said = f"{label} ({record.provenance.file}): {record.reason}"
            yield judged(said, record.verdict)
    yield _verdict(found)
    yield from _doubts(found)
    yield Facts(
        chain_words(found.first.model.chain),
        [(label, _origin(record)) for label, record in pair],
    )
    yield from tip_differences(found)
    yield from parameter_changes(found)
    yield from accuracies(found)


def _verdict(found: Comparison) -> Line:
    drift = found.drift
    apart = _size(found, drift.position.rms, drift.orientation.rms)
    if found.identical:
        return Line("No drift: both predict the same tool points.", "good")
    if found.explained is None:
        return Line(
            f"The tool points are {apart} rms apart; the files do not say how much of "
            "it is noise.",
            "strong",
        )
    noise = _size(found, *found.explained)
    if found.drifted:
        beyond = f"{apart} rms where the noise of both explains {noise}."
        return Line(f"{_cause(found)} {beyond}", "bad")
    within = f"{apart} rms where noise explains {noise}."
    if found.changed and found.described:
        said = f"The robot changed, but not visibly at the tool point: {_first(found)};"
        return Line(f"{said} the tool points differ by {within}", "bad")
    said = "No drift beyond the noise of both: the tool points differ by"
    return Line(f"{said} {within}", "good")


def _cause(found: Comparison) -> str:
    """The cause of a drift, as far as it is known."""
    trusted = {found.first.verdict, found.second.verdict} <= set(TRUSTED)
    if found.same_rows or not found.same_parameters or not trusted:
        return "The two disagree on the tool point, which differs by"
    if not found.described:
        return (
            "The robot changed, or was measured at other configurations: tool-point "
            "drift"
        )
    return "The robot changed: tool-point drift"


def _first(found: Comparison) -> str:
    """The most significant difference in words."""
    leading = found.differences[0]
    name = leading.name
    if leading.terms:
        name = f"a combination with {leading.terms[0][0]}"
    unit, factor = DISPLAY.get(leading.unit, (leading.unit, 1.0))
    return (
        f"{name} by {number(factor * leading.change)} {unit}, "
        f"{leading.significance:.0f} standard deviations"
    )


def _size(found: Comparison, position: float, orientation: float) -> str:
    """A drift in words; an orientation only where it is known."""
    pairs = [(position, "m"), (orientation, "rad")][: 2 if found.oriented else 1]
    return " and ".join(amount(*pair) for pair in pairs)


def _doubts(found: Comparison) -> Iterator[Line]:
    """Other possible causes of the difference."""
    if not found.same_nominal:
        yield Line(
            "The nominal robots differ: only the tool points are compared, not the "
            "parameters, which refer to different robots.",
            "note",
        )
    if found.same_rows and found.identical:
        yield Line("Both fit the same measurements in the same way.", "note")
        return
    if found.same_rows:
        yield Line(
            "Both fit the same measurements: not the robot but the fit changed, and "
            "their noise is not independent.",
            "note",
        )
        return
    if found.same_nominal and not found.same_parameters:
        yield Line(
            "The errors are described by different parameters, which can cause a "
            "difference without any change of the robot.",
            "note",
        )
    if found.shared_rows:
        yield Line(
            "They share a measurement file: their noise is not independent.", "note"
        )
    elif (
        found.drifted
        and found.same_parameters
        and None not in (stated_noise(found.first), stated_noise(found.second))
        and not found.described
    ):
        yield Line(
            "Both fits contain errors that no parameter describes, which differ from "
            "configuration to configuration: measurements at the same configurations "
            "would settle it.",
            "note",
        )


def _origin(record: CalibrationResult) -> str:
    setup = record.model.setup
    kinds = [*setup.parameters, *([setup.learned] if setup.learned else [])]
    created, file = record.provenance.created, record.provenance.file
    day = f"; {created[:10]}" if created else ""
    return (
        f"{file}: {record.model.measurement.name}, {len(record.fitted)} measurements, "
        f"{' + '.join(kinds)}{day}"
    )
