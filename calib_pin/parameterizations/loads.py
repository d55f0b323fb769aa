"""Loads of gravity on a chain: the part that all compliances share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.observations.labels import Labels
from calib_pin.parameterizations.base import BasisFunctions
from calib_pin.setup import Payload, Setup

LEAST = 0.01
"""Part of the largest usual torque below which a joint counts as not loaded.

An axis along gravity has none but rounding, which must not become its scale.
"""

NOTHING = "none"
"""Payload of measurements in which the robot carries nothing."""

SAMPLES = 200
"""Configurations that the usual torques are taken from."""


Loading = Callable[..., Floats]
"""Loads of configurations (N, n) by gravity and a payload, shape (N, ...)."""


@dataclass(frozen=True)
class Loads:
    """Gravity, and what a robot carries.

    Attributes:
        gravity: Acceleration of gravity in the base link [m/s^2].
        payloads: Payloads by the names that measurements give; a single one is carried
            in all measurements that name none.
    """

    gravity: tuple[float, float, float] = Setup.gravity
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    requires: ClassVar[tuple[str, ...]] = ("gravity", "payloads")

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """The gravity and the payloads of a setup."""
        return cls(setup.gravity, setup.payloads)

    def loads(
        self, loading: Loading, q: Floats, conditions: Conditions = UNSTATED
    ) -> Floats:
        """Loads of configurations under what each of them carries, shape (N, ...).

        Raises:
            InputError: If a payload is unknown.
        """
        names = conditions.payload
        names = names if len(names) else Labels.all("", len(q))
        result = np.empty(0)
        for name in names.distinct:
            rows = names.where(name)
            values = loading(q[rows], self.gravity, self._payload(name))
            if not result.size:
                result = np.empty((len(q), *values.shape[1:]))
            result[rows] = values
        return result if len(q) else loading(q, self.gravity, None)

    def usual(self, functions: BasisFunctions, chain: Chain, name: str) -> Floats:
        """Root mean squares of loads of the heaviest payload over the limits, (m,).

        Args:
            functions: The loads.
            chain: The chain.
            name: What needs them, for messages.

        Raises:
            OptionError: If nothing that has a mass loads anything.
        """
        # Any fixed configurations that fill the limits; these are quasi-random.
        roots = np.sqrt(np.arange(2, 2 + len(chain.joints)) + 0.5)
        parts = np.outer(np.arange(1, SAMPLES + 1), roots) % 1.0
        q = chain.lower + parts * (chain.upper - chain.lower)
        heaviest = max(self.payloads, key=lambda k: self.payloads[k].mass, default="")
        loads = functions(q, Conditions(Labels.all(heaviest, len(q))))
        usual = np.sqrt(np.mean(loads**2, axis=0))
        # A newton-meter for a revolute joint, a newton for a prismatic one.
        if not usual.max() > 1e-6:
            raise OptionError(
                f"'{name}' needs something that gravity pulls at: there is no "
                f"gravity, or the links of '{chain.robot.name}' have no mass that "
                "loads a joint and there is no payload",
                allowed="<inertial> in the URDF, or payloads in the setup file",
            )
        return np.asarray(usual)

    def _payload(self, name: str) -> Payload | None:
        """The payload of a name in the measurements, None for nothing.

        Raises:
            InputError: If it is unknown.
        """
        payloads = self.payloads
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
