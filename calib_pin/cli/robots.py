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
    from calib_pin.cli.printing import say_json, say_written, show
    from calib_pin.io.files import read_bytes, write_files
    from calib_pin.io.urdf import bundled_robots, load_robot
    from calib_pin.kinematics.chain import Chain
    from calib_pin.report.blocks import table

    known = bundled_robots()
    if (name is None) != (output is None):
        raise OptionError("name the robot and the folder: robots NAME -o DIR")
    if name is not None and output is not None:
        require_known("bundled robot", name, known)
        files = sorted(path for path in known[name].parent.iterdir() if path.is_file())
        copies = {output / path.name: read_bytes(path) for path in files}
        with write_files(copies, force=force):
            pass
        if json:
            say_json({"robot": name}, copies)
        else:
            say_written(f"wrote {path}" for path in copies)
        return 0
    rows, found = [], []
    for robot, path in known.items():
        chain = Chain(load_robot(robot))
        others = sorted(p.name for p in path.parent.iterdir() if p.suffix != ".urdf")
        joints = list(chain.joints)
        ends = {"base": chain.base, "tip": chain.tip}
        found.append({"name": robot, **ends, "joints": joints, "files": others})
        ways = " -> ".join(ends.values())
        rows.append((robot, ways, len(joints), ", ".join(others)))
    if json:
        say_json({"robots": found})
        return 0
    show([table("", ("name", "chain|word", "joints", "files|remark"), rows)])
    typer.echo("calib-pin robots NAME -o DIR copies one with its example files")
    return 0
