"""Joint compliance under gravity and a payload (elastostatic errors)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.parameterizations.base import (
    BasisFunction,
    Drive,
    Effects,
    Parameterization,
    Screw,
    drives,
)
from calib_pin.parameterizations.loads import LEAST, Loads

DEFLECTION = 1e-3
"""Expected deflection of a joint under its usual torque [rad, m]."""


@dataclass(frozen=True)
class Compliance(Loads, Parameterization):
    """`<joint>.compliance.k`: `dq_j = k tau_j(q)` [rad/Nm, m/N].

    tau is the torque that gravity exerts on the joint at the commanded configuration
    and nominal geometry, of the links' masses in the URDF and of a payload. It is the
    negative of what the drive must hold (Pinocchio's `computeGeneralizedGravity`), so
    that a joint that sags has a positive compliance (Wu et al., elastostatic part).
    A drive holds the torques of its joint and of the mimic joints in the chain, each by
    its factor.
    """

    name = "compliance"
    geometric = False
    effects: ClassVar[Effects] = Effects(("k",), DEFLECTION)

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """One screw along every joint's own motion, as large as the drive's torque.

        Raises:
            OptionError: If nothing that has a mass loads any joint.
        """
        moved = drives(chain)
        if not moved:
            return []
        functions = _Torques(chain, self, moved)
        usual = self.usual(functions, chain, self.name) / np.abs(
            [drive.factor for drive in moved]
        )
        # To the last bit: joints of one drive have one parameter.
        leaders = [d.joint for d in moved]
        usual = usual[[leaders.index(joint) for joint in leaders]]
        scales = DEFLECTION / np.maximum(usual, LEAST * usual.max())
        return [
            Screw(
                self.parameter(
                    drive.joint,
                    "k",
                    "rad/Nm" if drive.unit == "rad" else "m/N",
                    float(scale),
                ),
                drive.frame,
                drive.motion,
                BasisFunction(functions, k),
            )
            for k, (drive, scale) in enumerate(zip(moved, scales, strict=True))
        ]


@dataclass(frozen=True, eq=False)
class _Torques:
    """Torques of gravity on all drives, by the factors of the joints they move."""

    chain: Chain
    load: Loads
    drives: Sequence[Drive]

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        torques = self.load.loads(self.chain.gravity_torques, q, conditions)
        factors = np.zeros((len(self.chain.joints), len(self.drives)))
        for k, drive in enumerate(self.drives):
            for other in self.drives:
                if other.joint == drive.joint:
                    factors[other.frame - 1, k] = other.factor * drive.factor
        return np.asarray(torques @ factors)
