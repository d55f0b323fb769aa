"""Lost motion: what joints fall short by, from the side from which they come."""

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
    Parameterization,
    Screw,
    drives,
)

BACKLASH_SCALES = {"rad": 3e-4, "m": 1e-4}
"""Expected lost motion, by the unit of the joint's position: an arc minute."""


@dataclass(frozen=True)
class Hysteresis(Parameterization):
    """`<joint>.hysteresis.backlash`: `dq_j = -backlash/2 d_j` [rad, m].

    d_j is the sign of the last motion of the joint, 0 where it is not known. A joint
    lags behind its motion: of a positive backlash it stands half of it short of where
    it was sent, from either side, and the two places lie the backlash apart. Play of
    gears and wind-up under a friction that is the same everywhere look alike, so this
    is the sum of both, the lost motion. Mimic joints move with that of their leader.
    """

    name = "hysteresis"
    geometric = False
    conditions: ClassVar[tuple[str, ...]] = ("direction",)

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """One screw along every joint's own motion, against its last one."""
        moved = drives(chain)
        functions = _Sides(tuple(moved))
        return [
            Screw(
                self.parameter(
                    drive.joint, "backlash", drive.unit, BACKLASH_SCALES[drive.unit]
                ),
                drive.frame,
                drive.motion,
                BasisFunction(functions, k),
            )
            for k, drive in enumerate(moved)
        ]


@dataclass(frozen=True, eq=False)
class _Sides:
    """Half of minus the direction of each drive, by the size of its factor.

    The direction of a joint is that of its drive times the sign of the factor, and what
    the drive lacks moves the joint by the factor: the sign goes in twice.
    """

    drives: tuple[Drive, ...]

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        if not conditions.direction.size:
            return np.zeros((len(q), len(self.drives)))
        joints = [drive.frame - 1 for drive in self.drives]
        sizes = np.abs([drive.factor for drive in self.drives])
        return np.asarray(-0.5 * sizes * conditions.direction[:, joints])
