"""The pixels that triangles cover, and which of them is the nearest in each."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

Ints = NDArray[np.int64]

FRAGMENTS = 4_000_000
"""Pixels of triangles that are held at once."""


def covered(spots: Floats, size: tuple[int, int]) -> Iterator[tuple[Ints, Ints, Ints]]:
    """Pixels whose middle lies in triangles with corners at (T, 3, 2) pixels.

    Yields:
        Triangle, row and column of pixels within an image of some width and height,
        part by part.
    """
    width, height = size
    y = spots[..., 1]
    first = np.ceil(np.clip(y.min(axis=1), 0.0, height) - 0.5).astype(np.int64)
    last = np.ceil(np.clip(y.max(axis=1), 0.0, height) - 0.5).astype(np.int64)
    outside = (spots[..., 0].max(axis=1) < 0.0) | (spots[..., 0].min(axis=1) > width)
    rows = np.where(outside, 0, last - first)
    triangle, row = _spread(np.flatnonzero(rows), first, rows)
    at, corners = row + 0.5, spots[triangle]
    low, high = np.full(len(at), np.inf), np.full(len(at), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        (xa, ya), (xb, yb) = corners[:, a].T, corners[:, b].T
        crossing = (ya <= at) != (yb <= at)
        slope = (xb - xa) / np.where(crossing, yb - ya, 1.0)
        x = xa + (at - ya) * slope
        low = np.where(crossing, np.minimum(low, x), low)
        high = np.where(crossing, np.maximum(high, x), high)
    crossed = high >= low
    start, stop = (
        np.ceil(np.clip(np.where(crossed, x, 0.0), 0.0, width) - 0.5).astype(np.int64)
        for x in (low, high)
    )
    lengths = stop - start
    batch = np.cumsum(lengths) // FRAGMENTS
    for k in range(int(batch[-1]) + 1 if len(batch) else 0):
        span, column = _spread(
            np.flatnonzero((batch == k) & (lengths > 0)), start, lengths
        )
        yield triangle[span], row[span], column


def _spread(which: Ints, first: Ints, counts: Ints) -> tuple[Ints, Ints]:
    """Each of `which` as often as it counts, with the numbers from its first one on."""
    many = counts[which]
    owner = np.repeat(which, many)
    start = np.repeat(np.cumsum(many) - many, many)
    return owner, first[owner] + np.arange(len(owner)) - start


def nearest(
    size: tuple[int, int], spots: Floats, nearness: Floats
) -> tuple[Floats, Ints]:
    """Nearness (h, w) and number (h, w) of the triangle seen in each pixel, or -1.

    Args:
        size: Width and height of the image [px].
        spots: Corners of T triangles, shape (T, 3, 2) [px].
        nearness: One by their depths, shape (T, 3) [1/m].
    """
    width, height = size
    best, winner = np.zeros(width * height), np.full(width * height, -1)
    origin, across, down = _plane(spots, nearness)
    for triangle, row, column in covered(spots, size):
        # One by the depth is linear in the image.
        near = (
            origin[triangle]
            + across[triangle] * (column + 0.5)
            + down[triangle] * (row + 0.5)
        )
        pixel = row * width + column
        np.maximum.at(best, pixel, near)
        first = near == best[pixel]
        winner[pixel[first]] = triangle[first]
    return best.reshape(height, width), winner.reshape(height, width)


def _plane(spots: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Linear functions of the pixel with values (T, 3) at corners (T, 3, 2)."""
    (x1, y1), (x2, y2) = (np.moveaxis(spots[:, k] - spots[:, 0], 1, 0) for k in (1, 2))
    v1, v2 = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
    area = x1 * y2 - x2 * y1
    # What is seen from its edge has no plane: it is as near as its first corner.
    usable = np.abs(area) > 1e-3
    area = np.where(usable, area, 1.0)
    across = np.where(usable, (v1 * y2 - v2 * y1) / area, 0.0)
    down = np.where(usable, (x1 * v2 - x2 * v1) / area, 0.0)
    origin = values[:, 0] - across * spots[:, 0, 0] - down * spots[:, 0, 1]
    return origin, across, down
