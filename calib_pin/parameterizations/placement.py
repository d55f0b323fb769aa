"""Errors of every joint's placement, in its frame or its parent's, and of its zero."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations.base import (
    COMPONENTS,
    Parameterization,
    Screw,
    drives,
)

HAND_SET = math.radians(5.0)
"""Expected error of a zero that is set by hand [rad]: the teeth of a servo's spline are
14 to 17 degrees apart."""

UNITS = ("m", "m", "m", "rad", "rad", "rad")


class Placement(Parameterization):
    """`<joint>.placement.x|y|z|rx|ry|rz`: screws along the axes of the joint frame.

    `M_j(theta) = M_j0 Tx Ty Tz Rx Ry Rz`. Redundant, but free of singularities and
    the same for every robot; the rank analysis finds which of it is identifiable.
    """

    name = "placement"

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Six screws at every moving joint."""
        return [
            Screw(self.parameter(joint, component, unit), frame, twist)
            for frame, joint in enumerate(chain.joints, start=1)
            for component, unit, twist in zip(COMPONENTS, UNITS, np.eye(6), strict=True)
        ]


class LinkTransform(Parameterization):
    """`<joint>.link-transform.mx|my|mz|dx|dy|dz`: the error in the parent frame.

    To first order `M_j = (I + Delta) M_j0` with position part m and rotation part
    delta in the frame of the preceding joint of the tree (Liu et al. 2022, section
    1.2); here the exact motion `Exp(mx) ... Exp(dz) M_j0`, moved through the placement
    by the adjoint. The fixed transform from the last joint to the tip is the last link.
    """

    name = "link-transform"

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Six screws at every moving joint and at the tip's fixed joint."""
        count = len(chain.joints)
        # The chain's own placements reach back past joints that it does not contain.
        model = chain.robot.model
        links = [
            (frame, joint, model.jointPlacements[model.getJointId(joint)])
            for frame, joint in enumerate(chain.joints, start=1)
        ]
        if chain.tip_joint is not None:
            links.append((count + 1, chain.tip_joint, chain.tip_placement))
        components = ("mx", "my", "mz", "dx", "dy", "dz")
        return [
            Screw(self.parameter(joint, component, unit), frame, twist)
            for frame, joint, placement in links
            for component, unit, twist in zip(
                components, UNITS, placement.toActionMatrixInverse().T, strict=True
            )
        ]


class JointOffset(Parameterization):
    """`<joint>.joint-offset.q`: a screw along the joint's own motion.

    It commutes with the motion, so `M_j Exp(S theta) J(q) = M_j J(q + theta)`. Mimic
    joints move with the offset of their leader. A servo is screwed on by hand, and so
    its zero may be off by several degrees.
    """

    name = "joint-offset"
    turn = 0.25 * HAND_SET  # From 31 deg on, two teeth of a spline, it is implausible.

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """One screw at every moving joint."""
        return [
            Screw(
                self.parameter(drive.joint, "q", drive.unit),
                drive.frame,
                drive.factor * drive.motion,
            )
            for drive in drives(chain)
        ]
