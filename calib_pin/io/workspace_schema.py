"""What a setup file may say about where the robot may measure, for pydantic.

Every check raises a `ValueError` whose message is what is allowed instead. pydantic is
slow to import; import this module where a file is read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import PlainValidator, model_validator

from calib_pin.io.columns import ANGLE, LENGTH
from calib_pin.io.schema_values import (
    Angles,
    Length,
    Position,
    Section,
    Text,
    number,
    numbers,
    positive,
)
from calib_pin.setup import Cone, Obstacle, RangerSetup, Region

__all__ = ["REGION", "Limits", "ObstacleSection", "RangerSection", "RegionSection"]

Triple = tuple[float, float, float]
Pair = tuple[float, float]


def _lengths(value: object, count: int, allowed: str) -> tuple[float, ...]:
    lengths = numbers(value, count, allowed)
    if not 0.0 < min(lengths) <= max(lengths) <= LENGTH.largest:
        raise ValueError(allowed)
    return lengths


def _edges(value: object) -> tuple[float, ...]:
    return _lengths(value, 3, "three positive lengths in m, such as [1, 1, 0.02]")


def _cylinder(value: object) -> tuple[float, ...]:
    return _lengths(value, 2, "[radius, length], both positive and in m")


def _scale(value: object) -> Triple:
    allowed = "a positive number, or three of them, such as 0.001 for a mesh in mm"
    try:
        x, y, z = map(positive, value if isinstance(value, list) else [value] * 3)
    except ValueError:
        raise ValueError(allowed) from None
    return x, y, z


def _corners(value: object) -> tuple[Triple, Triple]:
    allowed = (
        "[lower, upper], two corners of three numbers in m, such as "
        "[[0.2, -0.5, 0.1], [1, 0.5, 1.2]]"
    )
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(allowed)
    (a, b, c), (x, y, z) = (numbers(corner, 3, allowed) for corner in value)
    largest = max(map(abs, (a, b, c, x, y, z)))
    if not (a < x and b < y and c < z and largest <= LENGTH.largest):
        raise ValueError(allowed)
    return (a, b, c), (x, y, z)


def _direction(value: object) -> Triple:
    allowed = "three finite numbers that are not all 0, such as [0, 0, 1]"
    x, y, z = numbers(value, 3, allowed)
    if not 0.0 < math.hypot(x, y, z) < math.inf:
        raise ValueError(allowed)
    return x, y, z


def _opening(value: object) -> float:
    angle = number(value)
    if not 0.0 < angle <= math.pi:
        raise ValueError("half the opening angle in rad, above 0 and at most 3.14")
    return angle


def _range(value: object) -> Pair:
    allowed = "the farthest distance in m, or [nearest, farthest]"
    written = value if isinstance(value, list) else [0.0, value]
    near, far = numbers(written, 2, allowed)
    if not 0.0 <= near < far <= LENGTH.largest:
        raise ValueError(allowed)
    return near, far


def _incidence(value: object) -> float:
    angle = number(value)
    if not 0.0 < angle < math.pi / 2:
        raise ValueError("an angle to the normal in rad, above 0 and below 1.57")
    return angle


def _limits(value: object) -> Pair:
    allowed = "[lower, upper] in rad or m with lower < upper"
    lower, upper = numbers(value, 2, allowed)
    # Degrees would leave a joint as free as it was, without a word.
    if not -ANGLE.largest <= lower < upper <= ANGLE.largest:
        raise ValueError(f"{allowed}, at most {ANGLE.largest:.4g}")
    return lower, upper


Limits = Annotated[Pair, PlainValidator(_limits)]
Range = Annotated[Pair, PlainValidator(_range)]


class ObstacleSection(Section):
    """A member of `obstacles`."""

    box: Annotated[tuple[float, ...], PlainValidator(_edges)] | None = None
    sphere: Length | None = None
    cylinder: Annotated[tuple[float, ...], PlainValidator(_cylinder)] | None = None
    mesh: Text | None = None
    scale: Annotated[Triple, PlainValidator(_scale)] | None = None
    xyz: Position = Obstacle.xyz
    rpy: Angles = Obstacle.rpy

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        kinds = (self.box, self.sphere, self.cylinder, self.mesh)
        if sum(kind is not None for kind in kinds) != 1:
            raise ValueError("exactly one of box, sphere, cylinder, mesh")
        if self.scale is not None and self.mesh is None:
            raise ValueError("a scale only together with a mesh")
        return self

    def setup(self) -> Obstacle:
        """The same as plain data."""
        kind: Literal["box", "sphere", "cylinder", "mesh"] = "mesh"
        size: tuple[float, ...] = self.scale or (1.0, 1.0, 1.0)
        if self.box is not None:
            kind, size = "box", self.box
        elif self.sphere is not None:
            kind, size = "sphere", (self.sphere,)
        elif self.cylinder is not None:
            kind, size = "cylinder", self.cylinder
        return Obstacle(kind, size, self.mesh or "", self.xyz, self.rpy)


class SphereSection(Section):
    """`region.sphere`."""

    center: Position
    radius: Length


class ConeSection(Section):
    """`region.cone`."""

    apex: Position
    axis: Annotated[Triple, PlainValidator(_direction)]
    angle: Annotated[float, PlainValidator(_opening)]
    range: Range


class RegionSection(Section):
    """`region`."""

    box: Annotated[tuple[Triple, Triple], PlainValidator(_corners)] | None = None
    sphere: SphereSection | None = None
    cone: ConeSection | None = None

    @model_validator(mode="after")
    def _check_shape(self) -> Self:
        if self.box is None and self.sphere is None and self.cone is None:
            raise ValueError("at least one of box, sphere, cone")
        return self

    def setup(self) -> Region:
        """The same as plain data."""
        sphere, cone = self.sphere, self.cone
        return Region(
            box=self.box,
            sphere=None if sphere is None else (sphere.center, sphere.radius),
            cone=None if cone is None else Cone(**dict(cone)),
        )


class RangerSection(Section):
    """`ranger`."""

    range: Range = RangerSetup.range
    incidence: Annotated[float, PlainValidator(_incidence)] = RangerSetup.incidence


REGION: Mapping[str | int, type[Section]] = {
    "sphere": SphereSection,
    "cone": ConeSection,
}
"""The sections inside `region`."""
