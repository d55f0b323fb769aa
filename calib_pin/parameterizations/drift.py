"""Instruments that drift in the course of the measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.parameterizations.base import (
    COMPONENTS,
    BasisFunction,
    Parameterization,
    Screw,
)
from calib_pin.parameters import Parameter
from calib_pin.setup import DriftSetup, Setup

INCREMENTS = 8
"""Increments of a drift, each in an equal part of its time."""

USUAL = 1e-4
"""Standard deviation of a drift where none is stated [m, rad]."""


@dataclass(frozen=True)
class InstrumentDrift(Parameterization):
    """`<station>.instrument-drift.x1..rz8`: increments of the place of an instrument.

    The base link wanders in the measurement frame by a random walk: a twist that grows
    evenly within each of eight equal parts of the time and stands still before and
    after. Its increments are independent, and so are their priors. They are nuisances,
    as the frame of the station is: they say nothing of the robot, and a URDF lacks
    nothing of them.

    Attributes:
        drift: The time of the drift, that of the station `base`, and its size; without
            a time there is none.
    """

    drift: DriftSetup = field(default_factory=DriftSetup)
    name = "instrument-drift"
    requires = ("drift",)
    conditions: ClassVar[tuple[str, ...]] = ("time",)

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """The drift that a setup states."""
        return cls(setup.drift)

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Six screws in the frame of the base for every increment."""
        span = self.drift.spans.get("base")
        if span is None:
            return []
        functions = _Ramps(*span)
        sizes = (self.drift.shift, self.drift.turn)
        of_walk = [USUAL if size is None else size for size in sizes]
        increments = np.array(of_walk) / np.sqrt(INCREMENTS)
        return [
            Screw(
                Parameter(
                    f"base.{self.kind}.{component}{part + 1}",
                    "m" if k < 3 else "rad",
                    float(increments[k // 3]),
                    nuisance=True,
                    prior=float(increments[k // 3]),
                ),
                0,
                np.eye(6)[k],
                BasisFunction(functions, part),
            )
            for k, component in enumerate(COMPONENTS)
            if increments[k // 3] > 0.0
            for part in range(INCREMENTS)
        ]


@dataclass(frozen=True)
class _Ramps:
    """Part of each increment that is past; nothing where no time is stated."""

    first: float
    last: float

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        if not len(conditions.time):
            return np.zeros((len(q), INCREMENTS))
        past = (conditions.time - self.first) / (self.last - self.first)
        parts = INCREMENTS * past[:, None] - np.arange(INCREMENTS)
        return np.asarray(np.clip(parts, 0.0, 1.0))
