"""Errors of gears and encoders: joint corrections by the joint's own position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Self

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

    def _waves(self, drive: Drive, ratio: float | None) -> Iterator[_Wave]:
        """Gain and waves of a drive, whose motor has a gear of a ratio or of none."""
        unit = drive.unit
        if self.of_joint:
            yield _Wave(drive, "gain", f"{unit}/{unit}", GAIN_SCALE)
        named = list[tuple[str, float]]()
        if unit == "rad" and self.of_joint:
            named += [(f"{{}}{k}", float(k)) for k in range(1, HARMONICS + 1)]
        if ratio is not None:
            named += [("motor_{}", ratio), ("motor_{}2", 2.0 * ratio)]
        scale = AMPLITUDE_SCALES[unit]
        for name, frequency in named:
            for wave, phase in (("sin", 0.0), ("cos", np.pi / 2.0)):
                yield _Wave(drive, name.format(wave), unit, scale, frequency, phase)

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Screws along every joint's own motion, as large as its position says.

        Raises:
            OptionError: If a gear ratio belongs to no joint of the robot.
        """
        joints = list(chain.robot.model.names)[1:]
        ratios = by_joint(self.gear_ratios.items(), joints, "gear_ratios")
        waves = list[_Wave]()
        for drive in drives(chain):
            waves += self._waves(drive, ratios.get(drive.joint))
        functions = _Waves(tuple(waves))
        return [
            Screw(
                self.parameter(wave.drive.joint, wave.component, wave.unit, wave.scale),
                wave.drive.frame,
                wave.drive.motion,
                BasisFunction(functions, column),
            )
            for column, wave in enumerate(waves)
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


class _Wave(NamedTuple):
    """A component of a drive: `sin(frequency q + phase)`, or q where that is 0."""

    drive: Drive
    component: str
    unit: str
    scale: float
    frequency: float = 0.0
    phase: float = 0.0


@dataclass(frozen=True, eq=False)
class _Waves:
    """Components of drives at positions q, by the factors of the joints that they move.

    The joint that a drive moves stands at `factor q + offset`.
    """

    waves: tuple[_Wave, ...]

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        result = np.empty((len(self.waves), len(q)))
        for row, wave in zip(result, self.waves, strict=True):
            drive = wave.drive
            of_drive = (q[:, drive.frame - 1] - drive.offset) / drive.factor
            if wave.frequency != 0.0:
                np.sin(wave.frequency * of_drive + wave.phase, out=of_drive)
            np.multiply(drive.factor, of_drive, out=row)
        return result.T
