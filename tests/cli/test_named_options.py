"""Options that messages, docstrings and comments of the package name."""

from __future__ import annotations

import re
from pathlib import Path

import typer

import calib_pin
from calib_pin.cli.application import application

FOREIGN = {"--frame-id", "--child-frame-id"}
"""Options of other programs."""

NAMED = re.compile(r"(?:\b([a-z-]+) )?(--[a-z][a-z-]*[a-z])")


def test_every_option_that_is_named_exists() -> None:
    """And of the command that is named before it."""
    commands = typer.main.get_command(application([])).commands
    options = {
        name: {word for p in command.params for word in (*p.opts, *p.secondary_opts)}
        for name, command in commands.items()
    }
    every = set().union(*options.values(), {"--help", "--version", "--debug"})
    for file in Path(calib_pin.__file__).parent.rglob("*.py"):
        for command, option in NAMED.findall(file.read_text()):
            known = options.get(command, every) | {"--help"}
            assert option in known | FOREIGN, f"{file}: {command} {option}"
