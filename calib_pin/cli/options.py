"""Arguments and options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

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


def option(
    heading: str,
    name: str,
    metavar: str | None,
    meaning: str,
    parser: Callable[[str], Any] | None = None,
    callback: Callable[..., Any] | None = None,
) -> Any:
    """An option under a heading of `--help`; without a metavar, a switch."""
    return typer.Option(
        name,
        metavar=metavar,
        help=meaning,
        parser=parser,
        callback=callback,
        rich_help_panel=heading,
    )


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
        help="URDF file, name of a bundled robot, or example:NAME if "
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
    option(ROBOT, "--setup", "FILE", "Setup file (YAML); options override it."),
]
Model = Annotated[
    str | None,
    option(
        ROBOT,
        "--model",
        "NAME",
        "Measurement model, or several joined by +; by default inferred from the "
        "columns. 'list' prints all.",
        callback=listed,
    ),
]
Base = Annotated[
    str | None,
    option(ROBOT, "--base", "LINK", "First link of the chain; by default the root."),
]
Tip = Annotated[
    str | None,
    option(ROBOT, "--tip", "LINK", "Last link of the chain; by default the only leaf."),
]
Parameters = Annotated[
    str | None,
    option(
        ROBOT, "--parameters", "P,...", "{parameterizations}; several may be combined."
    ),
]


def seed(heading: str, what: str = "Random seed.") -> Any:
    """The option `--seed` under a heading of `--help`."""
    return option(
        heading, "--seed", "N", what, number(int, "--seed", "0, 1, 2, ...", 0)
    )


def csv_file(what: str) -> Any:
    """The option `-o` of a command that writes one table."""
    return typer.Option(
        "-o", "--output", metavar="CSV", help=what, rich_help_panel=OUTPUT
    )


Seed = Annotated[int, seed(FIT)]
Force = Annotated[bool, option(OUTPUT, "--force", None, "Replace existing output.")]
Quiet = Annotated[bool, option(OUTPUT, "--quiet", None, "Print nothing but errors.")]
Json = Annotated[bool, option(OUTPUT, "--json", None, "Print JSON.")]
