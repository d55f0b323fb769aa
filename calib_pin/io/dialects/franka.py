"""Logs of libfranka: joints, and much that no instrument measured.

Source: `logToCSV` in github.com/frankaemika/libfranka, `src/log.cpp` (now in
`src/logging/`): `time` in ms, `success_rate`, `state.q[0]`, `state.q_d[0]` and so on,
then commands `cmd.q_d[0]`, `cmd.O_T_EE_d[0]`. `state.O_T_EE` of extended logs is a
matrix by columns, which the controller computes from the joints.
"""

from __future__ import annotations

from calib_pin.io.dialects.base import Dialect


class Franka(Dialect):
    """A log of the states and the commands of a robot."""

    signs = (r"state\.q\[0\]",)
    ours = ((r"state\.q\[(\d)\]", r"q_\1", "rad"), ("time", "time", "ms"))
    other = r"(?:state|cmd)\..*|success_rate"
    remark = (
        "a log of libfranka (q); commanded values and the pose that the controller "
        "computed from the joints are left out"
    )
