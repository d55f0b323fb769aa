"""The shapes of a robot's links, from the URDF or in place of missing ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.errors import InputError
from calib_pin.io.meshes import MeshReader, shape_in
from calib_pin.io.urdf_bytes import Element, parse_document
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

SURFACES: Mapping[str, Callable[..., Surface]] = {
    "box": lambda *size: box(np.array(size)),
    "sphere": ball,
    "cylinder": cylinder,
    "capsule": capsule,
    "mesh": lambda surface: surface,
}
"""Surfaces by the tag of a shape, from its numbers."""


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
    parts: list[Shape] = []
    missing: dict[str, Any] = {}
    with MeshReader(robot.file, package_dirs) as meshes:
        for k, (name, link) in enumerate(links.items()):
            if progress is not None:
                progress(k / len(links))
            found: list[Shape] = []
            lost: dict[str, Any] = {}
            for element in link.all("visual") or link.all("collision"):
                if (shape := shape_in(element)) is None:
                    continue
                try:
                    surface = meshes.made(document, shape, SURFACES)
                    place = document.origin(element).homogeneous
                    found.append(Shape(name, place, surface, _color(element, colors)))
                except InputError:
                    lost[shape.attributes.get("filename", shape.tag)] = None
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
