"""What links look like, and what stands in where a mesh is missing."""

from __future__ import annotations

import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.io.robot_shapes import read_mesh, robot_shapes
from calib_pin.io.urdf import load_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.stand_ins import JOINT
from tests.shared import TETRAHEDRON, collada, joint, refused, urdf_of

RED = '<material name="red"><color rgba="1 0 0 1"/></material>'


def visual(geometry: str, more: str = "", kind: str = "visual") -> str:
    return f"<{kind}>{more}<geometry>{geometry}</geometry></{kind}>"


def arm(base: str = "", upper: str = "", tool: str = "") -> str:
    shoulder = joint("shoulder", "base upper", "0 0 0.2", "0 1 0", inside=upper)
    flange = joint("flange", "upper tool", "0.3 0 0", kind="fixed", inside=tool)
    return urdf_of(shoulder, flange, inside=base).replace("<link", f"{RED}<link", 1)


def test_visuals_come_before_collisions(write: Callable[..., Path]) -> None:
    ball_, cube = '<sphere radius="0.1"/>', '<box size="0.2 0.2 0.4"/>'
    placed = '<origin xyz="0 0 0.1" rpy="0 0 1.5"/><material name="red"/>'
    first = visual(cube, placed) + visual(ball_, kind="collision")
    file = write(arm(first, visual(ball_, kind="collision")), "arm.urdf")
    shapes = robot_shapes(load_robot(file))
    assert shapes.missing == ()
    first, second = shapes.parts
    assert (first.link, first.color) == ("base", (1.0, 0.0, 0.0))
    assert first.placement[:3, 3].tolist() == [0.0, 0.0, 0.1]
    assert first.placement[:2, 0] == pytest.approx([np.cos(1.5), np.sin(1.5)])
    assert np.ptp(first.surface.vertices, axis=0).tolist() == [0.2, 0.2, 0.4]
    assert (second.link, second.color) == ("upper", None)
    assert np.ptp(second.surface.vertices, axis=0) == pytest.approx(0.2, rel=0.01)


@pytest.mark.parametrize(
    "bad",
    [
        '<mesh filename="broken.obj"/>',
        '<mesh filename="a.obj" scale="1e308 1 1"/>',
        "<heap/>",
    ],
)
def test_solids_stand_in_for_what_is_missing(write, capfd, bad):
    write("v 0 0\nf 1 2 9\n", "broken.obj")
    write(TETRAHEDRON, "a.obj")
    good = visual('<sphere radius="0.1"/>')
    file = write(arm(good, good + visual(bad), visual(bad)), "arm.urdf")
    shapes = robot_shapes(load_robot(file))
    assert len(shapes.missing) == 1
    links = [shape.link for shape in shapes.parts]
    assert links == ["base", "upper", "upper", "tool"]
    _, joint, upper, tool = shapes.parts
    assert joint.color == JOINT
    # From the shoulder to the flange, along x of the link.
    points = upper.surface.vertices @ upper.placement[:3, :3].T + upper.placement[:3, 3]
    assert np.ptp(points, axis=0).argmax() == 0 and points[:, 0].max() > 0.3
    assert np.ptp(tool.surface.vertices, axis=0).max() < 0.06
    assert capfd.readouterr() == ("", "")


def test_a_robot_without_any_shapes(write: Callable[..., Path]) -> None:
    shapes = robot_shapes(load_robot(write(arm(), "arm.urdf")))
    assert shapes.missing == ()
    assert {shape.link for shape in shapes.parts} == {"base", "upper", "tool"}


# Meshes of any format; what is wrong with one costs a line.

CORNERS = ((0.0, 0.0, 0.0), (0.25, 0.0, 0.0), (0.0, 0.25, 0.0))


ROBOT = parse_robot(b'<robot name="r"><link name="a"/></robot>', "")


def stl(last: str = "0 0.25 0") -> str:
    points = "".join(f"vertex {p}\n" for p in ("0 0 0", "0.25 0 0", last))
    facet = f"facet normal 0 0 1\nouter loop\n{points}endloop\nendfacet"
    return f"solid a\n{facet}\nendsolid a\n"


def binary_stl(*triangles: Any) -> bytes:
    data = [struct.pack("<12fH", 0, 0, 1, *np.ravel(t), 0) for t in triangles]
    return bytes(80) + struct.pack("<I", len(data)) + b"".join(data)


def obj(last: str = "0 0.25 0", face: str = "1 2 3") -> str:
    return f"v 0 0 0\nv 0.25 0 0\nv {last}\nf {face}\n"


def ply(face: str = "0 1 2") -> bytes:
    points = "\n".join(" ".join(map(str, corner)) for corner in CORNERS)
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    return (
        f"ply\nformat ascii 1.0\nelement vertex 3\n{properties}element face 2\n"
        f"property list uchar int vertex_indices\nend_header\n{points}\n3 0 1 2\n"
        f"3 {face}\n"
    ).encode()


def dae(face: str = "0 1 2") -> str:
    return collada(CORNERS, face)


def stored(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_a_triangle(tmp_path: Path) -> None:
    files = [("a.stl", stl()), ("b.stl", binary_stl(CORNERS)), ("a.obj", obj())]
    files += [("a.dae", dae()), ("a.ply", ply())]
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for name, content in files:
        path = stored(tmp_path, name, content)
        surface = read_mesh(path, ROBOT, scale=(4.0, 4.0, 8.0))
        triangles = surface.vertices[surface.triangles].tolist()
        assert triangles in ([corners], [corners] * 2)
        assert len(surface.vertices) == 3


def test_parts_and_materials(tmp_path: Path) -> None:
    """Coal joined the parts of a file by wrong triangles; a material matters not."""
    faces = '<triangles count="1"><input'
    again = dae()[dae().index("<triangles") : dae().index("</mesh>")]
    material = '<bind_material><technique_common><instance_material symbol="m" target='
    material += '"#m"/></technique_common></bind_material>'
    both = dae().replace(faces, again.replace("0 1 2", "1 0 2") + faces)
    both = both.replace(' url="#g"/>', f' url="#g">{material}</instance_geometry>')
    surface = read_mesh(stored(tmp_path, "a.dae", both), ROBOT)
    assert sorted(map(sorted, surface.triangles.tolist())) == [[0, 1, 2]] * 2
    assert len(surface.vertices) == 3


def test_what_is_no_surface_in_a_dae_file_does_not_matter(tmp_path: Path) -> None:
    """An image that is missing, a light, a comment: trimesh reads such files, too."""
    effect = '<effect id="e"><profile_GLSL/></effect>'
    effects = f"</asset><library_effects>{effect}</library_effects>"
    instance = '<instance_geometry url="#g"/>'
    more = '<!-- a --><other/><instance_light url="#no"/><scale>-1 1 1</scale>'
    content = dae().replace(instance, more + instance).replace("</asset>", effects)
    surface = read_mesh(stored(tmp_path, "a.dae", content), ROBOT)
    (corners,) = surface.vertices[surface.triangles]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assert corners[:, 0].min() == -0.25 and normal[2] > 0.0


def test_instances_of_instances_in_a_dae_file(tmp_path: Path) -> None:
    """A small file that would make 10 ** 12 triangles."""
    geometry, nodes = '<instance_geometry url="#g"/>', ""
    for k in range(9):
        nodes += f'<node id="n{k}">{geometry * 10}</node>'
        geometry = f'<instance_node url="#n{k}"/>'
    library = f"<library_nodes>{nodes}</library_nodes><library_visual_scenes>"
    content = dae("0 1 2 " * 1000).replace('<instance_geometry url="#g"/>', geometry)
    content = content.replace("<library_visual_scenes>", library)
    with pytest.raises(InputError, match="larger than 1000000 triangles"):
        read_mesh(stored(tmp_path, "a.dae", content), ROBOT)


def zipped(content: str) -> bytes:
    stream = BytesIO()
    with ZipFile(stream, "w") as archive:
        archive.writestr("a.dae", content)
    return stream.getvalue()


BAD = [
    ("a.ply", ply("0 1 -1")),
    ("a.ply", ply("0 1 200000000")),
    ("a.ply", b"ply\nformat ascii 1.0\n"),
    ("a.ply", ply().replace(b"vertex 3", b"point 3")),
    ("a.obj", obj(face="1 2 4")),
    ("a.dae", dae("0 1 3")),
    ("a.stl", stl("0 nan 0")),
    ("a.obj", obj("0 1e308 0")),
    ("a.stl", binary_stl(((0, 0, 0), (1, 0, 0), (0, 2e6, 0)))),
    ("a.stl", binary_stl(((0, 0, 1),) * 3)),
    ("a.stl", binary_stl()),
    ("a.stl", "no mesh"),
    ("a.dae", f'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>&x;{dae()}'),
    ("a.dae", dae() + "<x>" * 100_000),
    ("a.dae", zipped(dae())),
    ("a.3mf", b"PK"),
]


@pytest.mark.parametrize(("name", "content"), BAD)
def test_files_that_could_hurt(tmp_path, capfd, name, content):
    path = stored(tmp_path, name, content)
    with refused(InputError, file=str(path)):
        read_mesh(path, ROBOT)
    assert capfd.readouterr() == ("", "")
