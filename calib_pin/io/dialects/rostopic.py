"""`rostopic echo -p`: messages of ROS 1 as CSV, a column for each field.

Names of joints stand in each row, beside their positions. Source: the ROS wiki,
rostopic, "echo -p": `%time` is when a message came, all stamps are nanoseconds.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from calib_pin.io.columns import Column
from calib_pin.io.dialects.base import Reading

STAMP = "field.header.stamp"


class Rostopic:
    """Messages of ROS 1 as `rostopic echo -p` writes them."""

    def read(self, columns: Mapping[str, Column]) -> Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        if not any(name.startswith("field.") for name in columns):
            return None
        ours = dict[str, str]()
        for name, column in columns.items():
            found = re.fullmatch(r"field\.name(\d+)", name)
            position = f"field.position{found[1]}" if found else ""
            if position in columns and len(column.words) == 1:
                ours[position] = column.words[0].strip()
        read = {ours.get(name, name): column for name, column in columns.items()}
        if STAMP in read:
            read["time"] = replace(read.pop(STAMP), unit="ns")
        elif "time" in read:
            read["time"] = replace(read["time"], unit="ns")
        return Reading(read, "a topic of ROS 1 (rostopic echo -p)")
