"""Errors of every measurement, before and after, of fit and validation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    INK,
    OF_STATIONS,
    WIDTH,
    Drawn,
    key,
    marks,
    panels,
)
from calib_pin.report.figures.labels import (
    log_axis,
    log_limits,
    shortened,
    stations_of,
    unit_of,
)
from calib_pin.report.figures.strokes import Marks, thinned, thinning
from calib_pin.report.tables import number
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import CalibrationResult

LIMIT = 20_000
"""Measurements that are drawn at most."""

VECTORS = 500
"""Points of one kind that are drawn as paths of their own."""

HEAD = 0.65
"""Height of the key and the first title [inch]."""

ROW = 2.2
"""Height of panels with the title of those below [inch]."""

PANEL = 1.65
"""Height of a panel [inch]."""

FOOT = 0.1
"""Height of the labels below the last row, less a title [inch]."""

SIGNS: dict[str, dict[str, Any]] = {
    "before": marks(BEFORE, "o", hollow=True),
    "after": marks(AFTER, "s"),
}
"""Signs of the errors before and after."""

RING = marks(INK, "o", 10.0, hollow=True)


@dataclass(frozen=True)
class _Pane:
    """The errors of one quantity of the fitted or the validation measurements.

    Attributes:
        rows: `fitted` or `validation`.
        quantity: Name of the quantity.
        unit: Display unit.
        sizes: Sizes before and after in that unit, shape (N,) each; NaN for
            measurements that do not have it.
        counted: The measurements that were not set aside, shape (N,).
        drawn: Positions of those that are drawn, ascending, shape (M,).
        rings: Positions of the outliers among them, shape (K,).
        stations: Names of the stations that colors tell apart.
        station: The station of each measurement, shape (N,).
    """

    rows: str
    quantity: str
    unit: str
    sizes: tuple[Floats, Floats]
    counted: NDArray[np.bool_]
    drawn: NDArray[np.intp]
    rings: NDArray[np.intp]
    stations: Sequence[str]
    station: NDArray[np.intp]

    @property
    def means(self) -> list[float]:
        """Mean sizes before and after; empty where no measurement has the quantity."""
        sizes = [size[~np.isnan(size) & self.counted] for size in self.sizes]
        return [float(size.mean()) for size in sizes] if all(map(len, sizes)) else []


def errors_per_measurement(result: CalibrationResult) -> Drawn | None:
    """Sizes of the errors of every measurement: one row of panels per quantity."""
    parts = [
        _panes("fitted", result.fitted, [o.row for o in result.statistics.outliers])
    ]
    if result.held_out is not None:
        parts.append(_panes("validation", result.held_out, []))
    rows = [panes for panes in zip(*parts, strict=True) if panes[0].means]
    if not rows:
        return None
    figure = Figure(figsize=(WIDTH, HEAD + ROW * len(rows) + FOOT))
    entries = {
        "before (nominal robot)": SIGNS["before"],
        **{name: sign for name, sign, _ in _after(rows[0][0])},
    }
    key(
        figure,
        {**entries, **({"outlier": RING} if result.statistics.outliers else {})},
        0.7,
    )
    for k, panes in enumerate(rows):
        row = panels(figure, len(panes), HEAD + k * ROW, PANEL, right=0.3, gap=0.4)
        _scale(row, panes)
        for axes, pane in zip(row, panes, strict=True):
            _points(axes, pane)
            if panes is rows[-1]:
                axes.set_xlabel("measurement")
    return Drawn(
        "errors-per-measurement",
        "Errors per measurement",
        " ".join(_reading(result, rows)),
        figure,
    )


def _panes(name: str, rows: MeasurementErrors, outliers: Sequence[int]) -> list[_Pane]:
    """The panels of some measurements; of many, the most important ones are drawn."""
    sizes = [rows.sizes(quantity) for quantity in rows.quantities]
    drawn = thinned(
        len(rows), LIMIT, [size for pair in sizes for size in pair], outliers
    )
    rings = np.intersect1d(drawn, np.asarray(outliers, np.intp))
    stations = stations_of(rows.rows)
    panes = []
    for quantity, (before, after) in zip(rows.quantities, sizes, strict=True):
        unit, factor = unit_of(quantity.unit)
        shown = factor * before, factor * after
        counted = rows.rows.weight > 0.0
        of = name, quantity.name, unit
        panes.append(_Pane(*of, shown, counted, drawn, rings, *stations))
    return panes


def _scale(row: Sequence[Axes], panes: Sequence[_Pane]) -> None:
    """The same log axis for all panels of a quantity."""
    limits = log_limits(*(size for pane in panes for size in pane.sizes))
    for axes in row:
        if limits is None:
            axes.set_yticks([])
        else:
            log_axis(axes, "y", limits)
        axes.tick_params(labelleft=axes is row[0])
    row[0].set_ylabel(f"{panes[0].quantity} error [{panes[0].unit}]")


def _points(axes: Axes, pane: _Pane) -> None:
    """Errors before and after; those no log axis can show stand at its ends."""
    count = len(pane.sizes[0])
    width = float(np.clip(50.0 / np.sqrt(count), 1.8, 4.5))
    before = "before", SIGNS["before"], pane.drawn
    for stage, sign, drawn in (before, *_after(pane)):
        sizes = pane.sizes[0 if stage == "before" else 1]
        shown, style = sizes[drawn], {**sign, "markersize": width}
        inside = np.isfinite(shown) & (shown > 0.0)
        points = Marks(drawn[inside] + 1, shown[inside], **style, label=stage)
        points.set_rasterized(bool(inside.sum() > VECTORS))
        axes.add_line(points)
        _at_end(axes, drawn[np.isposinf(shown)] + 1, {**style, "marker": "^"}, 0.97)
        _at_end(axes, drawn[shown == 0.0] + 1, {**style, "marker": "v"}, 0.03)
    ringed = pane.sizes[1][pane.rings]
    inside = np.isfinite(ringed) & (ringed > 0.0)
    if inside.any():
        style = {**RING, "markersize": width + 5.0, "label": "outliers"}
        axes.plot(pane.rings[inside] + 1, ringed[inside], **style)
    axes.locator_params(axis="x", nbins=6, integer=True)
    room = 0.02 * count + 0.5
    axes.set_xlim(1 - room, count + room)
    if pane.means:
        means = " → ".join(map(number, pane.means))
        axes.set_title(f"{pane.rows}: mean {means} {pane.unit}")


def _after(pane: _Pane) -> list[tuple[str, dict[str, Any], NDArray[np.intp]]]:
    """The errors after by station: name, sign, and positions of those drawn."""
    if len(pane.stations) < 2:
        return [("after (calibrated)", SIGNS["after"], pane.drawn)]
    return [
        (
            f"after, {shortened(station, 16)}",
            {**SIGNS["after"], "color": color},
            pane.drawn[pane.station[pane.drawn] == k],
        )
        for k, (station, color) in enumerate(
            zip(pane.stations, OF_STATIONS, strict=False)
        )
    ]


def _at_end(
    axes: Axes, at: NDArray[np.intp], style: Mapping[str, Any], height: float
) -> None:
    """Marks at the upper or the lower end of the axis."""
    if len(at):
        axes.plot(
            *(at, np.full(len(at), height)),
            **style,
            transform=axes.get_xaxis_transform(),
            rasterized=len(at) > VECTORS,
        )


def _reading(
    result: CalibrationResult, rows: Sequence[Sequence[_Pane]]
) -> Iterator[str]:
    pane = rows[0][-1]
    if means := [number(mean) for mean in pane.means]:
        of = "fitted measurements"
        if pane.rows == "validation":
            of = f"validation measurements ({result.validation.method})"
        yield (
            f"On {of} the mean {pane.quantity} error goes from {means[0]} to "
            f"{means[1]} {pane.unit}."
        )
    if len(rows[0]) > 1:
        yield "Fitted and validation measurements should look alike."
    if result.statistics.outliers:
        yield f"Rings mark {len(result.statistics.outliers)} outliers."
    if any(np.isinf(size).any() for row in rows for p in row for size in p.sizes):
        yield "Triangles at the upper edge are measurements that cannot be predicted."
    for p in rows[0]:
        if note := thinning(len(p.drawn), len(p.sizes[0])):
            yield f"{p.rows.capitalize()}:{note}"
