"""Arguments and options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

__all__ = [
    "FIT",
    "OUTPUT",
    "ROBOT",
    "Base",
    "Force",
    "Json",
    "Model",
    "Parameters",
    "Quiet",
    "RobotName",
    "RobotOrCalibration",
    "Seed",
    "SetupFile",
    "Tip",
    "csv_file",
    "listed",
    "number",
    "seed",
]

ROBOT = "Robot"
FIT = "Fit"
OUTPUT = "Output"
"""Headings of `--help`."""

_Number = TypeVar("_Number", int, float)


def number(
    kind: type[_Number],
    option: str,
    allowed: str,
    least: float = -math.inf,
    most: float = math.inf,
) -> Callable[[str], _Number]:
    """A parser of a number whose errors name the option, the value and the range."""

    def parse(text: str) -> _Number:
        from calib_pin.errors import OptionError

        try:
            value = kind(text)
        except ValueError:
            value = None
        # Not-a-number lies in no interval.
        inside = value is not None and least <= value <= most
        if value is None or not inside or value in (-math.inf, math.inf):
            raise OptionError(f"{option} cannot be {text!r}", allowed=allowed)
        return value

    return parse


def listed(model: str | None) -> str | None:
    """The name of a measurement model; `list` prints all with their help, and ends."""
    if model != "list":
        return model
    from calib_pin.measurement_models import MEASUREMENT_MODELS, declared

    for name in MEASUREMENT_MODELS:
        print(f"{name:18} {declared(name).help}")
    raise typer.Exit


RobotName = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="URDF file, name of a bundled robot, or example:NAME where "
        "example-robot-data is installed.",
    ),
]
RobotOrCalibration = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT|calibration.json",
        help="URDF file, bundled robot, example:NAME, or a calibration.",
    ),
]
SetupFile = Annotated[
    Path | None,
    typer.Option(
        "--setup",
        metavar="FILE",
        help="Setup file (YAML); options win over it.",
        rich_help_panel=ROBOT,
    ),
]
Model = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="Measurement model, or several joined by +; default what the columns "
        "show. 'list' prints all.",
        callback=listed,
        rich_help_panel=ROBOT,
    ),
]
Base = Annotated[
    str | None,
    typer.Option(
        "--base",
        metavar="LINK",
        help="Start of the chain; default the root.",
        rich_help_panel=ROBOT,
    ),
]
Tip = Annotated[
    str | None,
    typer.Option(
        "--tip",
        metavar="LINK",
        help="End of the chain; default the only leaf.",
        rich_help_panel=ROBOT,
    ),
]
Parameters = Annotated[
    str | None,
    typer.Option(
        "--parameters",
        metavar="P,...",
        help="{parameterizations}; several may be combined.",
        rich_help_panel=ROBOT,
    ),
]


def seed(heading: str, what: str = "Seed of all that is random.") -> Any:
    """The option `--seed` under a heading of `--help`."""
    return typer.Option(
        "--seed",
        metavar="N",
        help=what,
        parser=number(int, "--seed", "0, 1, 2, ...", 0),
        rich_help_panel=heading,
    )


def csv_file(what: str) -> Any:
    """The option `-o` of a command that writes one table."""
    return typer.Option(
        "-o", "--output", metavar="CSV", help=what, rich_help_panel=OUTPUT
    )


Seed = Annotated[int, seed(FIT)]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace existing output.", rich_help_panel=OUTPUT),
]
Quiet = Annotated[
    bool,
    typer.Option("--quiet", help="Print nothing but errors.", rich_help_panel=OUTPUT),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print JSON.", rich_help_panel=OUTPUT)
]
