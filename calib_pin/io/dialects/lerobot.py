"""Data sets of LeRobot: `observation.state` are the joints, `action` the commands.

Sources: github.com/huggingface/lerobot, `motors/motors_bus.py` (`_normalize`) and
`robots/so100_follower`: a motor `shoulder_pan.pos` is in degrees, or in -100 to 100 of
its range (the gripper 0 to 100), by a setting that the data do not state. The ranges
are in the calibration file of the robot; data set files (Parquet, lists) have their
names in `meta/info.json`.
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
from calib_pin.io.columns import Column, Floats
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
        for name, column in _elements(columns, file).items():
            if found := MOTOR.fullmatch(name):
                motors[found[1] or found[2]] = column
            elif not name.startswith("action"):
                read["time" if name == "timestamp" else name] = column
        joints = motors.keys() - {GRIPPER}
        if len(joints) < 2:
            return None
        numbers = {name: _readings(column) for name, column in motors.items()}
        largest = max(np.abs(np.nan_to_num(numbers[k])).max() for k in joints)
        beside = "put the calibration file of the robot (JSON) beside it"
        if RADIANS < largest <= 100.0 and (ranges := _half_ranges(file, motors)):
            for name, values in numbers.items():
                part = values / 100.0
                part = 2.0 * part - 1.0 if name == GRIPPER else part
                read[name] = base.computed(name, part * ranges[1][name], "deg")
            remark = (
                f"-100 to 100 of the ranges in {ranges[0]}; are they degrees, move "
            )
            return base.Reading(read, f"joints of LeRobot in {remark}that file away")
        if largest == 100.0:
            reason = (
                f"the joints are in -100 to 100 of their ranges: {beside}, or state "
            )
            raise InputError(reason + "their unit in 'columns' of the setup", file=file)
        unit, remark = ("deg", "degrees") if largest > RADIANS else (None, "rad")
        if RADIANS < largest < 100.0:
            remark += f"; are they in -100 to 100 of a range, {beside}"
        for name, column in motors.items():
            if name == GRIPPER:
                read[f"{name}.pos"] = column
            else:
                read[name] = base.named(column, name, unit)
        return base.Reading(read, f"joints of LeRobot in {remark}")


def _readings(column: Column) -> Floats:
    """The numbers of a column, nan for one that stands for no reading, shape (N,)."""
    return np.where(column.numbers == column.sentinel, np.nan, column.numbers)


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


def _half_ranges(
    file: Path, motors: Collection[str]
) -> tuple[str, Mapping[str, float]] | None:
    """The calibration file beside a file, and half the range of each motor [deg].

    Raises:
        InputError: If there are several.
    """
    found = {}
    for path in sorted(file.parent.glob("*.json")):
        with suppress(InputError, KeyError):
            calibration = read_motors(path)
            found[path.name] = {
                name: (-1.0 if calibration[name].get("drive_mode") else 1.0)
                * (calibration[name]["range_max"] - calibration[name]["range_min"])
                * 180.0
                / STEPS
                for name in motors
            }
    if len(found) > 1:
        reason = f"there are several calibration files beside it: {', '.join(found)}"
        raise InputError(reason, file=file)
    return next(iter(found.items()), None)


def _elements(columns: Mapping[str, Column], file: Path) -> dict[str, Column]:
    """The columns, that of lists of joint positions as a column for each."""
    read = dict(columns)
    lists = columns.get(STATE)
    if lists is None or not lists.words or (lists.codes < 0).any():
        return read
    rows = [re.sub(r"[\[\],()]", " ", word).split() for word in lists.words]
    with suppress(ValueError):  # Other texts, or lists of several lengths.
        numbers: Floats = np.array(rows, float)[lists.codes]
        names = _names(file) or [f"q_{k}" for k in range(numbers.shape[1])]
        for name, column in zip(names, numbers.T, strict=True):
            read[f"{STATE}.{name}"] = base.computed(name, column)
        del read[STATE]
    return read


def _names(file: Path) -> list[str]:
    """Names of the joints, from the data set that a file is of."""
    for folder in file.resolve().parents[:4]:
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            info = json.loads((folder / "meta" / "info.json").read_text("utf-8"))
            names = info["features"][STATE]["names"]
            return [*names] if isinstance(names, list) else [*names.popitem()[1]]
    return []
