"""Recordings of Universal Robots' RTDE: joints, and much that no instrument measured.

Source: `rtde/csv_writer.py` and `examples/record.py` of
github.com/UniversalRobots/RTDE_Python_Client_Library: a header with the name of each
output and the number of its element (`timestamp actual_q_0 ...`), separated by spaces
or commas. The controller computes `actual_TCP_pose` from the joints; `target_` is
commanded.
"""

from __future__ import annotations

from calib_pin.io.dialects.base import Dialect


class Rtde(Dialect):
    """A recording of a controller."""

    signs = ("actual_q_0",)
    ours = ((r"actual_(q_\d)", r"\1", "rad"), ("timestamp", "time", "s"))
    other = (
        r"(?:actual|target|joint|tool|tcp|elbow|output|input)_\w+_\d+"
        r"|(?:actual|robot|safety|runtime|speed|payload)_(?:\w+_)?"
        r"(?:time|state|mode|status|bits|scaling|fraction|mass|voltage|current)"
    )
    remark = (
        "a recording of a UR controller (actual_q); commanded values and the pose that "
        "it computed from the joints are left out"
    )
