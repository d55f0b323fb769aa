"""The reference of the formats that are exported, from their declarations."""

from __future__ import annotations

from calib_pin.io.exchange import FORMATS
from calib_pin.io.exchange.base import PARTS, ROBOTS, SIGNS

INTRODUCTION = """\
# Formats of `export`

The parts of a calibration that each format of `calib-pin export` has a place for, on
the left, and properties of a robot, on the right. When a file is written, `export`
reports the parts that it does not hold, and how far the tool point is from the
calibrated robot because of it. No format holds compliance, waves of gears, backlash,
thermal growth or a learned correction: `calib-pin compensate` uses everything.

`xacro`, `mjcf`, `ros2-control`, `dh` and the vendors' files move by joints of the URDF,
not by the columns of a controller. A format without prismatic joints refuses a
robot that has some; one without several chains writes that of `--chain`. A mimic joint
has no drive, and so no offset of its own; a coupled column has that which its joint
needs. This page is made by `scripts/document` from the formats.
"""

HELD = (*PARTS, *ROBOTS, SIGNS)
"""All that a format may hold."""


def text() -> str:
    """The text of docs/reference/formats.md."""
    lines = [
        f"| `--format` | {' | '.join(HELD)} | `--template` | |",
        "|" + "---|" * (len(HELD) + 3),
    ]
    for form in FORMATS.values():
        held = ("yes" if part in form.holds else "" for part in HELD)
        template = form.template or "none"
        row = f"`{form.name}`", *held, template, form.summary
        lines.append("| " + " | ".join(row).replace("|  |", "| |") + " |")
    return "\n".join([INTRODUCTION, *lines, ""])
