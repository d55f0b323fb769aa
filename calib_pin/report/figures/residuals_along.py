"""Residuals along what may cause them: their place in the files, and each joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    GROUPS,
    INK,
    OF_STATIONS,
    WIDTH,
    Drawn,
    key,
    marks,
    panels,
)
from calib_pin.report.figures.labels import plain, shortened, stations_of, unit_of
from calib_pin.report.figures.strokes import Marks, thinned, thinning
from calib_pin.validation.measurement_errors import AXES, MeasurementErrors
from calib_pin.validation.result import CalibrationResult

LIMIT = 2000
"""Measurements that are drawn at most."""

VECTORS = 200
"""Points of one kind that are drawn as paths of their own."""

FEWEST = 8
"""Measurements from which a course can be seen."""

HEAD, PANEL, FOOT = 0.45, 1.25, 0.55
"""Heights of the key, of a panel, and of the labels below it [inch]."""

LEFT = 0.85
"""Room for the labels at the left [inch]."""

SIDE = 3
"""Panels of joints side by side."""

SMOOTH = 15
"""Parts of the measurements over which the mean is drawn."""


def residuals_over_order(result: CalibrationResult) -> Drawn | None:
    """Residuals of the first quantity by their place in the files."""
    rows = result.fitted
    found = _residuals(rows)
    if found is None:
        return None
    values, names, unit = found
    place = np.empty(len(rows))
    place[rows.rows.in_order] = np.arange(1, len(rows) + 1)
    groups, of = _groups(rows)
    count = len(names)
    figure = Figure(figsize=(WIDTH, HEAD + count * (PANEL + 0.2) + FOOT - 0.2))
    drawn = _drawn(rows, values)
    for k, name in enumerate(names):
        (axes,) = panels(figure, 1, HEAD + k * (PANEL + 0.2), PANEL, left=LEFT)
        for g, color in zip(range(len(groups)), OF_STATIONS, strict=False):
            own = drawn[of[drawn] == g]
            _points(axes, place[own], values[own, k], color)
        _course(axes, place, values[:, k], rows.rows.weight)
        _limit(axes, values, rows.rows.weight)
        axes.set_ylabel(f"{name} [{unit}]")
        axes.tick_params(labelbottom=k == count - 1)
    axes.set_xlabel("place in the files")
    colors = zip(groups, OF_STATIONS, strict=False)
    entries = {shortened(g, 16): marks(c, "o") for g, c in colors if g}
    key(figure, {**entries, "moving mean": {"color": INK}}, LEFT)
    return Drawn(
        "residuals-over-order",
        "Residuals over the order of the measurements",
        "Signed residuals of the fit by their place in the files. They should scatter "
        "about zero everywhere: a step is an instrument or a tool that moved, a slope "
        "is drift, single points at the edge are outliers."
        + thinning(len(drawn), len(rows)),
        figure,
    )


def residuals_by_joint(result: CalibrationResult) -> Drawn | None:
    """Residuals of the first quantity against the position of each joint."""
    rows = result.fitted
    found = _residuals(rows)
    if found is None:
        return None
    values, names, unit = found
    chains, q = result.model.chains, rows.rows.q
    lines = -(-len(chains.joints) // SIDE)
    apart = PANEL + FOOT + 0.15
    figure = Figure(figsize=(WIDTH, HEAD + 0.2 + lines * apart))
    drawn = _drawn(rows, values)
    for j, joint in enumerate(chains.joints):
        line, side = divmod(j, SIDE)
        top = HEAD + 0.2 + line * apart
        row = panels(figure, SIDE, top, PANEL, left=LEFT, gap=0.3)
        for other in row[:side] + row[side + 1 :]:
            other.remove()
        axes = row[side]
        shown, factor = unit_of("rad" if chains.revolute[j] else "m")
        for k, color in zip(range(len(names)), GROUPS, strict=False):
            _points(axes, factor * q[drawn, j], values[drawn, k], color)
        _limit(axes, values, rows.rows.weight)
        axes.set_title(shortened(joint, 19))
        axes.set_xlabel(f"position [{shown}]")
        axes.tick_params(labelleft=side == 0)
        if side == 0:
            axes.set_ylabel(f"residual [{unit}]")
    colors = zip(names, GROUPS, strict=False)
    key(figure, {name: marks(color, "o") for name, color in colors}, LEFT)
    return Drawn(
        "residuals-by-joint",
        "Residuals by joint",
        "Signed residuals of the fit against the position of each joint. A slope or a "
        "wave along one joint is an error of its gear or its encoder; a joint whose "
        "points stand in a narrow band was hardly moved."
        + thinning(len(drawn), len(rows)),
        figure,
    )


def _residuals(
    rows: MeasurementErrors,
) -> tuple[Floats, Sequence[str], str] | None:
    """Residuals of the first quantity (N, d), names of its components, their unit."""
    quantity = rows.quantities[0]
    unit, factor = unit_of(quantity.unit)
    values = factor * rows.after[:, quantity.columns]
    if np.isfinite(values).all(axis=1).sum() < FEWEST:
        return None
    names = AXES[: values.shape[1]] if values.shape[1] > 1 else (quantity.name,)
    return values, names, unit


def _groups(rows: MeasurementErrors) -> tuple[Sequence[str], NDArray[np.intp]]:
    """Names that colors tell apart, stations or else targets, and that of each row."""
    groups, of = stations_of(rows.rows)
    targets = rows.rows.target.distinct
    if len(groups) == 1 and 1 < len(targets) <= len(OF_STATIONS):
        places = {name: k for k, name in enumerate(targets)}
        of = np.array([places[name] for name in rows.rows.target], np.intp)
        groups = list(targets)
    return groups, of


def _drawn(rows: MeasurementErrors, values: Floats) -> NDArray[np.intp]:
    sizes = np.linalg.norm(np.where(np.isfinite(values), values, np.nan), axis=1)
    return thinned(len(rows), LIMIT, [sizes])


def _points(axes: Axes, x: Floats, y: Floats, color: str) -> None:
    known = np.isfinite(y)
    points = Marks(x[known], y[known], **marks(color, "o", 2.8))
    points.set_rasterized(bool(known.sum() > VECTORS))
    axes.add_line(points)


def _course(axes: Axes, place: Floats, y: Floats, weight: Floats) -> None:
    """The mean over a few neighbors that were not set aside."""
    order = np.argsort(place)
    order = order[np.isfinite(y[order]) & (weight[order] > 0.0)]
    width = max(len(order) // SMOOTH, 3)
    if len(order) >= FEWEST:
        kernel = np.full(width, 1.0 / width)
        x, mean = (np.convolve(v[order], kernel, "valid") for v in (place, y))
        axes.plot(x, mean, color=INK, linewidth=1.0)


def _limit(axes: Axes, values: Floats, weight: Floats) -> None:
    """The limits of what was fitted; what lies beyond is put at the edge."""
    kept = values[np.isfinite(values) & (weight > 0.0)[:, None]]
    edge = 1.15 * float(np.abs(kept).max(initial=1e-12))
    for line in axes.get_lines():
        line.set_ydata(np.clip(np.asarray(line.get_ydata(), float), -edge, edge))
    axes.set_ylim(-1.02 * edge, 1.02 * edge)
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axes.autoscale_view(scaley=False)
