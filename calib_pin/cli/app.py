"""The application and its commands; imports nothing heavy, so that help is fast."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import typer

from calib_pin.cli.calibrate import calibrate
from calib_pin.cli.command import Command
from calib_pin.cli.compare import compare
from calib_pin.cli.compensate import compensate
from calib_pin.cli.evaluate import evaluate
from calib_pin.cli.identify import identify
from calib_pin.cli.plan import plan
from calib_pin.cli.report import report
from calib_pin.cli.robots import robots
from calib_pin.cli.simulate import simulate
from calib_pin.cli.view import view

COMMANDS: dict[Callable[..., int | None], str] = {
    calibrate: "Fit a robot to measurements and write the corrected URDF.",
    identify: "Print which parameters are identifiable.",
    evaluate: "Print the accuracy of a robot or a calibration on measurements.",
    simulate: "Simulate measurements of a robot with known errors.",
    plan: "Choose optimal calibration configurations.",
    compensate: "Find joint commands that reach targets on the real robot.",
    compare: "Print the difference between two calibrations of a robot.",
    report: "Write the page and figures of a calibration again.",
    view: "Show a robot, its errors and a plan in the browser.",
    robots: "List the bundled robots.",
}


def application(words: Sequence[str]) -> typer.Typer:
    """The application, as far as a command line needs it.

    Args:
        words: The command line. Where it begins with a command, the others are left
            out: building all their options takes a while.
    """
    app = typer.Typer(
        name="calib-pin",
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    app.callback(
        invoke_without_command=True,
        epilog="Lengths are in m and angles in rad unless another unit is given. "
        "Exit status: 0 good, 1 wrong input or option, 2 the result must not be "
        "trusted.",
    )(overview)
    commands = {command.__name__: command for command in COMMANDS}
    for name in commands.keys() & set(words[:1]) or commands:
        summary = COMMANDS[commands[name]]
        app.command(name, cls=Command, short_help=summary)(commands[name])
    return app


def overview(
    context: typer.Context,
    show: bool = typer.Option(False, "--version", help="Print the version."),
    _debug: bool = typer.Option(False, "--debug", help="Show tracebacks."),
) -> None:
    """Calibrate a robot's URDF from measurements."""
    if show:
        from importlib.metadata import version

        typer.echo(f"calib-pin {version('calib-pin')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
