"""One offset per joint: the zero of its encoder."""

from __future__ import annotations

from collections.abc import Sequence

from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations.base import Screw, robot_parameter

__all__ = ["JointOffset"]


class JointOffset:
    """`<joint>.joint-offset.q`: a screw along the joint's own motion.

    It commutes with the motion, so `M_j Exp(S theta) J(q) = M_j J(q + theta)`.
    """

    name = "joint-offset"

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """One screw at every moving joint."""
        result = []
        for place, (joint, motion) in enumerate(
            zip(chain.joints, chain.motions, strict=True), start=1
        ):
            unit = "rad" if chain.revolute[place - 1] else "m"
            parameter = robot_parameter(joint, self.name, "q", unit)
            result.append(Screw(parameter, place, motion))
        return result
