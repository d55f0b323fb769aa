"""Links that grow with the temperature."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from calib_pin.errors import OptionError, nearest
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.parameterizations.base import (
    BasisFunction,
    Parameterization,
    Screw,
    owner,
)
from calib_pin.parameters import Parameter, matching
from calib_pin.setup import Setup

EXPANSION = 2e-5
"""Expected size of a coefficient of expansion [1/K]: steel has 1.2e-5, aluminium
2.3e-5."""

REFERENCE = 20.0
"""Temperature at which lengths hold where nothing else is known [degC] (ISO 1)."""

SHORTEST = 1e-6
"""Length from which a link can grow [m]."""


@dataclass(frozen=True)
class ThermalGrowth(Parameterization):
    """`<joint>.thermal.growth`: growth of the link before a joint [1/K].

    The joint moves along the nominal way from the joint before it, by the length of
    that way times `growth (temperature - reference)`; so does the tip, named after the
    fixed joint that carries it. Links of one material share its growth,
    `<material>.thermal.growth`. The prior is as wide as the expected size: no material
    grows ten times as much.

    Attributes:
        reference: Temperature at which the geometry holds [degC].
        materials: Names or globs of joints by the name of a material.
    """

    reference: float = REFERENCE
    materials: Mapping[str, Sequence[str]] = field(default_factory=dict)
    name = "thermal"
    geometric = False
    requires = ("thermal",)
    conditions: ClassVar[tuple[str, ...]] = ("temperature",)

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """The growth from the reference temperature of a setup."""
        stated = setup.thermal.reference
        reference = REFERENCE if stated is None else stated
        return cls(reference, setup.thermal.materials)

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """A screw along the way to every joint and to the tip, per unit of growth.

        Raises:
            OptionError: If a material belongs to no joint of the robot.
        """
        robot = chain.robot
        joints = [*list(robot.model.names)[1:], *robot.fixed_parents.values()]
        owners = self._owners(joints)
        functions = _Warmth(self.reference)
        return [
            Screw(
                Parameter(
                    f"{owners.get(joint, owner(joint))}.{self.kind}.growth",
                    "1/K",
                    EXPANSION,
                    prior=EXPANSION,
                ),
                frame,
                np.concatenate([way, np.zeros(3)]),
                BasisFunction(functions, 0),
            )
            for frame, joint, way in _ways(chain)
        ]

    def _owners(self, joints: Sequence[str]) -> dict[str, str]:
        """Material by joint; later entries win."""
        result: dict[str, str] = {}
        for material, patterns in self.materials.items():
            for pattern in patterns:
                found = matching(pattern, joints)
                if not found:
                    raise OptionError(
                        f"no joint of the robot matches '{pattern}'"
                        f"{nearest(pattern, joints)}",
                        column="thermal.materials",
                        allowed=", ".join(joints),
                    )
                result.update({joints[k]: owner(material) for k in found})
        return result


def _ways(chain: Chain) -> Iterator[tuple[int, str, Floats]]:
    """Frame, joint, and nominal way to it from the joint before in its own frame."""
    for k, (joint, placement) in enumerate(
        zip(chain.joints, chain.placements, strict=True)
    ):
        way = placement.translation
        if k == 0 and not chain.reversed[0]:
            way = way - chain.ends[0].translation
        if np.linalg.norm(way) > SHORTEST:
            yield k + 1, joint, placement.rotation.T @ way
    if chain.tip_joint is not None:
        way = chain.tip_placement.translation
        if np.linalg.norm(way) > SHORTEST:
            frame = len(chain.joints) + 1
            yield frame, chain.tip_joint, chain.tip_placement.rotation.T @ way


@dataclass(frozen=True)
class _Warmth:
    """The temperature from a reference on; zero where it is not stated."""

    reference: float

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        if not len(conditions.temperature):
            return np.zeros((len(q), 1))
        return np.asarray(conditions.temperature[:, None] - self.reference)
