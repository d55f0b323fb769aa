"""The robot in three dimensions, with its errors before and after beside each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure

import calib_pin.report.figures.canvas as canvas
from calib_pin.kinematics.shapes import Color, Shape, simplified
from calib_pin.kinematics.skeleton import (
    Skeleton,
    base_poses,
    chain_links,
    drawn_link,
    floor_height,
)
from calib_pin.kinematics.skeleton import corners as corners_of
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.stand_ins import stand_ins
from calib_pin.observations import Observations
from calib_pin.report.tables import significant, unit_of
from calib_pin.validation.result import CalibrationResult, MeasurementErrors

POINTS = 700
"""Points that are drawn at most: more hide each other and the robot."""

HEIGHT = 4.4
"""Height of the figure [inch]."""

SMALLEST, LARGEST = 0.006, 0.013
"""Radius of balls by the extent of the scene."""

ROUND = np.exp(2j * np.pi * np.arange(11) / 10.0)
"""Corners of a ball as it is seen."""

ELEVATION, ASIDE, USUAL = 22.0, 40.0, -50.0
"""Height of the eye; where it stands beside the points, or where these are all around
the robot [deg]."""

LAMP = 35.0, 50.0
"""Where the light comes from: to the right of the eye, and up [deg]."""

LIKELY = 12
"""Configurations near the middle of all, of which one is drawn."""

ROBOT: Color = (0.93, 0.92, 0.89)
"""Of links whose color nobody states."""

FEW, DETAIL, COARSEST = 400, 150.0, 25.0
"""Triangles up to which a surface stays as it is, cubes along the whole scene to which
others are simplified, and longest edges along it."""

XRAY = 0.35
"""Opacity of a hidden ball."""


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
) -> canvas.Drawn | None:
    """Tool points colored by their errors before and after, around the robot.

    Args:
        result: The result.
        shapes: Shapes of the robot's links; simple solids where there are none.
    """
    measured = _measured(result)
    if not len(measured.points):
        return None
    links = list(shapes) or stand_ins(result.model.chains.robot)
    low, high, triangles, colors = _scene(result, links, measured.points)
    unit, factor = unit_of(measured.unit)
    sizes = [factor * measured.before, factor * measured.after]
    chosen = canvas.thinned(len(measured.points), POINTS, sizes)
    points, extent = measured.points[chosen], float((high - low).max())
    azimuth = _azimuth(points, extent)
    eye = LightSource(90.0 - azimuth, ELEVATION).direction
    lamp = LightSource(90.0 - azimuth - LAMP[0], LAMP[1]).direction
    apart = len(np.unique(np.round(points / (LARGEST * extent)), axis=0))
    radius = extent * float(np.clip(0.17 / math.sqrt(apart), SMALLEST, LARGEST))
    corners = np.concatenate([triangles, _balls(points, radius, eye)])
    lit, top = (
        _shade(triangles, colors, eye, lamp),
        canvas.top_of(np.concatenate(sizes)),
    )
    scale = ScalarMappable(Normalize(0.0, top), canvas.SCALE)
    figure = Figure(figsize=(canvas.WIDTH, HEIGHT))
    for k, (name, color) in enumerate(canvas.STAGES.items()):
        axes: Any = figure.add_axes((0.5 * k + 0.01, 0.23, 0.46, 0.7), projection="3d")
        axes.view_init(ELEVATION, azimuth)
        axes.set_box_aspect(high - low, zoom=1.08)
        axes.set(**{f"{x}lim": ends for x, *ends in zip("xyz", low, high, strict=True)})
        shades = scale.to_rgba(np.nan_to_num(sizes[k][chosen], posinf=1e300))
        _draw(axes, corners, np.concatenate([lit, np.repeat(shades, 10, axis=0)]))
        through = {"c": shades, "alpha": XRAY, "linewidths": 0.0, "depthshade": False}
        axes.scatter(*points.T, s=7.0, zorder=3.0, **through)
        label = f"{name.partition(' ')[0]}: {_mean(result, measured, k)}"
        figure.text(0.25 + 0.5 * k, 0.95, label, ha="center", color=color)
    clipped = ", more at the end" if np.concatenate(sizes).max() > top else ""
    place = figure.add_axes((0.3, 0.11, 0.4, 0.022))
    bar = figure.colorbar(scale, place, orientation="horizontal")
    bar.set_label(f"{measured.name} error [{unit}]{clipped}")
    return canvas.Drawn(
        "Errors of the robot before and after calibration",
        f"Every ball is a measured tool point; its color is the {measured.name} error "
        "there, on one scale for both. A ball behind the robot shines through. "
        "The robot stands as in one of the measurements; axes in meters."
        + canvas.thinning(len(chosen), len(measured.points)),
        figure,
    )


def _draw(axes: Any, corners: Floats, faces: Floats) -> None:
    """Triangles (T, 3, 3) of some colors (T, 4), with axes around them."""
    from mpl_toolkits.mplot3d.art3d import (  # type: ignore[import-untyped]
        Poly3DCollection,
    )

    # Neighbors share their pixels, or there were gaps between them: to close these by
    # edges takes twice as long as everything else.
    style = {"facecolors": faces, "linewidths": 0.0, "antialiased": False}
    axes.add_collection3d(Poly3DCollection(corners, **style), autolim=False)
    axes.set_rasterization_zorder(math.inf)
    axes.computed_zorder = False
    for x, axis in zip("xy ", (axes.xaxis, axes.yaxis, axes.zaxis), strict=True):
        axis.set_pane_color((0.0, 0.0, 0.0, 0.0))
        axis.set_tick_params(labelsize=7, pad=0.0)
        axis.set_label_text(x, fontsize=8)
        axis.labelpad = -4.0
        axis.get_major_locator().set_params(nbins=4)


# --- what is measured --------------------------------------------------------------


def _measured(result: CalibrationResult) -> Measured:
    """Tool points and sizes of errors of all measurements, fitted and held out.

    Lengths come before all other quantities.
    """
    parts = [part for part in (result.fitted, result.held_out) if part is not None]
    units = {q.unit for q in result.fitted.quantities}
    unit = "m" if "m" in units else min(units)
    names = [q.name for q in result.fitted.quantities if q.unit == unit]
    link = drawn_link(result.model.chains)
    arrays = []
    for part in parts:
        sizes = [part.sizes(q) for q in part.quantities if q.unit == unit]
        if not sizes:
            continue
        # Of several quantities a measurement may have one only.
        before, after = np.fmax.reduce(np.asarray(sizes, float), axis=0)
        usable = np.isfinite(part.points).all(axis=1) & ~np.isnan(before)
        usable &= np.isfinite(after)
        points = _in_link(result, part, link)
        arrays.append((points[usable], before[usable], after[usable]))
    points, before, after = (
        np.concatenate(parts) for parts in zip(*arrays, strict=True)
    )
    name = names[0] if len(names) == 1 else "length"
    return Measured(points, before, after, unit, name)


def _mean(result: CalibrationResult, measured: Measured, stage: int) -> str:
    """Mean error before or after, that of the report where it has one, in words."""
    mean, where = float(np.mean((measured.before, measured.after)[stage])), "on average"
    for error in result.errors:
        if error.name == measured.name:
            mean = error.shown[stage].mean
            where = "on average" if "validation" in error.stages else "where fitted"
    unit, factor = unit_of(measured.unit)
    return f"{significant(factor * mean)} {unit} {where}"


def _in_link(result: CalibrationResult, part: MeasurementErrors, link: str) -> Floats:
    """Tool points in a link, shape (N, 3) [m]."""
    chains, points = result.model.chains, part.points.copy()
    for key, rows in zip(part.rows.keys, part.rows.slices, strict=True):
        T = base_poses(chains, key.chain, link, part.rows.q[rows])
        points[rows] = np.einsum("nij,nj->ni", T[:, :3, :3], points[rows]) + T[:, :3, 3]
    return points


# --- the scene ---------------------------------------------------------------------


def _scene(
    result: CalibrationResult, shapes: Sequence[Shape], points: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """The robot where it was measured, on its ground.

    Args:
        result: The result.
        shapes: Shapes of the robot's links.
        points: Tool points in the drawn link, shape (N, 3) [m].

    Returns:
        The ends of all of it, (3,) each [m]; corners of triangles (T, 3, 3) [m], and
        their red, green, blue and opacity from 0 to 1, (T, 4).
    """
    chains, rows = result.model.chains, result.fitted.rows
    skeleton = Skeleton(chains.robot, drawn_link(chains))
    q, measured = _typical(rows, skeleton), chain_links(chains)
    T = dict(zip(skeleton.links, skeleton.placements(q), strict=True))
    seen = np.concatenate([corners_of(skeleton, shapes, q), points])
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    radius = float(np.linalg.norm(seen - middle, axis=1).max())
    parts = [_triangles(s, T[s.link], 2.0 * radius) for s in shapes]
    colors = [
        np.tile([*_muted(s.color or ROBOT, s.link in measured), 1.0], (len(part), 1))
        for s, part in zip(shapes, parts, strict=True)
    ]
    low, high = seen.min(axis=0), seen.max(axis=0)
    low[2] = min(low[2], floor_height(skeleton, shapes))
    return low, high, np.concatenate(parts), np.concatenate(colors)


def _typical(rows: Observations, skeleton: Skeleton) -> Floats:
    """Positions (K,) of the skeleton's joints in a measurement that shows the robot.

    Of those nearest to the middle of all, the one that stretches it most.
    """
    away = np.abs(rows.q - np.median(rows.q, axis=0))
    scale = np.maximum(away.mean(axis=0), 1e-9)
    nearest = np.argsort((away / scale).sum(axis=1), kind="stable")
    likely = np.tile(skeleton.neutral, (min(LIKELY, len(rows) // 4 + 1), 1))
    for k, joint in enumerate(rows.joints):
        if joint in skeleton.joints:
            likely[:, skeleton.joints.index(joint)] = rows.q[nearest[: len(likely)], k]
    sizes = [np.ptp(skeleton.placements(q)[:, :3, 3], axis=0).sum() for q in likely]
    return np.asarray(likely[int(np.round(sizes, 9).argmax())])


def _triangles(shape: Shape, T: Floats, extent: float) -> Floats:
    """Corners (T, 3, 3) [m] of a shape's triangles, neither too many nor too large.

    What is nearer hides what is farther, triangle by triangle: a large one is near and
    far at once.
    """
    surface, pose = shape.surface, T @ shape.placement
    if len(surface.triangles) > FEW:
        surface = simplified(surface, extent / DETAIL)
    corners = (surface.vertices @ pose[:3, :3].T + pose[:3, 3])[surface.triangles]
    while True:
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        large = edges.max(axis=1) > extent / COARSEST
        if not large.any():
            return np.asarray(corners)
        first, which = edges[large].argmax(axis=1), np.arange(int(large.sum()))
        a, b, c = (corners[large][which, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)]
        corners = np.concatenate([corners[~large], *halves])


def _muted(color: Color, measured: bool) -> Color:
    """A color of a link that leaves the strong ones to the errors."""
    gray = float(np.dot((0.3, 0.59, 0.11), color))
    strength, white = (0.45, 0.12) if measured else (0.15, 0.62)
    mixed = (gray + strength * (part - gray) for part in color)
    r, g, b = (white + (1.0 - white) * part for part in mixed)
    return r, g, b


def _azimuth(points: Floats, extent: float) -> float:
    """From where points (N, 3) stand before a robot at the origin [deg]."""
    x, y, _ = points.mean(axis=0)
    if math.hypot(x, y) < 0.1 * extent:
        return USUAL
    return math.degrees(math.atan2(y, x)) - ASIDE


def _balls(points: Floats, radius: float, eye: Floats) -> Floats:
    """Triangles (10 N, 3, 3) [m] of discs at (N, 3) that face the eye."""
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    rim = np.outer(ROUND.real, right) + np.outer(ROUND.imag, np.cross(eye, right))
    fan = radius * np.stack([np.zeros((10, 3)), rim[:-1], rim[1:]], axis=1)
    return ((points + radius * eye)[:, None, None] + fan).reshape(-1, 3, 3)


def _shade(triangles: Floats, colors: Floats, eye: Floats, lamp: Floats) -> Floats:
    """Colors (T, 4) of triangles in the light; rims are darker."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # Some meshes are inside out: what is seen is the side that faces the eye.
    facing = normals @ eye
    normals = np.where(facing[:, None] < 0.0, -normals, normals)
    bright = 0.62 + 0.43 * np.clip(normals @ lamp, 0.0, 1.0)
    lit = colors.copy()
    lit[:, :3] *= (bright * (0.75 + 0.25 * np.abs(facing)))[:, None]
    return np.clip(lit, 0.0, 1.0)
