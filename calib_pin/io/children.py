"""Processes of our own that read what may crash a library, or never come to an end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Self

from calib_pin.errors import OptionError, RobotError
from calib_pin.io.json_text import Json

SECONDS = 30.0
"""Time for a file, and one more for each megabyte; large ones take a fifth [s]."""


EXTRAS = {
    "MJCF": ("calib-pin[mujoco]", "mujoco"),
    "xacro": ("calib-pin[ros]", "xacro", "simpleeval"),
}
"""The package to install, and those in it that read a kind of file."""


def started(script: str) -> subprocess.Popen[bytes]:
    """Start a script of this folder, with pipes to it."""
    # Where this process has its packages from, and no thread that needs memory.
    paths = os.pathsep.join(filter(None, sys.path))
    environment = {
        **os.environ,
        "PYTHONPATH": paths,
        "PYTHONUTF8": "1",
        "PYTHONHASHSEED": "0",
        "OPENBLAS_NUM_THREADS": "1",
    }
    return subprocess.Popen(
        # Without the folder of the script.
        [sys.executable, "-P", str(Path(__file__).with_name(script))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    )


class Reader:
    """A process that reads the files of a robot, in a `with` block.

    It starts when it is first asked, and again when it was lost; see `robot_child`.
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
    ) -> tuple[Json, bytes]:
        """The content of a file, as `robot_child.READERS` give it.

        Args:
            kind: Name of what reads it.
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
        child = self._child = self._child or started("robot_child.py")
        assert child.stdin is not None and child.stdout is not None
        seconds = SECONDS + file.stat().st_size / 1e6
        timer, end = Timer(seconds, child.kill), monotonic() + seconds
        timer.start()
        request = {"kind": kind, "file": str(file), **(about or {})}
        try:
            with suppress(OSError):  # It is gone, as its answer will tell.
                child.stdin.write(json.dumps(request).encode() + b"\n")
                child.stdin.flush()
            head: Json = json.loads(child.stdout.readline())
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
