"""Errors of every measurement, before and after, of fit and validation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

from calib_pin.measurement_models import Quantity
from calib_pin.report.figures.canvas import (
    BEFORE,
    INK,
    OF_STATIONS,
    STAGES,
    Drawn,
    key,
    log_axis,
    marks,
    panels,
    points,
    shortened,
    stations_of,
    thinned,
    thinning,
)
from calib_pin.report.tables import number, unit_of
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import CalibrationResult

LIMIT = 20_000
"""Measurements that are drawn at most."""

RING = marks(INK, "o", 10.0, hollow=True)

BEFORE_NAME, AFTER_NAME = STAGES


def errors_per_measurement(result: CalibrationResult) -> Drawn | None:
    """Sizes of the errors of every measurement: one row of panels per quantity."""
    outliers = [outlier.row for outlier in result.statistics.outliers]
    parts = [("fitted", result.fitted, outliers)]
    if result.held_out is not None:
        parts.append(("validation", result.held_out, []))
    quantities = [q for q in result.fitted.quantities if _means(result.fitted, q)]
    if not quantities:
        return None
    shape = len(quantities), len(parts)
    figure, places = panels(*shape, 1.65, top=0.65, gap=0.4, apart=0.55, sharey="row")
    notes: dict[str, None] = {}
    for row, quantity in zip(places, quantities, strict=True):
        unit, factor = unit_of(quantity.unit)
        sizes = [size for _, part, _ in parts for size in part.sizes(quantity)]
        row[0].set_ylabel(f"{quantity.name} error [{unit}]")
        if not log_axis(row[0], "y", *(factor * size for size in sizes)):
            row[0].set_yticks([])
        for axes, (name, part, rings) in zip(row, parts, strict=True):
            notes[_panel(axes, name, part, quantity, rings)] = None
    for axes in places[-1]:
        axes.set_xlabel("measurement")
    entries = {BEFORE_NAME: marks(BEFORE, "o", hollow=True)}
    entries |= {name: marks(color, "s") for name, color, _ in _after(result.fitted)}
    key(figure, {**entries, **({"outlier": RING} if outliers else {})})
    return Drawn(
        "errors-per-measurement",
        "Errors per measurement",
        " ".join([*_reading(result, quantities, parts), *filter(None, notes)]),
        figure,
    )


def _panel(
    axes: Axes,
    name: str,
    part: MeasurementErrors,
    quantity: Quantity,
    outliers: Sequence[int],
) -> str:
    """Errors before and after; what a log axis cannot show is put at its edge.

    Returns:
        A sentence where some are left out.
    """
    unit, factor = unit_of(quantity.unit)
    sizes = [factor * size for size in part.sizes(quantity)]
    chosen = thinned(len(part), LIMIT, sizes, outliers)
    low, high = axes.get_ylim()
    before, after = (
        np.where(np.isnan(s), s, np.clip(s, 1.06 * low, high / 1.06)) for s in sizes
    )
    width = float(np.clip(50.0 / np.sqrt(len(part)), 1.8, 4.5))
    points(axes, chosen + 1, before[chosen], marks(BEFORE, "o", width, hollow=True))
    for _, color, own in _after(part):
        shown = chosen[own[chosen]]
        points(axes, shown + 1, after[shown], marks(color, "s", width))
    rings = np.intersect1d(chosen, np.asarray(outliers, np.intp))
    points(axes, rings + 1, after[rings], {**RING, "markersize": width + 5.0})
    axes.locator_params(axis="x", nbins=6, integer=True)
    room = 0.02 * len(part) + 0.5
    axes.set_xlim(1 - room, len(part) + room)
    if means := _means(part, quantity):
        axes.set_title(f"{name}: mean {' → '.join(means)} {unit}")
    if note := thinning(len(chosen), len(part)):
        return f"{name.capitalize()}:{note}"
    return ""


def _means(part: MeasurementErrors, quantity: Quantity) -> list[str]:
    """Mean sizes before and after of what was not set aside, as far as there are."""
    factor, counted = unit_of(quantity.unit)[1], part.rows.weight > 0.0
    sizes = [size[~np.isnan(size) & counted] for size in part.sizes(quantity)]
    return [number(factor * float(s.mean())) for s in sizes] if len(sizes[0]) else []


def _after(part: MeasurementErrors) -> list[tuple[str, str, np.ndarray]]:
    """The errors after by station: name, color, and which they are, shape (N,)."""
    names, station = stations_of(part.rows)
    if len(names) < 2:
        return [(AFTER_NAME, STAGES[AFTER_NAME], station == 0)]
    return [
        (f"after, {shortened(name, 16)}", color, station == k)
        for k, (name, color) in enumerate(zip(names, OF_STATIONS, strict=False))
    ]


def _reading(
    result: CalibrationResult,
    quantities: Sequence[Quantity],
    parts: Sequence[tuple[str, MeasurementErrors, object]],
) -> Iterator[str]:
    (name, part, _), quantity = parts[-1], quantities[0]
    if means := _means(part, quantity):
        how = f" ({result.validation.method})" if len(parts) > 1 else ""
        yield (
            f"On {name} measurements{how} the mean {quantity.name} error goes from "
            f"{' to '.join(means)} {unit_of(quantity.unit)[0]}."
        )
    if len(parts) > 1:
        yield "Fitted and validation measurements should look alike."
    if result.statistics.outliers:
        yield f"Rings mark {len(result.statistics.outliers)} outliers."
    sizes = [size for q in quantities for _, p, _ in parts for size in p.sizes(q)]
    if any(np.isinf(size).any() for size in sizes):
        yield "Points at the upper edge are measurements that cannot be predicted."
