"""CSV exports of Vicon Nexus and Tracker: objects side by side, a row each frame.

Layout: a line `Trajectories`, `Segments`, `Objects` or `Model Outputs`; the frame rate;
the name of each object above its first column; `Frame,Sub Frame` and X, Y, Z of markers
or RX, RY, RZ, TX, TY, TZ of segments; their units. Sources: the readers of such files
in github.com/PaulT95/Import_Vicon_Data (Nexus 2.6 to 2.12) and
github.com/AG6GR/Vicon_CSV (Tracker). With RW a rotation is a quaternion; without, the
settings of the export decide between a rotation vector and Euler angles, and the file
does not say which, so these columns are left out.
"""

from __future__ import annotations

import re
from itertools import zip_longest

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Column


class Vicon(base.Dialect):
    """A section of an export."""

    def heading(self, lines: base.Lines) -> base.Heading | None:
        """The lines from the title of the section to that of the units."""
        at = len(lines) - len(base.starting(lines, "Frame"))
        if not 3 <= at < len(lines) - 1:
            return None
        head = [lines[k] for k in (at, at + 1, at - 1, at - 2)]
        (axes, units, objects, rate), mark = base.cut(head)
        if axes[:2] != ["Frame", "Sub Frame"] or not re.fullmatch(r"[\d.]+", rate[0]):
            return None
        kind, of, names = "tool" if "TX" in axes else "target", ["", ""], axes[:2]
        columns = [*zip_longest(axes, units, objects, fillvalue="")][: len(axes)]
        for axis, unit, name in columns[2:]:
            of.append(name.removeprefix("Global Angle ") or of[-1])
            length = axis.removeprefix("T") in ("X", "Y", "Z") and unit in ("mm", "m")
            turn = f"q{axis[1:].lower()}" * (axis[:1] == "R" and "RW" in axes)
            names.append(base.header(axis[-1].lower(), unit) if length else turn)
        turned = "RX" in axes and "RW" not in axes
        remark = "an export of Vicon" + "; angles of segments are left out" * turned

        def with_time(columns: dict[str, Column]) -> dict[str, Column]:
            time = columns["Frame"].numbers / float(rate[0])
            return {"time": base.computed("time", time, "s"), **columns}

        return base.Heading(mark, names, lines[at + 1][0], remark, of, kind, with_time)
