"""Files of other software, one module for each kind."""

from __future__ import annotations

from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.exchange.descriptions import MJCF, URDF, XACRO
from calib_pin.io.exchange.dh import DH
from calib_pin.io.exchange.joint_offsets import JOINT_OFFSETS, LEROBOT, ROS2_CONTROL
from calib_pin.io.exchange.places import CAMERA_INFO, TF
from calib_pin.io.exchange.vendor_kinematics import UR, XARM

__all__ = ["FORMATS", "Encoded", "Exported", "Format"]

_ROBOTS = (UR, XARM, URDF, XACRO, MJCF)
_JOINTS = (ROS2_CONTROL, LEROBOT, JOINT_OFFSETS)

FORMATS = {form.name: form for form in (*_ROBOTS, *_JOINTS, CAMERA_INFO, DH, TF)}
"""Formats that a calibration is exported to, by name."""
