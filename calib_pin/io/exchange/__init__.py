"""Files of other software, one module for each."""

from __future__ import annotations

from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.exchange.dh import DH
from calib_pin.io.exchange.joint_offsets import JOINT_OFFSETS
from calib_pin.io.exchange.lerobot import LEROBOT
from calib_pin.io.exchange.mjcf import MJCF
from calib_pin.io.exchange.places import CAMERA_INFO, TF
from calib_pin.io.exchange.ros2_control import ROS2_CONTROL
from calib_pin.io.exchange.vendor_kinematics import UR, XARM
from calib_pin.io.exchange.xacro import XACRO

__all__ = ["FORMATS", "Encoded", "Exported", "Format"]

FORMATS = {
    form.name: form
    for form in (
        UR,
        XARM,
        XACRO,
        MJCF,
        ROS2_CONTROL,
        LEROBOT,
        JOINT_OFFSETS,
        CAMERA_INFO,
        DH,
        TF,
    )
}
"""Formats that a calibration is exported to, by name."""
