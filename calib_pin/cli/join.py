"""`calib-pin join`: a measurement file of two logs, by time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
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

STAND = 0.5
"""Default of --settle and of --tolerance [s]."""

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
    ] = STAND,
    tolerance: Annotated[
        float,
        options.option(
            "Logs",
            "--tolerance S",
            "Longest time without a sample of the joints; default 0.5.",
            options.number(float, "--tolerance", SECONDS, 1e-3, 60.0),
        ),
    ] = STAND,
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
    instrument measured during some. The standard deviation of a mean is that of
    readings that scatter about it, by their autocorrelation. Images, which have a
    column 'image', stay apart; a list of images and times gets their joints. Files
    without times are joined by the names of points that both have. A bag with
    CalibrationData (robot_calibration) is given twice.
    """
    from calib_pin.errors import stated_in
    from calib_pin.io.exchange.rosbag import (
        holds_calibration_data,
        is_bag,
        read_calibration_data,
        read_joint_bag,
        read_reading_bag,
    )
    from calib_pin.io.files import write_files
    from calib_pin.io.logs import (
        encode_joined,
        join_logs,
        named_alike,
        read_joint_log,
        read_reading_log,
    )
    from calib_pin.io.table import read_table

    stated = open_setup(setup).columns
    for path in (joints, measurements):
        require_file(path)
    check_outputs([output], [joints, measurements, setup], force)
    bags = is_bag(joints), is_bag(measurements)
    samples = all(bags) and joints == measurements and holds_calibration_data(joints)
    tell = (lambda remark: None) if quiet else notice
    with progress_bar(quiet=quiet) as bar:
        if samples:
            positions, readings, found = read_calibration_data(joints, topic, tell)
        else:
            ours, theirs = (
                None if bag else read_table(path, stage(bar, of), columns=stated)
                for path, bag, of in zip(
                    (joints, measurements), bags, ("joints", "readings"), strict=True
                )
            )
            if ours and theirs:
                ours, theirs = named_alike(ours, theirs)
            positions = (
                read_joint_log(ours, stated, tell)
                if ours
                else read_joint_bag(joints, joint_topic)
            )
            readings = (
                read_reading_log(theirs, tell)
                if theirs
                else read_reading_bag(measurements, topic)
            )
            with stated_in(f"{joints}, {measurements}"):
                readings, found = join_logs(
                    positions, readings, settle, tolerance, tell
                )
    data = encode_joined(found, positions, readings, keep=keep or samples)
    with write_files({output: data}, force=force):
        if json:
            say_json(_document(found), [output])
        elif not quiet:
            say("".join(f"{line}\n" for line in _lines(found, measurements)))
    if not quiet and not json:
        say_written([f"wrote {output}"])
    return 0


def _lines(found: Joined, measurements: Path) -> Iterator[str]:
    """The counts of a join, and how well the clock is known."""
    clock = found.clock
    if clock is None:
        yield f"{len(found.standstills)} samples with {found.used} readings"
        return
    empty = f", {found.empty} without" if found.empty else ""
    far = f", {found.scattered} far from their standstill's others"
    yield f"{found.stands} standstills with {found.used} readings{empty}"
    yield (
        f"dropped: {found.moving} readings in motion or beside a standstill"
        f"{far if found.scattered else ''}"
    )
    sigma = f"{1e3 * clock.sigma:.1f} ms"
    if clock.motions:
        yield (
            f"the clock of {measurements} is {clock.ahead:+.4f} s ahead, known to "
            f"{sigma} from {clock.motions} motions"
        )
    else:
        yield (
            f"the clock of {measurements} is taken to be {clock.ahead:+.2f} s ahead: "
            f"nothing was measured in motion, and the standstills tell it to {sigma}"
        )


def _document(found: Joined) -> dict[str, object]:
    """The counts of a join, and the clock of the instrument [s]."""
    if found.clock is None:
        return {"standstills": found.stands}
    counts = ("used", "empty", "moving", "scattered")
    return {
        "standstills": found.stands,
        "readings": {name: getattr(found, name) for name in counts},
        "clock": asdict(found.clock),
    }
