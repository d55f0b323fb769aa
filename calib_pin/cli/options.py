"""Arguments and options that several commands share, and what they stand for."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from rich.console import RenderableType

    from calib_pin.chain import Chain
    from calib_pin.measurements import Measurements
    from calib_pin.setup import Setup

__all__ = [
    "FIT",
    "FRAMES",
    "OUTPUT",
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
    "check_outputs",
    "exists",
    "notice",
    "number",
    "open_chain",
    "open_measurements",
    "open_setup",
    "require_distinct",
    "show",
]

FRAMES = "Robot"
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


RobotName = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="URDF file, name of a bundled robot, or example:NAME where "
        "example-robot-data is installed.",
    ),
]
SetupFile = Annotated[
    Path | None,
    typer.Option(
        "--setup",
        metavar="FILE",
        help="Setup file (YAML); options win over it.",
        rich_help_panel=FRAMES,
    ),
]
Model = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="position, pose or plane-distance; default what the columns show.",
        rich_help_panel=FRAMES,
    ),
]
Base = Annotated[
    str | None,
    typer.Option(
        "--base",
        metavar="LINK",
        help="Start of the chain; default the root.",
        rich_help_panel=FRAMES,
    ),
]
Tip = Annotated[
    str | None,
    typer.Option(
        "--tip",
        metavar="LINK",
        help="End of the chain; default the only leaf.",
        rich_help_panel=FRAMES,
    ),
]
Parameters = Annotated[
    str | None,
    typer.Option(
        "--parameters",
        metavar="P,...",
        help="placement (default), link-transform, dh, dh-full, joint-offset; "
        "several may be combined.",
        rich_help_panel=FRAMES,
    ),
]
Seed = Annotated[
    int,
    typer.Option(
        "--seed",
        metavar="N",
        help="Seed of all that is random.",
        parser=number(int, "--seed", "0, 1, 2, ...", 0),
        rich_help_panel=FIT,
    ),
]
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


def show(content: RenderableType) -> None:
    """Print to standard output: colored on a terminal, plain 80 columns elsewhere."""
    from rich.console import Console

    from calib_pin.report.text import plain_text

    if sys.stdout.isatty():
        # Names are what they are: no markup and no emoji codes in them.
        Console(highlight=False, markup=False, emoji=False).print(content)
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
    from calib_pin.io.measured_columns import check_model
    from calib_pin.io.setup import read_setup
    from calib_pin.parameterizations import parameterization
    from calib_pin.setup import Setup

    for option, value in (("--base", base), ("--tip", tip)):
        if value is not None and not value.strip():
            raise OptionError(f"{option} is empty", allowed="the name of a link")
    setup = Setup() if file is None else read_setup(file)
    if parameters is not None:
        names = tuple(name.strip() for name in parameters.split(","))
        for name in names:
            parameterization(name)
        if len(set(names)) != len(names):
            raise OptionError("a parameterization is named twice", value=parameters)
        setup = replace(setup, parameters=names)
    if model is not None:
        check_model(model)
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
    from calib_pin.errors import RobotError
    from calib_pin.io.urdf import load_robot

    if robot.endswith(".json"):
        raise RobotError(
            "this command needs a robot; a calibration can only be evaluated",
            file=robot,
            allowed="a URDF file, such as the corrected one",
        )
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


def require_distinct(files: Sequence[Path]) -> None:
    """Refuse rows that would count twice.

    Raises:
        OptionError: If a file is given twice.
    """
    from calib_pin.errors import OptionError

    for position, file in enumerate(files):
        if any(_same(file, other) for other in files[:position]):
            raise OptionError("this file is given twice", file=file)


def check_outputs(
    outputs: Iterable[Path | None],
    inputs: Iterable[str | Path | None],
    force: bool,
) -> None:
    """Complain about files that must not be written, before the work is done.

    Args:
        outputs: The files to write.
        inputs: The files that are read; a robot may be one by name.
        force: Whether existing outputs may be replaced.

    Raises:
        OptionError: If an output exists without `force`, is an input, or is given
            twice.
    """
    from calib_pin.errors import OptionError
    from calib_pin.io.urdf import locate_robot

    read = [locate_robot(str(file)) for file in inputs if file is not None]
    written: list[Path] = []
    for path in outputs:
        if path is None:
            continue
        if any(_same(path, file) for file in read):
            raise OptionError(
                "is an input of this run, and inputs are never changed",
                file=path,
                allowed="another file",
            )
        if any(path.absolute() == other.absolute() for other in written):
            raise OptionError("two outputs would go to this file", file=path)
        if exists(path) and not force:
            raise OptionError("exists already; --force replaces it", file=path)
        written.append(path)


def _same(first: Path, second: Path) -> bool:
    try:
        return first.samefile(second)
    except (OSError, ValueError):
        return False  # One of them does not exist.


def exists(path: Path) -> bool:
    """Whether something is there, as far as that can be said."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False  # Whatever is wrong with it, writing will tell.
