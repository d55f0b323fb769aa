"""`calib-pin view`: the robot, its errors and a plan in the browser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
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
    tell_remarks,
)
from calib_pin.cli.printing import Bar, notice, progress_bar, stage, tell_notices
from calib_pin.errors import OptionError, require_known

if TYPE_CHECKING:
    from calib_pin.kinematics.chains import Chains
    from calib_pin.observations import Observations
    from calib_pin.report.surroundings import Thing
    from calib_pin.setup import Setup
    from calib_pin.validation.calibrated_model import CalibratedModel
    from calib_pin.validation.evaluation import Prepared
    from calib_pin.viewer.scene import Rows, Scene

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
    _require_viser()
    from calib_pin.viewer.server import Window

    stated = open_setup(setup, base=base, tip=tip, model=model)
    require_file(robot, ", or a robot")
    require_folders(package_dir or [])
    require_distinct(measurements or [])
    reading = partial(
        open_measurements,
        measurements or [],
        chain=chain,
        station_per_file=station_per_file,
    )
    read = reading if measurements else None
    scene = _open(robot, read, plan, package_dir or [], setup, stated, chain)
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


def _require_viser() -> None:
    """Complain if the extra is missing."""
    from importlib.util import find_spec

    if find_spec("viser") is None:
        raise OptionError(
            "the viewer needs viser, which is missing: pip install 'calib-pin[view]'"
        )


Reading = Callable[..., "tuple[Chains, Observations]"]
"""Reads the measurements, as `open_measurements` does."""


def _open(
    name: str,
    reading: Reading | None,
    plan: Path | None,
    package_dirs: list[Path],
    file: Path | None,
    setup: Setup,
    chain: str | None,
) -> Scene:
    """The scene to draw."""
    from calib_pin.io.measurements import read_configurations, read_names
    from calib_pin.io.robot_shapes import robot_shapes
    from calib_pin.io.urdf import load_robot
    from calib_pin.kinematics.skeleton import corners, drawn_link
    from calib_pin.report.surroundings import surroundings
    from calib_pin.viewer.errors import things_around
    from calib_pin.viewer.scene import Plan, Scene, bodies_of, tip_paths

    model, chains, rows, planned = None, None, None, None
    if name.endswith(".json"):
        model, setup = open_calibration(name, file, setup, notice)
        chains = model.chains
        if chain is not None:
            require_known("chain", chain, model.measured_chains)
    elif reading is not None or plan is not None or setup.base or setup.tip or chain:
        chains = open_chains(name, setup, chain, package_dirs)
    if chains is None:
        robot = load_robot(name, package_dirs)
        tell_remarks(robot)
    else:
        robot = chains.robot
    with progress_bar() as bar:
        known: Prepared | None = None
        if chains is not None and reading is not None:
            chains, rows, known = _rows(model, chains, reading, setup, bar)
        if chains is not None and not chains.names:
            named = () if plan is None else read_names(plan, "chain").distinct
            chains = chains.named(named or ("",))
        link = robot.root if chains is None else drawn_link(chains)
        if chains is not None and plan is not None:
            q = read_configurations(plan, chains, setup.joints)
            planned = Plan(q, tip_paths(chains, q, link, model))
        shapes = robot_shapes(robot, package_dirs, stage(bar, "shapes"))
    if shapes.missing:
        _note_missing(shapes.missing)
    bodies = tuple(bodies_of(robot, link, model))
    skeleton = bodies[0].skeleton
    size = corners(skeleton, shapes.parts, skeleton.neutral)
    reach = float((size.max(axis=0) - size.min(axis=0)).max())
    things: Sequence[Thing] = ()
    if known is not None:
        things = things_around(known, reach)
    elif model is not None:
        things = surroundings(model.terms, {}, reach)
    return Scene(robot.name, shapes.parts, bodies, chains, rows, planned, tuple(things))


def _note_missing(meshes: Sequence[str]) -> None:
    """Say once that simple shapes stand in for meshes."""
    first, *others = meshes
    count = f"{len(meshes)} meshes are" if others else "1 mesh is"
    notice(
        f"{count} missing or unreadable and replaced by simple shapes: {first}"
        f"{', ...' if others else ''}; name the folder of its package with "
        "--package-dir"
    )


def _rows(
    model: CalibratedModel | None,
    chains: Chains,
    reading: Reading,
    setup: Setup,
    bar: Bar | None,
) -> tuple[Chains, Rows, Prepared]:
    """Measurements, and the errors of the nominal and of the calibrated robot.

    Returns:
        The chains, the measurements, and the last of these robots.
    """
    from calib_pin.kinematics.skeleton import drawn_link
    from calib_pin.validation.evaluation import prepared
    from calib_pin.viewer.errors import stage_errors
    from calib_pin.viewer.scene import Rows

    known = {} if model is None else model.references
    sockets = (reference.name for reference in known.values())
    measured, rows = reading(chains, setup, sockets=sockets, bar=bar)
    chains = measured if model is None else chains
    link = drawn_link(chains)
    stage(bar, "errors")
    before = prepared(chains, rows, setup)
    if before.reason:
        notice(f"the errors before cannot be trusted: {before.reason}")
    stages, last = {"before": stage_errors(before, link)}, before
    if model is not None:
        last = prepared(model, rows)
        stages["after"] = stage_errors(last, link)
    return chains, Rows(rows, stages), last
