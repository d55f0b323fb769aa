"""Data sets of LeRobot: `observation.state` are the joints, `action` the commands.

Sources: github.com/huggingface/lerobot, `motors/motors_bus.py` (`_normalize`) and
`robots/so100_follower`: a motor `shoulder_pan.pos` is in degrees, or in -100 to 100 of
its range (the gripper 0 to 100), by a setting that the data do not state. The ranges
are in the calibration file of the robot.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.errors import InputError
from calib_pin.io.columns import Column
from calib_pin.io.files import TEXT, read_bytes

STATE = "observation.state"
MOTOR = re.compile(
    rf"(?:{STATE}\.)?(?!(?:\w+_)?[xyz]\.)([\w-]+)\.pos|{STATE}\.([\w-]+)"
)
"""Motors, of which none is an axis of a position."""

RADIANS = 2.2 * np.pi
"""Joints that never go beyond this are in rad."""

STEPS = 4095
"""Steps of a turn, as LeRobot counts them (resolution 4096)."""

KEYS = ("homing_offset", "range_min", "range_max")

GRIPPER = "gripper"
"""The motor that is in 0 to 100 of its range in either case."""


class LeRobot(base.Dialect):
    """The states of a robot, and maybe its commands."""

    def read(self, columns: Mapping[str, Column], file: Path) -> base.Reading | None:
        """The joints in degrees, or as the calibration file beside has them."""
        read, motors = dict[str, Column](), dict[str, Column]()
        for name, column in columns.items():
            if found := MOTOR.fullmatch(name):
                motors[found[1] or found[2]] = column
            elif not name.startswith("action"):
                read["time" if name == "timestamp" else name] = column
        joints = motors.keys() - {GRIPPER}
        if len(joints) < 2:
            return None
        # A number that stands for no reading tells nothing of the unit.
        sizes = [
            np.abs(column.numbers[column.numbers != column.sentinel])
            for column in map(motors.__getitem__, joints)
        ]
        largest = max(np.nanmax(size, initial=0.0) for size in sizes)
        beside = "put the calibration file of the robot (JSON) beside it"
        if RADIANS < largest <= 100.0 and (ranges := _ranges(file, motors)):
            calibration, of = ranges
            read |= {n: _in_degrees(n, c, of[n]) for n, c in motors.items()}
            remark = f"-100 to 100 of the ranges in {calibration}"
            remark += "; are they degrees, move that file away"
        elif largest == 100.0:
            reason = (
                f"the joints are in -100 to 100 of their ranges: {beside}, or state "
                "their unit in 'columns' of the setup"
            )
            raise InputError(reason, file=file)
        else:
            unit, remark = None, "rad"
            if largest > RADIANS:
                unit, remark = "deg", f"degrees; are they parts of a range, {beside}"
            for name in joints:
                read[name] = base.named(motors[name], name, unit)
            if GRIPPER in motors:
                read[f"{GRIPPER}.pos"] = motors[GRIPPER]
        return base.Reading(read, f"joints of LeRobot in {remark}")


def _in_degrees(name: str, column: Column, motor: Mapping[str, Any]) -> Column:
    """A motor's position, which the file has in -100 to 100 of its range."""
    part = np.where(column.numbers == column.sentinel, np.nan, column.numbers / 100.0)
    part = 2.0 * part - 1.0 if name == GRIPPER else part
    half = (motor["range_max"] - motor["range_min"]) * 180.0 / STEPS
    return base.computed(
        name, part * (-half if motor.get("drive_mode") else half), "deg"
    )


def read_motors(template: Path) -> dict[str, dict[str, Any]]:
    """The content of a calibration file, by motor.

    Raises:
        InputError: If it is no such file.
    """
    try:
        data = json.loads(read_bytes(template, TEXT))
    except (ValueError, RecursionError) as error:
        found = getattr(error, "msg", error)
        raise InputError(f"is not JSON: {found}", file=template) from None
    if not isinstance(data, dict) or not data:
        raise InputError("holds no motors", file=template)
    for name, motor in data.items():
        numbers = [motor.get(key) if isinstance(motor, dict) else None for key in KEYS]
        if any(isinstance(n, bool) or not isinstance(n, int) for n in numbers):
            raise InputError(
                f"motor '{name}' lacks one of {', '.join(KEYS)}, in whole steps",
                file=template,
            )
    return data


def _ranges(
    file: Path, motors: Collection[str]
) -> tuple[str, Mapping[str, dict[str, Any]]] | None:
    """Name and content of the calibration file of these motors beside a file.

    Raises:
        InputError: If there are several.
    """
    found = {}
    for path in sorted(file.parent.glob("*.json")):
        with suppress(InputError):
            calibration = read_motors(path)
            if calibration.keys() >= {*motors}:
                found[path.name] = calibration
    if len(found) > 1:
        reason = f"there are several calibration files beside it: {', '.join(found)}"
        raise InputError(reason, file=file)
    return next(iter(found.items()), None)
