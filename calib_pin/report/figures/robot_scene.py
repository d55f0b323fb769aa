"""The robot as it was measured, with what stands around it, as an image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.path import Path

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
from calib_pin.report.surroundings import surroundings, touched_by
from calib_pin.validation.result import CalibrationResult

AZIMUTHS = np.radians(np.arange(-165.0, 181.0, 30.0))
ELEVATION = math.radians(25.0)
"""Directions from which the robot may be looked at."""

FRONT, LIKED = math.radians(-35.0), 0.2
"""Azimuth that is liked best, and how much more others must show."""

ROBOT: Color = (0.93, 0.92, 0.89)
"""Of links whose color nobody states."""

USUAL = 12
"""Configurations near the middle of all, of which one is drawn."""

NEAR = 1.4
"""Distance of things that are drawn, by the radius of robot and points."""

LINES, FINEST = 10, 0.05
"""Lines on the ground at most in one direction, and their least distance [m]."""

FEW, DETAIL, COARSEST = 400, 200.0, 25.0
"""Triangles up to which a surface stays as it is, cubes along the whole scene to which
others are simplified, and longest edges along it."""

LAMP = (-0.3, 0.35, 0.9)
"""Direction to the lamp: to the right, back to the eye, and up."""

SHADE, XRAY = 0.15, 0.35
"""Darkness of a shadow, opacity of a hidden ball."""

ROUND = np.exp(2j * np.pi * np.arange(16) / 16.0)
"""Corners of a ball in the image."""


@dataclass(frozen=True)
class View:
    """A pinhole that looks at a scene.

    Attributes:
        eye: Its place, shape (3,) [m].
        axes: Right, down and ahead as rows, shape (3, 3).
        focal: Pixels at depth 1.
        center: Pixel straight ahead, shape (2,).
        size: Width and height of the image [px].
    """

    eye: Floats
    axes: Floats
    focal: float
    center: Floats
    size: tuple[int, int]

    @staticmethod
    def of(points: Floats, azimuth: float, elevation: float, room: Floats) -> View:
        """The view from a direction that has all points (N, 3) in the image.

        Args:
            points: What must be seen [m].
            azimuth: Of the eye about the vertical [rad].
            elevation: Of the eye above the horizon [rad].
            room: Width and height that there are at most, shape (2,) [px]; the image
                is as large as the points are.
        """
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        radius = float(np.linalg.norm(points - middle, axis=1).max())
        out = np.array(
            [
                math.cos(azimuth) * math.cos(elevation),
                math.sin(azimuth) * math.cos(elevation),
                math.sin(elevation),
            ]
        )
        right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        axes = np.stack([right, np.cross(-out, right), -out])
        view = View(middle + 5.5 * radius * out, axes, 1.0, np.zeros(2), (1, 1))
        spots, _ = view.project(points)
        low, high = spots.min(axis=0), spots.max(axis=0)
        focal = float((room / (high - low)).min())
        width, height = (math.ceil(k) for k in focal * (high - low))
        return View(view.eye, axes, focal, -focal * low, (width, height))

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Pixels (..., 2) and depths (...) [m] of points (..., 3)."""
        seen = np.einsum("kj,...j->...k", self.axes, points - self.eye)
        depth = np.maximum(seen[..., 2], 1e-6)
        return self.focal * seen[..., :2] / depth[..., None] + self.center, depth

    @property
    def lamp(self) -> Floats:
        """Unit vector to a lamp that stands where it does for every eye, shape (3,)."""
        right, up = self.axes[0], np.array([0.0, 0.0, 1.0])
        found = np.array(LAMP) @ np.stack([right, np.cross(right, up), up])
        return np.asarray(found / np.linalg.norm(found))


@dataclass(frozen=True)
class Scene:
    """All that is drawn but for the balls.

    Attributes:
        triangles: Corners of the triangles, shape (T, 3, 3) [m].
        colors: Their red, green, blue and opacity from 0 to 1, shape (T, 4).
        frame: Corners of boxes around all of it, shape (S, 3) [m].
        floor: Height of the ground [m].
        grid: Step of its grid, and its least and largest (x, y) [m].
        extent: Size of robot and points [m].
    """

    triangles: Floats
    colors: Floats
    frame: Floats
    floor: float
    grid: tuple[float, Floats, Floats]
    extent: float

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
    drawn = [(s, _muted(s.color, s.link in own)) for s in shapes]
    touched = touched_by(rows, result.fitted.points)
    for thing in surroundings(result.model.terms, touched, reach):
        place = T[thing.link][:3, :3] @ thing.origin + T[thing.link][:3, 3]
        # A measurement frame is a place where nothing needs to be.
        if thing.kind == "station" or np.linalg.norm(place - middle) > NEAR * radius:
            continue
        drawn += [(s, s.color or ROBOT) for s in thing.shapes]
        frame = np.concatenate([frame, corners(skeleton, thing.shapes, q)])
    parts = [_triangles(s, T[s.link], 2.0 * radius) for s, _ in drawn]
    colors = [
        np.tile([*color, s.opacity], (len(part), 1))
        for (s, color), part in zip(drawn, parts, strict=True)
    ]
    seen = np.concatenate([frame, points])
    return Scene(
        np.concatenate(parts),
        np.concatenate(colors),
        frame,
        floor_height(skeleton, shapes),
        _grid(frame),
        float(np.ptp(seen, axis=0).max()),
    )


def _triangles(shape: Shape, T: Floats, extent: float) -> Floats:
    """Corners (T, 3, 3) [m] of a shape's triangles, neither too many nor too large.

    What is nearer hides what is farther, triangle by triangle: a large one is near and
    far at once.
    """
    surface, pose = shape.surface, T @ shape.placement
    if len(surface.triangles) > FEW:
        surface = simplified(surface, extent / DETAIL)
    found = (surface.vertices @ pose[:3, :3].T + pose[:3, 3])[surface.triangles]
    while True:
        edges = np.linalg.norm(found - np.roll(found, -1, axis=1), axis=2)
        large = edges.max(axis=1) > extent / COARSEST
        if not large.any():
            return np.asarray(found)
        first = edges[large].argmax(axis=1)
        which = np.arange(len(first))
        a, b, c = (found[large][which, (first + k) % 3] for k in range(3))
        halves = [
            np.stack([a, 0.5 * (a + b), c], 1),
            np.stack([0.5 * (a + b), b, c], 1),
        ]
        found = np.concatenate([found[~large], *halves])


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
    """The view in which robot and balls hide each other least.

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
    robot = scene.triangles.mean(axis=1)

    def shown(azimuth: float) -> float:
        """Points before the robot, and the area over which both are spread."""
        view = View.of(seen, azimuth, ELEVATION, np.ones(2))
        spots, depths = view.project(points)
        before = float((depths < np.median(view.project(robot)[1])).mean())
        both = np.concatenate(
            [spots, view.project(robot)[0][:: len(robot) // len(spots) + 1]]
        )
        spread = float(np.linalg.det(np.cov(both.T))) ** 0.5
        return float(before + 8.0 * spread + LIKED * math.cos(azimuth - FRONT))

    return View.of(seen, max(AZIMUTHS, key=shown), ELEVATION, room)


def draw(
    axes: Axes, view: View, scene: Scene, points: Floats, radius: float, colors: Floats
) -> None:
    """Draw a scene with balls, the farthest first.

    Args:
        axes: Axes in the pixels of the view.
        view: The view.
        scene: The scene.
        points: Middles of the balls, shape (N, 3) [m].
        radius: Their radius [m].
        colors: Red, green and blue of the balls from 0 to 1, shape (N, 3).
    """
    triangles, depths = view.project(scene.triangles)
    spots, away = view.project(points)
    sizes = view.focal * radius / away
    corner = np.stack([ROUND.real, ROUND.imag], axis=1)
    balls = spots[:, None] + sizes[:, None, None] * corner
    gleams = spots[:, None] + sizes[:, None, None] * (0.4 * corner - 0.3)
    bright = 0.6 * colors + 0.4
    solid = np.ones((len(points), 1))
    polygons = [*triangles, *balls, *gleams]
    faces = np.concatenate(
        [_lit(view, scene), np.hstack([colors, solid]), np.hstack([bright, solid])]
    )
    near = away - radius
    order = np.argsort(
        -np.concatenate([depths.mean(axis=1), near, near - 1e-6]), kind="stable"
    )
    axes.add_collection(_shadow(view, scene), autolim=False)
    through = np.hstack([colors, XRAY * solid])
    # Edges of the same color, or there were gaps between neighbors.
    for shapes, shades in (
        ([polygons[k] for k in order], faces[order]),
        (balls, through),
    ):
        drawn = PolyCollection(shapes, facecolors=shades, linewidths=0.25)
        drawn.set(edgecolors=shades, rasterized=True, clip_on=False, zorder=2.0)
        axes.add_collection(drawn, autolim=False)


def _lit(view: View, scene: Scene) -> Floats:
    """Colors (T, 4) of triangles in the light of a lamp and the sky, rims darker."""
    a, b, c = np.moveaxis(scene.triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    ahead = normals @ view.axes[2]
    # Some meshes are inside out: what is seen is the side that faces the eye.
    normals = np.where(ahead[:, None] > 0.0, -normals, normals)
    lamp = np.maximum(normals @ view.lamp, 0.0)
    bright = 0.5 + 0.12 * normals[:, 2] + 0.5 * lamp
    lit = scene.colors.copy()
    lit[:, :3] *= (bright * (0.7 + 0.3 * np.abs(ahead)))[:, None]
    return np.clip(lit, 0.0, 1.0)


def _shadow(view: View, scene: Scene) -> PathCollection:
    """The shadow of what cannot be seen through, on the floor."""
    opaque = scene.triangles[scene.colors[:, 3] == 1.0]
    height = np.maximum(opaque[..., 2] - scene.floor, 0.0)
    spots, _ = view.project(opaque - height[..., None] * (view.lamp / view.lamp[2]))
    # All in one sense of rotation, so that two of them together are no hole.
    (x1, y1), (x2, y2) = (np.moveaxis(spots[:, k] - spots[:, 0], 1, 0) for k in (1, 2))
    spots = np.where((x1 * y2 < x2 * y1)[:, None, None], spots[:, ::-1], spots)
    path = Path.make_compound_path_from_polys(spots)
    return PathCollection(
        [path],
        facecolors="black",
        alpha=SHADE,
        linewidths=0.0,
        rasterized=True,
        zorder=2.0,
    )


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
