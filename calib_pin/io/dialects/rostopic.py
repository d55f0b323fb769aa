"""`rostopic echo -p`: messages of ROS 1 as CSV, a column for each field.

Names of joints stand in each row, beside their positions. Source: the ROS wiki,
rostopic, "echo -p": `%time` is when a message came, all stamps are nanoseconds.
"""

from __future__ import annotations

from calib_pin.io.columns import Column
from calib_pin.io.dialects.base import Columns, Dialect


class Rostopic(Dialect):
    """Messages of ROS 1 as `rostopic echo -p` writes them."""

    signs = (r"field\..*",)
    ours = ((r"field\.header\.stamp", "time", "ns"), ("time", "time", "ns"))
    remark = "a topic of ROS 1 (rostopic echo -p)"

    def converted(self, columns: Columns) -> dict[str, Column]:
        """The columns as ours, positions under the names of their joints."""
        joints = {
            name.replace("name", "position"): column.words[0].strip()
            for name, column in columns.items()
            if name.startswith("field.name") and len(column.words) == 1
        }
        return super().converted({joints.get(n, n): c for n, c in columns.items()})
