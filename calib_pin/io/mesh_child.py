"""Reads mesh files in a process that may crash; `meshes.py` runs it as a script.

The library that knows the formats believes what the files say: a wrong index ends in
a crash, a wrong number in memory without end. A line of JSON comes in, the path of a
file. A line of JSON goes out, with the numbers of vertices and triangles and then
their bytes, or with the reason why there are none.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib_pin.io.limits import limit

PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


def check_ply(data: bytes) -> None:
    """Refuse a PLY file with faces between vertices that it does not have.

    Raises:
        ValueError: If it has such a face, or is no PLY file.
    """
    header = re.match(rb"ply\s.*?\nend_header[ \t]*\r?\n", data, re.DOTALL)
    if header is None:
        raise ValueError("it has no header of a PLY file")
    body, place = data[header.end() :], 0
    lines = [line.split() for line in header[0].decode("latin-1").splitlines()]
    kind = next((line[1] for line in lines if line[:1] == ["format"]), "")
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind)
    words = body.split() if order is None else []

    def take(name: str, count: int) -> list[float]:
        nonlocal place
        start, step = place, 1
        if order is not None:
            step = np.dtype(PLY_TYPES[name]).itemsize
        place += count * step
        if not start <= place <= len(words or body):
            raise ValueError("it ends before its last element")
        if order is None:
            return [float(word) for word in words[start:place]]
        found = np.frombuffer(body[start:place], order + PLY_TYPES[name])
        return [float(number) for number in found]

    elements: dict[str, tuple[int, list[list[str]]]] = {}
    for line in lines:
        if line[:1] == ["element"]:
            elements[line[1]] = int(line[2]), []
        elif line[:1] == ["property"]:
            elements[[*elements][-1]][1].append(line[1:-1])
    vertices = elements["vertex"][0]
    for element, (count, properties) in elements.items():
        for number in range(1, count + 1):
            for first, *counted in properties:
                if not counted:
                    take(first, 1)
                    continue
                indices = take(counted[1], int(take(counted[0], 1)[0]))
                if element == "face" and not all(0 <= i < vertices for i in indices):
                    raise ValueError(f"face {number} has a vertex that is not there")


def read(path: Path) -> tuple[bytes, int, int]:
    """The surface in a mesh file: its bytes, and how many vertices and triangles.

    Raises:
        Exception: Of any kind, if the file cannot be read.
    """
    data = path.read_bytes()
    if path.suffix.lower() == ".ply" or data.startswith(b"ply"):
        check_ply(data)
    # Boxes along the axes are the quickest to build of what nobody asks for here.
    loader = pin.coal.MeshLoader(pin.coal.NODE_TYPE.BV_AABB)
    surface = loader.load(str(path), np.ones(3))
    corners = map(surface.tri_indices, range(surface.num_tris))
    triangles = np.array([(t[0], t[1], t[2]) for t in corners], "<i8")
    vertices = np.array(surface.vertices(), "<f8")
    return vertices.tobytes() + triangles.tobytes(), len(vertices), len(triangles)


def reason(failure: Exception) -> str:
    """Why a file cannot be read, out of the several lines that C++ says."""
    found = re.search(r"Could not load resource .*\n(.+)", str(failure))
    text = found[1].strip() if found else str(failure)
    return "it needs too much memory" if "bad_alloc" in text else text


def main() -> None:
    """Answer until nobody asks any more."""
    limit()
    # What the library prints does not get between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    answers.write(b"{}\n")  # Ready.
    answers.flush()
    for line in sys.stdin.buffer:
        head: dict[str, object]
        try:
            data, vertices, triangles = read(Path(json.loads(line)))
            head = {"vertices": vertices, "triangles": triangles}
        except Exception as failure:
            head, data = {"reason": reason(failure)}, b""
        answers.write(json.dumps(head).encode() + b"\n" + data)
        answers.flush()


if __name__ == "__main__":
    main()
