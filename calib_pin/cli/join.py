"""`calib-pin join`: a measurement file of two logs, by time."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import calib_pin.io.rosbag as rosbag
from calib_pin.cli import printing
from calib_pin.cli.asked import Join
from calib_pin.cli.files import check_outputs, open_setup
from calib_pin.cli.options import as_option
from calib_pin.errors import OptionError, counted
from calib_pin.io import logs, table
from calib_pin.io.table import Table
from calib_pin.observations.joining import Joined


def join(asked: Join) -> int:
    """Do what `Join` asks for."""
    columns = open_setup(asked.setup).columns
    files = joints, measurements = asked.log, asked.measurements
    check_outputs([asked.output], [*files, asked.setup], asked.force)
    for path, option in (joints, "joint_topic"), (measurements, "topic"):
        if getattr(asked, option) is not None and not rosbag.is_bag(path):
            reason = f"{as_option(option)} is of a bag, and this is none"
            raise OptionError(reason, file=path)

    def read(path: Path, part: str, kinds: Collection[str], topic: str | None) -> Table:
        if rosbag.is_bag(path):
            return rosbag.read_bag(path, kinds, topic)
        return table.read_table(path, printing.stage(bar, part), columns=columns)

    with printing.progress_bar(quiet=asked.quiet) as bar:
        tables = None
        if joints == measurements and rosbag.is_bag(joints):
            tables = rosbag.read_calibration_data(joints, asked.topic, asked.tell)
        tables = tables or (
            read(joints, "joints", rosbag.JOINTS, asked.joint_topic),
            read(measurements, "readings", rosbag.READINGS, asked.topic),
        )
        # All columns of a bag are joints, whatever they are called.
        names = tables[0].columns if rosbag.is_bag(joints) else columns
        wait = asked.settle, asked.tolerance
        summary, data = logs.join_logs(*tables, names, *wait, asked.tell, asked.keep)
    text = "".join(f"{line}\n" for line in _lines(summary, measurements))
    asked.give({asked.output: data}, text)
    return 0


def _lines(summary: Joined, measurements: Path) -> Iterator[str]:
    """The counts of a join, and how well the clock is known."""
    clock, readings = summary.clock, counted(summary.used, "reading")
    if clock is None:
        yield f"{counted(summary.stands, 'sample')} with {readings}"
        return
    yield f"{counted(summary.stands, 'standstill')} with {readings}"
    for count, remark in (
        (summary.empty, "standstills without readings"),
        (summary.moving, "readings dropped: in motion or beside a standstill"),
        (summary.scattered, "readings dropped: far from others of their standstill"),
    ):
        if count:
            yield f"{count} {remark}"
    known = f"{clock.ahead:+.4f} s ahead, known to {1e3 * clock.sigma:.1f} ms"
    source = f"{counted(clock.motions, 'motion')}" if clock.motions else "standstills"
    yield f"the clock of {measurements} is {known} from {source}"
