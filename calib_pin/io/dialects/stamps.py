"""Times of whole seconds, with the rest in a column beside.

Sources: `header.stamp.secs` and `nsecs` (ROS 1), `sec` and `nanosec` (ROS 2) as they
are exported field by field, `sec` and `usec` of `timeval` (VRPN).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Column

PARTS = {"nsec": 1e-9, "nsecs": 1e-9, "nanosec": 1e-9, "usec": 1e-6, "usecs": 1e-6}
"""Last words of columns of the rest, and their unit [s]."""

TIME = re.compile(r"(.*[\W_])?(time|timestamp)([\W_].*)?", re.IGNORECASE)


class Stamps(base.Dialect):
    """Times in two columns."""

    def read(self, columns: Mapping[str, Column], file: Path) -> base.Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        if any(map(TIME.fullmatch, columns)):
            return None
        for rest, column in columns.items():
            word = re.split(r"[\W_]", rest)[-1]
            stem = rest.removesuffix(word)
            wholes = [n for n in (f"{stem}sec", f"{stem}secs") if n in columns]
            if word in PARTS and wholes:
                seconds = columns[wholes[0]].numbers + PARTS[word] * column.numbers
                time = base.computed("time", seconds, "s")
                remark = f"times of '{wholes[0]}' and '{rest}'"
                return base.Reading({**columns, "time": time}, remark)
        return None
