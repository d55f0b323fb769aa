"""Points of the workspace from three sides, in the base link."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import WIDTH, inches, note, panel
from calib_pin.report.figures.strokes import dots

SIDES = ((0, 1), (0, 2), (1, 2))
"""Axes of the base link to the right and upwards, of every view."""

LEFT = 0.74
GAP = 0.68
RIGHT = 0.12

FOOT = 0.5
"""Height of the labels below a view [inch]."""

SCALE = 0.6
"""Height of a color scale with its labels [inch]."""

SMALLEST = 1.0
LARGEST = 2.4
"""Least and largest width or height of a view, where one scale allows it [inch]."""

MARGIN = 0.12
"""Room around the points, in parts of the largest extent."""

LEAST = 0.2
"""Least extent of the points [m]."""

COLORS = "viridis"

LEVELS = 24
"""Colors that are told apart."""

EDGE = "#808890"
"""Rim of colored points, seen on white and on black."""


@dataclass(frozen=True)
class Sides:
    """Three views of equal scale that have room for some points.

    Attributes:
        middle: Their middle in the base link, shape (3,) [m].
        spans: Extent of the views along its axes, shape (3,) [m].
        scale: Inches per meter.
    """

    middle: Floats
    spans: Floats
    scale: float

    @staticmethod
    def of(points: Floats) -> Sides:
        """Views of points in the base link, shape (N, 3) [m]."""
        low, high = points.min(axis=0), points.max(axis=0)
        extent = max(float((high - low).max()), LEAST)
        spans = high - low + 2.0 * MARGIN * extent
        room = WIDTH - LEFT - RIGHT - 2 * GAP
        for _ in range(2):  # What is widened to be readable leaves less for the others.
            across = sum(spans[right] for right, _ in SIDES)
            scale = min(room / across, LARGEST / max(spans[1], spans[2]))
            spans = np.maximum(spans, SMALLEST / scale)
        across = sum(spans[right] for right, _ in SIDES)
        scale = min(scale, room / across)
        return Sides((low + high) / 2.0, spans, float(scale))

    @property
    def height(self) -> float:
        """Height of the highest view [inch]."""
        return self.scale * float(max(self.spans[1], self.spans[2]))

    def axes(self, figure: Figure, top: float) -> list[Axes]:
        """The empty views, side by side, `top` inches below the edge of the figure."""
        views, left = [], LEFT
        for right, up in SIDES:
            width, height = (self.scale * float(self.spans[k]) for k in (right, up))
            axes = panel(figure, left, top + self.height - height, width, height)
            low, high = self.middle - self.spans / 2.0, self.middle + self.spans / 2.0
            axes.set(xlim=(low[right], high[right]), ylim=(low[up], high[up]))
            axes.locator_params(axis="x", nbins=max(2, int(width / 0.5)))
            axes.locator_params(axis="y", nbins=max(2, int(height / 0.5)))
            axes.set_xlabel(f"{'xyz'[right]} [m]")
            axes.set_ylabel(f"{'xyz'[up]} [m]", labelpad=1.0)
            views.append(axes)
            left += width + GAP
        return views


def colored(
    figure: Figure,
    top: float,
    sides: Sides,
    points: Floats,
    values: Floats,
    label: str,
) -> None:
    """Three views of points (N, 3) [m] colored by values (N,), and the color scale.

    Infinite values look like the largest; `top` is in inches.
    """
    low, high, clipped = _range(values)
    remark = ", more at the end" if clipped else ""
    shades = colormaps[COLORS](np.linspace(0.0, 1.0, LEVELS))
    part = (np.minimum(values, high) - low) / (high - low)
    level = np.rint(part * (LEVELS - 1)).astype(int)
    size = float(np.clip(60.0 / np.sqrt(len(points)), 2.5, 4.5))
    for axes, side in zip(sides.axes(figure, top), SIDES, strict=True):
        # The largest come last and hide the others.
        for k in np.unique(level):
            spots = points[level == k][:, side]
            for color, width in ((EDGE, size + 0.8), (to_hex(shades[k]), size)):
                axes.add_artist(dots(spots, color, width, sides.scale))
    color_bar(figure, top + sides.height + FOOT, (low, high), f"{label}{remark}")


def _range(values: Floats) -> tuple[float, float, bool]:
    """Ends of the color scale, and whether some values lie above it."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0, True
    low, high = float(finite.min()), float(np.quantile(finite, 0.98))
    # A few that stand out must not make all others look the same.
    if finite.max() < 1.5 * high:
        high = float(finite.max())
    clipped = bool(values.max() > high)
    return low, max(high, low * (1.0 + 1e-3), low + 1e-12), clipped


def color_bar(
    figure: Figure, top: float, ends: tuple[float, float], label: str
) -> None:
    """The shades with some numbers below and what they mean at the left."""
    left, width, height = WIDTH - 3.6, 3.3, 0.13
    low, high = ends
    bottom = figure.get_figheight() - top - 0.1 - height
    for k, shade in enumerate(colormaps[COLORS](np.linspace(0.0, 1.0, LEVELS))):
        place = (left + k * width / LEVELS, bottom)
        swatch = Rectangle(place, width / LEVELS, height, color=to_hex(shade))
        swatch.set(linewidth=0.3, transform=inches(figure))
        figure.add_artist(swatch)
    note(figure, left - 0.1, top + 0.1 + height / 2.0, label, ha="right", va="center")
    for value in MaxNLocator(4, steps=[1, 2, 5, 10]).tick_values(low, high):
        if low <= value <= high:
            at = left + (value - low) / (high - low) * width
            note(figure, at, top + 0.14 + height, f"{value:g}", ha="center", va="top")
