"""The shapes of a robot's links: simple ones, meshes of any format, and stand-ins."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from calib_pin.errors import InputError, words_of
from calib_pin.io.files import read_bytes
from calib_pin.io.packages import locate_mesh
from calib_pin.io.urdf import locate_robot
from calib_pin.io.urdf_tree import FARTHEST, NUMBERS, Document, parse_document
from calib_pin.kinematics import shapes
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import Color, Shape, Shapes, Surface
from calib_pin.kinematics.stand_ins import stand_ins

LARGEST = 1 << 27
"""Bytes of the largest mesh file."""

TRIANGLES = 1_000_000
"""Triangles of the largest mesh: collision geometry takes half a kilobyte of each."""

FORMATS = ("dae", "glb", "gltf", "obj", "off", "ply", "stl")
"""Formats of meshes; not those that are archives, which can swell to any size."""

STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
"""A triangle of a binary STL file, of which most meshes of robots are."""

SIMPLE: Mapping[str, Callable[..., Surface]] = {
    "box": lambda *size: shapes.box(np.array(size)),
    "sphere": shapes.ball,
    "cylinder": shapes.cylinder,
    "capsule": shapes.capsule,
}
"""Surfaces by the tag of a shape, from its numbers."""


def read_mesh(
    written: str | Path,
    robot: Robot,
    package_dirs: Sequence[str | Path] = (),
    scale: Sequence[float] = (1.0, 1.0, 1.0),
) -> Surface:
    """The surface in a mesh file.

    Args:
        written: Its name in the robot's file.
        robot: The robot.
        package_dirs: Folders of packages, see `io.packages.locate_mesh`.
        scale: Factors of the coordinates, shape (3,).

    Raises:
        InputError: If there is no such file or a surface in it cannot be used.
    """
    file = locate_robot(robot.file).resolve()
    path = locate_mesh(str(written), file, package_dirs)
    if path is None:
        hint = "a path from the URDF, --package-dir DIR for a package"
        raise InputError("does not exist", allowed=hint)
    mesh = _read_mesh(path)
    points, count = mesh.vertices, len(mesh.triangles)
    if not 1 <= count <= TRIANGLES:
        reason = f"has {count} triangles, not 1 to {TRIANGLES}"
        raise InputError(reason, file=path)
    # What stands twice is one vertex. To sort by columns takes a quarter of the time of
    # `np.unique`, which compares rows.
    used = np.unique(mesh.triangles)
    by = used[np.lexsort(points[used].T)]
    begins = np.append(True, (points[by][1:] != points[by][:-1]).any(axis=1))
    first, place = by[begins], np.empty(len(points), np.intp)
    place[by] = np.cumsum(begins) - 1
    if len(first) < 3:  # Of a single one, the library gives numbers of no meaning.
        raise InputError("has less than 3 different vertices", file=path)
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = points[first] * np.array(scale)
    far = vertices[~(np.abs(vertices) <= FARTHEST).all(axis=1)]
    if len(far):
        reason = f"has the vertex {far[0].tolist()}, not within {FARTHEST:g} m"
        raise InputError(reason, file=path)
    return Surface(vertices, place[mesh.triangles])


def _read_mesh(path: Path) -> Surface:
    """The mesh in a file; vertices may stand there twice, or for nothing."""
    data, kind = read_bytes(path, LARGEST), path.suffix[1:].lower()
    if kind not in FORMATS:
        raise InputError("is no mesh", file=path, allowed=", ".join(FORMATS))
    if len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        points = np.frombuffer(data, STL, offset=84)["corners"].reshape(-1, 3)
        return Surface(points.astype(float), np.arange(len(points)).reshape(-1, 3))
    try:
        mesh = _of_collada(data) if kind == "dae" else _by_trimesh(data, kind, path)
        corners, count = mesh.triangles, len(mesh.vertices)
        if corners.min(initial=0) < 0 or corners.max(initial=-1) >= count:
            raise ValueError("it has a face with a vertex that is not there")
    except Exception as failure:
        raise InputError(f"cannot be read: {words_of(failure)}", file=path) from failure
    return mesh


def _of_collada(data: bytes) -> Surface:
    """The mesh in a DAE file, of which most visuals of robots are."""
    from zipfile import is_zipfile

    # Trimesh reads it by this, but takes ten times as long to load.
    from collada import Collada
    from collada.common import DaeError

    if is_zipfile(BytesIO(data)):  # This would be read, too.
        raise ValueError("it is an archive")
    # Where a material is not found, the mesh would be left out.
    data = re.sub(rb"(?s)<bind_material>.*?</bind_material>", b"", data)
    # Of no use here are missing images, and elements that other programs add.
    document = Collada(BytesIO(data), ignore=[DaeError])
    points, triangles = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    vertices = count = 0
    nodes = (node.objects("geometry", np.eye(4)) for node in document.scene.nodes)
    for geometry in chain.from_iterable(nodes):
        R, t = geometry.matrix[:3, :3], geometry.matrix[:3, 3]
        # The outside of what is mirrored stays outside.
        turn = -1 if np.linalg.det(R) < 0.0 else 1
        for part in geometry.original.primitives:
            part = part.triangleset() if hasattr(part, "triangleset") else part
            # Others are lines.
            if part.vertex is not None and part.vertex_index.shape[1:] == (3,):
                points.append(part.vertex @ R.T + t)
                triangles.append(part.vertex_index[:, ::turn] + vertices)
                vertices += len(part.vertex)
                count += max(len(part.vertex_index), len(part.vertex) // 3)
        if count > TRIANGLES:  # Instances of instances can be any number.
            raise ValueError(f"it is larger than {TRIANGLES} triangles")
    if not count and document.errors:
        raise document.errors[0]
    return Surface(np.concatenate(points), np.concatenate(triangles))


def _by_trimesh(data: bytes, kind: str, path: Path) -> Surface:
    """The mesh in any other file."""
    import trimesh  # It takes several times as long to load as Pinocchio.

    beside = trimesh.resolvers.FilePathResolver(path) if kind == "gltf" else None
    about = {"file_type": kind, "resolver": beside, "process": False}
    mesh = trimesh.load_mesh(BytesIO(data), **about)
    return Surface(np.asarray(mesh.vertices, float), np.asarray(mesh.faces))


def shape_of(
    document: Document,
    element: Element,
    robot: Robot,
    package_dirs: Sequence[str | Path],
) -> tuple[str, list[Any]] | None:
    """The shape of a visual or collision element, if it has one.

    Returns:
        Its kind, and its numbers or the surface of its mesh.

    Raises:
        InputError: If a mesh cannot be used, or there is no such shape; its value is
            the name of the mesh.
    """
    shape = element.find("geometry/*")
    if shape is None:
        return None
    if shape.tag in SIMPLE:
        sizes = NUMBERS[shape.tag].items()
        numbers = [document.numbers(shape, key, count) for key, count in sizes]
        return shape.tag, np.concatenate(numbers).tolist()
    name = shape.get("filename", shape.tag)
    try:
        if shape.tag != "mesh":
            raise InputError("is no shape", allowed=", ".join(SIMPLE))
        scale = [float(x) for x in shape.get("scale", "1 1 1").split()]
        return shape.tag, [read_mesh(name, robot, package_dirs, scale)]
    except InputError as error:
        owner = document.owner(element)
        reason = f"the collision mesh of {owner} {error.reason}"
        hint = error.allowed or "another mesh"
        allowed = f"{hint}, or plan --ignore-collisions"
        raise document.error(shape, reason, value=name, allowed=allowed) from None


def robot_shapes(robot: Robot, package_dirs: Sequence[str | Path] = ()) -> Shapes:
    """The appearance of a robot.

    A link looks like its visual elements, or else its collision elements. Where a mesh
    is missing, simple solids between the link's joints stand in for all of the link;
    so they do for every link of a robot that has no shapes at all.

    Args:
        robot: The robot.
        package_dirs: Folders of packages, see `io.packages.locate_mesh`.
    """
    document = parse_document(robot.source)
    materials = document.named("material")
    parts, missing = list[Shape](), dict[str, None]()
    for name, link in document.named("link").items():
        visuals, lost = list[Shape](), dict[str, None]()
        for element in link.findall("visual") or link.findall("collision"):
            try:
                shape = shape_of(document, element, robot, package_dirs)
            except InputError as error:
                lost[str(error.value)] = None
                continue
            if shape is not None:
                kind, values = shape
                surface = SIMPLE[kind](*values) if kind in SIMPLE else values[0]
                place = document.origin(element).homogeneous
                visuals.append(Shape(name, place, surface, _color(element, materials)))
        missing |= lost
        parts += stand_ins(robot, name) if lost else visuals
    return Shapes(tuple(parts or stand_ins(robot)), tuple(missing))


def _color(element: Element, materials: Mapping[str, Element]) -> Color | None:
    """The color of a visual element, of its own or by the name of a material."""
    for material in element.findall("material")[:1]:
        definition = materials.get(material.get("name", ""), material)
        for color in (*material.findall("color"), *definition.findall("color")):
            with suppress(ValueError):
                red, green, blue, _ = map(float, color.get("rgba", "").split())
                return red, green, blue
    return None
