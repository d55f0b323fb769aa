"""The robot as it was measured, with what stands around it, as an image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from calib_pin.kinematics.shapes import Color, Shape, simplified
from calib_pin.kinematics.skeleton import (
    Skeleton,
    chain_links,
    corners,
    drawn_link,
    floor_height,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.report.figures.palettes import Bytes, with_few_colors
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
from calib_pin.report.figures.strokes import thinned
from calib_pin.report.surroundings import surroundings, touched_by
from calib_pin.validation.result import CalibrationResult

FINE = 2
"""Pixels of the drawing by those of the image, in either direction."""

AZIMUTHS = np.radians(np.arange(-165.0, 181.0, 30.0))
ELEVATIONS = np.radians((18.0, 32.0))
"""Directions from which the robot may be looked at."""

FRONT, LIKED = math.radians(-35.0), 0.2
"""Azimuth that is liked best, and how much more others must show."""

COARSE, SAMPLES = 90.0, 6000
"""Size of the images that compare directions [px], and points of the robot in them."""

ROBOT: Color = (0.93, 0.92, 0.89)
"""Of links whose color nobody states."""

USUAL = 12
"""Configurations near the middle of all, of which one is drawn."""

NEAR = 1.4
"""Distance of things that are drawn, by the radius of robot and points."""

LINES, FINEST = 10, 0.05
"""Lines on the ground at most in one direction, and their least distance [m]."""

MANY, DETAIL = 4000, 1200.0
"""Triangles from which on a surface is simplified, and cubes along the whole scene."""

OUTLINE, SHADE, XRAY = 0.32, 0.30, 0.38
"""Light that an outline leaves, darkness of a shadow, opacity of a hidden ball."""


@dataclass(frozen=True)
class Scene:
    """All that is drawn but for the balls.

    Attributes:
        solids: What cannot be seen through.
        clear: What can.
        frame: Corners of boxes around all of it, shape (S, 3) [m].
        floor: Height of the ground [m].
        grid: Step of its grid, and its least and largest (x, y) [m].
        extent: Size of robot and points [m].
        spots: The middle, and where things stand that should be seen, (T, 3) [m].
    """

    solids: tuple[Solid, ...]
    clear: tuple[Solid, ...]
    frame: Floats
    floor: float
    grid: tuple[float, Floats, Floats]
    extent: float
    spots: Floats

    @property
    def ends(self) -> Floats:
        """Ends of the axes x and y on the ground, where the grid ends, (2, 3) [m]."""
        step, low, high = self.grid
        found = np.array([[0.0, 0.0, self.floor]] * 2)
        for k in (0, 1):
            found[k, k] = high[k] if high[k] > 0.5 * step else low[k]
        return found


def scene_of(
    result: CalibrationResult, shapes: Sequence[Shape], points: Floats
) -> Scene:
    """The robot where it was measured, and what stands around it.

    Args:
        result: The result.
        shapes: Shapes of the robot's links.
        points: Tool points in the drawn link, shape (N, 3) [m].
    """
    chains, rows = result.model.chains, result.fitted.rows
    skeleton = Skeleton(chains.robot, drawn_link(chains))
    q = _typical(rows, skeleton)
    T = dict(zip(skeleton.links, skeleton.placements(q), strict=True))
    own, frame = chain_links(chains), corners(skeleton, shapes, q)
    reach = float(np.ptp(frame, axis=0).max())
    seen = np.concatenate([frame, points])
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    radius = float(np.linalg.norm(seen - middle, axis=1).max())
    cell = 2.0 * radius / DETAIL
    solids = [
        Solid(
            s.surface
            if len(s.surface.triangles) < MANY
            else simplified(s.surface, cell),
            T[s.link] @ s.placement,
            _muted(s.color, s.link in own),
        )
        for s in shapes
    ]
    clear: list[Solid] = []
    touched = touched_by(rows, result.fitted.points)
    spots = [middle]
    for thing in surroundings(result.model.parts, touched, reach):
        place = T[thing.link][:3, :3] @ thing.origin + T[thing.link][:3, 3]
        # A measurement frame is a place where nothing needs to be.
        if thing.kind == "station" or np.linalg.norm(place - middle) > NEAR * radius:
            continue
        for s in thing.shapes:
            solid = Solid(
                s.surface, T[s.link] @ s.placement, s.color or ROBOT, s.opacity
            )
            (solids if s.opacity == 1.0 else clear).append(solid)
        spots.append(place)
        frame = np.concatenate([frame, corners(skeleton, thing.shapes, q)])
    floor = floor_height(skeleton, shapes)
    seen = np.concatenate([frame, points])
    extent = float(np.ptp(seen, axis=0).max())
    return Scene(
        tuple(solids), tuple(clear), frame, floor, _grid(frame), extent, np.array(spots)
    )


def _typical(rows: Observations, skeleton: Skeleton) -> Floats:
    """Positions (K,) of the skeleton's joints in a measurement that shows the robot.

    Of those nearest to the middle of all, the one that stretches it most.
    """
    away = np.abs(rows.q - np.median(rows.q, axis=0))
    scale = np.maximum(away.mean(axis=0), 1e-9)
    nearest = np.argsort((away / scale).sum(axis=1), kind="stable")
    best, most = skeleton.neutral, -1.0
    for row in nearest[: min(USUAL, len(rows) // 4 + 1)]:
        q = skeleton.neutral
        for joint, position in zip(rows.joints, rows.q[row], strict=True):
            if joint in skeleton.joints:
                q[skeleton.joints.index(joint)] = position
        places = skeleton.placements(q)[:, :3, 3]
        size = float(np.ptp(places, axis=0).sum())
        if size > most + 1e-9:
            best, most = q, size
    return best


def _muted(color: Color | None, measured: bool) -> Color:
    """A color of a link that leaves the strong ones to the errors."""
    red, green, blue = ROBOT if color is None else color
    gray = 0.3 * red + 0.59 * green + 0.11 * blue
    strength, white = (0.45, 0.12) if measured else (0.15, 0.62)
    mixed = (gray + strength * (part - gray) for part in (red, green, blue))
    r, g, b = (white + (1.0 - white) * part for part in mixed)
    return r, g, b


def best_view(scene: Scene, points: Floats, radius: float, room: Floats) -> View:
    """The view from where most is seen of the robot and of balls.

    Args:
        scene: The scene.
        points: Middles of the balls, shape (N, 3) [m].
        radius: Their radius [m].
        room: Width and height of the image at most, shape (2,) [px].
    """
    step, low, high = scene.grid
    ground = [(x, y, scene.floor) for x in (low[0], high[0]) for y in (low[1], high[1])]
    rims = [points + sign * radius * k for sign in (-1.0, 1.0) for k in np.eye(3)]
    # The names of the axes stand beyond their ends.
    names = scene.ends + 0.6 * step * np.sign(scene.ends) * [1.0, 1.0, 0.0]
    seen = np.concatenate([scene.frame, ground, names, *rims])
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
            found = _shown(view, spread, few, scene.spots)
            found += LIKED * math.cos(azimuth - FRONT)
            if found > score + 1e-6:
                best, score = (float(azimuth), float(elevation)), found
    return View.of(seen, *best, room)


def _shown(view: View, robot: Floats, points: Floats, others: Floats) -> float:
    """How much a view shows: points in front, and all of it over the image."""
    width, height = view.size
    nearness = np.zeros((height, width))
    spots, depths = view.project(robot)
    x, y = np.clip(spots.T.astype(int), 0, [[width - 1], [height - 1]])
    np.maximum.at(nearness, (y, x), 1.0 / depths)
    nearness = maximum_filter(nearness, 3)
    covered = float((nearness > 0.0).mean()) * width * height / COARSE**2
    seen = []
    for some in (points, others):
        spots, depths = view.project(some)
        x, y = np.clip(spots.T.astype(int), 0, [[width - 1], [height - 1]])
        seen.append(float((1.0 / depths > 0.995 * nearness[y, x]).mean()))
    spots, _ = view.project(points)
    spread = 0.0
    if len(points) > 2:
        spread = math.sqrt(abs(float(np.linalg.det(np.cov(spots.T)))))
    return seen[0] + 0.5 * seen[1] + 8.0 * spread / COARSE**2 + 1.5 * covered


@dataclass(frozen=True)
class SceneImage:
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
    def of(view: View, scene: Scene) -> SceneImage:
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
            part = solid.opacity * (own.nearness > seen.nearness).astype(float)
            drawn = _over(own.color, part[..., None], drawn)
        return SceneImage(fine, seen, drawn)

    def with_balls(self, points: Floats, radius: float, colors: Floats) -> Bytes:
        """The image (h, w, 4) of bytes with balls at points (N, 3) [m]."""
        pixels, lit, hidden = balls(self.view, self.seen, points, radius, colors)
        drawn = self.drawn.reshape(-1, 4).copy()
        part = np.where(hidden, XRAY, 1.0)[:, None].astype(float)
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


def _grid(frame: Floats) -> tuple[float, Floats, Floats]:
    """Step of the ground's grid, and its least and largest (x, y) [m].

    It lies under what has a frame, shape (S, 3), and under the base link's origin.
    """
    seen = np.concatenate([frame[:, :2], np.zeros((1, 2))])
    low, high = seen.min(axis=0), seen.max(axis=0)
    least = max(float((high - low).max()) / LINES, FINEST)
    power = 10.0 ** math.floor(math.log10(least))
    step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= least)
    return step, np.floor(low / step) * step, np.ceil(high / step) * step
