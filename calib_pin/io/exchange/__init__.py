"""Files of other software, one module for each kind."""

from __future__ import annotations

from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.exchange.descriptions import camera_info, mjcf, tf, xacro
from calib_pin.io.exchange.joint_frames import dh, ur, xarm
from calib_pin.io.exchange.joint_offsets import lerobot, offsets_table, ros2_control

__all__ = ["FORMATS", "Encoded", "Exported", "Format"]

_ROBOTS = (ur, xarm, xacro, mjcf)
_JOINTS = (ros2_control, lerobot, offsets_table)

FORMATS = {form.name: form for form in (*_ROBOTS, *_JOINTS, camera_info, dh, tf)}
"""Formats that a calibration is exported to, by name."""
