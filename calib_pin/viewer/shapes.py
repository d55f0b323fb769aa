"""The shapes of a robot's links, from the URDF or in place of missing ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from calib_pin.errors import InputError
from calib_pin.io.meshes import MeshReader
from calib_pin.io.packages import locate_mesh
from calib_pin.io.urdf import locate_robot
from calib_pin.io.urdf_bytes import parse_document
from calib_pin.kinematics.chain import Robot
from calib_pin.kinematics.spatial import Floats

SIDES = 32
"""Sides of a round surface."""

EDGE = math.radians(35.0)
"""Angle between triangles from which on their common edge looks sharp [rad]."""


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


def creased(surface: Surface) -> Surface:
    """The same surface with vertices of its own for each smooth part.

    A browser averages the normals of the triangles at a vertex, so that edges between
    triangles that share theirs look round.
    """
    corners, triangles = surface.vertices, surface.triangles
    sides = np.diff(corners[triangles], axis=1)
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edge = ends[:, 0] * len(corners) + ends[:, 1]
    order = np.argsort(edge, kind="stable")
    owner, shared = order // 3, np.diff(edge[order]) == 0
    first, second = owner[:-1][shared], owner[1:][shared]
    flat = np.einsum("ij,ij->i", normals[first], normals[second]) > math.cos(EDGE)
    links = (np.ones(flat.sum()), (first[flat], second[flat]))
    count, part = connected_components(
        coo_array(links, shape=(len(triangles), len(triangles))), directed=False
    )
    used, index = np.unique(triangles * count + part[:, None], return_inverse=True)
    return Surface(corners[used // max(count, 1)], index.reshape(-1, 3))


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

THICKNESS = 0.12
"""Radius of a stand-in for a link, by its length."""

THIN, THICK = 0.012, 0.05
"""Least and largest radius of a stand-in [m]."""


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


def robot_shapes(
    robot: Robot,
    package_dirs: Sequence[str | Path] = (),
    progress: Callable[[float], None] | None = None,
) -> Shapes:
    """The appearance of a robot.

    A link looks like its visual elements, or else its collision elements. Where a mesh
    is missing, simple solids between the link's joints stand in for all of the link;
    so they do for every link of a robot that has no shapes at all.

    Args:
        robot: The robot.
        package_dirs: Folders of packages, see `io.packages.locate_mesh`.
        progress: Told the part that is done, 0 to 1.
    """
    root = fromstring(parse_document(robot.source).plain)
    links = root.findall("link")
    urdf = locate_robot(robot.file).resolve()
    colors = {m.get("name", ""): _rgb(m) for m in root.iterfind("material")}
    parts: list[Shape] = []
    missing: list[str] = []
    with MeshReader() as meshes:
        reader = _Reader(urdf, package_dirs, meshes)
        for k, link in enumerate(links):
            if progress is not None:
                progress(k / len(links))
            found, lost = _of_link(link, reader, colors)
            missing += lost
            parts += _stand_in(link, root) if lost else found
    if not parts:
        parts = [shape for link in links for shape in _stand_in(link, root)]
    return Shapes(tuple(parts), tuple(dict.fromkeys(missing)))


def _of_link(
    link: Element, reader: _Reader, colors: dict[str, Color | None]
) -> tuple[list[Shape], list[str]]:
    """The shapes of a link, and its meshes that are missing."""
    found: list[Shape] = []
    missing: list[str] = []
    for element in link.findall("visual") or link.findall("collision"):
        geometry = element.find("geometry/*")
        if geometry is None:
            continue
        material = element.find("material")
        color = None
        if material is not None:
            color = _rgb(material) or colors.get(material.get("name", ""))
        try:
            surface = reader.surface(geometry)
            placement = _origin(element)
        except (InputError, ValueError):
            missing.append(geometry.get("filename", geometry.tag))
        else:
            found.append(Shape(link.get("name", ""), placement, surface, color))
    return found, missing


@dataclass(frozen=True)
class _Reader:
    """Reads the geometry of a URDF, each mesh file only once."""

    urdf: Path
    package_dirs: Sequence[str | Path]
    meshes: MeshReader
    known: dict[tuple[Path, str], Surface] = field(default_factory=dict)

    def surface(self, geometry: Element) -> Surface:
        """The surface of a geometry element.

        Raises:
            InputError: If its mesh is missing or cannot be read.
            ValueError: If it is none, or has a wrong number.
        """
        if geometry.tag == "mesh":
            return self._mesh(geometry.get("filename", ""), geometry.get("scale"))
        radius, length = (float(geometry.get(k, "0")) for k in ("radius", "length"))
        if geometry.tag == "box":
            return creased(box(_vector(geometry.get("size"))))
        if geometry.tag == "sphere":
            return ball(radius)
        if geometry.tag == "cylinder":
            return creased(cylinder(radius, length))
        if geometry.tag == "capsule":
            return capsule(radius, length)
        raise ValueError(f"there is no geometry '{geometry.tag}'")

    def _mesh(self, written: str, scale: str | None) -> Surface:
        path = locate_mesh(written, self.urdf, self.package_dirs)
        if path is None:
            raise InputError("no such file", file=written)
        key = path, scale or "1 1 1"
        if key not in self.known:
            mesh = self.meshes.read(path, _vector(key[1]))
            self.known[key] = creased(Surface(*mesh))
        return self.known[key]


def _stand_in(link: Element, root: Element) -> Iterator[Shape]:
    """Capsules from a link's origin to the joints that it carries, or else a ball."""
    name = link.get("name", "")
    ends = [
        _origin(joint)[:3, 3]
        for joint in root.iterfind("joint")
        if (parent := joint.find("parent")) is not None and parent.get("link") == name
    ]
    ends = [end for end in ends if np.linalg.norm(end) > THIN]
    for end in ends:
        length = float(np.linalg.norm(end))
        placement = np.eye(4)
        z = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length)
        placement[:3, :3], placement[:3, 3] = z.toRotationMatrix(), 0.5 * end
        radius = float(np.clip(THICKNESS * length, THIN, THICK))
        yield Shape(name, placement, capsule(radius, length))
    if not ends:
        yield Shape(name, np.eye(4), ball(2.0 * THIN))


def _origin(element: Element) -> Floats:
    """The pose of an `<origin>`, shape (4, 4)."""
    origin = element.find("origin")
    result = np.eye(4)
    if origin is not None:
        roll, pitch, yaw = _vector(origin.get("rpy"))
        result[:3, :3] = pin.rpy.rpyToMatrix(roll, pitch, yaw)
        result[:3, 3] = _vector(origin.get("xyz"))
    return result


def _vector(text: str | None) -> Floats:
    """Three numbers; zeros where there are none."""
    x, y, z = map(float, (text or "0 0 0").split())
    return np.array([x, y, z])


def _rgb(material: Element) -> Color | None:
    """The color that a material states, if it does."""
    color = material.find("color")
    if color is None:
        return None
    try:
        red, green, blue, _ = map(float, color.get("rgba", "").split())
    except ValueError:
        return None
    return red, green, blue
