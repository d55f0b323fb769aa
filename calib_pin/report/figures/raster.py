"""Triangles in perspective as an image: depth buffer, light, outlines, shadow.

Everything is arithmetic of numpy, element by element: the same triangles give the same
image, whatever the number of threads, and no graphics card or library is asked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from calib_pin.kinematics.shapes import Color, Surface
from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.pixels import Ints, covered, nearest

EDGE = math.cos(math.radians(40.0))
"""Cosine of the angle of triangles from which on their common edge looks sharp."""

KEY, FILL = (-0.45, 0.45, 0.77), (0.80, 0.30, 0.35)
"""Directions to both lamps: to the right, back to the eye, and up."""

STEP = 0.018
"""Jump of the depth at which an outline is drawn, by the depth of the whole."""

OCCLUSION = ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1))
"""Directions in which neighbors may keep the light away."""


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

    def scaled(self, factor: float) -> View:
        """The same image of other pixels."""
        width, height = (round(factor * k) for k in self.size)
        center, focal = factor * self.center, factor * self.focal
        return View(self.eye, self.axes, focal, center, (width, height))

    def toward(self, lamp: tuple[float, float, float]) -> Floats:
        """Unit vector to a lamp that stands where it does for every eye, shape (3,)."""
        right, up = self.axes[0], np.array([0.0, 0.0, 1.0])
        found = np.array(lamp) @ np.stack([right, np.cross(right, up), up])
        return np.asarray(found / np.sqrt((found**2).sum()))

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Pixels (..., 2) and depths (...) [m] of points (..., 3)."""
        seen = np.einsum("kj,...j->...k", self.axes, points - self.eye)
        depth = np.maximum(seen[..., 2], 1e-6)
        return self.focal * seen[..., :2] / depth[..., None] + self.center, depth


@dataclass(frozen=True)
class Solid:
    """A surface where it stands.

    Attributes:
        surface: Its triangles.
        pose: Where it stands, shape (4, 4).
        color: Red, green and blue from 0 to 1.
        opacity: 1 for what cannot be seen through.
    """

    surface: Surface
    pose: Floats
    color: Color
    opacity: float = 1.0


@dataclass(frozen=True)
class Picture:
    """Nearness and color of every pixel of an image.

    Attributes:
        nearness: One by the depth, shape (h, w) [1/m]; 0 where nothing is.
        color: Lit colors from 0 to 1, shape (h, w, 3).
        depth: Extent of the scene along the view [m].
    """

    nearness: Floats
    color: Floats
    depth: float


def picture(view: View, solids: Sequence[Solid]) -> Picture:
    """The lit solids in a view."""
    corners, normals, owner = _triangles(solids)
    spots, depths = view.project(corners)
    nearness, winner = nearest(view.size, spots, 1.0 / depths)
    shown = winner >= 0
    chosen = winner[shown]
    normal = _smooth(spots[chosen], normals[chosen], shown)
    ahead = np.einsum("nj,j->n", normal, view.axes[2])
    # Some meshes are inside out: what is seen is the side that faces the eye.
    normal = np.where(ahead[:, None] > 0.0, -normal, normal)
    colors = np.array([solid.color for solid in solids])[owner[chosen]]
    lit = np.zeros((*nearness.shape, 3), np.float32)
    lit[shown] = colors * _light(view, normal, np.abs(ahead))[:, None]
    extent = float(np.ptp(depths)) if depths.size else 1.0
    # What is smooth is found from every second pixel.
    left = widened(_ambient(nearness[::2, ::2], view.scaled(0.5)), 2)
    lit[shown] *= left[: len(shown), : shown.shape[1]][shown][:, None]
    return Picture(nearness, lit, extent)


def shadow(view: View, solids: Sequence[Solid], floor: float) -> Floats:
    """How dark the floor is below solids, 0 to 1, shape (h, w)."""
    corners, _, _ = _triangles(solids)
    height = np.maximum(corners[..., 2] - floor, 0.0)
    key = view.toward(KEY)
    fallen = corners - height[..., None] * (key / key[2])
    spots, _ = view.project(fallen)
    dark, size = np.zeros(view.size[::-1]), max(3, round(0.012 * view.size[0]))
    for _, row, column in covered(spots, view.size):
        dark[row, column] = 1.0
    for _ in range(3):
        dark = uniform_filter(dark, size, mode="constant")
    # It fades before the image ends.
    from_rim = [np.minimum(np.arange(k), np.arange(k)[::-1]) for k in dark.shape]
    down, across = (np.minimum(rim / (3.0 * size), 1.0) for rim in from_rim)
    return np.asarray(dark * down[:, None] * across)


def outlines(seen: Picture) -> NDArray[np.bool_]:
    """Pixels at the rim of something in front of something else, shape (h, w)."""
    z = 1.0 / np.where(seen.nearness > 0.0, seen.nearness, 1e-9)
    result = np.zeros(z.shape, bool)
    for axis in (0, 1):
        for step in (1, -1):
            beyond = _moved(z, step, axis) - z > STEP * seen.depth
            result |= beyond & (seen.nearness > 0.0)
    return result


def balls(
    view: View, seen: Picture, points: Floats, radius: float, colors: Floats
) -> tuple[Ints, Floats, NDArray[np.bool_]]:
    """Balls at points (N, 3) [m] among what is seen.

    Args:
        view: The view.
        seen: What else is seen.
        points: Their middles.
        radius: Their radius [m].
        colors: Red, green and blue from 0 to 1, shape (N, 3).

    Returns:
        Numbers of the pixels that show a ball, row by row, shape (n,), their lit
        colors, shape (n, 3), and whether the ball stands behind something, shape (n,).
    """
    width, height = view.size
    spots, depths = view.project(points)
    sizes = np.maximum(view.focal * radius / depths, 1.0)
    reach = math.ceil(float(sizes.max(initial=1.0)))
    grid = np.arange(-reach, reach + 1)
    first = np.floor(spots).astype(np.int64)
    column, row = np.broadcast_arrays(
        first[:, None, None, 0] + grid, first[:, None, None, 1] + grid[:, None]
    )
    x, y = (
        (pixel + 0.5 - spots[:, None, None, k]) / sizes[:, None, None]
        for k, pixel in enumerate((column, row))
    )
    inside = (x**2 + y**2 < 1.0) & (column >= 0) & (column < width)
    inside &= (row >= 0) & (row < height)
    ball = np.nonzero(inside)[0]
    pixel, x, y = (row * width + column)[inside], x[inside], y[inside]
    bulge = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    near = 1.0 / (depths[ball] - radius * bulge)
    best, winner = np.zeros(width * height), np.full(width * height, -1)
    np.maximum.at(best, pixel, near)
    first_one = near == best[pixel]
    winner[pixel[first_one]] = np.flatnonzero(first_one)
    shown = np.flatnonzero(winner >= 0)
    k = winner[shown]
    local = np.stack([x[k], y[k], -bulge[k]], axis=1)
    bright = _light(view, np.einsum("nj,jk->nk", local, view.axes), bulge[k])
    lit = colors[ball[k]] * (0.35 + 0.75 * bright[:, None])
    return shown, lit, best[shown] < seen.nearness.ravel()[shown]


def shrunk(image: Floats, factor: int) -> Floats:
    """Means of squares of pixels, shape (h f, w f, ...) -> (h, w, ...)."""
    parts = [image[k::factor, j::factor] for k in range(factor) for j in range(factor)]
    return np.asarray(sum(parts[1:], parts[0]) / factor**2)


def widened(image: Floats, factor: int) -> Floats:
    """Each pixel as a square of pixels, shape (h, w) -> (h f, w f)."""
    return np.repeat(np.repeat(image, factor, axis=0), factor, axis=1)


def _triangles(solids: Sequence[Solid]) -> tuple[Floats, Floats, Ints]:
    """Corners (T, 3, 3) [m], their normals, and the solid of each triangle (T,)."""
    corners, normals, owner = [], [], []
    for k, solid in enumerate(solids):
        triangles, R = solid.surface.triangles, solid.pose[:3, :3]
        moved = np.einsum("ij,vj->vi", R, solid.surface.vertices) + solid.pose[:3, 3]
        corners.append(moved[triangles])
        normals.append(_normals(corners[-1], triangles, len(moved)))
        owner.append(np.full(len(triangles), k))
    empty = np.zeros((0, 3, 3))
    return (
        np.concatenate([empty, *corners]),
        np.concatenate([empty, *normals]),
        np.concatenate([np.zeros(0, np.int64), *owner]),
    )


def _normals(corners: Floats, triangles: Ints, count: int) -> Floats:
    """Unit normals at the corners of triangles, of smooth surfaces means, (T, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    flat = np.cross(b - a, c - a)
    means = np.stack(
        [
            np.bincount(triangles.ravel(), np.repeat(flat[:, k], 3), count).astype(
                float
            )
            for k in range(3)
        ],
        axis=1,
    )
    flat, smooth = _unit(flat), _unit(means)[triangles]
    near = np.einsum("tkj,tj->tk", smooth, flat) > EDGE
    return np.where(near[..., None], smooth, flat[:, None])


def _unit(vectors: Floats) -> Floats:
    """Vectors of length one, or zero, shape (..., 3)."""
    sizes = np.sqrt((vectors**2).sum(axis=-1, keepdims=True))
    return np.asarray(vectors / np.maximum(sizes, 1e-300))


def _smooth(spots: Floats, normals: Floats, shown: NDArray[np.bool_]) -> Floats:
    """Normals (n, 3) of the pixels that show something, between those of corners."""
    row, column = np.nonzero(shown)
    middle = np.stack([column + 0.5, row + 0.5], axis=1)
    (x1, y1), (x2, y2), (x, y) = (
        (part - spots[:, 0]).T for part in (spots[:, 1], spots[:, 2], middle)
    )
    area = x1 * y2 - x2 * y1
    area = np.where(np.abs(area) > 1e-9, area, np.inf)
    second = np.clip((x * y2 - x2 * y) / area, 0.0, 1.0)
    third = np.clip((x1 * y - x * y1) / area, 0.0, 1.0)
    parts = np.stack([np.maximum(1.0 - second - third, 0.0), second, third], axis=1)
    return _unit(np.einsum("nk,nkj->nj", parts, normals))


def _light(view: View, normal: Floats, facing: Floats) -> Floats:
    """Brightness of surfaces, shape (n,): two lamps, the sky, and darker rims."""
    sky = 0.5 + 0.5 * normal[:, 2]
    key, fill = (
        np.maximum(np.einsum("nj,j->n", normal, view.toward(lamp)), 0.0)
        for lamp in (KEY, FILL)
    )
    bright = 0.42 + 0.22 * sky + 0.48 * key + 0.14 * fill + 0.16 * key**24
    return np.asarray(bright * (0.72 + 0.28 * facing))


def _ambient(nearness: Floats, view: View) -> Floats:
    """The part of the light that neighbors in front leave, 0 to 1, shape (h, w)."""
    z = np.where(nearness > 0.0, 1.0 / np.maximum(nearness, 1e-9), 1e9)
    kept = np.zeros(z.shape)
    reach = 0.012 * view.size[0]
    meters = reach * z / view.focal
    for scale in (0.4, 1.0):
        for right, down in OCCLUSION:
            length = scale * reach / math.hypot(right, down)
            step_x, step_y = round(right * length), round(down * length)
            other = _moved(_moved(z, step_x, 1), step_y, 0)
            rise = (z - other) / (scale * meters)
            # What is far in front is another thing, and keeps no light away.
            kept += np.clip(rise - 0.35, 0.0, 1.0) * (rise < 4.0)
    return np.asarray(1.0 - 0.55 * kept / (2 * len(OCCLUSION)))


def _moved(image: Floats, step: int, axis: int) -> Floats:
    """An image of the pixels that lie some steps further; the rim is repeated."""
    count = image.shape[axis]
    return np.take(image, np.clip(np.arange(count) + step, 0, count - 1), axis=axis)
