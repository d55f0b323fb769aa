"""Errors of gears and encoders: joint corrections by the joint's own position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

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
from calib_pin.parameters import by_joint
from calib_pin.setup import Setup

GAIN_SCALE = 1e-3
"""Expected size of the error of a gear ratio."""

AMPLITUDE_SCALES = {"rad": 3e-4, "m": 1e-4}
"""Expected amplitude of a harmonic, by the unit of the joint's position."""

HARMONICS = 2
"""Harmonics of a turn of the joint."""


@dataclass(frozen=True)
class Transmission(Parameterization):
    """`<joint>.transmission.gain|sin1|cos1|sin2|cos2`, and of motors the same.

    `dq = gain q + sum_k (sin_k sin(k q) + cos_k cos(k q))`: a gear ratio or a scale
    that is off, an eccentric wheel or encoder (once per turn), an elliptic one (twice).
    A motor behind a gear of ratio r adds the same once (`motor_sin`, `motor_cos`) and
    twice (`motor_sin2`, `motor_cos2`) per turn of its own, r q: the wave generator of a
    strain-wave gear is elliptic. A prismatic joint has no turn; it has the gain, and
    the motor's where r is given.
    Mimic joints move with the errors of their leader, at its position.

    Attributes:
        gear_ratios: Joint name or glob to r [rad/rad, rad/m].
    """

    gear_ratios: Mapping[str, float] = field(default_factory=dict)
    of_joint: ClassVar[bool] = True
    name = "transmission"
    geometric = False
    requires = ("gear_ratios",)
    effects: ClassVar[Effects | None] = Effects(
        ("sin1", "cos1", "sin2", "cos2"), AMPLITUDE_SCALES["rad"]
    )

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """Transmission errors with the gear ratios of a setup."""
        return cls(setup.gear_ratios)

    def _waves(self, unit: str, ratio: float | None) -> Iterator[tuple[str, float]]:
        """Names with a place for `sin` and `cos`, and frequencies of the waves."""
        if unit == "rad" and self.of_joint:
            for k in range(1, HARMONICS + 1):
                yield f"{{}}{k}", float(k)
        if ratio is not None:
            yield "motor_{}", ratio
            yield "motor_{}2", 2.0 * ratio

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Screws along every joint's own motion, as large as its position says.

        Raises:
            OptionError: If a gear ratio belongs to no joint of the robot.
        """
        joints = list(chain.robot.model.names)[1:]
        ratios = by_joint(self.gear_ratios.items(), joints, "gear_ratios")
        parts: list[tuple[Drive, str, str, float, float, float]] = []
        for drive in drives(chain):
            unit = drive.unit
            if self.of_joint:
                parts.append((drive, "gain", f"{unit}/{unit}", GAIN_SCALE, 0.0, 0.0))
            for name, frequency in self._waves(unit, ratios.get(drive.joint)):
                for wave, phase in (("sin", 0.0), ("cos", np.pi / 2.0)):
                    component = name.format(wave)
                    scale = AMPLITUDE_SCALES[unit]
                    parts.append((drive, component, unit, scale, frequency, phase))
        if not parts:
            return []
        functions = _Waves(
            joint=np.array([part[0].frame - 1 for part in parts], np.intp),
            factor=np.array([part[0].factor for part in parts]),
            offset=np.array([part[0].offset for part in parts]),
            frequency=np.array([part[4] for part in parts]),
            phase=np.array([part[5] for part in parts]),
        )
        return [
            Screw(
                self.parameter(drive.joint, component, unit, scale),
                drive.frame,
                drive.motion,
                BasisFunction(functions, column),
            )
            for column, (drive, component, unit, scale, _, _) in enumerate(parts)
        ]


@dataclass(frozen=True)
class MotorRipple(Transmission):
    """The `motor_*` of `transmission` alone, of joints whose gear ratio is stated.

    Low waves of a joint bend with what no parameter describes, and hold nowhere else;
    ripples are what they are wherever the other joints stand.
    """

    of_joint: ClassVar[bool] = False
    name = "motor-ripple"
    kind = "transmission"
    effects: ClassVar[Effects | None] = None


@dataclass(frozen=True, eq=False)
class _Waves:
    """`factor sin(frequency q + phase)` of one drive each; q where the frequency is 0.

    The joint that the drive moves stands at `factor q + offset`.
    """

    joint: NDArray[np.intp]
    factor: Floats
    offset: Floats
    frequency: Floats
    phase: Floats

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        result = np.empty((len(self.joint), len(q)))
        for k, (joint, factor) in enumerate(zip(self.joint, self.factor, strict=True)):
            of_drive = (q[:, joint] - self.offset[k]) / factor
            if self.frequency[k] != 0.0:
                np.sin(self.frequency[k] * of_drive + self.phase[k], out=of_drive)
            np.multiply(factor, of_drive, out=result[k])
        return result.T
