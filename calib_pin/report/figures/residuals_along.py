"""Residuals along what may cause them: their place in the files, and each joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    GROUPS,
    INK,
    OF_STATIONS,
    Drawn,
    key,
    marks,
    panels,
    points,
    shortened,
    stations_of,
    thinned,
    thinning,
)
from calib_pin.report.tables import unit_of
from calib_pin.validation.measurement_errors import AXES, MeasurementErrors
from calib_pin.validation.result import CalibrationResult

LIMIT = 2000
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
        chosen = thinned(len(rows), LIMIT, [sizes])
        shown = np.where(np.isfinite(values), np.clip(values, -edge, edge), np.nan)
        return _Residuals(shown, names, unit, kept, chosen, edge)

    def limit(self, axes: Axes) -> None:
        """Make an axis as high as what was not set aside."""
        axes.set_ylim(-1.02 * self.edge, 1.02 * self.edge)
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))


def residuals_over_order(result: CalibrationResult) -> Drawn | None:
    """Residuals of the first quantity by their place in the files."""
    rows = result.fitted
    found = _Residuals.of(rows)
    if found is None:
        return None
    place = np.empty(len(rows))
    place[rows.rows.in_order] = np.arange(1, len(rows) + 1)
    groups, of = _groups(rows)
    figure, places = panels(
        len(found.names), 1, PANEL, left=0.85, apart=0.2, sharex=True
    )
    for k, (axes, name) in enumerate(zip(places.flat, found.names, strict=True)):
        for g, color in enumerate(OF_STATIONS[: len(groups)]):
            own = found.chosen[of[found.chosen] == g]
            points(axes, place[own], found.values[own, k], marks(color, "o", 2.8))
        order = rows.rows.in_order[found.kept[rows.rows.in_order]]
        if len(order) >= FEWEST:
            width = max(len(order) // SMOOTH, 3)
            x, mean = (
                np.convolve(v[order], np.full(width, 1.0 / width), "valid")
                for v in (place, found.values[:, k])
            )
            axes.plot(x, mean, color=INK, linewidth=1.0)
        found.limit(axes)
        axes.set_ylabel(f"{name} [{found.unit}]")
    places[-1, 0].set_xlabel("place in the files")
    entries = {
        shortened(g, 16): marks(color, "o")
        for g, color in zip(groups, OF_STATIONS, strict=False)
        if g
    }
    key(figure, {**entries, "moving mean": {"color": INK}})
    return Drawn(
        "residuals-over-order",
        "Residuals over the order of the measurements",
        "Signed residuals of the fit by their place in the files. They should scatter "
        "about zero everywhere: a step is an instrument or a tool that moved, a slope "
        "is drift, single points at the edge are outliers."
        + thinning(len(found.chosen), len(rows)),
        figure,
    )


def residuals_by_joint(result: CalibrationResult) -> Drawn | None:
    """Residuals of the first quantity against the position of each joint."""
    rows, chains = result.fitted, result.model.chains
    found = _Residuals.of(rows)
    if found is None:
        return None
    lines = -(-len(chains.joints) // SIDE)
    figure, places = panels(
        lines, SIDE, PANEL, left=0.85, top=0.65, gap=0.3, sharey=True
    )
    for axes in places.flat[len(chains.joints) :]:
        axes.remove()
    for j, (axes, joint) in enumerate(zip(places.flat, chains.joints, strict=False)):
        unit, factor = unit_of("rad" if chains.revolute[j] else "m")
        q = factor * rows.rows.q[found.chosen, j]
        for k, color in enumerate(GROUPS[: len(found.names)]):
            points(axes, q, found.values[found.chosen, k], marks(color, "o", 2.8))
        found.limit(axes)
        axes.set_title(shortened(joint, 19))
        axes.set_xlabel(f"position [{unit}]")
        if j % SIDE == 0:
            axes.set_ylabel(f"residual [{found.unit}]")
    colors = zip(found.names, GROUPS, strict=False)
    key(figure, {name: marks(color, "o") for name, color in colors})
    return Drawn(
        "residuals-by-joint",
        "Residuals by joint",
        "Signed residuals of the fit against the position of each joint. A slope or a "
        "wave along one joint is an error of its gear or its encoder; a joint whose "
        "points stand in a narrow band was hardly moved."
        + thinning(len(found.chosen), len(rows)),
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
