"""Parameterizations of a robot's errors, by the names that users write."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from calib_pin.errors import require_known
from calib_pin.parameterizations.base import (
    BasisFunctions,
    Parameterization,
    Screw,
    frame_pose,
    frame_screws,
    frame_setup,
)
from calib_pin.parameterizations.compliance import Compliance
from calib_pin.parameterizations.cross_compliance import CrossCompliance
from calib_pin.parameterizations.dh import DenavitHartenberg, FullDenavitHartenberg
from calib_pin.parameterizations.drift import InstrumentDrift
from calib_pin.parameterizations.hysteresis import Hysteresis
from calib_pin.parameterizations.loads import NOTHING
from calib_pin.parameterizations.placement import (
    JointOffset,
    LinkTransform,
    Placement,
)
from calib_pin.parameterizations.thermal import ThermalGrowth, WarmUp
from calib_pin.parameterizations.transmission import MotorRipple, Transmission
from calib_pin.plugins import Members
from calib_pin.setup import Setup

__all__ = [
    "NOTHING",
    "PARAMETERIZATIONS",
    "BasisFunctions",
    "Screw",
    "frame_pose",
    "frame_screws",
    "frame_setup",
    "needed_conditions",
    "outside_urdf",
    "parameterization",
    "required_keys",
]

_BUNDLED: tuple[type[Parameterization], ...] = (
    Placement,
    LinkTransform,
    DenavitHartenberg,
    FullDenavitHartenberg,
    JointOffset,
    Transmission,
    Compliance,
    Hysteresis,
    MotorRipple,
    CrossCompliance,
    ThermalGrowth,
    WarmUp,
    InstrumentDrift,
)


def _fault(name: str, member: object) -> str:
    """Why an object of another package cannot be a member; empty where it can."""
    fits = isinstance(member, type) and issubclass(member, Parameterization)
    return "" if fits else "it is no Parameterization"


PARAMETERIZATIONS: Mapping[str, type[Parameterization]] = Members(
    "calib_pin.parameterizations", {member.name: member for member in _BUNDLED}, _fault
)
"""All parameterizations by name, those of other packages last."""


def parameterization(name: str, setup: Setup | None = None) -> Parameterization:
    """The parameterization of a name.

    Args:
        name: Name of the parameterization.
        setup: The user's statements about the robot, such as its payload.

    Raises:
        OptionError: If there is none; names the nearest.
    """
    require_known("parameterization", name, PARAMETERIZATIONS)
    return PARAMETERIZATIONS[name].of_setup(setup or Setup())


def outside_urdf() -> tuple[str, ...]:
    """Names of the parameterizations that a URDF cannot hold."""
    return tuple(
        name for name, member in PARAMETERIZATIONS.items() if not member.geometric
    )


def needed_conditions(names: Iterable[str]) -> dict[str, str]:
    """Conditions that measurements must state, each with the name that needs it.

    Names that do not exist need none; others say so.
    """
    return {
        condition: name
        for name in names
        if name in PARAMETERIZATIONS
        for condition in PARAMETERIZATIONS[name].conditions
    }


def required_keys(names: Iterable[str]) -> set[str]:
    """Keys of a setup file without which these parameterizations mean nothing."""
    return {key for name in names for key in PARAMETERIZATIONS[name].requires}
