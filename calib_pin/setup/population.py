"""The prior of a robot by others of its type, or by an older calibration of it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

from calib_pin.errors import enumerated

SAME = 1e-6
"""Largest difference of nominal geometries that count as one [m], and as parts of unit
vectors: what is left of numbers that were printed with seven digits."""

Row = tuple[float, ...]

PoseSizes = tuple[float, float]
"""Sizes of a position [m] and of an orientation [rad]."""


@dataclass(frozen=True)
class JointType:
    """The nominal geometry of a joint.

    Attributes:
        name: Name of the joint.
        axis: Unit axis in the joint frame.
        placement: Pose of the joint frame in that of the joint before it, the first
            three rows of the homogeneous matrix row by row [m]; empty for the first
            joint, before which a base frame may be anywhere.
    """

    name: str
    axis: Row
    placement: Row


@dataclass(frozen=True)
class RobotType:
    """By which robots of one type are recognized, whatever their files look like.

    Attributes:
        name: Name of the robot, for messages.
        joints: The joints of all chains.
    """

    name: str
    joints: tuple[JointType, ...]

    def difference(self, other: RobotType) -> str:
        """How another robot differs in a few words; empty for one of this type."""
        here, there = ([joint.name for joint in of.joints] for of in (self, other))
        if here != there:
            return f"its joints are {enumerated(map(repr, there))}"
        for first, second in zip(self.joints, other.joints, strict=True):
            for word in ("axis", "placement"):
                numbers: list[Row] = [getattr(first, word), getattr(second, word)]
                apart = [abs(a - b) for a, b in zip(*numbers, strict=False)]
                if len({*map(len, numbers)}) > 1 or not max(apart, default=0) <= SAME:
                    return f"its joint '{first.name}' has another nominal {word}"
        return ""


@dataclass(frozen=True)
class ExpectedParameter:
    """The value that an error parameter is expected to have.

    Attributes:
        name: Name of the parameter.
        unit: Its unit.
        mean: The most likely value.
    """

    name: str
    unit: str
    mean: float


@dataclass(frozen=True)
class ParameterPrior(ExpectedParameter):
    """An error parameter over the robots of a type; its mean is theirs.

    Attributes:
        sigma: Standard deviation of the mean, as far as it is known.
        spread: Standard deviation among robots.
        robots: Number of robots that the spread is known from: one counts in full that
            tells the parameter without error; 0 where no robot tells anything.
    """

    sigma: float
    spread: float
    robots: float


@dataclass(frozen=True)
class JointPrior:
    """A normal prior of all errors of a robot together.

    Attributes:
        robot: The type of the robot.
        parameters: What is expected of every parameter, P of them.
        covariance: Of the errors about their means, shape (P, P).
        noise: Standard deviation of the measurements by quantity; it counts as stated
            where nobody states another one.
        file: Where it was read from, for messages.
        unmodeled: Errors of the tool that no parameter describes, by chain: where it
            was measured, and over the workspace.
    """

    robot: RobotType
    parameters: tuple[ExpectedParameter, ...]
    covariance: tuple[Row, ...]
    noise: Mapping[str, float] = field(default_factory=dict)
    file: str = field(default="", metadata={"key": None})
    unmodeled: Mapping[str, tuple[PoseSizes, PoseSizes]] = field(
        default_factory=dict, metadata={"key": None}
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(parameter.name for parameter in self.parameters)

    def deviations(self, names: Collection[str]) -> Iterator[tuple[str, float]]:
        """Names and standard deviations of those of its parameters that are named."""
        for k, name in enumerate(self.names):
            if name in names:
                yield name, self.covariance[k][k] ** 0.5


@dataclass(frozen=True)
class PopulationPrior(JointPrior):
    """A normal prior of the errors of the next robot of a type.

    Its covariance holds the spreads, and what is unknown of these and of the means; its
    noise is the median of the robots.

    Attributes:
        robots: Number of robots that it was made from.
        parameters: Mean and spread of every parameter.
    """

    parameters: tuple[ParameterPrior, ...]
    robots: int = field(kw_only=True)
