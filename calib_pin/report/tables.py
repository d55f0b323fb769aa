"""Numbers as people read them, and the rows and tables of all reports."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from calib_pin.report.blocks import Block, Cell, Names, Table, note, table
from calib_pin.units import DISPLAY
from calib_pin.validation.result import (
    Accuracy,
    CalibrationResult,
    DistanceCheck,
    ModelSelection,
    ParameterEstimate,
    QuantityErrors,
)

UNIT = "unit|word"

ESTIMATE = ("value", "std. dev.", UNIT)
"""Columns of `estimate`."""

SIZES = ("mean", "rms", "95 %", "max", UNIT)
"""Columns of `sizes`."""

DECIMALS = 4
"""Decimals of an estimate without a standard deviation."""

STATUS = {
    "identifiable": "identifiable",
    "coupled": "coupled",
    "weak": "weakly observable",
    "unidentifiable": "unobservable",
    "fixed": "fixed",
}
"""The words for a parameter's status, by its name in calibration.json."""


def number(value: float) -> str:
    """Four significant digits, plain where that is short."""
    if not math.isfinite(value):
        return "inf" if value > 0 else "unknown"
    size = abs(value)
    if size == 0.0 or 1e-3 <= size < 1.0:
        return f"{value:.4f}"
    if 1.0 <= size < 1e5:
        return f"{value:.{max(0, 3 - int(math.log10(size)))}f}"
    return f"{value:.1e}"


def significant(value: float, digits: int = 2) -> str:
    """A number with so many significant digits, by default a standard deviation's."""
    if not math.isfinite(value):
        return "inf" if value > 0 else "unknown"
    places = decimals(value, digits)
    return f"{round(value, places):.{max(places, 0)}f}"


def decimals(value: float, digits: int = 2) -> int:
    """Decimal places that show so many significant digits; fewer than none for tens.

    Examples:
        >>> decimals(0.0123), decimals(0.0996), decimals(1234.0), decimals(0.0)
        (3, 2, -2, 0)
    """
    if value == 0.0 or not math.isfinite(value):
        return 0
    # As it is when rounded: 0.0996 is 0.10.
    return digits - 1 - int(f"{abs(value):.{digits - 1}e}".partition("e")[2])


def unit_of(unit: str) -> tuple[str, float]:
    """Unit that people read, and the factor to it; an unknown one is left alone."""
    return DISPLAY.get(unit, (unit, 1.0))


def quantity(value: float, unit: str) -> Cell:
    """A number in the unit in which people read it, a dash for NaN."""
    if math.isnan(value):
        return Cell("-")
    return Cell(number(unit_of(unit)[1] * value), value)


def amount(value: float, unit: str) -> str:
    """A number and the unit in which people read it, such as `0.1200 mm`."""
    return f"{number(unit_of(unit)[1] * value)} {unit_of(unit)[0]}"


def measures(unit: str, *values: float) -> tuple[Cell, ...]:
    """Cells of some numbers of one unit, and that of the unit."""
    return (*(quantity(value, unit) for value in values), Cell(unit_of(unit)[0]))


def sizes(accuracy: Accuracy, unit: str) -> tuple[Cell, ...]:
    """The cells of `SIZES`."""
    return measures(unit, accuracy.mean, accuracy.rms, accuracy.p95, accuracy.max)


def estimate(value: float, sigma: float | None, unit: str) -> tuple[Cell, ...]:
    """The cells of `ESTIMATE`, both numbers to the place that is known."""
    shown, factor = unit_of(unit)
    deviation, places = Cell("-"), DECIMALS
    if sigma is not None:
        places = decimals(factor * sigma) if sigma else DECIMALS
        deviation = Cell(significant(factor * sigma), sigma)
    text = f"{round(factor * value, places):+.{max(places, 0)}f}"
    # Zero has no sign.
    return Cell(text if float(text) else text[1:], value), deviation, Cell(shown)


def percent(part: float) -> str:
    """Whole percents, but never all or nothing where it is not quite so."""
    if 0.0 < part < 0.01:
        return "< 1 %"
    if 0.99 < part < 1.0:
        return "> 99 %"
    return f"{100 * part:.0f} %"


def accuracy_table(errors: Sequence[QuantityErrors], *, details: bool = True) -> Table:
    """Accuracy before and after, on fitted and on validation measurements.

    Args:
        errors: The accuracy by quantity.
        details: Also on fitted ones where there are validation measurements.
    """
    rows = [
        (error.name, which, robot, *sizes(accuracy, error.unit))
        for error in errors
        for which, pair in [*error.stages.items()][0 if details else -1 :]
        for robot, accuracy in zip(("nominal", "calibrated"), pair, strict=True)
    ]
    titles = ("", "measurements|word", "robot|word", *SIZES)
    return table("Accuracy", titles, rows, grouped=2)


def distance_table(distances: Sequence[DistanceCheck]) -> Table:
    """Known distances beside those of the nominal and of the calibrated robot."""
    rows, (unit, factor) = [], DISPLAY["m"]
    for distance in distances:
        sizes = distance.value, distance.nominal, distance.found
        cells = [Cell(f"{factor * size:.3f}", size) for size in sizes]
        which = "fitted" if distance.fitted else "validation"
        rows.append((" - ".join(distance.between), which, *cells, unit))
    titles = ("", "measurements|word", "known", "nominal", "calibrated", UNIT)
    return table("Known distances", titles, rows)


LADDER = "Model selection: mean errors on held-out measurements"

WHERE = {
    "near": "near the fitted configurations",
    "away": "away from the fitted configurations",
    "both": "everywhere",
}
"""Meaning of each use of a model, see `ModelSelection.use`."""


def ladder(selection: ModelSelection) -> Iterator[Block]:
    """The candidates of model selection with their errors on held-out measurements.

    Near the fitted configurations, and in regions of joint space that were held out
    whole.
    """
    every, chosen = selection.candidates, selection.candidates[selection.chosen]
    rungs = [rung for rung in every if not rung.reason]
    far = any(rung.away for rung in rungs)
    places = ("near ", "away ") if far else ("",)
    columns = [
        (error.name, error.unit, k)
        for error in max((rung.errors for rung in every), key=len)
        for k in range(len(places))
    ]
    rows = []
    for rung in rungs:
        stages = rung.errors, rung.away.errors if rung.away else ()
        means = [{e.name: quantity(e.mean, e.unit) for e in s} for s in stages]
        cells = (means[k].get(name, "-") for name, _, k in columns)
        remark = "selected" * (rung is chosen) if rung.helps else "no significant gain"
        rows.append((rung.name, *cells, remark))
    titles = (f"{name} {places[k]}[{DISPLAY[unit][0]}]" for name, unit, k in columns)
    title = f"{LADDER}, near the fitted configurations and away" if far else LADDER
    marked = [k for k, rung in enumerate(rungs) if rung is chosen]
    yield table(title, ("", *titles, "|remark"), rows, marked)
    yield note(f"The model is for use {WHERE[selection.use]}.")
    for reason in dict.fromkeys(rung.reason for rung in every if rung.reason):
        names = ", ".join(rung.name for rung in every if rung.reason == reason)
        yield note(f"Not tried: {names}: {reason.rstrip('.')}.")


def parameter_overview(
    parameters: Sequence[ParameterEstimate], unknown: Sequence[str] = ()
) -> Table:
    """All parameters with their estimates.

    A fixed or unobservable parameter has no value: that of the URDF holds. Neither has
    one of a frame or an instrument that is `unknown`.
    """
    rows = []
    for p in parameters:
        value, *rest = estimate(p.value, p.sigma, p.unit)
        if p.status in ("fixed", "unidentifiable") or p.name in unknown:
            value = Cell("-")
        groups = ", ".join(map(str, p.groups))
        rows.append((p.name, value, *rest, STATUS[p.status], groups))
    titles = ("parameter", *ESTIMATE, "status|word", "combinations|word")
    return table("Parameters", titles, rows)


def outlier_table(result: CalibrationResult, most: int, *, errors: bool) -> Table:
    """The worst outliers with their weights and causes.

    Args:
        result: The calibration.
        most: How many are listed.
        errors: Also their errors before and after.
    """
    outliers, rows = result.statistics.outliers, result.fitted
    caused = any(outlier.cause for outlier in outliers)
    titles = ["measurement", "normalized residual", "weight"]
    titles += ["cause|remark"] * caused
    cells: list[list[Cell | str]] = []
    for outlier in outliers[:most]:
        size, weight = f"{outlier.size:.1f}", significant(outlier.weight)
        pair = Cell(size, outlier.size), Cell(weight, outlier.weight)
        cells.append([outlier.place, *pair, *[outlier.cause][:caused]])
    for of in rows.quantities if errors else ():
        titles += [f"{of.name}, nominal [{unit_of(of.unit)[0]}]"]
        titles += [f"calibrated [{unit_of(of.unit)[0]}]"]
        for outlier, row in zip(outliers, cells, strict=False):
            errors_of = (float(size[outlier.row]) for size in rows.sizes(of))
            row += measures(of.unit, *errors_of)[:2]
    return table(f"Outliers ({len(outliers)} of {len(rows)})", titles, cells)


def listed(meaning: str, names: Sequence[str]) -> Iterator[Names]:
    """Names under a heading, the components of one owner and kind on one line."""
    together: dict[str, list[str]] = {}
    for name in names:
        stem, component = name.rsplit(".", 1)
        together.setdefault(stem, []).append(component)
    if together:
        lines = (f"{stem}.{'|'.join(parts)}" for stem, parts in together.items())
        yield Names(f"{meaning}:", tuple(lines))
