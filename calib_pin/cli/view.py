"""`calib-pin view`: the robot, its errors and a plan in the browser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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

if TYPE_CHECKING:
    from calib_pin.kinematics.chains import Chains
    from calib_pin.observations import Observations
    from calib_pin.setup import Setup
    from calib_pin.validation.calibrated_model import CalibratedModel
    from calib_pin.viewer.scene import Scene

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
    from calib_pin.viewer.server import Window

    stated = open_setup(setup, base=base, tip=tip, model=model)
    require_file(robot, ", or a robot")
    require_folders(package_dir or [])
    require_distinct(measurements or [])
    read = partial(
        open_measurements,
        measurements or [],
        chain=chain,
        station_per_file=station_per_file,
    )
    calibrated = None
    if robot.endswith(".json"):
        calibrated, stated = open_calibration(robot, setup, stated, notice)
        chains = calibrated.chains
        if chain is not None:
            require_known("chain", chain, calibrated.measured_chains)
    else:
        chains = open_chains(robot, stated, chain, package_dir)
    reading = read if measurements else None
    scene = _scene(chains, calibrated, stated, reading, plan, package_dir or [])
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


def _scene(
    chains: Chains,
    model: CalibratedModel | None,
    setup: Setup,
    read: Callable[..., tuple[Chains, Observations]] | None,
    plan: Path | None,
    package_dirs: Sequence[Path],
) -> Scene:
    """The scene of a robot, or of one nominally and as it was calibrated.

    `read` reads the measurements, as `open_measurements` does.
    """
    import numpy as np

    from calib_pin.io.measurements import read_configurations, read_names
    from calib_pin.io.robot_shapes import robot_shapes
    from calib_pin.kinematics.skeleton import corners, drawn_link
    from calib_pin.report.surroundings import surroundings
    from calib_pin.validation.evaluation import Prepared, prepared
    from calib_pin.viewer.scene import (
        Plan,
        Rows,
        Scene,
        bodies_of,
        stage_errors,
        things_around,
        tip_paths,
    )

    rows, planned, ready = None, None, list[Prepared]()
    with progress_bar() as bar:
        if read is not None:
            known = {} if model is None else model.references
            sockets = (reference.name for reference in known.values())
            measured, data = read(chains, setup, sockets=sockets, bar=bar)
            chains = measured if model is None else chains
            stage(bar, "errors")
            ready.append(prepared(chains, data, setup))
            if reason := ready[0].reason:
                notice(f"the errors before cannot be trusted: {reason}")
            ready += [] if model is None else [prepared(model, data)]
            found = [stage_errors(robot, drawn_link(chains)) for robot in ready]
            rows = Rows(data, dict(zip(("before", "after"), found, strict=False)))
        if not chains.names and (plan is not None or setup.base):
            named = () if plan is None else read_names(plan, "chain").distinct
            chains = chains.named(named or ("",))
        link = drawn_link(chains)
        if plan is not None:
            q = read_configurations(plan, chains, setup.joints)
            planned = Plan(q, tip_paths(chains, q, link, model))
        stage(bar, "shapes")
        shapes = robot_shapes(chains.robot, package_dirs)
    if shapes.missing:
        first, *others = shapes.missing
        count = f"{1 + len(others)} meshes are" if others else "1 mesh is"
        notice(
            f"{count} missing or unreadable and replaced by simple shapes: {first}"
            f"{', ...' if others else ''}; name the folder of its package with "
            "--package-dir"
        )
    bodies = tuple(bodies_of(chains.robot, link, model))
    skeleton = bodies[0].skeleton
    reach = float(np.ptp(corners(skeleton, shapes.parts, skeleton.neutral), 0).max())
    things = [] if model is None else surroundings(model.parts, {}, reach)
    if ready:
        things = things_around(ready[-1], reach)
    title = chains.robot.name
    return Scene(title, shapes.parts, bodies, chains, rows, planned, tuple(things))
