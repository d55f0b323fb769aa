"""Arguments and options that several commands share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, wraps
from inspect import Parameter, Signature, cleandoc, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import typer

from calib_pin.cli.completion import completed, robots
from calib_pin.cli.files import FLAGS, open_chains, open_setup
from calib_pin.cli.printing import notice, say, say_written, show
from calib_pin.cli.request import Request, Told
from calib_pin.cli.request import number as number
from calib_pin.errors import OptionError
from calib_pin.units import as_number

if TYPE_CHECKING:
    from calib_pin.kinematics.chains import Chains
    from calib_pin.observations import BlockKey
    from calib_pin.report.blocks import Block
    from calib_pin.setup import ReportSetup, Setup

ARGUMENTS = {
    *("robot", "measurements", "calibration", "targets", "first", "second"),
    *("images", "log", "name"),
}
"""Fields of requests that are arguments; all others are options."""

ANSWER = ("force", "quiet", "json")
"""Options of nearly all commands, the last ones of their help."""


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


def meanings(cls: type) -> dict[str, str]:
    """The attributes in the docstrings of a class and of its bases.

    Returns:
        Text on one line, by attribute.
    """
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        _, _, text = cleandoc(base.__doc__ or "").partition("Attributes:\n")
        text = text.split("\n\n")[0]
        for entry in re.split(r"\n    (?=\w)", "\n" + text)[1:]:
            name, _, meaning = entry.partition(": ")
            found[name] = " ".join(meaning.split())
    return found


def asked(name: str) -> Any:
    """The argument or the option for a field of the request of a calibration."""
    (told,) = get_type_hints(Request, include_extras=True)[name].__metadata__
    return declared(name, told, meanings(Request)[name])


def declared(name: str, told: Told, meaning: str) -> Any:
    """The argument or the option for a field of a request."""
    if name in ARGUMENTS:
        completion = robots if name == "robot" else None
        return typer.Argument(
            metavar=told.word, help=meaning, autocompletion=completion
        )
    short = "-o " if name == "output" else ""
    usage = f"{short}--{name.replace('_', '-')} {told.word}"
    then = listed if name == "model" else None
    return option(told.heading, usage, meaning, told.parse, then)


def spread(function: Callable[..., int]) -> Callable[..., int]:
    """A command whose first argument, a request, is made from options of its own."""
    first, *own = signature(function, eval_str=True).parameters.values()
    kind, only = first.annotation, Parameter.KEYWORD_ONLY
    hints, texts = get_type_hints(kind, include_extras=True), meanings(kind)
    for name, hint in hints.items():
        told = hint.__metadata__[0]
        if isinstance(told, Told):
            made = declared(name, told, texts.get(name, ""))
            hints[name] = Annotated[get_args(hint)[0], made]
    names = [*(name for name in hints if name not in ANSWER), *ANSWER]
    given = signature(kind).parameters
    fields = [given[name] for name in names if name in hints]
    options = [p.replace(annotation=hints[p.name], kind=only) for p in fields]
    options += [p.replace(kind=only) for p in own]

    @wraps(function)
    def run(**given: Any) -> int:
        return function(kind(**{name: given.pop(name) for name in hints}), **given)

    run.__signature__ = Signature(options)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in options}
    return run


robot, output = (partial(option, heading) for heading in ("Robot", "Output"))


def listed(model: str | None) -> str | None:
    """The name of a measurement model; `list` prints all with their help, and ends."""
    if model != "list":
        return model
    from calib_pin.measurement_models import MEASUREMENT_MODELS, declared

    for name in MEASUREMENT_MODELS:
        print(f"{name:18} {declared(name).help}")
    raise typer.Exit


RobotName = Annotated[str, asked("robot")]
PackageDirs = Annotated[list[Path] | None, asked("package_dir")]
SetupFile = Annotated[Path | None, asked("setup")]
Model = Annotated[str | None, asked("model")]
Base = Annotated[str | None, asked("base")]
Tip = Annotated[str | None, asked("tip")]
StationPerFile = Annotated[bool, asked("station_per_file")]
Parameters = Annotated[str | None, asked("parameters")]
RobotOrCalibration = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT|calibration.json",
        autocompletion=robots,
        help="URDF or xacro file (with its arguments, name:=value), bundled robot, "
        "example:NAME, or a calibration.",
    ),
]
ChainName = Annotated[
    str | None,
    robot(
        "--chain NAME",
        "Chain, by its name in the setup file or that of its tip link; needed where "
        "there are several and the measurements do not say.",
    ),
]


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


@dataclass(frozen=True, kw_only=True)
class OfRobot:
    """The robot that a command is for, as it is asked for."""

    robot: RobotName
    package_dir: PackageDirs = None
    setup: SetupFile = None
    model: Model = None
    base: Base = None
    tip: Tip = None

    def stated(self) -> Setup:
        """The setup file with the options on top; errors as of `open_setup`."""
        own = {name: value for name, value in vars(self).items() if name in FLAGS}
        return open_setup(self.setup, **own)

    def chains(
        self, setup: Setup, measured: Sequence[BlockKey] | str | None = None
    ) -> Chains:
        """The chains of the robot; all else as for `open_chains`."""
        return open_chains(self.robot, setup, measured, self.package_dir)


@dataclass(frozen=True, kw_only=True)
class Answer:
    """How a command answers."""

    force: Force = False
    json: Json = False

    quiet = False

    def give(
        self,
        contents: Mapping[Path, bytes],
        document: Callable[[], Mapping[str, Any]],
        blocks: Iterable[Block] | str = (),
        written: Iterable[str] = (),
    ) -> None:
        """Write files, and print what is found; neither if one of both fails.

        Args:
            contents: The files.
            document: Makes what is printed as JSON.
            blocks: The report that is printed else, or its text as it is.
            written: Lines on the files that are in place.
        """
        from calib_pin.io.files import write_files
        from calib_pin.io.json_text import encode

        told = not (self.json or self.quiet)
        with write_files(contents, force=self.force):
            if self.json:
                say(encode(document()).decode())
            elif told and isinstance(blocks, str):
                say(blocks)
            elif told and (shown := [*blocks]):
                show(shown)
        if told:
            say_written(written)


@dataclass(frozen=True, kw_only=True)
class QuietAnswer(Answer):
    """The same, of a command that may say nothing."""

    quiet: Quiet = False

    def tell(self, remark: str) -> None:
        """A remark on standard error, of a command that may speak."""
        if not self.quiet:
            notice(remark)


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
        joint, (interval, unit) = joint.strip(), split_header(rest)
        ends = [as_number(end.strip()) for end in interval.split(":")]
        wrong, allowed = f"--limits cannot be {word!r}", ""
        factor = 1.0 if unit is None else units.get(unit, 0.0)
        if not joint or len(ends) != 2 or None in ends or not factor:
            allowed = "JOINT=LOWER:UPPER, such as 'elbow=-90:90 [deg]'; units "
            raise OptionError(wrong, allowed=allowed + ", ".join(units))
        lower, upper = (factor * float(end or 0.0) for end in ends)
        # Degrees would leave a joint as free as it was, without a word.
        if not -ANGLE.largest <= lower <= upper <= ANGLE.largest:
            most = f"{ANGLE.largest:.4g} rad or m"
            allowed = (
                f"LOWER up to UPPER, at most {most}; other units in brackets: [deg]"
            )
            raise OptionError(wrong, allowed=allowed)
        for k in matching(joint, chains.joints):
            kind = ANGLE if chains.revolute[k] else LENGTH
            if unit not in (None, *kind.units):
                wrong += f": joint '{chains.joints[k]}' is of another kind"
                raise OptionError(wrong, allowed=", ".join(kind.units))
        limits[joint] = (lower, upper)
    return limits


def dated(entries: ReportSetup) -> ReportSetup:
    """The entries of a report with their date, by default today."""
    from dataclasses import replace
    from datetime import date

    return replace(entries, date=entries.date or date.today().isoformat())
