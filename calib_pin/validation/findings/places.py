"""Measurements as findings and their remedies name them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from calib_pin.measurement_models.readings import places_of
from calib_pin.observations import Observations
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.setup_lines import lines_of, written

NAMED = 3
"""Measurements that a sentence names; the lines of the setup file have all of them."""

SHORT = 12
"""Measurements that a remedy names."""


def named(data: Observations, rows: Sequence[int]) -> str:
    """Measurements in words, such as `lines 12, 31, 40 and 2 more`."""
    words = ", ".join(places_of(data, rows[:NAMED]))
    if len(rows) > NAMED:
        words += f" and {len(rows) - NAMED} more"
    kind = "line" if data.files[rows[0]] else "measurement"
    return f"{kind}{'s' if len(rows) > 1 else ''} {words}"


def without(
    data: Observations, rows: Sequence[int], advice: str
) -> tuple[str, dict[str, Any]]:
    """The remedy to leave measurements out, and its setup lines.

    Args:
        data: All measurements.
        rows: Those to leave out.
        advice: The words before the measurements.
    """
    reading = ReadingSetup(without=places_of(data, rows))
    lines = {"reading": lines_of(reading)}
    if len(rows) > SHORT:
        return f"{advice} ('reading: without' in the setup file)", lines
    return f"{advice} (in the setup file: {written(lines)})", lines
