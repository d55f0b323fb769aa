"""Places of a chain that bend row by row: screws whose amounts depend on conditions.

Behind the screws of the geometry, and before the joint's own motion, a place has

    Exp(sum_p S_p theta_p phi_p)

with unit twists S_p and basis functions phi_p of the configuration and its conditions.
A bearing gives across its axis in this way, a link grows, an instrument drifts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.chain import Placement, matrix
from calib_pin.kinematics.spatial import (
    Floats,
    adjoint,
    invert,
    se3_exp,
    se3_left_jacobian,
)
from calib_pin.parameterizations.base import Screw


@dataclass(frozen=True)
class Bends:
    """How the places of a chain are bent at N configurations.

    Attributes:
        flexures: Positions of the parameters that bend places, shape (F,).
        twists: Twist of each place that is bent, shape (N, 6), by its frame.
    """

    flexures: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    twists: Mapping[int, Floats] = field(default_factory=dict)

    @staticmethod
    def of(
        screws: Sequence[Screw],
        flexures: NDArray[np.intp],
        amounts: Floats,
        basis: Floats,
    ) -> Bends:
        """The bends by the values of the parameters and of their basis functions.

        Args:
            screws: All screws.
            flexures: Positions of those that bend places, shape (F,).
            amounts: Their values, shape (F,).
            basis: Their basis functions, shape (N, F).
        """
        twists: dict[int, Floats] = {}
        for k, amount, phi in zip(flexures, amounts, basis.T, strict=True):
            if amount != 0.0:
                screw = screws[k]
                turned = np.outer(amount * phi, screw.twist)
                twists[screw.frame] = twists.get(screw.frame, 0.0) + turned
        return Bends(flexures, twists)

    @cached_property
    def motions(self) -> Mapping[int, Floats]:
        """The bends as poses, shape (N, 4, 4), by frame."""
        return {frame: se3_exp(twist) for frame, twist in self.twists.items()}

    def bent(self, frame: int, pose: pin.SE3) -> Placement:
        """A pose at the end of the geometry of a frame, with the bend behind it."""
        if frame not in self.twists:
            return pose
        return np.asarray(pose.homogeneous @ self.motions[frame])

    def before(self, frame: int, derivative: Floats) -> Floats:
        """Derivatives by twists behind a bend as those by twists before it.

        Args:
            frame: Frame of the bend.
            derivative: By body twists at the end of the frame, shape (N, d, 6).
        """
        if frame not in self.twists:
            return derivative
        return np.asarray(derivative @ adjoint(invert(self.motions[frame])))

    def by_twist(self, frame: int, derivative: Floats) -> Floats:
        """Derivatives by the twist that bends a frame, shape (N, d, 6).

        Args:
            frame: The frame.
            derivative: By body twists before the bend, shape (N, d, 6).
        """
        if frame not in self.twists:
            return derivative
        return np.asarray(derivative @ se3_left_jacobian(self.twists[frame]))


def joined(first: Placement, second: Placement) -> Placement:
    """Product of two poses, each of them one or one of each configuration."""
    if isinstance(first, pin.SE3) and isinstance(second, pin.SE3):
        return first * second
    return np.asarray(matrix(first) @ matrix(second))


def carried(pose: Placement, twists: Floats) -> Floats:
    """Body twists of a frame as those of one that it carries, shape (N, 6, k).

    Args:
        pose: Where that one stands in the frame.
        twists: Body twists of the frame, shape (N, 6, k).
    """
    if isinstance(pose, pin.SE3):
        return np.asarray(pose.toActionMatrixInverse() @ twists)
    return np.asarray(adjoint(invert(pose)) @ twists)
