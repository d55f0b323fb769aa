"""What a parameterization is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import Parameter

__all__ = [
    "ANGLE_SCALE",
    "COMPONENTS",
    "LENGTH_SCALE",
    "Factor",
    "JointFunctions",
    "Parameterization",
    "Screw",
    "expected_size",
    "owner",
    "robot_parameter",
]

LENGTH_SCALE = 1e-3
"""Expected size of a length error of a robot [m]."""

ANGLE_SCALE = 3e-3
"""Expected size of an angle error of a robot [rad].

Over a link of a third of a meter it moves what follows as far as a length error does.
The marginal likelihood of the TALOS and TIAGo training rows peaks at this ratio too.
"""

PIXEL_SCALE = 1.0
"""Expected size of an error in an image [px]: a millimeter seen from a meter."""

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the six unit twists, in the order (linear, angular)."""


class JointFunctions(Protocol):
    """Functions of the commanded joint positions, and of what the robot carries."""

    def __call__(self, q: Floats, payload: Sequence[str] = ()) -> Floats:
        """Their values.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            payload: Name of what the robot carries in each row; default the only
                payload that there is.

        Returns:
            Values, shape (N, m).

        Raises:
            InputError: If there are several payloads, or none of that name.
        """
        ...


@dataclass(frozen=True)
class Factor:
    """One of several functions, which are evaluated together.

    Attributes:
        functions: The functions.
        column: Which of them.
    """

    functions: JointFunctions
    column: int


@dataclass(frozen=True)
class Screw:
    """One error parameter as a unit screw at one place of the chain.

    Attributes:
        parameter: The parameter whose value is the amount of the screw.
        place: 0 for the base, 1..n for the joints from base to tip, n + 1 for the tip,
            n + 2 for the tool. At a joint the screw follows the nominal placement, in
            the joint frame; screws of one place apply in the order they are listed.
        twist: Unit twist (linear, angular), shape (6,), per unit of the parameter.
        factor: What the amount is multiplied by at a configuration, for a joint
            correction `dq_j = sum_p theta_p phi_p(q)`; its twist is the joint's own
            motion, with which it commutes. None for an error of the geometry.
    """

    parameter: Parameter
    place: int
    twist: Floats
    factor: Factor | None = None


class Parameterization(Protocol):
    """Error parameters of a robot: of its geometry, or of its joints' motions."""

    @property
    def name(self) -> str:
        """Name as users write it."""
        ...

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """The screws of a chain, place by place in the order they apply."""
        ...


def owner(joint: str) -> str:
    """Name of a joint as it stands in parameter names.

    The words `base` and `tool` belong to the two frames.

    Example:
        >>> owner("elbow"), owner("tool")
        ('elbow', 'joint:tool')
    """
    return f"joint:{joint}" if joint in ("base", "tool") else joint


def expected_size(unit: str) -> float:
    """Expected size of an error of a robot in a unit, `m`, `px` or an angle."""
    if unit == "px":
        return PIXEL_SCALE
    return LENGTH_SCALE if unit == "m" else ANGLE_SCALE


def robot_parameter(joint: str, kind: str, component: str, unit: str) -> Parameter:
    """A parameter of the robot with the scale of its unit."""
    name = f"{owner(joint)}.{kind}.{component}"
    return Parameter(name, unit, expected_size(unit))
