"""The shapes of a robot's links, from the URDF or in place of missing ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError, RobotError
from calib_pin.io.meshes import MeshReader
from calib_pin.io.packages import locate_mesh
from calib_pin.io.urdf import locate_robot
from calib_pin.io.urdf_bytes import parse_document
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import (
    Color,
    Shape,
    Shapes,
    Surface,
    ball,
    box,
    capsule,
    cylinder,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.stand_ins import stand_ins


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
    try:
        urdf = locate_robot(robot.file).resolve()
    except RobotError:  # The package it came from is not installed here.
        urdf = Path(robot.file)
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
            parts += stand_ins(robot, link.get("name", "")) if lost else found
    if not parts:
        parts = stand_ins(robot)
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
            return box(_vector(geometry.get("size")))
        if geometry.tag == "sphere":
            return ball(radius)
        if geometry.tag == "cylinder":
            return cylinder(radius, length)
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
            self.known[key] = Surface(*mesh)
        return self.known[key]


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
