"""The shapes of a robot's links, from the URDF or in place of missing ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from calib_pin.errors import InputError
from calib_pin.io.meshes import MeshReader
from calib_pin.io.urdf_bytes import Document, Element, parse_document, read_origin
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
    document = parse_document(robot.source)
    elements = document.root.children
    links = [element for element in elements if element.tag == "link"]
    materials = (element for element in elements if element.tag == "material")
    colors = {m.attributes.get("name", ""): _rgb(m) for m in materials}
    parts: list[Shape] = []
    missing: list[str] = []
    with MeshReader(robot.file, package_dirs) as meshes:
        for k, link in enumerate(links):
            if progress is not None:
                progress(k / len(links))
            found, lost = _of_link(document, link, meshes, colors)
            missing += lost
            name = link.attributes.get("name", "")
            parts += stand_ins(robot, name) if lost else found
    if not parts:
        parts = stand_ins(robot)
    return Shapes(tuple(parts), tuple(dict.fromkeys(missing)))


def _of_link(
    document: Document,
    link: Element,
    meshes: MeshReader,
    colors: dict[str, Color | None],
) -> tuple[list[Shape], list[str]]:
    """The shapes of a link, and its meshes that are missing."""
    found: list[Shape] = []
    missing: list[str] = []
    for element in link.all("visual") or link.all("collision"):
        geometry = element.child("geometry")
        if geometry is None or not geometry.children:
            continue
        shape, color = geometry.children[0], None
        if material := element.child("material"):
            color = _rgb(material) or colors.get(material.attributes.get("name", ""))
        try:
            place = read_origin(document, element).homogeneous
            surface, name = _surface(shape, meshes), link.attributes.get("name", "")
            found.append(Shape(name, place, surface, color))
        except (InputError, ValueError):
            missing.append(shape.attributes.get("filename", shape.tag))
    return found, missing


def _surface(shape: Element, meshes: MeshReader) -> Surface:
    """The surface of a shape in a geometry.

    Raises:
        InputError: If its mesh is missing or cannot be read.
        ValueError: If it is none, or has a wrong number.
    """

    def numbers(key: str, usual: str) -> list[float]:
        return [float(word) for word in shape.attributes.get(key, usual).split()]

    if shape.tag == "mesh":
        name = shape.attributes.get("filename", "")
        return meshes.read(name, numbers("scale", "1 1 1"))
    if shape.tag == "box":
        return box(np.array(numbers("size", "0 0 0")))
    (radius,), (length,) = numbers("radius", "0"), numbers("length", "0")
    if shape.tag == "sphere":
        return ball(radius)
    if shape.tag == "cylinder":
        return cylinder(radius, length)
    if shape.tag == "capsule":
        return capsule(radius, length)
    raise ValueError(f"there is no shape '{shape.tag}'")


def _rgb(material: Element) -> Color | None:
    """The color that a material has, if it does."""
    color = material.child("color")
    words = [] if color is None else color.attributes.get("rgba", "").split()
    try:
        red, green, blue, _ = map(float, words)
    except ValueError:
        return None
    return red, green, blue
