"""Links that grow with the temperature, measured or as a robot warms up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.parameterizations.base import (
    BasisFunction,
    BasisFunctions,
    Parameterization,
    Screw,
    owner,
)
from calib_pin.parameters import Parameter
from calib_pin.setup import Setup

EXPANSION = 2e-5
"""Expected size of a coefficient of expansion [1/K]: steel has 1.2e-5, aluminium
2.3e-5."""

REFERENCE = 20.0
"""Temperature at which lengths hold where nothing else is known [degC] (ISO 1)."""

WARMER = 20.0
"""Temperature by which a robot that works is warmer than one that stood [K]."""

WARM_UP = 1800.0
"""Time constant of a robot's warm-up where nothing else is known [s]."""

SHORTEST = 1e-6
"""Length from which a link can grow [m]."""


@dataclass(frozen=True)
class _Growth(Parameterization):
    """`<joint>.<kind>.growth`: growth of the link before a joint.

    The joint moves along the nominal way from the joint before it, by the length of
    that way times the growth times a function of the conditions; so does the tip, named
    after the fixed joint that carries it. The prior is as wide as the expected size.

    Attributes:
        function: Function of the conditions that the growth is multiplied by.
        unit: Unit of the growth.
        size: Its expected size.
    """

    function: BasisFunctions
    geometric = False
    requires = ("thermal",)
    unit: ClassVar[str]
    size: ClassVar[float]

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """A screw along the way to every joint and to the tip, per unit of growth."""
        return [
            Screw(
                Parameter(
                    f"{owner(joint)}.{self.kind}.growth",
                    self.unit,
                    self.size,
                    prior=self.size,
                ),
                frame,
                np.concatenate([link, np.zeros(3)]),
                BasisFunction(self.function, 0),
            )
            for frame, joint, link in _link_vectors(chain)
        ]


@dataclass(frozen=True)
class ThermalGrowth(_Growth):
    """`<joint>.thermal.growth`: growth by `temperature - reference`, see `_Growth`.

    No material grows ten times as much as expected.
    """

    name = "thermal"
    conditions: ClassVar[tuple[str, ...]] = ("temperature",)
    unit: ClassVar[str] = "1/K"
    size: ClassVar[float] = EXPANSION

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """The growth from the reference temperature of a setup."""
        reference = setup.thermal.reference
        return cls(_Warmth(REFERENCE if reference is None else reference))


@dataclass(frozen=True)
class WarmUp(_Growth):
    """`<joint>.warm-up.growth`: relative growth as a robot warms up, see `_Growth`.

    From the time t0 at which it was switched on a link lacks `growth exp((t0 - t) / T)`
    of the length that it has when it is warm. The geometry, and so the URDF, is that of
    the warm robot, as it is where no time is stated. To take another time for t0 only
    scales the growth.
    """

    name = "warm-up"
    conditions: ClassVar[tuple[str, ...]] = ("time",)
    unit: ClassVar[str] = "1"
    size: ClassVar[float] = WARMER * EXPANSION

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """The growth since the times of a setup."""
        since = tuple(sorted(setup.thermal.switched_on)) or (0.0,)
        return cls(_Coldness(since, setup.thermal.warm_up_time or WARM_UP))


def _link_vectors(chain: Chain) -> Iterator[tuple[int, str, Floats]]:
    """Frame, joint, and nominal way to it from the joint before in its own frame."""
    for k, (joint, placement) in enumerate(
        zip(chain.joints, chain.placements, strict=True)
    ):
        link = placement.translation
        if k == 0 and not chain.reversed[0]:
            link = link - chain.ends[0].translation
        if np.linalg.norm(link) > SHORTEST:
            yield k + 1, joint, placement.rotation.T @ link
    if chain.tip_joint is not None:
        link = chain.tip_placement.translation
        if np.linalg.norm(link) > SHORTEST:
            frame = len(chain.joints) + 1
            yield frame, chain.tip_joint, chain.tip_placement.rotation.T @ link


@dataclass(frozen=True)
class _Warmth:
    """The temperature from a reference on [K]; zero where it is not stated.

    Attributes:
        reference: Temperature at which the geometry holds [degC].
    """

    reference: float

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        if not len(conditions.temperature):
            return np.zeros((len(q), 1))
        return np.asarray(conditions.temperature[:, None] - self.reference)


@dataclass(frozen=True)
class _Coldness:
    """Minus one when a robot was switched on, and later zero; zero without a time.

    Attributes:
        since: Times at which it was switched on, ascending [s].
        constant: Time constant T [s].
    """

    since: tuple[float, ...]
    constant: float

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        if not len(conditions.time):
            return np.zeros((len(q), 1))
        since = passed(conditions.time, self.since)
        return np.asarray(-np.exp(-since / self.constant))[:, None]


def passed(time: Floats, since: Sequence[float]) -> Floats:
    """Time that has passed since a robot was last switched on, (N,) [s].

    Args:
        time: Times, shape (N,) [s].
        since: Times at which it was switched on, ascending [s].

    Examples:
        >>> passed(np.array([-1.0, 5.0, 30.0]), (0.0, 20.0)).tolist()
        [0.0, 5.0, 10.0]
    """
    last = np.searchsorted(since, time, side="right") - 1
    result = time - np.array(since)[np.maximum(last, 0)]
    return np.asarray(np.maximum(result, 0.0))
