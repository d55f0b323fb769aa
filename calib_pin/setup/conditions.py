"""Effects of the conditions of measurements on a robot and an instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from calib_pin.setup.constraints import Section
from calib_pin.setup.values import Number, Pair, Position, Positive, Text, Vector

HEAVIEST = 1e5
"""Largest mass of a payload [kg]; more comes from a mistaken unit."""

COLDEST, HOTTEST = -100.0, 200.0
"""Temperatures that a robot can have [degC]."""

Temperature = Annotated[
    float,
    Number(
        "degC",
        least=COLDEST,
        most=HOTTEST,
        words=f"a temperature in degC from {COLDEST:g} to {HOTTEST:g}",
    ),
]


@dataclass(frozen=True)
class Payload(Section):
    """A payload of the robot.

    Attributes:
        mass: Mass [kg].
        com: Center of mass in the tip frame [m].
    """

    mass: Annotated[
        float,
        Positive(
            "kg",
            HEAVIEST,
            f"a mass in kg, more than 0 and at most {HEAVIEST:g}",
            always=True,
        ),
    ]
    com: Position


@dataclass(frozen=True)
class ThermalSetup(Section):
    """How links grow with the temperature: for the parameters `thermal`, `warm-up`.

    Attributes:
        reference: Temperature at which the geometry holds [degC]; None for the mean of
            the measurements.
        materials: Names or globs of joints by the name of a material: the links before
            these joints, and to a tip on such a fixed joint, grow alike.
        switched_on: Times since which the robot grows warm [s]; empty for that of the
            first measurement.
        warm_up_time: Time in which it covers 63 % of the way from cold to warm [s];
            None for that which suits the measurements best.
    """

    reference: Temperature | None = None
    materials: Mapping[str, tuple[Text, ...]] = field(default_factory=dict)
    switched_on: tuple[Annotated[float, Number("s")], ...] = ()
    warm_up_time: Annotated[float, Positive("s")] | None = None


Span = Annotated[
    Pair, Vector(2, "[first, last] in s with first < last", "s", rising=True)
]


@dataclass(frozen=True)
class DriftSetup(Section):
    """How instruments drift, for the parameters `instrument-drift`.

    What is not stated is found in the measurements.

    Attributes:
        spans: First and last time between which an instrument drifts [s], by the name
            of its station; `base` is that of the only one.
        shift: Standard deviation of what it has shifted by then along each axis [m]; 0
            where it does not shift.
        turn: The same of its turn about each axis [rad].
    """

    spans: Mapping[str, Span] = field(default_factory=dict)
    shift: (
        Annotated[float, Number("m", least=0.0, words="a length in m, 0 or more")]
        | None
    ) = None
    turn: (
        Annotated[float, Number("rad", least=0.0, words="an angle in rad, 0 or more")]
        | None
    ) = None


@dataclass(frozen=True)
class ConditionSetup(Section):
    """Statements about the effects of temperature and time.

    Attributes:
        thermal: How links grow with the temperature.
        drift: How instruments drift in the course of time.
    """

    thermal: ThermalSetup = field(default_factory=ThermalSetup)
    drift: DriftSetup = field(default_factory=DriftSetup)
