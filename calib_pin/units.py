"""Units that people read (inside, everything is SI), and numbers that they write."""

from __future__ import annotations

import math
import re

DISPLAY = {
    "m": ("mm", 1e3),
    "rad": ("deg", 180.0 / math.pi),
    "m/m": ("%", 100.0),
    "rad/rad": ("%", 100.0),
    "px": ("px", 1.0),
    "m/N": ("um/N", 1e6),
    "rad/Nm": ("urad/Nm", 1e6),
    "1/K": ("um/(m K)", 1e6),
}
"""Unit and factor that people read, by SI unit."""

_STEPS = re.compile(r"steps/(\d+\.?\d*)(?:@([-+]?\d+\.?\d*))?", re.ASCII)

MINUS = "\u2212"
"""The minus of typesetting, which spreadsheets of some countries write."""

_NUMBER = re.compile(rf"[-+{MINUS}]?(\d+\.?\d*|\.\d+)([eE][-+{MINUS}]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[-+]?\.?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)


def as_number(text: str) -> float | None:
    """The number that a text is in all files and options, or None.

    Python also reads `1_000` and the digits of all scripts; here they are slips.

    Args:
        text: Text without spaces around it; `nan` and `inf`, with or without the
            point of YAML, are numbers that are not finite.
    """
    if _NUMBER.fullmatch(text):
        return float(text.replace(MINUS, "-"))
    return float(text.replace(".", "")) if _NOT_FINITE.fullmatch(text) else None


def steps_of(unit: str) -> tuple[float, float | None] | None:
    """Steps of a turn, and the position at which a joint is at zero; None for no steps.

    A servo counts from 0, and stands at zero in the middle of a turn unless its unit
    says where: None for the middle.

    Examples:
        >>> steps_of("steps/4096"), steps_of("steps/1228.8@512"), steps_of("deg")
        ((4096.0, None), (1228.8, 512.0), None)
    """
    match = _STEPS.fullmatch(unit)
    if match is None or not float(match[1]):
        return None
    return float(match[1]), None if match[2] is None else float(match[2])
