"""Processes that read robots: whatever becomes of them costs one line."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib_pin.errors import OptionError, RobotError
from calib_pin.io import children
from calib_pin.io.children import Reader

ASKED = "import os, sys, time; sys.stdin.readline(); "


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("os.abort()", "crashes"),
        ("print('{')", "crashes"),
        ("print('{\"size\": 9}')", "crashes"),
        ("time.sleep(60)", "1 s"),
        (
            'print(\'{"reason": "it is wrong", "file": "", "size": 0}\', flush=True)',
            "it is wrong",
        ),
    ],
)
def test_no_answer(
    tmp_path: Path,
    refused: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    program: str,
    said: str,
) -> None:
    def started() -> subprocess.Popen[bytes]:
        command = [sys.executable, "-S", "-c", ASKED + program]
        return subprocess.Popen(command, stdin=-1, stdout=-1, stderr=-3)

    monkeypatch.setattr(children, "started", started)
    # However busy the machine is, the others end before their time does.
    monkeypatch.setattr(children, "SECONDS", 1.0 if "sleep" in program else 60.0)
    file = tmp_path / "arm.xml"
    file.write_text("<robot/>")
    with refused(RobotError, said, file=str(file)), Reader() as reader:
        reader.ask("mesh", file)


def test_an_extra_that_is_missing(
    tmp_path: Path, refused: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(children, "find_spec", lambda _: None)
    for kind, extra in (("MJCF", "mujoco"), ("xacro", "ros")):
        with refused(OptionError, f"calib-pin[{extra}]"), Reader() as reader:
            reader.ask(kind, tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of memory")
def test_memory_is_limited(tmp_path: Path, refused: Callable[..., Any]) -> None:
    import resource

    file = tmp_path / "arm.xacro"
    file.write_text('<robot><link name="${list(range(10 ** 10))}"/></robot>')
    with Reader() as reader:
        about = {"arguments": {}, "folders": []}
        for _ in range(2):  # It goes on after that.
            with refused(RobotError, "memory", file=str(file)):
                reader.ask("xacro", file, about)
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    assert used < 2_000_000  # In kB; of all processes that this one has waited for.
