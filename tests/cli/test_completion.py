"""Completion in a shell: commands, and names that options and arguments know."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


def completions(words: str) -> list[str]:
    """The completions of the last word of a command line, as bash asks for them."""
    environment = os.environ | {
        "_CALIB_PIN_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    words = [sys.executable, "-m", "calib_pin"]
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("calib-pin ca", ["calibrate"]),
        ("calib-pin calibrate space", ["space6", "space7"]),
        ("calib-pin calibrate space7 --solver g", ["gauss-newton"]),
        ("calib-pin plan space7 --criterion O", ["O1", "O2", "O3", "O4", "O5"]),
        ("calib-pin identify pa10 --model posi", ["position"]),
        ("calib-pin export out --format joint", ["joint-offsets"]),
        ("calib-pin compensate out --format joint", ["joint-trajectory"]),
    ],
)
def test_a_shell_completes(words: str, found: list[str]):
    assert completions(words) == found


def test_the_module_is_the_command():
    words = [sys.executable, "-m", "calib_pin", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("calib-pin 0.")
