"""What a shell completes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from calib_pin.cli.completion import KNOWN, completed, robots

FORMATS = {"export": "ur-kinematics", "compensate": "urscript"}


def names(option: str, begun: str, command: str = "") -> list[str]:
    context: Any = SimpleNamespace(info_name=command)
    complete = completed(option)
    assert complete is not None
    return complete(context, begun)


@pytest.mark.parametrize("option", KNOWN)
def test_every_option_with_names_completes_them(option: str) -> None:
    known = names(option, "")
    assert known and names(option, known[-1][:-1]).count(known[-1]) == 1
    assert names(option, "no such") == []


def test_formats_are_those_of_the_command() -> None:
    for command, one in FORMATS.items():
        assert one in names("--format", "ur", command)
    assert names("--format", "urs", "export") == []
    assert completed("--count") is None
    assert "space6" in robots(SimpleNamespace(), "space")  # type: ignore[arg-type]
