"""The reference of the Python API: the public names, each where it is defined."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from calib_pin import _HOMES

INTRODUCTION = """\
# Python

The public names of `calib_pin`, which loads what a name needs at its first use. Lengths
are in meters, angles in radians, twists in the order (linear, angular). A wrong input
raises `calib_pin.CalibPinError`, one line that says where.
"""

TOPICS: Mapping[str, tuple[str, ...]] = {
    "Robots": ("load_chain", "load_chains", "robot_file", "load_collisions", "Chain"),
    "Measurements": (
        "read_measurements",
        "write_measurements",
        "Measurements",
        "Observations",
    ),
    "Setup": ("read_setup", "Setup"),
    "Calibration": ("calibrate", "CalibrationResult", "identify", "evaluate"),
    "Results": (
        "format_report",
        "report",
        "write_urdf",
        "read_result",
        "read_calibration",
        "compare",
    ),
    "Planning and simulation": ("plan", "simulate", "draw_errors"),
    "Control": ("compensate",),
    "Errors": ("CalibPinError",),
}
"""Names by topic; a test holds them to `calib_pin.__all__`."""


def text() -> str:
    """The text of docs/reference/api.md."""
    return "\n".join([INTRODUCTION, *_topics()])


def _topics() -> Iterator[str]:
    for topic, names in TOPICS.items():
        yield f"## {topic}\n"
        for name in names:
            yield f"::: calib_pin.{_HOMES[name]}.{name}\n"
