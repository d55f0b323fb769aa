"""`calib-pin join`: a measurement file of two logs, by time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
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
    from calib_pin.io.logs import JointLog, ReadingLog
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
        named_alike,
        read_joint_log,
        read_reading_log,
    )
    from calib_pin.io.table import read_table

    stated = open_setup(setup).columns
    for path in (joints, measurements):
        require_file(path)
    check_outputs([output], [joints, measurements, setup], force)
    samples = (
        joints == measurements and is_bag(joints) and holds_calibration_data(joints)
    )
    tell = (lambda remark: None) if quiet else notice
    with progress_bar(quiet=quiet) as bar:
        if samples:
            positions, readings, found = read_calibration_data(joints, topic, tell)
        else:
            ours, theirs = (
                None
                if is_bag(path)
                else read_table(path, stage(bar, of), columns=stated)
                for path, of in ((joints, "joints"), (measurements, "readings"))
            )
            if ours and theirs:
                ours, theirs = named_alike(ours, theirs)
            if ours:
                positions = read_joint_log(ours, stated, tell)
            else:
                positions = read_joint_bag(joints, joint_topic)
            if theirs:
                readings = read_reading_log(theirs, tell)
            else:
                readings = read_reading_bag(measurements, topic)
            with stated_in(f"{joints}, {measurements}"):
                readings, found = joined(positions, readings, settle, tolerance, tell)
    data = encode_joined(found, positions, readings, keep=keep or samples)
    with write_files({output: data}, force=force):
        if json:
            say_json(_document(found), [output])
        elif not quiet:
            say("".join(f"{line}\n" for line in _lines(found, measurements)))
    if not quiet and not json:
        say_written([f"wrote {output}"])
    return 0


def joined(
    joints: JointLog,
    readings: ReadingLog,
    settle: float,
    tolerance: float,
    tell: Callable[[str], None],
) -> tuple[ReadingLog, Joined]:
    """The readings, by the unit of the joints' times, and what joins them.

    Args:
        joints: The log of the joints.
        readings: The log of the readings.
        settle: Time that joints stand before readings count [s].
        tolerance: Longest time without a sample of the joints [s].
        tell: Called with sentences about the logs and what was left out.

    Raises:
        InputError: If nothing does.
    """
    from calib_pin.errors import InputError, enumerated
    from calib_pin.io.logs import IMAGE, POSE, TIME
    from calib_pin.observations.joining import in_one_unit, join, join_by_name

    q, values = joints.log, readings.log
    if joints.poses:
        found = join_by_name(q, values, joints.poses, readings.texts[POSE])
        if found.alone:
            told = enumerated(found.alone)
            tell(f"in one of both files only, and left out: {told}")
        return readings, found
    if joints.loose and readings.loose:
        q, values, steps = in_one_unit(q, values)
        if steps:
            longer, unit = "joints" if steps > 0 else "readings", [*TIME.units]
            read = f"the times of the {longer} are read as {unit[abs(steps)]}"
            tell(f"{read}: so both last as long")
    found = join(q, values, settle, tolerance)
    if not found.standstills:
        raise InputError("no reading falls into a standstill of the joints")
    if images := readings.texts.get(IMAGE):
        used = {images[k] for one in found.standstills for k in one.readings}
        if lost := [name for name in dict.fromkeys(images) if name not in used]:
            tell(f"the joints do not stand at the time of {enumerated(lost)}: left out")
    return replace(readings, log=values), found


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
