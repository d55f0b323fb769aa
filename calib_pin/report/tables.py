"""The tables of all reports: one builder for each, whoever shows them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from calib_pin.estimation.evidence import Outlier
from calib_pin.report.blocks import Cell, Column, Kind, Names, Table, columns
from calib_pin.units import DISPLAY
from calib_pin.validation.accuracy import Accuracy, QuantityErrors
from calib_pin.validation.result import (
    CalibrationResult,
    Candidate,
    CoupledGroup,
    FoundDistance,
    ModelSelection,
    ParameterEstimate,
)

ESTIMATE = ("value", "std. dev.", "unit")
"""Columns that can stand beside a parameter or a group."""

DECIMALS = 4
"""Decimals of an estimate without a standard deviation."""

SIZES = ("mean", "rms", "95 %", "max", "unit")
"""Columns of an accuracy."""

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


def quantity(value: float, unit: str) -> Cell:
    """A number in the unit in which people read it."""
    return Cell(number(DISPLAY[unit][1] * value), value)


def amount(value: float, unit: str) -> str:
    """A number and the unit in which people read it, such as `0.1200 mm`."""
    return f"{quantity(value, unit).text} {DISPLAY[unit][0]}"


def sizes(
    accuracy: Accuracy, unit: str, cell: Callable[[float, str], Cell] = quantity
) -> tuple[Cell, ...]:
    """The cells of `SIZES`, each by `cell`."""
    found = (accuracy.mean, accuracy.rms, accuracy.p95, accuracy.max)
    return (*(cell(value, unit) for value in found), Cell(DISPLAY[unit][0]))


def known(value: float, unit: str) -> Cell:
    """A number in the unit in which people read it, a dash for NaN."""
    return Cell("-") if math.isnan(value) else quantity(value, unit)


def accuracy_table(errors: Sequence[QuantityErrors], *, details: bool = True) -> Table:
    """Accuracy before and after, on fitted and on validation measurements.

    Args:
        errors: The accuracy by quantity.
        details: Also on fitted ones where there are validation measurements.
    """
    rows = []
    for error in errors:
        pairs = [("fitted", error.before, error.after)]
        if error.validation_before and error.validation_after:
            held_out = error.validation_before, error.validation_after
            pairs = [*pairs[: int(details)], ("validation", *held_out)]
        name = error.name
        for which, before, after in pairs:
            for robot, accuracy in (("nominal", before), ("calibrated", after)):
                words = (Cell(name), Cell(which), Cell(robot))
                rows.append((*words, *sizes(accuracy, error.unit)))
                name = which = ""
    return Table("Accuracy", columns("", ("measurements", "robot", *SIZES)), rows)


def distance_table(distances: Sequence[FoundDistance]) -> Table:
    """Known distances beside those of the nominal and of the calibrated robot."""
    rows = [
        (
            Cell(" - ".join(distance.between)),
            Cell("fitted" if distance.fitted else "validation"),
            *(
                Cell(f"{factor * value:.3f}", value)
                for value in (distance.value, distance.nominal, distance.found)
            ),
            Cell(unit),
        )
        for distance in distances
        for unit, factor in [DISPLAY[distance.unit]]
    ]
    titles = ("measurements", "known", "nominal", "calibrated", "unit")
    return Table("Known distances", columns("", titles), rows)


LADDER = "Model selection: mean errors on held-out measurements"


def ladder_table(ladder: ModelSelection) -> Table:
    """The candidates of model selection with their errors on held-out measurements.

    Near the fitted configurations, and in regions of joint space that were held out
    whole.
    """
    rungs = ladder.candidates
    quantities = [
        (name, unit) for name, unit, *_ in max((r.errors for r in rungs), key=len)
    ]
    far = any(rung.away for rung in rungs)
    rows = []
    for k, rung in enumerate(rungs):
        away = dict.fromkeys((name for name, _ in quantities), Cell("-"))
        near = dict(away)
        near |= {name: quantity(mean, unit) for name, unit, mean, _ in rung.errors}
        if rung.away is not None:
            away |= {e.name: quantity(e.mean, e.unit) for e in rung.away.errors}
        pairs = [(near[name], away[name]) if far else (near[name],) for name in near]
        cells = [cell for pair in pairs for cell in pair]
        remark = rung.reason or _remark(rung, kept=k == ladder.chosen)
        rows.append((Cell(rung.name), *cells, Cell(remark)))
    places = ("near", "away") if far else ("",)
    titles = [
        f"{name} {place} [{DISPLAY[unit][0]}]".replace("  ", " ")
        for name, unit in quantities
        for place in places
    ]
    return Table(
        f"{LADDER}, near the fitted configurations and away" if far else LADDER,
        columns("", (*titles, ""), {"": "remark"}),
        rows,
        emphasized=(ladder.chosen,),
    )


def _remark(rung: Candidate, *, kept: bool) -> str:
    if not rung.helps:
        return "no significant gain"
    return "selected" if kept else ""


def parameter_table(
    parameters: Sequence[ParameterEstimate], shown: Sequence[str] = ESTIMATE
) -> Table:
    """Identifiable parameters, with some of the columns `ESTIMATE`."""
    rows = [(Cell(p.name), *_estimate(p, shown)) for p in parameters]
    return Table("Identifiable parameters", columns("", shown), rows)


def group_table(
    groups: Sequence[CoupledGroup], shown: Sequence[str] = ESTIMATE
) -> Table:
    """Coupled groups as formulae: only these combinations can be estimated."""
    of = (Column("", "number"), *columns("combination" if shown else "", shown))
    return Table(
        "Identifiable linear combinations (coefficients in SI units)",
        of,
        [
            (Cell(str(g.number)), Cell(g.expression), *_estimate(g, shown))
            for g in groups
        ],
    )


def parameter_overview(
    parameters: Sequence[ParameterEstimate], unknown: Sequence[str] = ()
) -> Table:
    """All parameters with their estimates.

    A fixed or unobservable parameter has no value: that of the URDF holds. Neither has
    one of a frame or an instrument that is `unknown`.
    """
    rows = []
    for p in parameters:
        cells = list(_estimate(p, ESTIMATE))
        if p.status in ("fixed", "unidentifiable") or p.name in unknown:
            cells[0] = Cell("-")
        groups = ", ".join(map(str, p.groups))
        rows.append((Cell(p.name), *cells, Cell(STATUS[p.status]), Cell(groups)))
    titles = (*ESTIMATE, "status", "combinations")
    kinds: dict[str, Kind] = {"combinations": "word"}
    return Table("Parameters", columns("parameter", titles, kinds), rows)


def outlier_table(result: CalibrationResult, most: int) -> Table:
    """The worst outliers with their weights and errors."""
    found, errors = result.statistics.outliers, result.fitted
    kept = found[:most]
    cells = [outlier_cells(row) for row in kept]
    titles = ["normalized residual", "weight", "cause"]
    for of in errors.quantities:
        unit = DISPLAY[of.unit][0]
        titles += [f"{of.name}, nominal [{unit}]", f"calibrated [{unit}]"]
        for row, own in zip(kept, cells, strict=True):
            sizes = [float(stage[row.row]) for stage in errors.sizes(of)]
            own += [known(size, of.unit) for size in sizes]
    return Table("Outliers", columns("measurement", titles, {"cause": "remark"}), cells)


def outlier_cells(row: Outlier) -> list[Cell]:
    """Place, normalized residual, weight and cause of an outlier."""
    size, weight = Cell(f"{row.size:.1f}", row.size), significant(row.weight)
    return [Cell(row.place), size, Cell(weight, row.weight), Cell(row.cause)]


def _estimate(
    item: ParameterEstimate | CoupledGroup, shown: Sequence[str]
) -> Iterator[Cell]:
    """The cells of a parameter or a group, of the columns in `shown`."""
    unit, factor = DISPLAY.get(item.unit, (item.unit, 1.0))
    pair = uncertain(item.value, item.sigma, factor)
    cells = dict(zip(ESTIMATE, (*pair, Cell(unit)), strict=True))
    return (cells[column] for column in shown)


def uncertain(value: float, sigma: float | None, factor: float) -> tuple[Cell, Cell]:
    """A signed value and its standard deviation, both to the place that is known.

    They are in SI units, and shown times a factor.
    """
    deviation, places = Cell("-"), DECIMALS
    if sigma is not None:
        places = decimals(factor * sigma) if sigma else DECIMALS
        deviation = Cell(significant(factor * sigma), sigma)
    return Cell(_signed(factor * value, places), value), deviation


def _signed(value: float, places: int) -> str:
    """A number with a sign, but for zero, and so many decimals."""
    text = f"{round(value, places):+.{max(places, 0)}f}"
    return text if float(text) else text[1:]


def listed(meaning: str, names: Sequence[str]) -> Iterator[Names]:
    """Names under a heading, if there are any."""
    if names:
        yield Names(f"{meaning}:", tuple(_compressed(names)))


def _compressed(names: Sequence[str]) -> Iterator[str]:
    """Names with the components of one owner and kind on one line."""
    together: dict[str, list[str]] = {}
    for name in names:
        stem, component = name.rsplit(".", 1)
        together.setdefault(stem, []).append(component)
    for stem, components in together.items():
        yield f"{stem}.{'|'.join(components)}"
