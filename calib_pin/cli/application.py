"""The application and its commands; imports nothing heavy, so that help is fast."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import typer
from typer.core import TyperCommand

from calib_pin import __version__
from calib_pin.cli.asked import COMMANDS
from calib_pin.cli.options import command
from calib_pin.errors import OptionError

ORDER = dict(Arguments=0, Robot=1, Constraints=3, Workers=4, Output=5, Other=6)
"""Place of the headings of `--help`; those of a single command stand between."""


def application(words: Sequence[str]) -> typer.Typer:
    """The application, as far as a command line needs it.

    Where it begins with a command, the others are left out: building all their options
    takes a while.
    """
    made = typer.Typer(
        name="calib-pin",
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    made.callback(
        invoke_without_command=True,
        epilog="Lengths are in m and angles in rad unless another unit is given. "
        "Exit status: 0 good, 1 wrong input or option, 2 the result must not be "
        "trusted.",
    )(overview)
    for name in COMMANDS.keys() & set(words[:1]) or COMMANDS:
        summary = (COMMANDS[name].__doc__ or "").partition("\n")[0]
        run = command(name, COMMANDS[name])
        made.command(name, cls=Command, short_help=summary)(run)
    return made


def overview(
    context: typer.Context,
    show: bool = typer.Option(False, "--version", help="Print the version."),
    _debug: bool = typer.Option(False, "--debug", help="Show tracebacks."),
) -> None:
    """Calibrate a robot's URDF from measurements."""
    if show:
        typer.echo(f"calib-pin {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


class Command(TyperCommand):
    """A command whose help reads `ROBOT MEASUREMENTS...`, with options by topic."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The words of the usage line."""
        arguments = [p for p in self.get_params(ctx) if p.param_type_name != "option"]
        return ["[OPTIONS]", *(argument.metavar or "" for argument in arguments)]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
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

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Arguments, then the options under the heading of their help panel."""
        topics: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            if param.param_type_name != "option":
                row = (param.metavar or "", getattr(param, "help", None) or "")
                topics.setdefault("Arguments", []).append(row)
            elif record := param.get_help_record(ctx):
                topic = getattr(param, "rich_help_panel", None) or "Other"
                topics.setdefault(topic, []).append(record)
        for topic, rows in sorted(topics.items(), key=lambda t: ORDER.get(t[0], 2)):
            with formatter.section(topic):
                formatter.write_dl(rows)
