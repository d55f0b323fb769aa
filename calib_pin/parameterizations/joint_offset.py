"""One offset per joint: the zero of its encoder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations.base import Parameterization, Screw


class JointOffset(Parameterization):
    """`<joint>.joint-offset.q`: a screw along the joint's own motion.

    It commutes with the motion, so `M_j Exp(S theta) J(q) = M_j J(q + theta)`.
    """

    name = "joint-offset"

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """One screw at every moving joint."""
        units = np.where(chain.revolute, "rad", "m")
        return [
            Screw(self.parameter(joint, "q", str(unit)), frame, motion)
            for frame, (joint, unit, motion) in enumerate(
                zip(chain.joints, units, chain.motions, strict=True), start=1
            )
        ]
