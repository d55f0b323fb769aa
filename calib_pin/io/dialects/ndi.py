"""Logs of NDI Polaris trackers: lengths in mm, tools below each other or side by side.

Sources: the header that NDI_DataLogger writes (`Tool ID, Timestamp, Frame #`, then Tx
Ty Tz and a rotation as a matrix R00 to R22 or a quaternion Q0 Qx Qy Qz, `Tracking
Quality`), of which lost tools are rows with `MISSING`; and the exports of NDI's own
tool tracker (`Tools,Port 1,Frame,Face,State,Q0,...,Error,Port 2,...`; in newer ones
`Time [sec]`, and the positions of the markers behind), of which lost tools have numbers
beyond 1e28, as public readers of such files (`vicra_plot`) quote them.
"""

from __future__ import annotations

from calib_pin.io.columns import split_header
from calib_pin.io.dialects.base import Dialect, Heading, Lines, cut, starting


class Ndi(Dialect):
    """A tracker's log of tools."""

    signs = ("Tx", "Ty", "Tz", "R22|Qz")
    ours = (
        (r"T([xyz])", r"\1", "mm"),
        ("Q0", "qw", None),
        (r"Q([xyz])", r"q\1", None),
        ("Tool ID", "tool", None),
        ("Time(?:stamp)?", "time", None),
    )
    remark = "a log of an NDI tracker"

    def heading(self, lines: Lines) -> Heading | None:
        """One line of names, which are the same for each tool."""
        if not (lines := starting(lines, "Tools")):
            return None
        (cells, *_), mark = cut(lines[:1])
        tools, port_names, names = [""], set[str](), list[str]()
        for cell in cells:
            name = split_header(cell)[0]
            if port := cell.startswith("Port"):
                port_names = {name}
            known = not port_names or name in port_names or "Markers" in port_names
            names.append("" if known else cell.replace("[sec]", "[s]"))
            tools.append(cell if port else tools[-1])
            port_names.add(name)
        arguments = names, lines[0][0], self.remark, tools[1:], "tool", self.converted
        return Heading(mark, *arguments) if any(tools) else None
