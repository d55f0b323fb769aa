"""Surfaces of simple solids, and the shapes of a robot's links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

SIDES = 32
"""Sides of a round surface."""


@dataclass(frozen=True)
class Surface:
    """Triangles in one frame.

    Attributes:
        vertices: Corners, shape (V, 3) [m].
        triangles: The corners of each triangle, shape (F, 3), counter-clockwise as
            seen from outside.
    """

    vertices: Floats
    triangles: NDArray[np.int64]


def box(size: Floats) -> Surface:
    """A box about the origin by its edge lengths, shape (3,) [m]."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    # Four corners of each face in turn about its outward normal.
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
    faces += [(0, 2, 6, 4), (1, 5, 7, 3)]
    halves = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    return Surface(0.5 * size * corners, np.array(halves, np.int64))


def cylinder(radius: float, length: float) -> Surface:
    """A cylinder along z about the origin [m]."""
    z = 0.5 * length
    return _revolved([(0.0, -z), (radius, -z), (radius, z), (0.0, z)])


def ball(radius: float) -> Surface:
    """A ball about the origin [m]."""
    return capsule(radius, 0.0)


def capsule(radius: float, length: float) -> Surface:
    """A cylinder along z about the origin, with half a ball at either end [m]."""
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SIDES // 2 + 2)
    ends = 0.5 * length * np.sign(angles.round(12))
    profile = np.column_stack([np.cos(angles), np.sin(angles)]) * radius
    return _revolved([(r, z + end) for (r, z), end in zip(profile, ends, strict=True)])


def simplified(surface: Surface, cell: float) -> Surface:
    """The same surface with one vertex for all those in a cube of some edge [m].

    Triangles that become lines are left out (J. Rossignac, P. Borrel, "Multi-resolution
    3D approximations for rendering complex scenes", 1993).
    """
    cubes = np.floor(surface.vertices / cell).astype(np.int64)
    cubes -= cubes.min(axis=0)
    across, up, _ = cubes.max(axis=0) + 1
    number = cubes[:, 0] + across * (cubes[:, 1] + up * cubes[:, 2])
    _, place, counts = np.unique(number, return_inverse=True, return_counts=True)
    means = [np.bincount(place, part) / counts for part in surface.vertices.T]
    a, b, c = moved = place[surface.triangles].T
    kept = (a != b) & (b != c) & (c != a)
    return Surface(np.stack(means, axis=1), moved.T[kept])


def _revolved(profile: list[tuple[float, float]]) -> Surface:
    """The surface that K points (radius, z), upwards, sweep about the z axis."""
    turns = 2.0 * np.pi * np.arange(SIDES) / SIDES
    radius, z = np.array(profile).T
    around = np.stack([np.cos(turns), np.sin(turns), np.ones(SIDES)], axis=1)
    rings = around * np.stack([radius, radius, z], axis=1)[:, None]
    low = np.arange(SIDES * (len(profile) - 1))
    # The neighbor in the same ring.
    beside = low // SIDES * SIDES + (low + 1) % SIDES
    quads = np.stack([low, beside, beside + SIDES, low + SIDES], axis=1)
    triangles = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return Surface(rings.reshape(-1, 3), triangles)


Color = tuple[float, float, float]


@dataclass(frozen=True)
class Shape:
    """A part of a link.

    Attributes:
        link: Name of the link.
        placement: Its pose in the link, shape (4, 4).
        surface: Its surface.
        color: Red, green and blue from 0 to 1; None where the URDF states none.
    """

    link: str
    placement: Floats
    surface: Surface
    color: Color | None = None


@dataclass(frozen=True)
class Shapes:
    """All shapes of a robot.

    Attributes:
        parts: The shapes.
        missing: Meshes that are not there or cannot be read, as the URDF names them.
    """

    parts: tuple[Shape, ...]
    missing: tuple[str, ...] = ()
