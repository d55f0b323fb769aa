"""The shapes of a robot's links: simple ones, meshes of any format, and stand-ins."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.errors import InputError, RobotError
from calib_pin.io.children import Reader
from calib_pin.io.files import read_bytes
from calib_pin.io.packages import locate_mesh
from calib_pin.io.urdf import locate_robot
from calib_pin.io.urdf_tree import FARTHEST, NUMBERS, Document, Element, parse_document
from calib_pin.kinematics import shapes
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import Color, Shape, Shapes, Surface
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.stand_ins import stand_ins

LARGEST = 1 << 27
"""Bytes of the largest mesh file."""

TRIANGLES = 1_000_000
"""Triangles of the largest mesh: collision geometry takes half a kilobyte of each."""

STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
"""A triangle of a binary STL file."""

SIMPLE: Mapping[str, Callable[..., Surface]] = {
    "box": lambda *size: shapes.box(np.array(size)),
    "sphere": shapes.ball,
    "cylinder": shapes.cylinder,
    "capsule": shapes.capsule,
}
"""Surfaces by the tag of a shape, from its numbers."""


class MeshReader(Reader):
    """Reads the mesh files of a robot, each once, in a `with` block.

    Files of other formats than binary STL are read in a process of their own.

    Args:
        robot: Name of the robot, as for `io.urdf.load_robot`.
        package_dirs: Folders of packages, see `io.packages.locate_mesh`.
    """

    def __init__(self, robot: str, package_dirs: Sequence[str | Path] = ()) -> None:
        """Nothing is read yet."""
        super().__init__()
        self.file, self.package_dirs = Path(robot), package_dirs
        with suppress(RobotError):  # The package it came from may not be here.
            self.file = locate_robot(robot).resolve()
        self._known: dict[tuple[object, ...], Surface] = {}

    def read(
        self, written: str | Path, scale: Sequence[float] = (1.0, 1.0, 1.0)
    ) -> Surface:
        """The surface in a mesh file.

        Args:
            written: Its name in the robot's file.
            scale: Factors of the coordinates, shape (3,).

        Raises:
            InputError: If there is no such file or a surface in it cannot be used.
        """
        path = locate_mesh(str(written), self.file, self.package_dirs)
        if path is None:
            hint = "--package-dir DIR, the folder of its package"
            if "package://" not in str(written):
                hint = "a path from the folder of the URDF"
            raise InputError("does not exist", allowed=hint)
        key = (path, *scale)
        if key not in self._known:
            self._known[key] = _surface(self._corners(path), path, np.array(scale))
        return self._known[key]

    def shape(
        self, document: Document, element: Element
    ) -> tuple[str, list[Any]] | None:
        """The shape of a visual or collision element, if it has one.

        Args:
            document: The URDF.
            element: The element.

        Returns:
            Its kind, and its numbers or the surface of its mesh.

        Raises:
            InputError: If a mesh cannot be used, or there is no such shape; its value
                is the name of the mesh.
        """
        geometry = element.child("geometry")
        if geometry is None or not geometry.children:
            return None
        shape = geometry.children[0]
        name = shape.attributes.get("filename", shape.tag)
        if shape.tag in SIMPLE:
            sizes = NUMBERS[shape.tag].items()
            numbers = [document.numbers(shape, key, count) for key, count in sizes]
            return shape.tag, np.concatenate(numbers).tolist()
        try:
            if shape.tag != "mesh":
                raise InputError("is no shape", allowed=", ".join(SIMPLE))
            scale = [float(x) for x in shape.attributes.get("scale", "1 1 1").split()]
            return shape.tag, [self.read(name, scale)]
        except InputError as error:
            reason = f"the collision mesh '{name}' of {shape.owner} {error.reason}"
            hint = error.allowed or "another mesh"
            allowed = f"{hint}, or no check of collisions (plan --ignore-collisions)"
            raise document.error(shape, reason, value=name, allowed=allowed) from None

    def _corners(self, path: Path) -> Floats:
        """Corners of the triangles in a file, shape (F, 3, 3)."""
        data = read_bytes(path, LARGEST)
        count = int.from_bytes(data[80:84], "little")
        if len(data) == 84 + 50 * count:  # It is binary STL.
            corners = np.frombuffer(data, STL, offset=84)["corners"]
            return corners.astype(float)
        _, answer = self.ask("mesh", path)
        return np.frombuffer(answer, "<f8").reshape(-1, 3, 3)


def _surface(corners: Floats, path: Path, scale: Floats) -> Surface:
    """The surface of triangles by their corners, shape (F, 3, 3), if it can be used."""
    if not 1 <= len(corners) <= TRIANGLES:
        reason = f"has {len(corners)} triangles, not 1 to {TRIANGLES}"
        raise InputError(reason, file=path)
    # Triangles share corners, in the order in which they first come.
    every, first, place = np.unique(
        corners.reshape(-1, 3), axis=0, return_index=True, return_inverse=True
    )
    if len(every) < 3:  # Of a single one, the library gives numbers of no meaning.
        raise InputError("has less than 3 different vertices", file=path)
    order = np.argsort(first)
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = every[order] * scale
    far = ~(np.abs(vertices) <= FARTHEST).all(axis=1)
    if far.any():
        written = " ".join(f"{x:.6g}" for x in vertices[far.argmax()])
        reason = f"has the vertex ({written}), not within {FARTHEST:g} m"
        raise InputError(reason, file=path)
    return Surface(vertices, np.argsort(order)[place.ravel()].reshape(-1, 3))


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
    document = parse_document(robot.source)
    links = document.named("link")
    colors = {name: _rgb(m) for name, m in document.named("material").items()}
    parts, missing = list[Shape](), dict[str, None]()
    with MeshReader(robot.file, package_dirs) as meshes:
        for k, (name, link) in enumerate(links.items()):
            if progress is not None:
                progress(k / len(links))
            found, lost = list[Shape](), dict[str, None]()
            for element in link.all("visual") or link.all("collision"):
                try:
                    if (shape := meshes.shape(document, element)) is not None:
                        kind, values = shape
                        simple = SIMPLE[kind](*values) if kind in SIMPLE else None
                        place = document.origin(element).homogeneous
                        surface, color = simple or values[0], _color(element, colors)
                        found.append(Shape(name, place, surface, color))
                except InputError as error:
                    lost[str(error.value)] = None
            missing |= lost
            parts += stand_ins(robot, name) if lost else found
    return Shapes(tuple(parts or stand_ins(robot)), tuple(missing))


def _color(element: Element, colors: Mapping[str, Color | None]) -> Color | None:
    """The color of a visual element, of its own or by the name of a material."""
    material = element.child("material")
    if material is None:
        return None
    return _rgb(material) or colors.get(material.attributes.get("name", ""))


def _rgb(material: Element) -> Color | None:
    """The color that a material has, if it does."""
    for color in material.all("color"):
        with suppress(ValueError):
            words = color.attributes.get("rgba", "").split()
            red, green, blue, _ = map(float, words)
            return red, green, blue
    return None
