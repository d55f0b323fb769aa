"""CSV exports of PlotJuggler: a column for each number of each topic.

Source: `StatePublisherCSV/publisher_csv.cpp` of github.com/facontidavide/PlotJuggler:
`__time` in seconds, then the names of the series in alphabetical order; a cell is blank
where a series has no number at this time. A series of a joint state is called
`/joint_states/elbow_joint/position`, `/joint_states/position[0]` or
`/joint_states/position.0`, by the version.
"""

from __future__ import annotations

from calib_pin.io.dialects.base import Dialect


class PlotJuggler(Dialect):
    """An export of series."""

    signs = ("__time",)
    ours = (
        ("__time", "time", "s"),
        (r".*joint_states?/positions?[\[./](\d+)\]?", r"q_\1", None),
        (r".*joint_states?/([^/]+)/position", r"\1", None),
    )
    other = (
        r".*joint_states?/(?:.*/)?(?:velocity|effort|header|seq)\b.*"
        r"|.*(?:tcp_pose|ee_pose|O_T_EE|cartesian_pose).*"
    )
    remark = "an export of PlotJuggler; poses of controllers are left out"
