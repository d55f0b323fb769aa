"""Calibration files of LeRobot's motors: offsets and ranges in motor steps.

A motor reads `position = encoder - homing_offset`, and its angle in degrees is
`(position - (range_min + range_max) / 2) 360 / 4095`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.errors import InputError, OptionError
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.exchange.joint_offsets import column_offsets, doubts, remarks
from calib_pin.io.files import TEXT, read_bytes

STEPS = 4095
"""Steps of a turn, as LeRobot counts them (resolution 4096)."""

FARTHEST = 2047
"""Largest homing offset that a motor stores."""

KEYS = ("homing_offset", "range_min", "range_max")


def encode(exported: Exported, template: Path | None) -> Encoded:
    """The user's own file with other homing offsets.

    The zero is in the middle of the range, so the range keeps its middle and shrinks:
    the joint goes nowhere it did not go before.

    Raises:
        InputError: If that is no such file, or lacks a motor.
        OptionError: If a joint does not turn, or a motor stores no such offset.
    """
    assert template is not None
    motors = _read(template)
    if not exported.nominal.revolute.all():
        raise OptionError("a motor needs a joint that turns", file=exported.file)
    steps, rounded = dict[str, int](), 0.0
    for joint, column, _, offset in column_offsets(exported):
        names = (joint, column, joint.removesuffix("_joint"))
        name = next((name for name in names if name in motors), None)
        if name is None:
            raise InputError(
                f"has no motor for joint '{joint}'",
                file=template,
                allowed=f"one of {', '.join(motors)}, mapped by 'joints' in the setup",
            )
        motor, exact = motors[name], offset * STEPS / (2.0 * np.pi)
        steps[name] = moved = round(exact)
        rounded = max(rounded, abs(exact - moved) * 360.0 / STEPS)
        motor["homing_offset"] -= moved
        if abs(motor["homing_offset"]) > FARTHEST:
            raise OptionError(
                f"the homing offset of '{name}' would be {motor['homing_offset']}; "
                "home this motor nearer the middle of its range first",
                file=template,
                allowed=f"{-FARTHEST} to {FARTHEST}",
            )
        if motor["range_max"] - motor["range_min"] < STEPS:
            motor["range_min"] += abs(moved)
            motor["range_max"] -= abs(moved)
    data = json.dumps(motors, indent=4).encode() + b"\n"
    told = ", ".join(f"{name} {-moved:+d}" for name, moved in steps.items())
    said = (
        f"homing offsets changed by motor steps: {told}",
        f"whole steps leave up to {rounded:.3f} deg of a joint",
    )
    return Encoded(data, (*said, *remarks(exported.offsets), *doubts(exported)))


def _read(template: Path) -> dict[str, dict[str, Any]]:
    try:
        data = json.loads(read_bytes(template, TEXT))
    except (ValueError, RecursionError) as error:
        found = getattr(error, "msg", error)
        raise InputError(f"is not JSON: {found}", file=template) from None
    if not isinstance(data, dict) or not data:
        raise InputError("holds no motors", file=template)
    for name, motor in data.items():
        numbers = [motor.get(key) if isinstance(motor, dict) else None for key in KEYS]
        if any(type(number) is not int for number in numbers):
            raise InputError(
                f"motor '{name}' lacks one of {', '.join(KEYS)}, in whole steps",
                file=template,
            )
    return data


LEROBOT = Format(
    "lerobot", ".json", "LeRobot's homing offsets and ranges", encode, "required"
)
