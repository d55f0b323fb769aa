"""Data sets of LeRobot: `observation.state` are the joints, `action` the commands.

Sources: github.com/huggingface/lerobot, `motors/motors_bus.py` (`_normalize`) and
`robots/so100_follower`: a motor `shoulder_pan.pos` is in degrees, or in -100 to 100 of
its range (the gripper 0 to 100), by a setting that the data do not state. The ranges
are in the calibration file of the robot.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.errors import InputError
from calib_pin.io.columns import TURNED, counted
from calib_pin.io.files import TEXT, read_bytes

MOTOR = re.compile(
    r"(?:observation\.state\.)?(?!gripper|(?:\w+_)?[xyz]\.)([\w-]+)\.pos"
    r"|observation\.state\.(?!gripper)([\w-]+)"
)
"""Motors of joints; the gripper is in 0 to 100 of its range in either case."""

STEPS = 4095
"""Steps of a turn, as LeRobot counts them (resolution 4096)."""

KEYS = ("homing_offset", "range_min", "range_max")

BESIDE = "put the calibration file of the robot (JSON) beside it"


class LeRobot(base.Dialect):
    """The states of a robot, and maybe its commands."""

    ours = (("timestamp", "time", None),)
    other = r"action.*"

    def read(self, columns: base.Columns, file: Path) -> base.Reading | None:
        """The joints in degrees, or as the calibration file beside has them."""
        motors = {n: m[1] or m[2] for n in columns if (m := MOTOR.fullmatch(n))}
        joints = {joint: columns[name] for name, joint in motors.items()}
        if len(joints) < 2:
            return None
        # A number that stands for no reading tells nothing of the unit.
        numbers = {
            joint: np.where(column.missing(), np.nan, column.numbers)
            for joint, column in joints.items()
        }
        positions = np.concatenate([*numbers.values()])
        largest = float(np.nanmax(np.abs(positions), initial=0.0))
        unit = counted(positions) or ("deg" if largest > TURNED else None)
        remark, half = unit or "rad", dict[str, float]()
        if unit and largest <= 100.0:
            name, half = _ranges(file, joints)
            remark += f"; are they in -100 to 100 of a range, {BESIDE}"
        if half:
            remark = f"parts of the ranges in {name}; are they degrees, move it away"
            joints = {n: base.computed(n, numbers[n] * half[n]) for n in joints}
        elif largest == 100.0:
            reason = f"the joints are in -100 to 100 of their ranges: {BESIDE}"
            raise InputError(reason, file=file)
        read = self.converted({n: c for n, c in columns.items() if n not in motors})
        read |= {n: base.named(column, n, unit) for n, column in joints.items()}
        return base.Reading(read, f"joints of LeRobot in {remark}")


def read_motors(template: Path) -> dict[str, dict[str, Any]]:
    """The content of a calibration file, by motor.

    Raises:
        InputError: If it is no such file.
    """
    motors, steps = dict[str, dict[str, Any]](), list[object]()
    with suppress(ValueError, RecursionError, LookupError, TypeError, AttributeError):
        motors = json.loads(read_bytes(template, TEXT))
        steps = [motor[key] for motor in motors.values() for key in KEYS]
    if {*map(type, steps)} != {int}:
        reason = f"each motor has {', '.join(KEYS)} in whole steps"
        raise InputError(f"is no calibration file of LeRobot: {reason}", file=template)
    return motors


def _ranges(file: Path, joints: Collection[str]) -> tuple[str, dict[str, float]]:
    """The calibration file beside a file, and a hundredth of half the ranges [deg].

    Raises:
        InputError: If there are several.
    """
    ranges = {}
    for path in sorted(file.parent.glob("*.json")):
        with suppress(InputError, KeyError):
            motors, half = read_motors(path), dict[str, float]()
            for name in joints:
                steps = motors[name]["range_max"] - motors[name]["range_min"]
                sign = -1.0 if motors[name].get("drive_mode") else 1.0
                half[name] = sign * steps * 1.8 / STEPS
            ranges[path.name] = half
    if len(ranges) > 1:
        reason = f"there are several calibration files beside it: {', '.join(ranges)}"
        raise InputError(reason, file=file)
    return next(iter(ranges.items()), ("", {}))
