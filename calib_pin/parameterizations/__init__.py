"""Parameterizations of a robot's errors, by the names that users write."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from calib_pin.errors import require_known
from calib_pin.parameterizations.base import (
    Factor,
    JointFunctions,
    Parameterization,
    Screw,
)
from calib_pin.parameterizations.compliance import NOTHING, Compliance
from calib_pin.parameterizations.dh import DenavitHartenberg
from calib_pin.parameterizations.frames import frame_pose, frame_screws, frame_setup
from calib_pin.parameterizations.joint_offset import JointOffset
from calib_pin.parameterizations.placement import LinkTransform, Placement
from calib_pin.parameterizations.transmission import Transmission
from calib_pin.setup import Setup

__all__ = [
    "NOTHING",
    "PARAMETERIZATIONS",
    "Factor",
    "JointFunctions",
    "Parameterization",
    "Screw",
    "frame_pose",
    "frame_screws",
    "frame_setup",
    "parameterization",
]


PARAMETERIZATIONS: Mapping[str, Callable[[Setup], Parameterization]] = {
    "placement": lambda setup: Placement(),
    "link-transform": lambda setup: LinkTransform(),
    "dh": lambda setup: DenavitHartenberg(),
    "dh-full": lambda setup: DenavitHartenberg(full=True),
    "joint-offset": lambda setup: JointOffset(),
    "transmission": lambda setup: Transmission(setup.gear_ratios),
    "compliance": lambda setup: Compliance(setup.gravity, setup.payloads),
}
"""How each parameterization is made from a setup."""


def parameterization(name: str, setup: Setup | None = None) -> Parameterization:
    """The parameterization of a name.

    Args:
        name: Name of the parameterization.
        setup: What the user states about the robot, such as its payload.

    Raises:
        OptionError: If there is none; names the nearest.
    """
    require_known("parameterization", name, PARAMETERIZATIONS)
    return PARAMETERIZATIONS[name](setup or Setup())
