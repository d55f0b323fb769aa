"""Turns foreign descriptions of robots into URDFs, in a process with limits.

MuJoCo copies a `<replicate>` as often as a file says, which never ends, and xacro
builds lists and texts of any length. This file is both ends: the function that asks,
and the script that answers one request of JSON in the same way.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from calib_pin.errors import RobotError, require_package

SECONDS = 30.0
"""Time for a file [s]."""

LIMITS = {"RLIMIT_AS": 3 << 29, "RLIMIT_CPU": 600, "RLIMIT_CORE": 0}
"""Address space of the process [bytes], of which its libraries take a tenth, and time
of a processor, should nobody be left to stop it [s]."""

EXTRAS = {
    "MJCF": ("mujoco", "mujoco"),
    "xacro": ("ros", "xacro", "simpleeval"),
}
"""The extra, and the packages in it that read a kind of file."""


def converted(kind: str, file: Path, **about: object) -> tuple[bytes, str]:
    """The URDF of a robot in another language, and what is to be said of it.

    Args:
        kind: The language, MJCF or xacro.
        file: The file.
        about: All else that is needed to read it, as JSON can hold it.

    Raises:
        OptionError: If an extra is missing.
        RobotError: If it cannot be read, takes too long or crashes the process.
    """
    extra, *needed = EXTRAS[kind]
    for package in needed:
        need = f"{kind} files need the package {package}"
        require_package(package, need, extra, file)
    # Where this process has its packages from, and no thread that needs memory.
    more = {"PYTHONUTF8": "1", "PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1"}
    more["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    request = {"kind": kind, "file": str(file), **about}
    try:
        done = subprocess.run(
            [sys.executable, "-P", __file__],  # Without the folder of the script.
            input=json.dumps(request).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | more,
            timeout=SECONDS,
        )
        answer = json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        answer = {"reason": f"cannot be read: it takes more than {SECONDS:.0f} s"}
    except ValueError:
        reason = "cannot be read: what reads it crashes, or needs too much memory"
        answer = {"reason": reason}
    if reason := answer.get("reason"):
        raise RobotError(reason, file=answer.get("file") or file)
    return answer["urdf"].encode(), answer["remark"]


def main() -> None:
    """Answer the request on standard input."""
    with suppress(ImportError):  # On Windows nothing holds a process to limits.
        import resource

        for kind, most in LIMITS.items():
            of = getattr(resource, kind)
            with suppress(OSError, ValueError):  # It has less, or the system refuses.
                resource.setrlimit(of, (most, resource.getrlimit(of)[1]))
    # What a library prints is not the answer.
    out = os.dup(1)
    os.dup2(2, 1)
    request = json.loads(sys.stdin.buffer.read())
    child = import_module(f"calib_pin.io.{request.pop('kind').lower()}_child")
    try:
        answer = dict(zip(("urdf", "remark"), child.read(**request), strict=True))
    except RobotError as error:
        answer = {"reason": error.reason, "file": error.file}
    with os.fdopen(out, "w") as stream:
        json.dump(answer, stream)


if __name__ == "__main__":
    main()
