"""One offset per joint: the zero of its encoder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib_pin.chain import Chain
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
        for place, joint in enumerate(chain.joints, start=1):
            axis, revolute = chain.axes[place - 1], chain.revolute[place - 1]
            zero = np.zeros(3)
            twist = np.concatenate([zero, axis] if revolute else [axis, zero])
            unit = "rad" if revolute else "m"
            parameter = robot_parameter(joint, self.name, "q", unit)
            result.append(Screw(parameter, place, twist))
        return result
