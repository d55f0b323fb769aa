"""Processes of our own that read what may crash a library, or never come to an end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from calib_pin.errors import RobotError
from calib_pin.io.json_text import Json

SECONDS = 30.0
"""Time for a description of a robot; large ones take two [s]."""


def started(script: str) -> subprocess.Popen[bytes]:
    """Start a script of this folder, with pipes to it."""
    # Where this process has its packages from, and no thread that needs memory.
    paths = os.pathsep.join(filter(None, sys.path))
    environment = {
        **os.environ,
        "PYTHONPATH": paths,
        "PYTHONUTF8": "1",
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


def answer(script: str, request: Mapping[str, object], file: str) -> Json:
    """The answer of a script to one request, both as JSON.

    Args:
        script: A script of this folder.
        request: What it reads.
        file: The file that it is about, for messages.

    Raises:
        RobotError: With the `reason` in its answer, or if it has none to give.
    """
    child = started(script)
    try:
        said, _ = child.communicate(json.dumps(request).encode(), SECONDS)
    except subprocess.TimeoutExpired:
        reason = f"cannot be read: it takes more than {SECONDS:.0f} s"
        raise RobotError(reason, file=file) from None
    finally:
        child.kill()
        child.communicate()
    try:
        found: Json = json.loads(said)
    except ValueError:
        reason = "cannot be read: what reads it crashes, or needs too much memory"
        raise RobotError(reason, file=file) from None
    if "reason" in found:
        raise RobotError(
            found["reason"], file=found.get("file", file), allowed=found.get("allowed")
        )
    return found
