"""Completion in a shell: commands, and names that options and arguments know."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("calib-pin ca", ["calibrate"]),
        ("calib-pin calibrate space", ["space6", "space7"]),
        ("calib-pin plan space7 --criterion O", ["O1", "O2", "O3", "O4", "O5"]),
    ],
)
def test_a_shell_completes(words: str, found: list[str]):
    """The last word of a command line, as bash asks for it."""
    environment = os.environ | {
        "_CALIB_PIN_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    done = subprocess.run(
        [sys.executable, "-m", "calib_pin"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == found
