"""`calib-pin robots`: the bundled robots, and a copy of one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.errors import OptionError, require_known


def robots(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="The robot to copy; without it, a list."),
    ] = None,
    output: Annotated[
        Path | None,
        options.output("-o --output DIR", "Folder for its URDF and example files."),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> int:
    """List the bundled robots, whose names can stand for a URDF file, or copy one.

    A copy holds robot.urdf, measurements.csv and setup.yaml: a calibration to try.
    """
    if name is None and output is None:
        return _listed(json)
    if name is None or output is None:
        raise OptionError("name the robot and the folder: robots NAME -o DIR")
    return _copied(name, output, force, json)


def _copied(name: str, folder: Path, force: bool, json: bool) -> int:
    from calib_pin.cli.printing import say_json, say_written
    from calib_pin.io.files import read_bytes, write_files
    from calib_pin.io.urdf import bundled_robots

    known = bundled_robots()
    require_known("bundled robot", name, known)
    files = [path for path in sorted(known[name].parent.iterdir()) if path.is_file()]
    copies = {folder / path.name: read_bytes(path) for path in files}
    with write_files(copies, force=force):
        pass
    if json:
        say_json({"robot": name}, copies)
    else:
        say_written(f"wrote {path}" for path in copies)
    return 0


def _listed(json: bool) -> int:
    from calib_pin.cli.printing import say_json, show
    from calib_pin.io.urdf import bundled_robots, load_robot
    from calib_pin.kinematics.chain import Chain
    from calib_pin.report.blocks import table

    rows, found = [], []
    for name, path in bundled_robots().items():
        chain = Chain(load_robot(name))
        others = sorted(
            file.name for file in path.parent.iterdir() if file.suffix != ".urdf"
        )
        joints = list(chain.joints)
        ends = {"base": chain.base, "tip": chain.tip}
        found.append({"name": name, **ends, "joints": joints, "files": others})
        ways = " -> ".join(ends.values())
        rows.append((name, ways, len(joints), ", ".join(others)))
    if json:
        say_json({"robots": found})
        return 0
    show([table("", ("name", "chain|word", "joints", "files|remark"), rows)])
    typer.echo("calib-pin robots NAME -o DIR copies one with its example files")
    return 0
