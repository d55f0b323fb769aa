"""`calib-pin view`: the robot, its errors and a plan in the browser."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib_pin.cli import files, options, printing
from calib_pin.cli.options import Told
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.viewer.server import Window


@dataclass(frozen=True, kw_only=True)
class Windowed:
    """A page as it is asked for.

    Attributes:
        port: Port on this machine; 0 for any free port.
        once: Stop when the last tab is closed.
    """

    port: Annotated[int, Told("N", "Window", (0, 65535))] = 8080
    once: Annotated[bool, Told("", "Window")] = False

    def serve(self, window: Window) -> None:
        """Tell where a window is; keep it until Ctrl-C or the last tab is closed."""
        try:
            if self.port not in (0, window.port):
                free = f"port {self.port} cannot be used; {window.port} is free"
                printing.notice(free)
            printing.tell_notices()
            typer.echo(f"viewing at {window.url} (Ctrl-C ends it)")
            window.run(self.once)
        except KeyboardInterrupt:
            typer.echo()
        finally:
            window.close()


@dataclass(frozen=True, kw_only=True)
class View(Windowed, options.OfStations, options.OfChain, options.OfCalibration):
    """A window as it is asked for.

    Attributes:
        measurements: CSV or Parquet files.
        plan: Configurations to play in order.
    """

    measurements: Annotated[list[Path] | None, Told("[MEASUREMENTS...]", "")] = None
    plan: Annotated[Path | None, Told("CSV", "Window")] = None


@options.spread
def view(asked: View) -> int:
    """Show a robot in the browser, with the errors of measurements and a plan.

    A calibration shows the nominal robot beside the corrected one. Errors are those of
    the nominal robot with base and tool registered on these measurements (before), and
    those of the calibration as it is (after). The page is open to this machine only, at
    the address that is printed.
    """
    require_viser()
    from calib_pin.viewer.scene import make_scene
    from calib_pin.viewer.server import Window

    folders = asked.package_dir or []
    files.require_folders(folders)
    calibrated, chains, stated = asked.subject(printing.notice, asked.chain)
    with printing.progress_bar() as bar:
        read = partial(asked.read, asked.measurements or [], bar=bar)
        scene = make_scene(
            chains,
            calibrated,
            stated,
            read if asked.measurements else None,
            asked.plan,
            folders,
            tell=printing.notice,
            stage=partial(printing.stage, bar),
        )
    window = Window(scene.title, asked.port)
    window.show(scene)
    asked.serve(window)
    return 0


def require_viser() -> None:
    """Refuse to show anything without the library for it.

    Raises:
        OptionError: If it is missing.
    """
    if find_spec("viser") is None:
        reason = "the viewer needs viser, which is missing: pip install "
        raise OptionError(f"{reason}'calib-pin[view]'")
