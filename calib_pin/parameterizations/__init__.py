"""Parameterizations of a robot's geometry, by the names that users write."""

from __future__ import annotations

from collections.abc import Mapping

from calib_pin.errors import require_known
from calib_pin.parameterizations.base import Parameterization, Screw
from calib_pin.parameterizations.dh import DenavitHartenberg
from calib_pin.parameterizations.frames import frame_screws
from calib_pin.parameterizations.joint_offset import JointOffset
from calib_pin.parameterizations.placement import LinkTransform, Placement

__all__ = [
    "PARAMETERIZATIONS",
    "Parameterization",
    "Screw",
    "frame_screws",
    "parameterization",
]

PARAMETERIZATIONS: Mapping[str, Parameterization] = {
    member.name: member
    for member in (
        Placement(),
        LinkTransform(),
        DenavitHartenberg(),
        DenavitHartenberg(full=True),
        JointOffset(),
    )
}
"""Every parameterization by its name."""


def parameterization(name: str) -> Parameterization:
    """The parameterization of a name.

    Raises:
        OptionError: If there is none; names the nearest.
    """
    require_known("parameterization", name, PARAMETERIZATIONS)
    return PARAMETERIZATIONS[name]
