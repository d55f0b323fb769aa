"""`rostopic echo -p`: messages of ROS 1 as CSV, a column for each field.

Names of joints stand in each row, beside their positions. Source: the ROS wiki,
rostopic, "echo -p": `%time` is when a message came, all stamps are nanoseconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Column

STAMP = "field.header.stamp"


class Rostopic(base.Dialect):
    """Messages of ROS 1 as `rostopic echo -p` writes them."""

    def read(self, columns: Mapping[str, Column], file: Path) -> base.Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        if not any(name.startswith("field.") for name in columns):
            return None
        read = dict[str, Column]()
        for name, column in columns.items():
            number = name.removeprefix("field.position")
            joint = columns.get(f"field.name{number}")
            if number != name and joint is not None and len(joint.words) == 1:
                name = joint.words[0].strip()
            read[name] = base.named(column, name)
        time = next((name for name in (STAMP, "time") if name in read), "")
        if time:
            read["time"] = base.named(read.pop(time), "time", "ns")
        return base.Reading(read, "a topic of ROS 1 (rostopic echo -p)")
