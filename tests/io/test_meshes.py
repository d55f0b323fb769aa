"""Meshes of any format; what is wrong with one costs a line, not the process."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError
from calib_pin.io import meshes
from calib_pin.io.meshes import MeshReader
from calib_pin.io.urdf import locate_robot

CORNERS = ((0.0, 0.0, 0.0), (0.25, 0.0, 0.0), (0.0, 0.25, 0.0))


@pytest.fixture(autouse=True)
def nothing_known_and_time_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshes, "_known", {})
    # However busy the machine is, memory comes to its end before time does.
    monkeypatch.setattr(meshes, "SECONDS", 60.0)


@pytest.fixture
def reader() -> Iterator[MeshReader]:
    with MeshReader() as opened:
        yield opened


def stl(last: str = "0 0.25 0") -> str:
    points = "".join(f"vertex {p}\n" for p in ("0 0 0", "0.25 0 0", last))
    facet = f"facet normal 0 0 1\nouter loop\n{points}endloop\nendfacet"
    return f"solid a\n{facet}\nendsolid a\n"


def binary_stl(*triangles: Any) -> bytes:
    data = [struct.pack("<12fH", 0, 0, 1, *np.ravel(t), 0) for t in triangles]
    return bytes(80) + struct.pack("<I", len(data)) + b"".join(data)


def obj(last: str = "0 0.25 0", face: str = "1 2 3") -> str:
    return f"v 0 0 0\nv 0.25 0 0\nv {last}\nf {face}\n"


def ply(face: str = "0 1 2", form: str = "ascii") -> bytes:
    header = (
        f"ply\nformat {form} 1.0\nelement vertex 3\n"
        "property float x\nproperty float y\nproperty float z\nelement face 2\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    if form == "ascii":
        points = "\n".join(" ".join(map(str, corner)) for corner in CORNERS)
        return f"{header}{points}\n3 0 1 2\n3 {face}\n".encode()
    mark = "<" if "little" in form else ">"
    indices = (3, 0, 1, 2), (3, *map(int, face.split()))
    return (
        header.encode()
        + struct.pack(f"{mark}9f", *np.ravel(CORNERS))
        + b"".join(struct.pack(f"{mark}B3i", *row) for row in indices)
    )


def dae(face: str = "0 1 2") -> str:
    axes = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    points = " ".join(map(str, np.ravel(CORNERS)))
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        'version="1.4.1"><asset><up_axis>Z_UP</up_axis></asset><library_geometries>'
        '<geometry id="g"><mesh><source id="s">'
        f'<float_array id="a" count="9">{points}</float_array><technique_common>'
        f'<accessor source="#a" count="3" stride="3">{axes}</accessor>'
        '</technique_common></source><vertices id="v"><input semantic="POSITION" '
        'source="#s"/></vertices><triangles count="1"><input semantic="VERTEX" '
        f'source="#v" offset="0"/><p>{face}</p></triangles></mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="w"><node>'
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#w"/></scene></COLLADA>'
    )


def stored(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", stl()),
        ("b.stl", binary_stl(CORNERS)),
        ("a.obj", obj()),
        ("a.dae", dae()),
        *(
            ("a.ply", ply(form=form))
            for form in ("ascii", "binary_little_endian", "binary_big_endian")
        ),
    ],
)
def test_a_triangle(
    tmp_path: Path, reader: MeshReader, name: str, content: str | bytes
) -> None:
    path = stored(tmp_path, name, content)
    vertices, triangles = reader.read(path, (4.0, 4.0, 8.0))
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert {tuple(triangle) for triangle in triangles.tolist()} == {(0, 1, 2)}


def test_binary_stl_is_what_pinocchio_reads() -> None:
    """The file comes from a package that is trusted."""
    robot = locate_robot("example:ur10_robot").resolve()
    file = robot.parents[1] / "meshes/ur10/collision/forearm.stl"
    surface = pin.coal.MeshLoader().load(str(file), np.ones(3))
    with MeshReader() as reader:
        vertices, triangles = reader.read(file)
        assert reader._child is None
    np.testing.assert_array_equal(vertices, surface.vertices())
    corners = map(surface.tri_indices, range(surface.num_tris))
    expected = sorted(sorted(t[k] for k in range(3)) for t in corners)
    assert sorted(map(sorted, triangles.tolist())) == expected


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.ply", ply("0 1 -1"), "face 2 has a vertex that is not there"),
        ("a.ply", ply("0 1 200000000"), "face 2 has a vertex that is not there"),
        ("a.ply", ply("0 1 3"), "face 2 has a vertex that is not there"),
        ("a.stl", ply("0 1 200000000"), "face 2 has a vertex that is not there"),
        (
            "a.ply",
            ply("0 1 -1", "binary_little_endian"),
            "face 2 has a vertex that is not there",
        ),
        ("a.ply", ply(form="binary_big_endian")[:-1], "ends before its last element"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "no header of a PLY file"),
        ("a.ply", ply().replace(b"vertex 3", b"point 3"), "'vertex'"),
        ("a.obj", obj(face="1 2 4"), "vertex index out of range"),
        ("a.dae", dae("0 1 3"), "Invalid data index"),
        ("a.dae", dae("0.1 1 2"), "needs too much memory"),
        ("a.stl", stl("0 nan 0"), "has the vertex (nan nan nan), not within 1e+06 m"),
        ("a.obj", obj("0 nan 0"), "has the vertex (nan nan nan), not within 1e+06 m"),
        ("a.stl", stl("0 1e308 0"), "not within 1e+06 m"),
        ("a.obj", obj("0 1e308 0"), "not within 1e+06 m"),
        (
            "a.stl",
            binary_stl(((0, 0, 0), (1, 0, 0), (0, 2e6, 0))),
            "has the vertex (0 2e+06 0), not within 1e+06 m",
        ),
        ("a.stl", binary_stl(((0, 0, 1),) * 3), "has less than 3 different vertices"),
        ("a.stl", binary_stl(), "has 0 triangles, not 1 to 1000000"),
        ("a.stl", "no mesh", "cannot be read"),
        ("a.stl", "", "cannot be read"),
    ],
)
def test_files_that_could_hurt(
    tmp_path: Path,
    reader: MeshReader,
    refused: Callable[..., Any],
    capfd: pytest.CaptureFixture[str],
    name: str,
    content: str | bytes,
    reason: str,
) -> None:
    path = stored(tmp_path, name, content)
    with refused(InputError, file=str(path), reason=reason):
        reader.read(path)
    assert capfd.readouterr() == ("", "")
    # It is no reason not to read the next one.
    assert len(reader.read(stored(tmp_path, "good.obj", obj())).triangles) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of memory")
def test_memory_is_limited(
    tmp_path: Path, reader: MeshReader, refused: Callable[..., Any]
) -> None:
    import resource

    path = stored(tmp_path, "a.dae", dae("0.1 1 2"))
    with refused(InputError, reason="needs too much memory"):
        reader.read(path)
    child = reader._child
    assert child is not None
    reader.close()
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    assert used < 2_000_000  # In kB; of all processes that this one has waited for.


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("os.abort()", "it is damaged"),
        ("time.sleep(60)", "it takes more than 1 s"),
        ('print(\'{"vertices": 9, "triangles": 1}\')', "it is damaged"),
        ("print('{\"vertices\": 100000000}')", "it has more than 1000000 triangles"),
    ],
)
def test_a_process_that_does_not_answer(
    tmp_path: Path,
    reader: MeshReader,
    refused: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    program: str,
    reason: str,
) -> None:
    before = "import os, sys, time; print('{}', flush=True); sys.stdin.readline(); "

    def started(_: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-c", before + program], stdin=-1, stdout=-1
        )

    path = stored(tmp_path, "a.obj", obj())
    with monkeypatch.context() as patch:
        patch.setattr(meshes, "SECONDS", 1.0)
        patch.setattr(meshes, "started", started)
        with refused(InputError, file=str(path), reason=reason):
            reader.read(path)
    other = stored(tmp_path, "b.obj", obj())
    assert len(reader.read(other).triangles) == 1


def test_content_is_read_once(
    tmp_path: Path, reader: MeshReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    answer = meshes._answer

    def counted(child: subprocess.Popen[bytes], seconds: float) -> Any:
        asked.append(seconds)
        return answer(child, seconds)

    monkeypatch.setattr(meshes, "_answer", counted)
    good, bad = stored(tmp_path, "a.obj", obj()), stored(tmp_path, "b.obj", "no mesh")
    for _ in range(2):
        reader.read(good)
        with pytest.raises(InputError):
            reader.read(bad)
    assert len(asked) == 1 + 2  # The process is there; each file.
    good.write_text(obj("0 0.5 0"))
    assert reader.read(good).vertices.max() == 0.5
    assert len(asked) == 4


def test_only_regular_files_of_some_size(
    tmp_path: Path,
    reader: MeshReader,
    refused: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = stored(tmp_path, "a.stl", binary_stl(CORNERS))
    monkeypatch.setattr(meshes, "LARGEST", 100)
    with refused(InputError, file=str(path), reason="is too large"):
        reader.read(path)
    os.mkfifo(tmp_path / "pipe.stl")
    with refused(InputError, reason="is not a regular file"):
        reader.read(tmp_path / "pipe.stl")
