"""`calib-pin view`: the robot, its errors and a plan in the browser."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import click

from calib_pin.cli import files, printing
from calib_pin.cli.asked import View, Windowed
from calib_pin.errors import require_package

if TYPE_CHECKING:
    from calib_pin.viewer.server import Window


def view(asked: View) -> int:
    """Do what `View` asks for."""
    require_viser()
    from calib_pin.viewer.scene import make_scene
    from calib_pin.viewer.server import Window

    folders = asked.package_dir or []
    files.require_folders(folders)
    subject = files.open_subject(asked)
    calibrated, chains = subject.calibration, subject.chains
    if subject.doubt:
        printing.notice(subject.doubt)
    with printing.progress_bar() as bar:
        model, rows = None if calibrated is None else calibrated.model, None
        if asked.measurements:
            measured, rows = files.open_tested(asked, asked.measurements, subject, bar)
            chains = chains if model else measured
        tell, stage = printing.notice, partial(printing.stage, bar)
        about = chains, model, subject.setup, rows, asked.plan, folders
        scene = make_scene(*about, tell=tell, stage=stage)
    window = Window(scene.title, asked.port)
    window.show(scene)
    serve(asked, window)
    return 0


def require_viser() -> None:
    """Refuse to show anything without the library for it.

    Raises:
        OptionError: If it is missing.
    """
    require_package("viser", "the viewer needs viser", "view")


def serve(asked: Windowed, window: Window) -> None:
    """Tell where a window is, and keep it until Ctrl-C."""
    try:
        if asked.port not in (0, window.port):
            free = f"port {asked.port} cannot be used; {window.port} is free"
            printing.notice(free)
        printing.tell_notices()
        click.echo(f"viewing at {window.url} (Ctrl-C ends it)")
        window.run()
    except KeyboardInterrupt:
        click.echo()
    finally:
        window.close()
