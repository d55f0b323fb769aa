"""Product of exponentials: a parameterization as another package would add it."""

from __future__ import annotations

from collections.abc import Sequence

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import adjoint, invert
from calib_pin.parameterizations.base import Parameterization, Screw

COMPONENTS = ("vx", "vy", "vz", "wx", "wy", "wz")


class ProductOfExponentials(Parameterization):
    """`<joint>.poe.vx|vy|vz|wx|wy|wz`: errors of a joint's screw axis in the base link.

    The twist of the error is in base coordinates at zero joint positions (He et al.,
    IEEE Transactions on Robotics 26(3), 2010); the adjoint takes it to the joint.
    """

    name = "poe"

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Six screws at every moving joint."""
        return [
            Screw(
                self.parameter(joint, component, "m" if k < 3 else "rad"),
                index + 1,
                to_joint[:, k],
            )
            for index, (joint, to_joint) in enumerate(
                zip(chain.joints, adjoint(invert(chain.joint_frames())), strict=True)
            )
            for k, component in enumerate(COMPONENTS)
        ]
