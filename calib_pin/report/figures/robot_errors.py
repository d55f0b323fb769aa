"""The robot in three dimensions, with its errors before and after beside each other.

Triangles and balls are drawn as an image, the farthest first. Text, ground and color
scale are lines and letters like in all figures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from calib_pin.kinematics.shapes import Shape
from calib_pin.kinematics.skeleton import base_poses, drawn_link
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.stand_ins import stand_ins
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    GRID,
    MUTED,
    WIDTH,
    Drawn,
    note,
    panel,
)
from calib_pin.report.figures.labels import unit_of
from calib_pin.report.figures.robot_scene import (
    Scene,
    View,
    best_view,
    draw,
    scene_of,
)
from calib_pin.report.figures.strokes import thinned, thinning
from calib_pin.report.figures.views import COLORS, LEVELS, color_bar
from calib_pin.report.tables import significant
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import CalibrationResult

POINTS = 700
"""Points that are drawn at most: more hide each other and the robot."""

LEFT, GAP, TITLE, FOOT = 0.1, 0.2, 0.35, 0.62
"""Margins, and room above and below both images [inch]."""

DENSITY = 200
"""Pixels of the image [1/inch]."""

ROOM = (WIDTH - 2 * LEFT - GAP) / 2.0, 3.3
"""Width and height of an image at most [inch]."""


BESIDE = 17.0
"""Distance of the names of axes from the last line of the grid [px]."""

TRIANGLES = 1_500_000
"""Triangles of a robot that are drawn in a few seconds; few robots have as many."""

SMALLEST, LARGEST = 0.006, 0.013
"""Radius of balls by the extent of the scene."""


class Measured(NamedTuple):
    """The points to be drawn.

    Attributes:
        points: Tool points in the drawn link, shape (N, 3) [m].
        before: Sizes of the errors of the nominal robot, shape (N,).
        after: Those of the calibrated one, shape (N,).
        unit: Unit of both.
        name: What they are errors of.
    """

    points: Floats
    before: Floats
    after: Floats
    unit: str
    name: str


def robot_errors(
    result: CalibrationResult, shapes: Sequence[Shape] = ()
) -> Drawn | None:
    """Tool points colored by their errors before and after, around the robot.

    Args:
        result: The result.
        shapes: Shapes of the robot's links; simple solids where there are none, or
            where these would take too long to draw.
    """
    measured = _measured(result)
    if measured is None or not len(measured.points):
        return None
    links = list(shapes)
    if not 0 < sum(len(shape.surface.triangles) for shape in links) <= TRIANGLES:
        links = stand_ins(result.model.chains.robot)
    scene = scene_of(result, links, measured.points)
    sizes = [measured.before, measured.after]
    chosen = thinned(len(measured.points), POINTS, sizes)
    points = measured.points[chosen]
    radius = scene.extent * _size(points / scene.extent)
    view = best_view(scene, points, radius, DENSITY * np.array(ROOM))
    width, height = (k / DENSITY for k in view.size)
    figure = Figure(figsize=(WIDTH, TITLE + height + FOOT))
    unit, factor = unit_of(measured.unit)
    high = _top(np.concatenate(sizes)) * factor
    shades = colormaps[COLORS](np.linspace(0.0, 1.0, LEVELS))[:, :3]
    *means, said = _means(result, measured)
    stages = (("before", BEFORE, sizes[0]), ("after", AFTER, sizes[1]))
    for k, (name, color, errors) in enumerate(stages):
        left = LEFT + k * (ROOM[0] + GAP) + 0.5 * (ROOM[0] - width)
        axes = panel(figure, left, TITLE, width, height)
        _ground(axes, view, scene)
        level = np.minimum(factor * errors[chosen] / high, 1.0) * (LEVELS - 1)
        level = np.where(np.isfinite(level), level, LEVELS - 1).round().astype(int)
        draw(axes, view, scene, points, radius, shades[level])
        axes.set(xlim=(0, view.size[0]), ylim=(view.size[1], 0))
        axes.set_axis_off()
        label = f"{name}: {significant(factor * means[k])} {unit} {said}"
        middle = LEFT + k * (ROOM[0] + GAP) + 0.5 * ROOM[0]
        note(figure, middle, 0.2, label, ha="center", va="center", color=color)
    clipped = (
        ", more at the end" if factor * np.max(np.concatenate(sizes)) > high else ""
    )
    top = TITLE + height + 0.02
    color_bar(figure, top, (0.0, high), f"{measured.name} error [{unit}]{clipped}")
    return Drawn(
        "robot-errors",
        "Errors of the robot before and after calibration",
        f"Every ball is a measured tool point; its color is the {measured.name} error "
        "there, on one scale for both. A ball behind the robot shines through. "
        "The robot stands as in one of the measurements."
        + thinning(len(chosen), len(measured.points)),
        figure,
    )


def _measured(result: CalibrationResult) -> Measured | None:
    """Tool points and sizes of errors of all measurements, fitted and held out.

    Lengths come before all other quantities; None where nothing is known.
    """
    parts = [part for part in (result.fitted, result.held_out) if part is not None]
    units = {q.unit for q in result.fitted.quantities}
    unit = "m" if "m" in units else next(iter(sorted(units)), "")
    names = [q.name for q in result.fitted.quantities if q.unit == unit]
    link = drawn_link(result.model.chains)
    found = []
    for part in parts:
        sizes = [part.sizes(q) for q in part.quantities if q.unit == unit]
        if not sizes:
            continue
        before, after = (_first([pair[k] for pair in sizes]) for k in (0, 1))
        usable = np.isfinite(part.points).all(axis=1) & ~np.isnan(before)
        usable &= np.isfinite(after)
        points = _in_link(result, part, link)
        found.append((points[usable], before[usable], after[usable]))
    if not found:
        return None
    points, before, after = (
        np.concatenate(parts) for parts in zip(*found, strict=True)
    )
    name = names[0] if len(names) == 1 else "length"
    return Measured(points, before, after, unit, name)


def _size(points: Floats) -> float:
    """Radius of balls at points (N, 3), both by the extent of the scene."""
    apart = len(np.unique(np.round(points / LARGEST), axis=0))
    return float(np.clip(0.17 / math.sqrt(apart), SMALLEST, LARGEST))


def _means(result: CalibrationResult, measured: Measured) -> tuple[float, float, str]:
    """Mean errors before and after, those of the report, and what they are means of."""
    for stated in result.errors:
        if stated.name == measured.name and stated.validation_after is not None:
            first = stated.validation_before or stated.before
            return first.mean, stated.validation_after.mean, "on average"
        if stated.name == measured.name:
            return stated.before.mean, stated.after.mean, "where fitted"
    before, after = (
        float(np.mean(sizes[np.isfinite(sizes)]))
        if np.isfinite(sizes).any()
        else math.inf
        for sizes in (measured.before, measured.after)
    )
    return before, after, "on average"


def _first(sizes: Sequence[Floats]) -> Floats:
    """The first size that each measurement has, shape (N,); NaN where it has none."""
    found = sizes[0]
    for other in sizes[1:]:
        found = np.where(np.isnan(found), other, found)
    return found


def _in_link(result: CalibrationResult, part: MeasurementErrors, link: str) -> Floats:
    """Tool points in a link, shape (N, 3) [m]."""
    chains, points = result.model.chains, part.points.copy()
    for key, rows in zip(part.rows.keys, part.rows.slices, strict=True):
        T = base_poses(chains, key.chain, link, part.rows.q[rows])
        points[rows] = np.einsum("nij,nj->ni", T[:, :3, :3], points[rows]) + T[:, :3, 3]
    return points


def _top(sizes: Floats) -> float:
    """End of the color scale: few large errors must not make all others look alike."""
    finite = sizes[np.isfinite(sizes)]
    high = float(np.quantile(finite, 0.97)) if finite.size else 0.0
    most = float(finite.max(initial=0.0))
    return max(most if most < 1.3 * high else high, 1e-12)


def _ground(axes: Axes, view: View, scene: Scene) -> None:
    """A grid on the ground, and the axes x and y of the base link on it."""
    step, low, high = scene.grid
    lines = []
    for k in (0, 1):
        for value in np.arange(low[k], high[k] + 0.5 * step, step):
            ends = np.full((2, 3), scene.floor)
            ends[:, k], ends[:, 1 - k] = value, (low[1 - k], high[1 - k])
            lines.append(view.project(ends)[0])
    axes.add_collection(LineCollection(lines, colors=GRID, linewidths=0.6, zorder=1.0))
    origin, _ = view.project(np.array([0.0, 0.0, scene.floor]))
    for k, end in enumerate(scene.ends):
        spot, _ = view.project(end)
        axes.add_collection(
            LineCollection([[origin, spot]], colors=MUTED, linewidths=0.9)
        )
        # Beside the last line of the grid, on which no letter can be read.
        rim, _ = view.project(end + step * np.eye(3)[1 - k])
        right, down = (rim - spot) / max(float(np.linalg.norm(rim - spot)), 1e-9)
        beside = BESIDE * np.array([-down, right])
        x, y = spot + math.copysign(1.0, beside @ (spot - origin)) * beside
        name = f"{'' if end[k] > 0.0 else '-'}{'xy'[k]}"
        axes.text(
            x, y, name, color=MUTED, fontsize=8.0, ha="center", va="center_baseline"
        )
