"""What a shell completes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import typer

from calib_pin.cli.application import application

COMMANDS = typer.main.get_command(application([])).commands  # type: ignore[attr-defined]


def names(option: str, command: str, begun: str = "") -> list[str]:
    """Names that begin so, of an option or an argument of a command."""
    (of,) = (p for p in COMMANDS[command].params if option in (*p.opts, p.name))
    context: Any = SimpleNamespace(info_name=command)
    return [item.value for item in of.shell_complete(context, begun)]


@pytest.mark.parametrize(
    ("option", "command", "one"),
    [
        ("--model", "calibrate", "position"),
        ("--parameters", "calibrate", "placement"),
        ("--solver", "calibrate", "hybrid"),
        ("--loss", "calibrate", "gnc"),
        ("--learned", "calibrate", "network"),
        ("--use", "calibrate", "away"),
        ("--criterion", "plan", "prediction"),
        ("--criterion", "plan", "O5"),
        ("--method", "plan", "exchange"),
        ("--format", "export", "ur-kinematics"),
        ("--format", "compensate", "urscript"),
        ("--figure-format", "report", "svg"),
        ("--mount", "detect", "world"),
        ("robot", "calibrate", "space6"),
    ],
)
def test_names_are_completed(option: str, command: str, one: str) -> None:
    assert one in names(option, command)
    assert names(option, command, one[:-1]).count(one) == 1
    assert names(option, command, "no such") == []


def test_other_values_are_not() -> None:
    assert names("--count", "plan") == names("--setup", "calibrate") == []
    assert "ur-kinematics" not in names("--format", "compensate")
