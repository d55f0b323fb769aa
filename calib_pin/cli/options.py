"""Arguments and options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from functools import partial, wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

from calib_pin.cli.completion import completed, robots
from calib_pin.errors import OptionError
from calib_pin.units import as_number

if TYPE_CHECKING:
    from calib_pin.kinematics.chains import Chains
    from calib_pin.setup import ReportSetup

_Number = TypeVar("_Number", int, float)


def number(
    kind: type[_Number],
    option: str,
    allowed: str,
    least: float = -math.inf,
    most: float = math.inf,
) -> Callable[[str], _Number]:
    """A parser of a number whose errors name the option, the value and the range."""

    def parse(text: str | _Number) -> _Number:
        try:
            value = None if as_number(str(text)) is None else kind(text)
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
    usage: str,
    meaning: str,
    parser: Callable[[str], Any] | None = None,
    callback: Callable[..., Any] | None = None,
) -> Any:
    """An option under a heading of `--help`.

    Its usage are its names and the word for its value; without that it is a switch.
    """
    words = usage.split()
    names = [word for word in words if word.startswith("-")]
    return typer.Option(
        *names,
        metavar=" ".join(words[len(names) :]) or None,
        help=meaning,
        parser=parser,
        callback=callback,
        autocompletion=completed(names[-1]),
        rich_help_panel=heading,
    )


def parameters(kind: Any) -> list[Parameter]:
    """The fields of a dataclass as parameters of a command."""
    hints = get_type_hints(kind, include_extras=True)
    return [
        Parameter(
            f.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if f.default is MISSING else f.default,
            annotation=hints[f.name],
        )
        for f in fields(kind)
    ]


def command(declared: Sequence[Parameter], function: Callable[..., Any]) -> Any:
    """A function as a command with these parameters."""
    function.__signature__ = Signature(declared)  # type: ignore[attr-defined]
    function.__annotations__ = {p.name: p.annotation for p in declared}
    return function


def spread(function: Callable[..., int]) -> Callable[..., int]:
    """A command whose first argument, a dataclass, is made from options of its own."""
    first, *own = signature(function, eval_str=True).parameters.values()
    asked = parameters(first.annotation)

    @wraps(function)
    def run(**given: Any) -> int:
        values = {p.name: given.pop(p.name) for p in asked}
        return function(first.annotation(**values), **given)

    others = (p.replace(kind=Parameter.KEYWORD_ONLY) for p in own)
    return command([*asked, *others], run)  # type: ignore[no-any-return]


robot, fit, constraints, output = (
    partial(option, heading) for heading in ("Robot", "Fit", "Constraints", "Output")
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
        autocompletion=robots,
        help="URDF or xacro file (with its arguments, name:=value), name of a bundled "
        "robot, or example:NAME if example-robot-data is installed.",
    ),
]
RobotOrCalibration = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT|calibration.json",
        autocompletion=robots,
        help="URDF or xacro file (with its arguments, name:=value), bundled robot, "
        "example:NAME, or a calibration.",
    ),
]
PackageDirs = Annotated[
    list[Path] | None,
    robot(
        "--package-dir DIR",
        "Folder of the ROS packages that the robot names; may be repeated.",
    ),
]
SetupFile = Annotated[
    Path | None, robot("--setup FILE", "Setup file (YAML); options override it.")
]
Model = Annotated[
    str | None,
    robot(
        "--model NAME",
        "Measurement model, or several joined by +; by default inferred from the "
        "columns. 'list' prints all.",
        callback=listed,
    ),
]
Base = Annotated[
    str | None,
    robot("--base LINK", "First link of the chain; by default the root."),
]
Tip = Annotated[
    str | None,
    robot("--tip LINK", "Last link of the chain; by default the only leaf."),
]
ChainName = Annotated[
    str | None,
    robot(
        "--chain NAME",
        "Chain, by its name in the setup file or that of its tip link; needed where "
        "there are several and the measurements do not say.",
    ),
]
StationPerFile = Annotated[
    bool,
    robot(
        "--station-per-file", "Every file is from another station of the instrument."
    ),
]
Parameters = Annotated[
    str | None,
    robot(
        "--parameters P,...",
        "placement (default), link-transform, dh, dh-full, joint-offset{}; beyond "
        "geometry transmission, compliance, hysteresis, motor-ripple, "
        "cross-compliance, thermal, warm-up{}; of the instrument instrument-drift; "
        "several may be combined.",
    ),
]


def seed(heading: str, meaning: str = "Random seed.") -> Any:
    """The option `--seed`."""
    return option(
        heading, "--seed N", meaning, number(int, "--seed", "0, 1, 2, ...", 0)
    )


Seed = Annotated[int, seed("Fit")]
Force = Annotated[bool, output("--force", "Replace existing output.")]
Quiet = Annotated[bool, output("--quiet", "Print nothing but errors.")]
Degrees = Annotated[
    bool, output("--degrees", "Write joint angles in degrees, with their unit.")
]
Json = Annotated[bool, output("--json", "Print JSON.")]
Details = Annotated[
    bool,
    output("--details", "Print statistics, all parameters and formulae as well."),
]


def parse_limits(
    words: Sequence[str], chains: Chains
) -> dict[str, tuple[float, float]]:
    """Limits by joint name or glob [rad, m].

    Args:
        words: `JOINT=LOWER:UPPER`, with a unit in brackets if it is not rad or m.
        chains: The chains; whether a name is one of their joints is checked later.

    Raises:
        OptionError: If a word is not of this form, the limits cross, or the unit is
            none of a joint that is meant.
    """
    from calib_pin.io.columns import ANGLE, LENGTH, split_header
    from calib_pin.parameters import matching

    units = {**ANGLE.units, **LENGTH.units}
    limits = {}
    for word in words:
        # The name of a joint may hold a sign of equality, an interval cannot.
        joint, _, rest = word.rpartition("=")
        joint = joint.strip()
        interval, unit = split_header(rest)
        low, _, high = interval.partition(":")
        lower, upper = as_number(low.strip()), as_number(high.strip())
        factor = 1.0 if unit is None else units.get(unit)
        if not joint or lower is None or upper is None or factor is None:
            raise OptionError(
                f"--limits cannot be {word!r}",
                allowed="JOINT=LOWER:UPPER, such as 'elbow=-90:90 [deg]'; units "
                + ", ".join(units),
            )
        lower, upper = factor * lower, factor * upper
        # Degrees would leave a joint as free as it was, without a word.
        if not -ANGLE.largest <= lower <= upper <= ANGLE.largest:
            raise OptionError(
                f"--limits cannot be {word!r}",
                allowed=f"LOWER up to UPPER, at most {ANGLE.largest:.4g} rad or m; "
                "other units in brackets: [deg]",
            )
        for k in matching(joint, chains.joints):
            kind = ANGLE if chains.revolute[k] else LENGTH
            if unit is not None and unit not in kind.units:
                raise OptionError(
                    f"--limits cannot be {word!r}: joint '{chains.joints[k]}' is "
                    f"{'revolute' if chains.revolute[k] else 'prismatic'}",
                    allowed=", ".join(kind.units),
                )
        limits[joint] = (lower, upper)
    return limits


def dated(entries: ReportSetup) -> ReportSetup:
    """The entries of a report with their date, by default today."""
    from dataclasses import replace
    from datetime import date

    return replace(entries, date=entries.date or date.today().isoformat())
