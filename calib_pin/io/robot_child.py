"""Reads files of robots in a process that may crash; `children` runs it as a script.

The libraries that know the formats believe what the files say. A line of JSON comes in
for each file. A line of JSON goes out, and then as many bytes as it says, or the reason
why there are none.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

from calib_pin.errors import RobotError
from calib_pin.io.files import read_bytes

Answer = tuple[dict[str, object], bytes]

MEMORY = 3 << 29
"""Address space of the process [bytes], of which its libraries take a tenth."""

SECONDS = 600
"""Time of a processor that it takes in all, should nobody be left to stop it [s]."""


def read_mesh(file: str) -> Answer:
    """The corners of the triangles in a mesh file, shape (F, 3, 3)."""
    import trimesh

    content: str | BytesIO = file
    kind = Path(file).suffix[1:].lower()
    if kind == "dae":
        # Where a material is not to be found, the mesh would be left out with it.
        data = re.sub(rb"(?s)<bind_material>.*?</bind_material>", b"", read_bytes(file))
        content = BytesIO(data)
    mesh = trimesh.load_mesh(content, file_type=kind, process=False)
    corners = mesh.triangles
    if corners.shape[1:] != (3, 3) or mesh.faces.min(initial=0) < 0:
        raise ValueError("it has a face with a vertex that is not there")
    return {}, corners.astype("<f8").tobytes()


def answer(kind: str, file: str, **more: Any) -> Answer:
    """The answer to one request, with the reason if there is no other."""
    try:
        if kind == "mesh":
            return read_mesh(file)
        child = import_module(f"calib_pin.io.{kind.lower()}_child")
        read: Callable[..., Answer] = child.read
        return read(file, **more)
    except RobotError as error:
        reason, file = error.reason, error.file or file
    except Exception as failure:
        memory = isinstance(failure, MemoryError)
        words = "it needs too much memory" if memory else " ".join(str(failure).split())
        reason = f"cannot be read: {words or type(failure).__name__}"
    return {"reason": reason, "file": file}, b""


def _limit() -> None:
    """Give up what this process does not need, where the system can hold it to that."""
    try:
        import resource
    except ImportError:  # On Windows.
        return
    for kind, most in (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_CPU, SECONDS),
        (resource.RLIMIT_CORE, 0),
    ):
        with suppress(OSError, ValueError):  # It has less, or the system refuses.
            resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))


def main() -> None:
    """Answer until nobody asks any more."""
    _limit()
    # What a library prints does not get between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    for line in sys.stdin.buffer:
        head, data = answer(**json.loads(line))
        answers.write(json.dumps({**head, "size": len(data)}).encode() + b"\n" + data)
        answers.flush()


if __name__ == "__main__":
    main()
