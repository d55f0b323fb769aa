"""`calib-pin join`: a measurement file of two logs, by time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import check_outputs, open_setup, require_file
from calib_pin.cli.printing import (
    notice,
    progress_bar,
    say,
    say_json,
    say_written,
    stage,
)

if TYPE_CHECKING:
    from calib_pin.observations.joining import Joined

SECONDS = "a time in seconds, more than 0 and at most 60"


def join(
    joints: Annotated[
        Path,
        typer.Argument(
            metavar="JOINTS",
            help="Log of the joints: CSV with a column of times, or a bag of ROS.",
        ),
    ],
    measurements: Annotated[
        Path,
        typer.Argument(
            metavar="MEASUREMENTS",
            help="Log of the instrument, by its own clock: CSV or a bag.",
        ),
    ],
    output: Annotated[
        Path, options.output("-o --output CSV", "Measurement file to write.")
    ],
    setup: Annotated[
        Path | None,
        options.option(
            "Logs",
            "--setup FILE",
            "Setup file: 'columns' says which foreign names are ours.",
        ),
    ] = None,
    settle: Annotated[
        float,
        options.option(
            "Logs",
            "--settle S",
            "Time that the joints stand before a reading counts; default 0.5.",
            options.number(float, "--settle", SECONDS, 1e-3, 60.0),
        ),
    ] = 0.5,
    tolerance: Annotated[
        float,
        options.option(
            "Logs",
            "--tolerance S",
            "Longest time without a sample of the joints; default 0.5.",
            options.number(float, "--tolerance", SECONDS, 1e-3, 60.0),
        ),
    ] = 0.5,
    topic: Annotated[
        str | None,
        options.option(
            "Logs",
            "--topic NAME",
            "Topic of MEASUREMENTS if it is a bag, of transforms the child frame; "
            "default the only one.",
        ),
    ] = None,
    joint_topic: Annotated[
        str | None,
        options.option("Logs", "--joint-topic NAME", "Topic of JOINTS if it is a bag."),
    ] = None,
    keep: Annotated[
        bool,
        options.option(
            "Logs",
            "--keep",
            "Keep every reading, instead of one mean for each standstill.",
        ),
    ] = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> int:
    """Join the log of a robot and that of an instrument to a measurement file.

    Readings count where the joints stood still; those in motion are dropped and
    counted. The offset of both clocks is estimated from the motions between, if the
    instrument measured during some. The standard deviation of a mean is the scatter of
    single readings. A bag with CalibrationData (robot_calibration) is given twice.
    """
    from calib_pin.errors import InputError, stated_in
    from calib_pin.io.exchange.rosbag import (
        holds_calibration_data,
        is_bag,
        read_calibration_data,
        read_joint_bag,
        read_reading_bag,
    )
    from calib_pin.io.files import write_files
    from calib_pin.io.logs import encode_joined, read_joint_log, read_reading_log
    from calib_pin.observations.joining import join as joined_logs

    stated = open_setup(setup)
    for path in (joints, measurements):
        require_file(path)
    check_outputs([output], [joints, measurements, setup], force)
    if joints == measurements and is_bag(joints) and holds_calibration_data(joints):
        positions, readings, found = read_calibration_data(
            joints, topic, None if quiet else notice
        )
        data = encode_joined(found, positions, readings, keep=True)
        with write_files({output: data}, force=force):
            pass
        if json:
            say_json({"standstills": len(found.standstills)}, [output])
        elif not quiet:
            say_written([f"{len(found.standstills)} samples", f"wrote {output}"])
        return 0
    with progress_bar(quiet=quiet) as bar:
        tell = None if quiet else notice
        positions = (
            read_joint_bag(joints, joint_topic)
            if is_bag(joints)
            else read_joint_log(joints, stated.columns, tell, stage(bar, "joints"))
        )
        readings = (
            read_reading_bag(measurements, topic)
            if is_bag(measurements)
            else read_reading_log(
                measurements, stated.columns, tell, stage(bar, "readings")
            )
        )
        with stated_in(f"{joints}, {measurements}"):
            found = joined_logs(positions.log, readings.log, settle, tolerance)
            if not found.standstills:
                raise InputError("no reading falls into a standstill of the joints")
        data = encode_joined(found, positions, readings, keep=keep)
    clock, empty, scattered = found.clock, "", ""
    if found.empty:
        empty = f", {found.empty} without"
    if found.scattered:
        scattered = f", {found.scattered} far from their standstill's others"
    lines = [
        f"{len(found.standstills)} standstills with {found.used} readings{empty}",
        f"dropped: {found.moving} readings in motion or beside a standstill{scattered}",
    ]
    sigma = f"{1e3 * clock.sigma:.1f} ms"
    if clock.motions:
        lines.append(
            f"the clock of {measurements} is {clock.ahead:+.4f} s ahead, known to "
            f"{sigma} from {clock.motions} motions"
        )
    else:
        lines.append(
            f"the clock of {measurements} is taken to be {clock.ahead:+.2f} s ahead: "
            f"nothing was measured in motion, and the standstills tell it to {sigma}"
        )
    with write_files({output: data}, force=force):
        if json:
            say_json(_document(found), [output])
        elif not quiet:
            say("".join(f"{line}\n" for line in lines))
    if not quiet and not json:
        say_written([f"wrote {output}"])
    return 0


def _document(found: Joined) -> dict[str, object]:
    """The counts of a join, and the clock of the instrument [s]."""
    counts = ("used", "empty", "moving", "scattered")
    return {
        "standstills": len(found.standstills),
        "readings": {name: getattr(found, name) for name in counts},
        "clock": {
            "ahead": found.clock.ahead,
            "sigma": found.clock.sigma,
            "motions": found.clock.motions,
        },
    }
