"""Numerical inverse kinematics, on the calibrated robot or any other kinematics."""

from __future__ import annotations

from calib_pin.control.calibrated import Frame, Point, kinematics
from calib_pin.control.compensation import commands
from calib_pin.control.joints import Joints, Kinematics, Solutions
from calib_pin.control.reaching import reach, search

__all__ = [
    "Frame",
    "Joints",
    "Kinematics",
    "Point",
    "Solutions",
    "commands",
    "kinematics",
    "reach",
    "search",
]
