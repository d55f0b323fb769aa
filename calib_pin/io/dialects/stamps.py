"""Times of whole seconds, with the rest in a column beside.

Sources: `header.stamp.secs` and `nsecs` (ROS 1), `sec` and `nanosec` (ROS 2) as they
are exported field by field, `sec` and `usec` of `timeval` (VRPN).
"""

from __future__ import annotations

import re
from pathlib import Path

from calib_pin.io.dialects.base import Columns, Dialect, Reading, computed

REST = re.compile(r"(.*[\W_])?(n|nano|u)secs?")
"""Columns of the rest, in nanoseconds or microseconds."""

TIME = re.compile(r"(.*[\W_])?(time|timestamp)([\W_].*)?", re.IGNORECASE)


class Stamps(Dialect):
    """Times in two columns."""

    def read(self, columns: Columns, file: Path) -> Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        if any(map(TIME.fullmatch, columns)):
            return None
        for rest in filter(None, map(REST.fullmatch, columns)):
            stem, unit = rest[1] or "", 1e-6 if rest[2] == "u" else 1e-9
            for whole in {f"{stem}sec", f"{stem}secs"} & columns.keys():
                seconds = columns[whole].numbers + unit * columns[rest[0]].numbers
                ours = {**columns, "time": computed("time", seconds, "s")}
                return Reading(ours, f"times of '{whole}' and '{rest[0]}'")
        return None
