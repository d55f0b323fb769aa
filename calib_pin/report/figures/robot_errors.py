"""The robot in three dimensions, with its errors before and after beside each other.

The robot is drawn by us, as an image: shapes come in, nobody is asked for a graphics
card, and the same result gives the same bytes. Text, ground and color scale are lines
and letters like in all figures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy.ndimage import maximum_filter

from calib_pin.kinematics.shapes import Color, Shape
from calib_pin.kinematics.skeleton import (
    Skeleton,
    base_poses,
    chain_links,
    corners,
    drawn_link,
    floor_height,
)
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
from calib_pin.report.figures.palettes import with_few_colors
from calib_pin.report.figures.raster import (
    Picture,
    Solid,
    View,
    balls,
    outlines,
    picture,
    shadow,
    shrunk,
    widened,
)
from calib_pin.report.figures.strokes import thinned, thinning
from calib_pin.report.figures.views import COLORS, LEVELS, color_bar
from calib_pin.report.surroundings import surroundings
from calib_pin.report.tables import number
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import CalibrationResult

POINTS = 700
"""Points that are drawn at most: more hide each other and the robot."""

FINE = 2
"""Pixels of the drawing by those of the image, in either direction."""

DENSITY = 200
"""Pixels of the image [1/inch]."""

LEFT, GAP, TITLE, FOOT = 0.1, 0.2, 0.35, 0.62
"""Margins, and room above and below both images [inch]."""

ROOM = (WIDTH - 2 * LEFT - GAP) / 2.0, 3.5
"""Width and height of an image at most [inch]."""

AZIMUTHS = np.radians(np.arange(-165.0, 181.0, 30.0))
ELEVATIONS = np.radians((18.0, 32.0))
"""Directions from which the robot may be looked at."""

FRONT = math.radians(-35.0)
"""Azimuth that is liked best, where others show no more."""

COARSE, SAMPLES = 90.0, 6000
"""Size of the images that compare directions [px], and points of the robot in them."""

ROBOT: Color = (0.93, 0.92, 0.89)
"""Of links whose color nobody states."""

NEAR = 1.4
"""Distance of things that are drawn, by the radius of robot and points."""

STEPS, LINES = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 100.0, np.inf), 10
"""Distances of the lines on the ground [m], and how many there are at most."""

OUTLINE, SHADE, XRAY = 0.32, 0.30, 0.38
"""Light that an outline leaves, darkness of a shadow, opacity of a hidden ball."""


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
        shapes: Shapes of the robot's links; simple solids where there are none.
    """
    measured = _measured(result)
    if measured is None or not len(measured.points):
        return None
    scene = _scene(result, list(shapes) or stand_ins(result.model.chains.robot))
    sizes = [measured.before, measured.after]
    chosen = thinned(len(measured.points), POINTS, sizes)
    points = measured.points[chosen]
    view = _view(scene, points)
    image = _Image.of(view, scene)
    width, height = (k / DENSITY for k in view.size)
    figure = Figure(figsize=(WIDTH, TITLE + height + FOOT))
    unit, factor = unit_of(measured.unit)
    high = _top(np.concatenate(sizes)) * factor
    shades = colormaps[COLORS](np.linspace(0.0, 1.0, LEVELS))[:, :3]
    radius = scene.extent * float(np.clip(0.17 / math.sqrt(len(points)), 0.006, 0.014))
    stages = (("before", BEFORE, sizes[0]), ("after", AFTER, sizes[1]))
    for k, (name, color, errors) in enumerate(stages):
        left = LEFT + k * (ROOM[0] + GAP) + 0.5 * (ROOM[0] - width)
        axes = panel(figure, left, TITLE, width, height)
        _ground(axes, view, scene)
        level = np.minimum(factor * errors[chosen] / high, 1.0) * (LEVELS - 1)
        level = np.where(np.isfinite(level), level, LEVELS - 1).round().astype(int)
        drawn = image.with_balls(points, radius, shades[level])
        axes.imshow(drawn, interpolation="none", zorder=2.0)
        axes.set(xlim=(0, view.size[0]), ylim=(view.size[1], 0))
        axes.set_axis_off()
        mean = number(factor * float(np.mean(errors[np.isfinite(errors)])))
        label = f"{name}: {mean} {unit} on average"
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


@dataclass(frozen=True)
class _Scene:
    """What is drawn but for the balls.

    Attributes:
        solids: What cannot be seen through.
        clear: What can.
        frame: Corners of boxes around all of it, shape (S, 3) [m].
        floor: Height of the ground [m].
        grid: Step of its grid, and its least and largest (x, y) [m].
        extent: Size of the robot [m].
    """

    solids: tuple[Solid, ...]
    clear: tuple[Solid, ...]
    frame: Floats
    floor: float
    grid: tuple[float, Floats, Floats]
    extent: float


def _scene(result: CalibrationResult, shapes: Sequence[Shape]) -> _Scene:
    """The robot where it was measured, and what stands around it."""
    chains, rows = result.model.chains, result.fitted.rows
    skeleton = Skeleton(chains.robot, drawn_link(chains))
    q = skeleton.neutral
    typical = rows.q[_typical(rows.q)]
    for k, joint in enumerate(rows.joints):
        if joint in skeleton.joints:
            q[skeleton.joints.index(joint)] = typical[k]
    T = dict(zip(skeleton.links, skeleton.placements(q), strict=True))
    own = chain_links(chains)
    solids = [
        Solid(s.surface, T[s.link] @ s.placement, _muted(s.color, s.link in own))
        for s in shapes
    ]
    frame = corners(skeleton, shapes, q)
    middle = 0.5 * (frame.min(axis=0) + frame.max(axis=0))
    radius = float(np.linalg.norm(frame - middle, axis=1).max())
    clear = []
    for thing in surroundings(result.model.parts, rows, result.fitted.points):
        place = T[thing.link][:3, :3] @ thing.origin + T[thing.link][:3, 3]
        if np.linalg.norm(place - middle) > NEAR * radius:
            continue
        for s in thing.shapes:
            solid = Solid(
                s.surface, T[s.link] @ s.placement, s.color or ROBOT, s.opacity
            )
            (solids if s.opacity == 1.0 else clear).append(solid)
        frame = np.concatenate([frame, corners(skeleton, thing.shapes, q)])
    floor = floor_height(skeleton, shapes)
    extent = float(np.ptp(frame, axis=0).max())
    return _Scene(tuple(solids), tuple(clear), frame, floor, _grid(frame), extent)


def _typical(q: Floats) -> int:
    """The configuration (N, n) nearest to the middle of all."""
    away = np.abs(q - np.median(q, axis=0))
    scale = np.maximum(away.mean(axis=0), 1e-9)
    return int(np.argmin((away / scale).sum(axis=1)))


def _muted(color: Color | None, measured: bool) -> Color:
    """A color of a link that leaves the strong ones to the errors."""
    red, green, blue = ROBOT if color is None else color
    gray = 0.3 * red + 0.59 * green + 0.11 * blue
    strength, white = (0.45, 0.12) if measured else (0.15, 0.62)
    mixed = (gray + strength * (part - gray) for part in (red, green, blue))
    r, g, b = (white + (1.0 - white) * part for part in mixed)
    return r, g, b


def _view(scene: _Scene, points: Floats) -> View:
    """The direction from which most is seen of the robot and the points."""
    room = DENSITY * np.array(ROOM)
    _, low, high = scene.grid
    ground = [(x, y, scene.floor) for x in (low[0], high[0]) for y in (low[1], high[1])]
    seen = np.concatenate([scene.frame, points, ground])
    every = max(1, sum(len(s.surface.vertices) for s in scene.solids) // SAMPLES)
    spread = np.concatenate(
        [
            np.einsum("ij,vj->vi", s.pose[:3, :3], s.surface.vertices[::every])
            + s.pose[:3, 3]
            for s in scene.solids
        ]
    )
    few = points[thinned(len(points), 200, [])]
    best, score = (0.0, 0.3), -1.0
    for elevation in ELEVATIONS:
        for azimuth in AZIMUTHS:
            view = View.of(seen, azimuth, elevation, np.full(2, COARSE))
            found = _shown(view, spread, few) + 0.1 * math.cos(azimuth - FRONT)
            if found > score + 1e-6:
                best, score = (float(azimuth), float(elevation)), found
    return View.of(seen, *best, room)


def _shown(view: View, robot: Floats, points: Floats) -> float:
    """How much a view shows: points before the robot, and both spread over the image."""
    width, height = view.size
    nearness = np.zeros((height, width))
    spots, depths = view.project(robot)
    x, y = np.clip(spots.T.astype(int), 0, [[width - 1], [height - 1]])
    np.maximum.at(nearness, (y, x), 1.0 / depths)
    nearness = maximum_filter(nearness, 3)
    covered = float((nearness > 0.0).mean()) * width * height / COARSE**2
    spots, depths = view.project(points)
    x, y = np.clip(spots.T.astype(int), 0, [[width - 1], [height - 1]])
    before = float((1.0 / depths > 0.995 * nearness[y, x]).mean())
    spread = (
        math.sqrt(abs(float(np.linalg.det(np.cov(spots.T))))) if len(x) > 2 else 0.0
    )
    return before + 8.0 * spread / COARSE**2 + 1.5 * covered


@dataclass(frozen=True)
class _Image:
    """The robot without the balls, in pixels finer than those of the image.

    Attributes:
        view: The view of these pixels.
        seen: What they show.
        drawn: Colors times opacity, and opacity, shape (h, w, 4).
    """

    view: View
    seen: Picture
    drawn: Floats

    @staticmethod
    def of(view: View, scene: _Scene) -> _Image:
        """Draw all but the balls as it is seen in a view of the image's pixels."""
        fine = view.scaled(FINE)
        seen = picture(fine, scene.solids)
        fallen = widened(shadow(view, scene.solids, scene.floor), FINE)
        there = seen.nearness > 0.0
        drawn = np.zeros((*there.shape, 4), np.float32)
        drawn[..., 3] = np.where(there, 1.0, SHADE * fallen)
        drawn[..., :3] = seen.color
        drawn[outlines(seen), :3] *= OUTLINE
        for solid in scene.clear:
            own = picture(fine, [solid])
            part = solid.opacity * (own.nearness > seen.nearness)
            drawn = _over(own.color, part[..., None], drawn)
        return _Image(fine, seen, drawn)

    def with_balls(self, points: Floats, radius: float, colors: Floats) -> Floats:
        """The image (h, w, 4) of bytes with balls at points (N, 3) [m]."""
        pixels, lit, hidden = balls(self.view, self.seen, points, radius, colors)
        drawn = self.drawn.reshape(-1, 4).copy()
        part = np.where(hidden, XRAY, 1.0)[:, None]
        drawn[pixels] = _over(lit, part, drawn[pixels])
        mean = shrunk(drawn.reshape(self.drawn.shape), FINE)
        mean[..., :3] /= np.where(mean[..., 3:] > 0.0, mean[..., 3:], 1.0)
        image = (np.clip(mean, 0.0, 1.0) * np.float32(255.0)).round().astype(np.uint8)
        return with_few_colors(image)


def _over(color: Floats, opacity: Floats, below: Floats) -> Floats:
    """Something over something else, colors times opacity, and opacity, (..., 4).

    Args:
        color: Colors of the upper one, shape (..., 3).
        opacity: Its opacity, shape (..., 1).
        below: The other one, shape (..., 4).
    """
    upper = np.concatenate([color * opacity, opacity], axis=-1)
    return np.asarray(upper + (1.0 - opacity) * below)


def _grid(scene_frame: Floats) -> tuple[float, Floats, Floats]:
    """Step of the ground's grid, and its least and largest (x, y) [m].

    It lies under what has a frame, shape (S, 3), and under the base link's origin.
    """
    seen = np.concatenate([scene_frame[:, :2], np.zeros((1, 2))])
    low, high = seen.min(axis=0), seen.max(axis=0)
    step = next(s for s in STEPS if LINES * s >= float((high - low).max()))
    return step, np.floor(low / step) * step, np.ceil(high / step) * step


def _ground(axes: Axes, view: View, scene: _Scene) -> None:
    """A grid on the ground, and the axes x and y of the base link on it."""
    step, low, high = scene.grid
    lines = []
    for k in (0, 1):
        for value in np.arange(low[k], high[k] + 0.5 * step, step):
            ends = np.full((2, 3), scene.floor)
            ends[:, k], ends[:, 1 - k] = value, (low[1 - k], high[1 - k])
            lines.append(view.project(ends)[0])
    axes.add_collection(LineCollection(lines, colors=GRID, linewidths=0.6, zorder=1.0))
    for k in (0, 1):
        ends = np.array([[0.0, 0.0, scene.floor]] * 2)
        ends[1, k] = high[k] if high[k] > 0.5 * step else low[k]
        spots = view.project(ends)[0]
        axes.add_collection(LineCollection([spots], colors=MUTED, linewidths=0.9))
        sign = "" if ends[1, k] > 0.0 else "-"
        axes.text(*spots[1], f"{sign}{'xy'[k]}", color=MUTED, fontsize=8.5)
