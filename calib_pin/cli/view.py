"""`calib-pin view`: the robot, its errors and a plan in the browser."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    open_calibration,
    open_measurements,
    require_distinct,
    require_file,
    require_folders,
)
from calib_pin.cli.printing import notice, progress_bar, stage, tell_notices
from calib_pin.cli.request import Told, number
from calib_pin.errors import OptionError, require_known

if TYPE_CHECKING:
    from calib_pin.viewer.server import Window

PORT = number(int, "--port", "0 to 65535", 0, 65535)


@dataclass(frozen=True, kw_only=True)
class View(options.OfRobot):
    """A window as it is asked for.

    Attributes:
        measurements: CSV or Parquet files.
        plan: Configurations to play in order.
        port: Port on this machine; 0 for any free port.
        once: Stop when the last window is closed.
    """

    robot: options.RobotOrCalibration
    measurements: Annotated[list[Path] | None, Told("[MEASUREMENTS...]")] = None
    plan: Annotated[Path | None, Told("CSV", "Window")] = None
    port: Annotated[int, Told("N", "Window", PORT)] = 8080
    once: Annotated[bool, Told("", "Window")] = False
    chain: options.ChainName = None
    station_per_file: options.StationPerFile = False


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

    stated, robot, chain = asked.stated(), asked.robot, asked.chain
    files, folders = asked.measurements or [], asked.package_dir or []
    require_file(robot, ", or a robot")
    require_folders(folders)
    require_distinct(files)
    calibrated = None
    if robot.endswith(".json"):
        calibrated, stated = open_calibration(robot, asked.setup, stated, notice)
        chains = calibrated.chains
        if chain is not None:
            require_known("chain", chain, calibrated.measured_chains)
    else:
        chains = asked.chains(stated, chain)
    with progress_bar() as bar:
        own = asked.station_per_file
        read = partial(
            open_measurements, files, chain=chain, station_per_file=own, bar=bar
        )
        scene = make_scene(
            chains,
            calibrated,
            stated,
            read if files else None,
            asked.plan,
            folders,
            tell=notice,
            stage=partial(stage, bar),
        )
    window = Window(scene.title, asked.port)
    window.show(scene)
    serve(window, asked.port, asked.once)
    return 0


def require_viser() -> None:
    """Refuse to show anything without the library for it.

    Raises:
        OptionError: If it is missing.
    """
    if find_spec("viser") is None:
        reason = "the viewer needs viser, which is missing: pip install "
        raise OptionError(f"{reason}'calib-pin[view]'")


def serve(window: Window, port: int, once: bool) -> None:
    """Tell where a window is, and keep it until Ctrl-C or the last tab is closed."""
    try:
        if port not in (0, window.port):
            notice(f"port {port} cannot be used; {window.port} is free")
        tell_notices()
        typer.echo(f"viewing at {window.url} (Ctrl-C ends it)")
        window.run(once)
    except KeyboardInterrupt:
        typer.echo()
    finally:
        window.close()
