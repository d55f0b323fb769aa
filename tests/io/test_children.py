"""Processes that read robots: whatever becomes of them costs one line."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from calib_pin.errors import RobotError
from calib_pin.io import children


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("import os; os.abort()", "crashes"),
        ("print('{')", "crashes"),
        ("import time; time.sleep(60)", "1 s"),
        ('print(\'{"reason": "it is wrong"}\')', "it is wrong"),
    ],
)
def test_no_answer(
    refused: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    program: str,
    said: str,
) -> None:
    def started(_: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-S", "-c", program], stdin=-1, stdout=-1, stderr=-3
        )

    monkeypatch.setattr(children, "started", started)
    # However busy the machine is, the others end before their time does.
    monkeypatch.setattr(children, "SECONDS", 1.0 if "sleep" in program else 60.0)
    with refused(RobotError, said, file="arm.xml"):
        children.answer("any.py", {"file": "arm.xml"}, "arm.xml")
