"""Arguments and options that several commands share, and what they stand for."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import RenderableType

    from calib_pin.chain import Chain
    from calib_pin.measurements import Measurements
    from calib_pin.setup import Setup

__all__ = [
    "Base",
    "Force",
    "Json",
    "Model",
    "Parameters",
    "Quiet",
    "RobotName",
    "Seed",
    "SetupFile",
    "Tip",
    "notice",
    "open_chain",
    "open_measurements",
    "open_setup",
    "show",
]

RobotName = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="URDF file, bundled robot, or example:<name> of example-robot-data.",
    ),
]
SetupFile = Annotated[
    Path | None, typer.Option("--setup", metavar="FILE", help="Setup file (YAML).")
]
Model = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="position, pose or plane-distance; inferred from the columns.",
    ),
]
Base = Annotated[
    str | None,
    typer.Option("--base", metavar="LINK", help="Start of the chain; default root."),
]
Tip = Annotated[
    str | None,
    typer.Option("--tip", metavar="LINK", help="End of the chain; default the leaf."),
]
Parameters = Annotated[
    str | None,
    typer.Option(
        "--parameters",
        metavar="P,...",
        help="placement, link-transform, dh, dh-full, joint-offset.",
    ),
]
Seed = Annotated[
    int,
    typer.Option("--seed", metavar="N", help="Seed of everything random.", min=0),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing output.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def show(content: RenderableType) -> None:
    """Print to standard output: colored on a terminal, plain 80 columns elsewhere."""
    from rich.console import Console

    from calib_pin.report.text import plain_text

    if sys.stdout.isatty():
        Console(highlight=False).print(content)
    else:
        typer.echo(plain_text(content), nl=False)


def notice(message: str) -> None:
    """A remark on standard error that does not stop the run."""
    print(f"calib-pin: note: {message}", file=sys.stderr)


def open_setup(
    file: Path | None,
    *,
    base: str | None = None,
    tip: str | None = None,
    model: str | None = None,
    parameters: str | None = None,
) -> Setup:
    """The setup file with the flags on top.

    Raises:
        InputError: If the file cannot be used.
        OptionError: If a flag names what does not exist.
    """
    from dataclasses import replace

    from calib_pin.errors import OptionError
    from calib_pin.io.setup import read_setup
    from calib_pin.parameterizations import parameterization
    from calib_pin.setup import Setup

    setup = Setup() if file is None else read_setup(file)
    if parameters is not None:
        names = tuple(name.strip() for name in parameters.split(","))
        for name in names:
            parameterization(name)
        if len(set(names)) != len(names):
            raise OptionError("a parameterization is named twice", value=parameters)
        setup = replace(setup, parameters=names)
    return replace(
        setup,
        base=base or setup.base,
        tip=tip or setup.tip,
        model=model or setup.model,
    )


def open_chain(robot: str, setup: Setup) -> Chain:
    """The chain of a robot that the setup names.

    Raises:
        RobotError: If the robot or a frame cannot be used.
    """
    from calib_pin.chain import Chain
    from calib_pin.io.urdf import load_robot

    return Chain(load_robot(robot), setup.base, setup.tip)


def open_measurements(
    files: Sequence[Path], chain: Chain, setup: Setup, *, quiet: bool = False
) -> Measurements:
    """Measurement files, with a remark on columns that mean nothing.

    Raises:
        InputError: If a file cannot be used.
    """
    from calib_pin.io.measurements import read_measurements

    return read_measurements(
        files,
        chain,
        model=setup.model,
        joints=setup.joints,
        notice=None if quiet else notice,
    )
