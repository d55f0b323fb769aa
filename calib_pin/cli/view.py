"""`calib-pin view`: the robot, its errors and a plan in the browser."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    open_calibration,
    open_chains,
    open_measurements,
    open_setup,
    require_distinct,
    require_file,
    require_folders,
)
from calib_pin.cli.printing import notice, progress_bar, stage, tell_notices
from calib_pin.errors import OptionError, require_known

window_option = partial(options.option, "Window")


def view(
    robot: options.RobotOrCalibration,
    measurements: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[MEASUREMENTS...]", help="CSV or Parquet files."),
    ] = None,
    plan: Annotated[
        Path | None, window_option("--plan CSV", "Configurations to play in order.")
    ] = None,
    port: Annotated[
        int,
        window_option(
            "--port N",
            "Port on this machine; 0 for any free port.",
            options.number(int, "--port", "0 to 65535", 0, 65535),
        ),
    ] = 8080,
    once: Annotated[
        bool, window_option("--once", "Stop when the last window is closed.")
    ] = False,
    package_dir: options.PackageDirs = None,
    setup: options.SetupFile = None,
    model: options.Model = None,
    base: options.Base = None,
    tip: options.Tip = None,
    chain: options.ChainName = None,
    station_per_file: options.StationPerFile = False,
) -> int:
    """Show a robot in the browser, with the errors of measurements and a plan.

    A calibration shows the nominal robot beside the corrected one. Errors are those of
    the nominal robot with base and tool registered on these measurements (before), and
    those of the calibration as it is (after). The page is open to this machine only, at
    the address that is printed.
    """
    if find_spec("viser") is None:
        reason = "the viewer needs viser, which is missing: pip install "
        raise OptionError(f"{reason}'calib-pin[view]'")
    from calib_pin.viewer.scene import make_scene
    from calib_pin.viewer.server import Window

    stated = open_setup(setup, base=base, tip=tip, model=model)
    require_file(robot, ", or a robot")
    require_folders(package_dir or [])
    require_distinct(measurements or [])
    calibrated = None
    if robot.endswith(".json"):
        calibrated, stated = open_calibration(robot, setup, stated, notice)
        chains = calibrated.chains
        if chain is not None:
            require_known("chain", chain, calibrated.measured_chains)
    else:
        chains = open_chains(robot, stated, chain, package_dir)
    with progress_bar() as bar:
        read = partial(
            open_measurements,
            measurements or [],
            chain=chain,
            station_per_file=station_per_file,
            bar=bar,
        )
        scene = make_scene(
            chains,
            calibrated,
            stated,
            read if measurements else None,
            plan,
            package_dir or [],
            tell=notice,
            stage=partial(stage, bar),
        )
    window = Window(scene, port)
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
    return 0
