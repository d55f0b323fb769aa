"""Joint compliance under gravity and a payload (elastostatic errors)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.observations.labels import Labels
from calib_pin.parameterizations.base import (
    BasisFunction,
    Drive,
    Effects,
    Parameterization,
    Screw,
    drives,
)
from calib_pin.setup import Payload, Setup

DEFLECTION = 1e-3
"""Expected deflection of a joint under its usual torque [rad, m]."""

LEAST = 0.01
"""Part of the largest usual torque below which a joint counts as not loaded.

An axis along gravity has none but rounding, which must not become its scale.
"""

NOTHING = "none"
"""Payload of measurements in which the robot carries nothing."""

SAMPLES = 200
"""Configurations that the usual torques are taken from."""


@dataclass(frozen=True)
class Compliance(Parameterization):
    """`<joint>.compliance.k`: `dq_j = k tau_j(q)` [rad/Nm, m/N].

    tau is the torque that gravity exerts on the joint at the commanded configuration
    and nominal geometry, of the links' masses in the URDF and of a payload. It is the
    negative of what the drive must hold (Pinocchio's `computeGeneralizedGravity`), so
    that a joint that sags has a positive compliance (Wu et al., elastostatic part).
    A drive holds the torques of its joint and of the mimic joints in the chain, each by
    its factor.

    Attributes:
        gravity: Acceleration of gravity in the base link [m/s^2].
        payloads: Payloads by the names that measurements give; a single one is carried
            in all measurements that name none.
    """

    gravity: tuple[float, float, float] = Setup.gravity
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    name = "compliance"
    geometric = False
    requires = ("gravity", "payloads")
    effects: ClassVar[Effects] = Effects(("k",), DEFLECTION)

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """Compliance under the gravity and the payloads of a setup."""
        return cls(setup.gravity, setup.payloads)

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """One screw along every joint's own motion, as large as the drive's torque.

        Raises:
            OptionError: If nothing that has a mass loads any joint.
        """
        moved = drives(chain)
        if not moved:
            return []
        functions = _Torques(chain, self, moved)
        # Any fixed configurations that fill the limits; these are quasi-random.
        roots = np.sqrt(np.arange(2, 2 + len(chain.joints)) + 0.5)
        parts = np.outer(np.arange(1, SAMPLES + 1), roots) % 1.0
        q = chain.lower + parts * (chain.upper - chain.lower)
        heaviest = max(self.payloads, key=lambda k: self.payloads[k].mass, default="")
        torques = functions(q, Conditions(Labels.all(heaviest, len(q)))) / [
            d.factor for d in moved
        ]
        usual = np.sqrt(np.mean(torques**2, axis=0))
        # To the last bit: joints of one drive have one parameter.
        leaders = [d.joint for d in moved]
        usual = usual[[leaders.index(joint) for joint in leaders]]
        # A newton-meter for a revolute joint, a newton for a prismatic one.
        if not usual.max() > 1e-6:
            raise OptionError(
                "'compliance' needs something that gravity pulls at: there is no "
                f"gravity, or the links of '{chain.robot.name}' have no mass that "
                "loads a joint and there is no payload",
                allowed="<inertial> in the URDF, or payloads in the setup file",
            )
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
    load: Compliance
    drives: Sequence[Drive]

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        result = np.empty((len(q), len(self.chain.joints)))
        names = (
            conditions.payload if len(conditions.payload) else Labels.all("", len(q))
        )
        for name in names.distinct:
            rows = names.where(name)
            result[rows] = self.chain.gravity_torques(
                q[rows], self.load.gravity, self._carried(name)
            )
        factors = np.zeros((len(self.chain.joints), len(self.drives)))
        for k, drive in enumerate(self.drives):
            for other in self.drives:
                if other.joint == drive.joint:
                    factors[other.frame - 1, k] = other.factor * drive.factor
        return np.asarray(result @ factors)

    def _carried(self, name: str) -> Payload | None:
        """The payload of a name in the measurements, None for nothing.

        Raises:
            InputError: If it is unknown.
        """
        payloads = self.load.payloads
        if name in payloads:
            return payloads[name]
        if name == NOTHING or (not name and not payloads):
            return None
        if not name and len(payloads) == 1:
            return next(iter(payloads.values()))
        reason = f"there is no payload '{name}'{nearest(name, payloads)}"
        if not name:
            reason = "there are several payloads, and nothing says which is carried"
        raise InputError(
            reason, column="payload", allowed=", ".join([*payloads, NOTHING])
        )
