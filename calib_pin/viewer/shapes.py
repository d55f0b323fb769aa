"""The shapes of a robot's links, from the URDF or in place of missing ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError
from calib_pin.io.meshes import locate_mesh, read_mesh
from calib_pin.io.urdf import locate_robot
from calib_pin.kinematics.chain import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.viewer.surfaces import Surface, ball, box, capsule, creased, cylinder

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
        package_dirs: Folders of packages, see `io.meshes.locate_mesh`.
        progress: Told the part that is done, 0 to 1.

    Example:
        >>> from calib_pin.io.urdf import load_robot
        >>> shapes = robot_shapes(load_robot("example:panda"))
        >>> len(shapes.parts), shapes.missing
        (11, ())
    """
    root = fromstring(robot.source)
    links = root.findall("link")
    reader = _Reader(locate_robot(robot.file).resolve(), package_dirs)
    colors = {m.get("name", ""): _rgb(m) for m in root.iterfind("material")}
    parts: list[Shape] = []
    missing: list[str] = []
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
    """Reads geometry, each mesh file only once.

    Attributes:
        urdf: Path of the URDF.
        package_dirs: Folders of packages.
        known: Surfaces by file and scale.
    """

    urdf: Path
    package_dirs: Sequence[str | Path]
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
            vertices, triangles = read_mesh(path, _vector(key[1]).tolist())
            if len(triangles) == 0:
                raise InputError("the mesh is empty", file=path)
            self.known[key] = creased(Surface(vertices, triangles))
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
