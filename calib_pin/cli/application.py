"""The application and its commands; imports nothing heavy, so that help is fast."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import import_module
from inspect import Parameter, cleandoc, signature
from pathlib import Path
from typing import Any, get_args, get_type_hints

import click

from calib_pin import __version__
from calib_pin.cli.asked import COMMANDS
from calib_pin.cli.options import Spec, as_option, meanings, require_partners
from calib_pin.errors import OptionError

INTERRUPTED = 130
"""Status after Ctrl-C."""

ORDER = dict(Arguments=0, Robot=1, Constraints=3, Workers=4, Output=5, Other=6)
"""Place of the headings of `--help`; those of a single command stand between."""

PLACES = {"output": -1, "force": 1, "quiet": 2, "json": 3}
"""Options of nearly all commands, by their places before or behind others."""


def application(words: Sequence[str]) -> click.Group:
    """The application, as far as a command line needs it.

    Where it begins with a command, the others are left out: building all their options
    takes a while.
    """
    group = Commands(
        "calib-pin",
        invoke_without_command=True,
        subcommand_metavar="COMMAND [ARGS]...",
        callback=overview,
        params=[
            click.Option(["--version"], is_flag=True, help="Print the version."),
            click.Option(["--debug"], is_flag=True, help="Show tracebacks."),
        ],
        help="Calibrate a robot's URDF from measurements.",
        epilog="Lengths are in m and angles in rad unless another unit is given. "
        "Exit status: 0 good, 1 wrong input or option, 2 the result must not be "
        "trusted.",
    )
    for name in COMMANDS.keys() & set(words[:1]) or COMMANDS:
        group.add_command(Command(name, COMMANDS[name]))
    return group


@click.pass_context
def overview(context: click.Context, version: bool, debug: bool) -> None:
    """Print the version, or all commands where none is named."""
    if version:
        click.echo(f"calib-pin {__version__}")
    elif context.invoked_subcommand is None:
        click.echo(context.get_help())


class Commands(click.Group):
    """Commands in the order in which people need them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Their names."""
        return list(self.commands)


class Command(click.Command):
    """The command that takes a request, which the module of its name does.

    Its help reads `ROBOT MEASUREMENTS...`, with options by topic.
    """

    def __init__(self, name: str, kind: type) -> None:
        """Declare arguments and options for the fields of a request."""
        hints, self.texts = get_type_hints(kind, include_extras=True), meanings(kind)
        fields = sorted(hints, key=lambda name: PLACES.get(name, 0))
        self.specs: dict[str, Spec] = {f: hints[f].__metadata__[0] for f in fields}
        given = signature(kind).parameters
        parameters = [
            _declared(f, spec, hints[f].__origin__, self.texts[f], given[f].default)
            for f, spec in self.specs.items()
        ]

        @click.pass_obj
        def run(words: Sequence[str], /, **values: Any) -> int:
            lists = {k: list(v) for k, v in values.items() if isinstance(v, tuple)}
            asked = kind(**{k: v for k, v in (values | lists).items() if v != []})
            require_partners(asked)
            work = getattr(import_module(f"calib_pin.cli.{name}"), name)
            try:
                return int(work(asked, *[words][: len(signature(work).parameters) - 1]))
            except KeyboardInterrupt:
                return INTERRUPTED

        text = cleandoc(kind.__doc__ or "").partition("\n\nAttributes:")[0]
        summary = text.partition("\n")[0]
        super().__init__(name, None, run, parameters, text, short_help=summary)

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """The words of the usage line."""
        return ["[OPTIONS]", *(s.word for s in self.specs.values() if not s.heading)]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Words like `name:=value`, wherever they stand, belong to the robot."""
        parts = ((word, *word.partition(":=")) for word in args)
        xacro = [word for word, name, mark, _ in parts if mark and name.isidentifier()]
        rest = super().parse_args(ctx, [word for word in args if word not in xacro])
        if xacro and "robot" not in ctx.params:
            reason = "is an argument of a robot, and this command takes none"
            raise OptionError(f"{xacro[0]} {reason}")
        if xacro:
            ctx.params["robot"] = " ".join([ctx.params["robot"], *xacro])
        return rest

    def format_options(self, ctx: click.Context, formatter: Any) -> None:
        """Arguments, then the options under the heading of their topic."""
        topics: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            spec = self.specs.get(param.name or "", Spec(heading="Other"))
            record = param.get_help_record(ctx)
            if not spec.heading:
                record = spec.word, self.texts[str(param.name)]
            if record:
                topics.setdefault(spec.heading or "Arguments", []).append(record)
        for topic, rows in sorted(topics.items(), key=lambda t: ORDER.get(t[0], 2)):
            with formatter.section(topic):
                formatter.write_dl(rows)


def _declared(
    name: str, spec: Spec, kind: Any, meaning: str, default: Any
) -> click.Parameter:
    """The argument or the option for a field."""
    kinds = {kind, *get_args(kind)}
    several, of_files = list[Path] in kinds, not kinds.isdisjoint((Path, list[Path]))
    unit = "".join(f" {unit}" for unit in re.findall(r"\[(m|s|m, rad)\]", meaning)[:1])
    parse: Any = spec.parser(name, kind, unit)
    if parse is None and (of_files or not spec.heading):
        # A shell completes files; a robot is mostly one, too.
        parse = click.Path(path_type=Path if of_files else str)
    required = default is Parameter.empty
    shared: dict[str, Any] = {"type": parse, "required": required}
    shared["metavar"] = spec.word or None
    if not spec.heading:
        return click.Argument([name], nargs=-1 if several else 1, **shared)
    return click.Option(
        [name, *["-o"] * (name == "output"), as_option(name)],
        multiple=several,
        is_flag=kind is bool,
        **({} if required else {"default": default}),
        show_default=kind is not bool,
        help=meaning,
        **shared,
    )
