"""The application and its commands; imports nothing heavy, so that help is fast."""

from __future__ import annotations

import typer

from calib_pin.cli.calibrate import calibrate
from calib_pin.cli.evaluate import evaluate
from calib_pin.cli.identify import identify
from calib_pin.cli.robots import robots
from calib_pin.cli.simulate import simulate

__all__ = ["app"]

app = typer.Typer(
    name="calib-pin",
    help="Calibrate a robot's URDF from measurements. --debug shows tracebacks.",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for command in (calibrate, identify, evaluate, simulate, robots):
    app.command(command.__name__)(command)


@app.callback(invoke_without_command=True)
def version(
    show: bool = typer.Option(False, "--version", help="Print the version."),
) -> None:
    """Calibrate a robot's URDF from measurements. --debug shows tracebacks."""
    if show:
        from importlib.metadata import version as installed

        typer.echo(f"calib-pin {installed('calib-pin')}")
        raise typer.Exit
