"""Processes of our own that read what may crash a library, or never come to an end.

The libraries that know the formats believe what the files say. This file is both ends:
the process that asks, and the script that answers. A line of JSON goes to it for each
file. A line of JSON comes back, and then as many bytes as it says, or the reason why
there are none.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Any, Self

from calib_pin.errors import OptionError, RobotError

SECONDS = 30.0
"""Time for a file, and one more for each megabyte; large ones take a fifth [s]."""

LIMITS = {"RLIMIT_AS": 3 << 29, "RLIMIT_CPU": 600, "RLIMIT_CORE": 0}
"""Address space of a process [bytes], of which its libraries take a tenth, and time of
a processor in all, should nobody be left to stop it [s]."""

EXTRAS = {
    "MJCF": ("calib-pin[mujoco]", "mujoco"),
    "xacro": ("calib-pin[ros]", "xacro", "simpleeval"),
}
"""The package to install, and those in it that read a kind of file."""

Answer = tuple[dict[str, Any], bytes]


def started() -> subprocess.Popen[bytes]:
    """Start the script that answers, with pipes to it."""
    # Where this process has its packages from, and no thread that needs memory.
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "PYTHONUTF8": "1",
        "PYTHONHASHSEED": "0",
        "OPENBLAS_NUM_THREADS": "1",
    }
    # Without the folder of the script.
    command = [sys.executable, "-P", __file__]
    pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
    return subprocess.Popen(
        command, stdin=pipe, stdout=pipe, stderr=nothing, env=environment
    )


class Reader:
    """A process that reads the files of a robot, in a `with` block.

    It starts when it is first asked, and again when it was lost.
    """

    def __init__(self) -> None:
        """Nothing starts before it is needed."""
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        """The reader itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process, if there is one."""
        if self._child is not None:
            self._child.kill()
            self._child.communicate()
            self._child = None

    def ask(
        self, kind: str, file: Path, about: Mapping[str, object] | None = None
    ) -> Answer:
        """The content of a file, and what is to be said of it.

        Args:
            kind: Name of what reads it: mesh, MJCF, xacro.
            file: The file.
            about: All else that is needed to read it, as JSON can hold it.

        Raises:
            OptionError: If an extra is missing.
            RobotError: If it cannot be read, takes too long or crashes the process.
        """
        extra, *needed = EXTRAS.get(kind, ("",))
        for package in needed:
            if find_spec(package) is None:
                reason = f"{kind} files need the package {package}, which is missing: "
                raise OptionError(f"{reason}pip install '{extra}'", file=file)
        child = self._child = self._child or started()
        assert child.stdin is not None and child.stdout is not None
        seconds = SECONDS + file.stat().st_size / 1e6
        timer, end = Timer(seconds, child.kill), monotonic() + seconds
        timer.start()
        request = {"kind": kind, "file": str(file), **(about or {})}
        try:
            with suppress(OSError):  # It is gone, as its answer will tell.
                child.stdin.write(json.dumps(request).encode() + b"\n")
                child.stdin.flush()
            head: dict[str, Any] = json.loads(child.stdout.readline())
            data = child.stdout.read(head["size"])
            if len(data) < head["size"]:
                raise EOFError
        except (ValueError, EOFError):
            self.__exit__()
            reason = "cannot be read: what reads it crashes, or needs too much memory"
            if monotonic() >= end:
                reason = f"cannot be read: it takes more than {seconds:.0f} s"
            raise RobotError(reason, file=file) from None
        finally:
            timer.cancel()
        if "reason" in head:
            raise RobotError(head["reason"], file=head["file"] or file)
        return head, data


def read_mesh(file: str) -> Answer:
    """The corners of the triangles in a mesh file, shape (F, 3, 3)."""
    import trimesh

    content: str | BytesIO = file
    kind = Path(file).suffix[1:].lower()
    if kind == "dae":
        # Where a material is not to be found, the mesh would be left out with it.
        data, bound = (
            Path(file).read_bytes(),
            rb"(?s)<bind_material>.*?</bind_material>",
        )
        content = BytesIO(re.sub(bound, b"", data))
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


def main() -> None:
    """Answer until nobody asks any more."""
    with suppress(ImportError):  # On Windows nothing holds a process to limits.
        import resource

        for kind, most in LIMITS.items():
            of = getattr(resource, kind)
            with suppress(OSError, ValueError):  # It has less, or the system refuses.
                resource.setrlimit(of, (most, resource.getrlimit(of)[1]))
    # What a library prints does not get between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    for line in sys.stdin.buffer:
        head, data = answer(**json.loads(line))
        answers.write(json.dumps({**head, "size": len(data)}).encode() + b"\n" + data)
        answers.flush()


if __name__ == "__main__":
    main()
