"""The options of commands, each declared once.

What a command can be asked for is a dataclass. Its fields are arguments and options,
whose help are the attributes in its docstring; options that several commands share are
those of its bases.
"""

from __future__ import annotations

import math
import re
import typing
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from importlib import import_module
from inspect import cleandoc, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_type_hints

from calib_pin.cli.printing import notice, say, say_written, show
from calib_pin.errors import OptionError, require_known
from calib_pin.units import as_number

if TYPE_CHECKING:
    from calib_pin.report.blocks import Block
    from calib_pin.workers.base import Workers

# --- how a field is stated ----------------------------------------------------------


class Spec(NamedTuple):
    """How a user states a field.

    Attributes:
        word: Stands for its value in a help text; empty for a switch.
        heading: Heading of the option there; empty for an argument.
        parse: Makes the value of a text where that is more than its type, or the least
            and the largest of a number.
        needs: The field without which this one means nothing, in commands that have it.
        excludes: The fields that mean nothing beside this one.
    """

    word: str = ""
    heading: str = "Fit"
    parse: Callable[[str], Any] | tuple[float, float] | None = None
    needs: str = ""
    excludes: tuple[str, ...] = ()

    def parser(
        self, name: str, kind: Any, unit: str = ""
    ) -> Callable[[str], Any] | None:
        """Makes the value of a text; None where the type alone says how."""
        if not isinstance(self.parse, tuple):
            return self.parse
        whole = int in (kind, *get_args(kind))
        return number(int if whole else float, as_option(name), *self.parse, unit)

    def called(self, name: str) -> str:
        """A field as a user knows it."""
        return as_option(name) if self.heading else self.word.strip("[]")


def as_option(name: str) -> str:
    """The option of a field."""
    return f"--{name.replace('_', '-')}"


def require_partners(asked: object) -> None:
    """Refuse what would be ignored beside, or without, something else.

    Raises:
        OptionError: If there is such an argument or option; names both.
    """
    kind = type(asked)
    hints = get_type_hints(kind, include_extras=True)
    specs: dict[str, Spec] = {n: h.__metadata__[0] for n, h in hints.items()}
    given = {
        name: spec
        for name, spec in specs.items()
        if getattr(asked, name) not in (getattr(kind, name, None), [])
    }
    for name, spec in given.items():
        if spec.needs in specs and spec.needs not in given:
            other = specs[spec.needs].called(spec.needs)
            raise OptionError(f"{spec.called(name)} needs {other}")
        for excluded in spec.excludes:
            if excluded not in given:
                continue
            other = given[excluded].called(excluded)
            raise OptionError(f"{spec.called(name)} and {other} exclude each other")


def number(
    kind: type, option: str, least: float, most: float, unit: str = ""
) -> Callable[[str], Any]:
    """A parser of a number whose errors name the option, the value and the range."""
    allowed = f"{least:.6g} {f'to {most:.6g}' if most < math.inf else 'or more'}{unit}"
    allowed = f"whole numbers, {allowed}" if kind is int else allowed

    def parse(text: str | float) -> Any:
        value = as_number(str(text))
        # Not-a-number lies in no interval, and infinity is no whole number.
        fits = value is not None and least <= value <= most
        if value is None or not fits or (kind is int and not value.is_integer()):
            raise OptionError(f"{option} cannot be {text!r}", allowed=allowed)
        return kind(value)

    return parse


def known(
    kind: str, where: str, *more: str, between: str | None = None
) -> Callable[[str], str]:
    """A parser of a name that has to be known.

    Args:
        kind: The kind of name.
        where: The module of the package and the names in it, loaded when asked for;
            empty for none.
        more: Names beside them.
        between: Stands between several names; None for one.
    """

    def parse(text: str) -> str:
        module, _, family = where.partition(":")
        loaded = vars(import_module(f"calib_pin.{module}"))[family] if where else ()
        names = [name.strip() for name in text.split(between)] if between else [text]
        for name in names:
            require_known(kind, name, [*more, *loaded])
        if len(set(names)) != len(names):
            raise OptionError(f"a {kind} is named twice", value=text)
        return text

    return parse


def meanings(cls: type) -> dict[str, str]:
    """The attributes in the docstrings of a class and of its bases.

    Returns:
        Text on one line, by attribute.
    """
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        _, _, text = cleandoc(base.__doc__ or "").partition("Attributes:\n")
        text = text.split("\n\n")[0]
        for entry in re.split(r"\n    (?=\w)", "\n" + text)[1:]:
            name, _, meaning = entry.partition(": ")
            texts[name] = " ".join(meaning.split())
    return texts


def same(asked: object, function: Callable[..., Any]) -> dict[str, Any]:
    """The fields of what is asked for that a function calls as they are."""
    names = signature(function).parameters.keys() & vars(asked).keys()
    return {name: getattr(asked, name) for name in names}


@typing.dataclass_transform(frozen_default=True, kw_only_default=True)
class Asked:
    """Base of what is asked for: its classes are frozen dataclasses of keywords."""

    def __init_subclass__(cls) -> None:
        """Declare the fields of a class."""
        dataclass(frozen=True, kw_only=True)(cls)


# --- options that several commands share --------------------------------------------

SEED = (0, math.inf)
SOLVER = known("solver", "setup:SOLVERS")
LOSS = known("loss", "setup:LOSSES")
LEARNED = known("residual model", "residual_models:RESIDUAL_MODELS")
USE = known("use", "validation.model_selection:USES")
PICTURES = known("figure format", "", "png", "pdf", "svg")
PARAMETERS = known(
    "parameterization", "parameterizations:PARAMETERIZATIONS", between=","
)


class OfPackages(Asked):
    """The packages of a robot.

    Attributes:
        package_dir: Where to find ROS packages that the robot file references; may be
            repeated.
    """

    package_dir: Annotated[list[Path] | None, Spec("DIR", "Robot")] = None


class OfRobot(OfPackages):
    """The robot that a command is for, as it is asked for.

    Attributes:
        robot: URDF or xacro file (with its arguments, name:=value), name of a bundled
            robot, or example:NAME if example-robot-data is installed.
        setup: Setup file (YAML); options override it.
        model: Measurement model, or several joined by +; by default inferred from the
            columns.
        base: First link of the chain; by default the root link.
        tip: Last link of the chain; by default the end link, if there is only one.
    """

    robot: Annotated[str, Spec("ROBOT", "")]
    setup: Annotated[Path | None, Spec("FILE", "Robot")] = None
    model: Annotated[str | None, Spec("NAME", "Robot")] = None
    base: Annotated[str | None, Spec("LINK", "Robot")] = None
    tip: Annotated[str | None, Spec("LINK", "Robot")] = None


class OfStations(OfRobot):
    """A robot with its measurements, as they are asked for.

    Attributes:
        station_per_file: Every file is from another station of the instrument.
    """

    station_per_file: Annotated[bool, Spec("", "Robot")] = False


class OfChain(Asked):
    """The chain that a command is for.

    Attributes:
        chain: Chain, by its name in the setup file or that of its tip link; needed
            where there are several and the measurements do not say.
    """

    chain: Annotated[str | None, Spec("NAME", "Robot")] = None


class OfParameters(OfRobot):
    """The errors that a robot may have.

    Attributes:
        parameters: placement (default), link-transform, dh, dh-full, joint-offset;
            beyond geometry transmission, compliance, hysteresis, motor-ripple,
            cross-compliance, thermal, warm-up; of the instrument instrument-drift;
            several may be combined.
    """

    parameters: Annotated[str | None, Spec("P,...", "Robot", PARAMETERS)] = None


class OfCalibration(OfRobot):
    """A robot or a calibration that a command is for.

    Attributes:
        robot: URDF or xacro file (with its arguments, name:=value), bundled robot,
            example:NAME, or a calibration: its file or folder.
    """

    robot: Annotated[str, Spec("ROBOT|calibration.json", "")]


class Request(OfStations, OfParameters):
    """A calibration as it is asked for.

    A field is an argument or option of `calibrate`, whose help is the text here, and a
    key of a job of `fleet`.

    Attributes:
        measurements: CSV or Parquet files with one row per measurement.
        solver: gauss-newton (default), two-step (alternating: frames and instrument,
            then the robot), de (differential evolution), or hybrid: de, then
            gauss-newton, for errors of centimeters and degrees.
        loss: auto (default) sets outliers aside where there are any; gnc always
            searches for them; squared weights all measurements equally.
        learned: Learn the errors that no parameter describes: network or
            gaussian-process; with --model-ladder the only one that is tried.
        model_ladder: Select the model: try joint offsets, geometry, transmission,
            compliance and learned corrections on held-out measurements, and take the
            simplest of the best.
        use: Select the model that holds near the measured configurations, away from
            them, or both (default); implies --model-ladder.
        validation: Check the fit on the measurements of this file.
        holdout: Hold out this part of the measurements, such as 0.2, for the check.
        start: Go on from an older calibration of the robot, a folder or its
            calibration.json: few measurements are enough, and sudden changes of the
            robot are told.
        process_noise: With --start: how far each error of the geometry may have
            drifted since then, standard deviation [m, rad]; by default as the
            measurements show.
        seed: Random seed.
    """

    measurements: Annotated[list[Path], Spec("MEASUREMENTS...", "")]
    solver: Annotated[str | None, Spec("NAME", parse=SOLVER)] = None
    loss: Annotated[str | None, Spec("NAME", parse=LOSS)] = None
    learned: Annotated[str | None, Spec("NAME", parse=LEARNED)] = None
    model_ladder: Annotated[bool, Spec()] = False
    use: Annotated[str | None, Spec("WHERE", parse=USE)] = None
    validation: Annotated[Path | None, Spec("FILE")] = None
    holdout: Annotated[float | None, Spec("PART", parse=(0, 1))] = None
    start: Annotated[Path | None, Spec("CALIBRATION")] = None
    process_noise: Annotated[
        float | None, Spec("S", parse=(1e-9, 1e-2), needs="start")
    ] = None
    seed: Annotated[int, Spec("N", parse=SEED)] = 0

    def words(self, output: Path) -> tuple[str, ...]:
        """The command line of `calibrate` that asks for the same."""
        words = ["calibrate", self.robot, *map(str, self.measurements)]
        for asked in fields(Request):
            value, option = getattr(self, asked.name), as_option(asked.name)
            if asked.name in ("robot", "measurements") or value == asked.default:
                continue
            if value is True:
                words.append(option)
            else:
                for one in value if isinstance(value, list) else [value]:
                    words += [option, str(one)]
        return ("calib-pin", *words, "-o", str(output))


class Shown(Asked):
    """Whether a program reads what a command prints.

    Attributes:
        json: Print JSON.
    """

    json: Annotated[bool, Spec("", "Output")] = False

    def show(
        self, document: Callable[[], Mapping[str, Any]], blocks: Iterable[Block]
    ) -> None:
        """Print what is found, as JSON or as a report."""
        from calib_pin.io.json_text import encode

        if self.json:
            say(encode(document()).decode())
        else:
            show(blocks)


class Answer(Asked):
    """How a command answers that writes files.

    Attributes:
        force: Replace existing output.
    """

    force: Annotated[bool, Spec("", "Output")] = False

    quiet = False

    def give(
        self,
        contents: Mapping[Path, bytes],
        blocks: Iterable[Block] | str = (),
        written: Iterable[str] | None = None,
    ) -> None:
        """Write files, and print what is found; neither if one of both fails.

        Args:
            contents: The files.
            blocks: The report that is printed, or its text as it is.
            written: Lines on the files that are in place; default their names.
        """
        from calib_pin.io.files import write_files

        with write_files(contents, force=self.force):
            if not self.quiet and isinstance(blocks, str):
                say(blocks)
            elif not self.quiet and (shown := [*blocks]):
                show(shown)
        if not self.quiet:
            lines = (f"wrote {name}" for name in contents)
            say_written(lines if written is None else written)


class QuietAnswer(Answer):
    """The same, of a command that may say nothing.

    Attributes:
        quiet: Print nothing but errors.
    """

    quiet: Annotated[bool, Spec("", "Output")] = False

    def tell(self, remark: str) -> None:
        """A remark on standard error, of a command that may speak."""
        if not self.quiet:
            notice(remark)

    def ended(self, verdict: str, reason: str, *, reported: bool) -> int:
        """The exit status by a verdict, told here if no report has told it."""
        from calib_pin.estimation.evidence import TRUSTED

        if verdict in TRUSTED:
            return 0
        if not reported:
            notice(f"{verdict}: {reason}")
        return 2


class Detailed(Asked):
    """How much a command tells.

    Attributes:
        details: Print statistics, all parameters and formulae as well.
    """

    details: Annotated[bool, Spec("", "Output")] = False


class InDegrees(Asked):
    """The unit of what a command writes.

    Attributes:
        degrees: Write joint angles in degrees, with their unit.
    """

    degrees: Annotated[bool, Spec("", "Output")] = False


class Pictured(Asked):
    """The figures that a command draws.

    Attributes:
        figures: Folder for the figures.
        figure_format: png (default), pdf or svg.
    """

    figures: Annotated[Path | None, Spec("DIR", "Output")] = None
    figure_format: Annotated[
        str, Spec("FORMAT", "Output", PICTURES, needs="figures")
    ] = "png"


class Shared(Asked):
    """Who does the work of a command.

    Attributes:
        workers: Processes on this machine that share the work; by default one for
            every core. The results are the same for any number.
        cluster: Workers of a dask scheduler instead: its address, or its
            scheduler.json. Only in a trusted network.
    """

    workers: Annotated[int | None, Spec("N", "Workers", (1, 1000))] = None
    cluster: Annotated[
        str | None, Spec("ADDRESS", "Workers", excludes=("workers",))
    ] = None


def asked_workers(
    count: int | None, cluster: str | None, **patience: float
) -> AbstractContextManager[Workers]:
    """The workers that `--workers` and `--cluster` ask for.

    Args:
        count: Number of processes; None for one for every core.
        cluster: Address of a scheduler; None for processes of this machine.
        patience: That of these processes, see `LocalProcesses`.

    Raises:
        OptionError: If the cluster cannot be used.
    """
    if cluster is not None:
        from calib_pin.workers.cluster import Cluster

        return Cluster(cluster)
    from calib_pin.workers.local import LocalProcesses

    return LocalProcesses(count, **patience)
