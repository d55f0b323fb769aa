"""Errors and residuals of measurements: their sizes, their order, and each joint."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Quantity
from calib_pin.report.figures.canvas import (
    BEFORE,
    GROUPS,
    INK,
    MUTED,
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
from calib_pin.report.tables import number, significant, unit_of
from calib_pin.validation.result import (
    AXES,
    Accuracy,
    CalibrationResult,
    MeasurementErrors,
)

SHARE = 0.95
"""The share that is marked."""

STEPS = 300
"""Steps of a curve at most."""

COLUMNS = 2
"""Panels side by side at most."""


def cumulative_errors(result: CalibrationResult) -> Drawn | None:
    """Cumulative errors of the held-out measurements, of all where there are none."""
    rows = result.fitted if result.held_out is None else result.held_out
    counted = rows.rows.weight > 0.0
    entries = []
    for quantity in rows.quantities:
        unit, factor = unit_of(quantity.unit)
        stages = [size[counted & ~np.isnan(size)] for size in rows.sizes(quantity)]
        if all(np.isfinite(size).any() for size in stages):
            entries.append((quantity.name, unit, [np.sort(factor * s) for s in stages]))
    if not entries:
        return None
    lines, columns = math.ceil(len(entries) / COLUMNS), min(len(entries), COLUMNS)
    figure, places = panels(lines, columns, 2.2, right=0.35, top=0.68, apart=0.95)
    for axes in places.flat[len(entries) :]:
        axes.remove()
    shares = []
    for axes, (name, unit, sizes) in zip(places.flat, entries, strict=False):
        below = " → ".join(significant(Accuracy.of(size).p95) for size in sizes)
        axes.set_title(f"95 % below {below} {unit}")
        axes.set_xlabel(f"{name} error [{unit}]")
        _curves(axes, sizes)
        shares.append(f"{name} {below} {unit}")
    for axes in places[:, 0]:
        axes.set_ylabel("share of measurements [%]")
    key(figure, {name: {"color": c} for name, c in STAGES.items()})
    which = "fitted" if result.held_out is None else "held-out"
    return Drawn(
        "Share of measurements below an error",
        f"Each curve shows which part of the {len(rows)} {which} measurements has an "
        "error of at most the size on the axis: the further to the left, the more "
        f"accurate. 95 % lie below the dots: {', '.join(shares)}.",
        figure,
    )


def _curves(axes: Axes, stages: list[Floats]) -> None:
    """Both curves on a linear axis, which leaves out the few that are far off."""
    finite = [sizes[np.isfinite(sizes)] for sizes in stages]
    spread = max(float(np.quantile(sizes, SHARE)) for sizes in finite)
    high = min(1.05 * float(max(s[-1] for s in finite)), 1.6 * spread) or 1.0
    for sizes, known, color in zip(stages, finite, STAGES.values(), strict=True):
        steps = np.unique(np.linspace(0, len(known) - 1, STEPS).round().astype(int))
        across = np.concatenate([[0.0], known[steps], [max(high, known[-1])]])
        up = np.concatenate([[0], steps + 1, [len(known)]]) * 100.0 / len(sizes)
        axes.plot(across, up, color=color, drawstyle="steps-post", linewidth=1.6)
        p95 = Accuracy.of(sizes).p95
        if math.isfinite(p95):
            axes.plot([p95], [100.0 * SHARE], **marks(color, "o", 6.0))
            axes.vlines(p95, 0.0, 100.0 * SHARE, color=color, linestyle=":")
    axes.axhline(100.0 * SHARE, color=MUTED, linestyle="--", linewidth=0.9)
    axes.set(xlim=(0.0, high), ylim=(0.0, 102.0))
    axes.set_yticks([0, 25, 50, 75, 95], ["0", "25", "50", "75", "95"])
    axes.locator_params(axis="x", nbins=6)


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
    quantities = [q for q in result.fitted.quantities if _mean_sizes(result.fitted, q)]
    if not quantities:
        return None
    shape = len(quantities), len(parts)
    figure, places = panels(*shape, 1.65, top=0.65, gap=0.4, apart=0.55, sharey="row")
    notes = ["Sizes of the errors of every measurement, and their means."]
    if len(parts) > 1:
        notes.append("Fitted and validation measurements should look alike.")
    notes += [f"Rings mark {len(outliers)} outliers."] * bool(outliers)
    for row, quantity in zip(places, quantities, strict=True):
        unit, factor = unit_of(quantity.unit)
        sizes = [size for _, part, _ in parts for size in part.sizes(quantity)]
        row[0].set_ylabel(f"{quantity.name} error [{unit}]")
        if not log_axis(row[0], "y", *(factor * size for size in sizes)):
            row[0].set_yticks([])
        for axes, (name, part, rings) in zip(row, parts, strict=True):
            notes += _panel(axes, name, part, quantity, rings)
    for axes in places[-1]:
        axes.set_xlabel("measurement")
    entries = {BEFORE_NAME: marks(BEFORE, "o", hollow=True)}
    entries |= {name: marks(color, "s") for name, color, _ in _stations(result.fitted)}
    key(figure, {**entries, **({"outlier": RING} if outliers else {})})
    return Drawn("Errors per measurement", " ".join(dict.fromkeys(notes)), figure)


def _panel(
    axes: Axes,
    name: str,
    part: MeasurementErrors,
    quantity: Quantity,
    outliers: Sequence[int],
) -> Iterator[str]:
    """Draw errors; what a log axis cannot show is put at its edge, and told."""
    unit, factor = unit_of(quantity.unit)
    sizes = [factor * size for size in part.sizes(quantity)]
    chosen = thinned(len(part), LIMIT, sizes, outliers)
    low, high = axes.get_ylim()
    before, after = (
        np.where(np.isnan(s), s, np.clip(s, 1.06 * low, high / 1.06)) for s in sizes
    )
    width = float(np.clip(50.0 / np.sqrt(len(part)), 1.8, 4.5))
    points(axes, chosen + 1, before[chosen], marks(BEFORE, "o", width, hollow=True))
    for _, color, mask in _stations(part):
        shown = chosen[mask[chosen]]
        points(axes, shown + 1, after[shown], marks(color, "s", width))
    rings = np.intersect1d(chosen, np.asarray(outliers, np.intp))
    points(axes, rings + 1, after[rings], {**RING, "markersize": width + 5.0})
    axes.locator_params(axis="x", nbins=6, integer=True)
    room = 0.02 * len(part) + 0.5
    axes.set_xlim(1 - room, len(part) + room)
    if means := _mean_sizes(part, quantity):
        axes.set_title(f"{name}: mean {' → '.join(means)} {unit}")
    if np.isinf(sizes).any():
        yield "Points at the upper edge are measurements that cannot be predicted."
    if note := thinning(len(chosen), len(part)):
        yield f"{name.capitalize()}:{note}"


def _mean_sizes(part: MeasurementErrors, quantity: Quantity) -> list[str]:
    """Mean sizes before and after of what was not set aside, as far as there are."""
    factor, counted = unit_of(quantity.unit)[1], part.rows.weight > 0.0
    sizes = [size[~np.isnan(size) & counted] for size in part.sizes(quantity)]
    return [number(factor * float(s.mean())) for s in sizes] if len(sizes[0]) else []


def _stations(part: MeasurementErrors) -> list[tuple[str, str, np.ndarray]]:
    """The errors after by station: name, color, and which they are, shape (N,)."""
    names, station = stations_of(part.rows)
    several = [f"after, {shortened(name, 16)}" for name in names]
    labels = several if len(names) > 1 else [AFTER_NAME]
    pairs = enumerate(zip(labels, OF_STATIONS, strict=False))
    return [(label, color, station == k) for k, (label, color) in pairs]


FEW = 2000
"""Measurements that are drawn at most."""

FEWEST = 8
"""Measurements from which a course can be seen."""

PANEL = 1.25
"""Height of a panel [inch]."""

SIDE = 3
"""Panels of joints side by side."""

SMOOTH = 15
"""Parts of the measurements over which the mean is drawn."""


@dataclass(frozen=True)
class _Residuals:
    """Residuals of the first quantity of the fitted measurements.

    Attributes:
        values: In the unit that people read, shape (N, d); what lies beyond the limits
            is put at the edge.
        names: Names of the components.
        unit: Their unit.
        kept: The measurements that were not set aside, shape (N,).
        chosen: Positions of those that are drawn, shape (M,).
        edge: The largest of those that were not set aside, and some room.
    """

    values: Floats
    names: Sequence[str]
    unit: str
    kept: NDArray[np.bool_]
    chosen: NDArray[np.intp]
    edge: float

    @staticmethod
    def of(rows: MeasurementErrors) -> _Residuals | None:
        """Those of a calibration, if there are enough to see something."""
        quantity = rows.quantities[0]
        unit, factor = unit_of(quantity.unit)
        values = factor * rows.after[:, quantity.columns]
        known = np.asarray(np.isfinite(values).all(axis=1))
        if known.sum() < FEWEST:
            return None
        names = AXES[: values.shape[1]] if values.shape[1] > 1 else (quantity.name,)
        kept = known & (rows.rows.weight > 0.0)
        edge = 1.15 * float(np.abs(values[kept]).max(initial=1e-12))
        sizes = np.linalg.norm(np.where(known[:, None], values, np.nan), axis=1)
        chosen = thinned(len(rows), FEW, [sizes])
        shown = np.where(np.isfinite(values), np.clip(values, -edge, edge), np.nan)
        return _Residuals(shown, names, unit, kept, chosen, edge)

    def limit(self, axes: Axes) -> None:
        """Make an axis as high as what was not set aside."""
        axes.set_ylim(-1.02 * self.edge, 1.02 * self.edge)
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.yaxis.set_major_formatter("{x:g}")


def residuals_over_order(result: CalibrationResult) -> Drawn | None:
    """Residuals of the first quantity by their place in the files."""
    rows = result.fitted
    residuals = _Residuals.of(rows)
    if residuals is None:
        return None
    place = np.empty(len(rows))
    place[rows.rows.in_order] = np.arange(1, len(rows) + 1)
    groups, of = _groups(rows)
    figure, places = panels(
        len(residuals.names), 1, PANEL, left=0.85, apart=0.2, sharex=True
    )
    for k, (axes, name) in enumerate(zip(places.flat, residuals.names, strict=True)):
        for g, color in enumerate(OF_STATIONS[: len(groups)]):
            at = residuals.chosen[of[residuals.chosen] == g]
            points(axes, place[at], residuals.values[at, k], marks(color, "o", 2.8))
        order = rows.rows.in_order[residuals.kept[rows.rows.in_order]]
        if len(order) >= FEWEST:
            width = max(len(order) // SMOOTH, 3)
            x, mean = (
                np.convolve(v[order], np.full(width, 1.0 / width), "valid")
                for v in (place, residuals.values[:, k])
            )
            axes.plot(x, mean, color=INK, linewidth=1.0)
        residuals.limit(axes)
        axes.set_ylabel(f"{name} [{residuals.unit}]")
    places[-1, 0].set_xlabel("place in the files")
    entries = {
        shortened(g, 16): marks(color, "o")
        for g, color in zip(groups, OF_STATIONS, strict=False)
        if g
    }
    key(figure, {**entries, "moving mean": {"color": INK}})
    return Drawn(
        "Residuals over the order of the measurements",
        "Signed residuals of the fit by their place in the files. They should scatter "
        "about zero everywhere: a step is an instrument or a tool that moved, a slope "
        "is drift, single points at the edge are outliers."
        + thinning(len(residuals.chosen), len(rows)),
        figure,
    )


def residuals_by_joint(result: CalibrationResult) -> Drawn | None:
    """Residuals of the first quantity against the position of each joint."""
    rows, chains = result.fitted, result.model.chains
    residuals = _Residuals.of(rows)
    if residuals is None:
        return None
    lines, values = -(-len(chains.joints) // SIDE), residuals.values[residuals.chosen].T
    figure, places = panels(
        lines, SIDE, PANEL, left=0.85, top=0.65, gap=0.3, sharey=True
    )
    for axes in places.flat[len(chains.joints) :]:
        axes.remove()
    for j, (axes, joint) in enumerate(zip(places.flat, chains.joints, strict=False)):
        unit, factor = unit_of("rad" if chains.revolute[j] else "m")
        q = factor * rows.rows.q[residuals.chosen, j]
        for part, color in zip(values, GROUPS, strict=False):
            points(axes, q, part, marks(color, "o", 2.8))
        residuals.limit(axes)
        axes.set_title(shortened(joint, 19))
        axes.set_xlabel(f"position [{unit}]")
        if j % SIDE == 0:
            axes.set_ylabel(f"residual [{residuals.unit}]")
    colors = zip(residuals.names, GROUPS, strict=False)
    key(figure, {name: marks(color, "o") for name, color in colors})
    return Drawn(
        "Residuals by joint",
        "Signed residuals of the fit against the position of each joint. A slope or a "
        "wave along one joint is an error of its gear or its encoder; a joint whose "
        "points stand in a narrow band was hardly moved."
        + thinning(len(residuals.chosen), len(rows)),
        figure,
    )


def _groups(rows: MeasurementErrors) -> tuple[Sequence[str], NDArray[np.intp]]:
    """Names that colors tell apart, stations or else targets, and that of each row."""
    groups, of = stations_of(rows.rows)
    targets = rows.rows.target.distinct
    if len(groups) == 1 and 1 < len(targets) <= len(OF_STATIONS):
        places = {name: k for k, name in enumerate(targets)}
        of = np.array([places[name] for name in rows.rows.target], np.intp)
        groups = list(targets)
    return groups, of
