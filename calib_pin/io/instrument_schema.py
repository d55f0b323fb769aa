"""What a setup file may say about what is measured against, for pydantic.

Every check raises a `ValueError` whose message is what is allowed instead. pydantic is
slow to import; import this module where a file is read.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import PlainValidator, model_validator

from calib_pin.io.columns import LENGTH
from calib_pin.io.schema_values import (
    Flag,
    Length,
    Position,
    Positive,
    Section,
    number,
    numbers,
    positive,
)
from calib_pin.setup import AnchorSetup, CameraSetup, DistanceSetup

__all__ = [
    "AnchorSection",
    "CameraSection",
    "DistanceSection",
    "NoiseSection",
    "PlaneSection",
    "PointSection",
    "SphereSection",
]

Pair = tuple[float, float]
Distortion = tuple[float, float, float, float, float]

STEEPEST = 1e6
"""Largest length of a normal, and the inverse of the smallest."""

WIDEST = 1e5
"""Largest focal length, image, and coefficient of a distortion [px]."""

BLURRED = 1e3
"""Largest standard deviation of a pixel [px]."""

COEFFICIENTS = (2, 4, 5)
"""Numbers of coefficients that a distortion can have; the others are zero."""


def _normal(value: object) -> tuple[float, float, float]:
    allowed = "three finite numbers that are not all 0, such as [0, 0, 1]"
    x, y, z = numbers(value, 3, allowed)
    if not 1.0 / STEEPEST <= math.hypot(x, y, z) <= STEEPEST:
        raise ValueError(allowed)
    return x, y, z


def _offset(value: object) -> float:
    plain = number(value)
    if abs(plain) > LENGTH.largest * STEEPEST:
        raise ValueError("the offset f of n . p + f = 0, in m where n has length 1")
    return plain


def _bias(value: object) -> float:
    plain = number(value)
    if abs(plain) > LENGTH.largest:
        raise ValueError(f"a length in m, at most {LENGTH.largest:g} either way")
    return plain


def _mount(value: object) -> str:
    if value not in ("hand", "world"):
        raise ValueError("hand, world")
    return str(value)


def _pixels(value: object, allowed: str) -> Pair:
    x, y = numbers(value, 2, allowed)
    if max(abs(x), abs(y)) > WIDEST:
        raise ValueError(allowed)
    return x, y


def _extent(value: object, allowed: str) -> Pair:
    x, y = _pixels(value, allowed)
    if min(x, y) <= 0.0:
        raise ValueError(allowed)
    return x, y


def _focal(value: object) -> Pair:
    return _extent(value, "[f_x, f_y], both positive and in px, such as [1200, 1200]")


def _center(value: object) -> Pair:
    return _pixels(value, "[c_x, c_y] in px, such as [639.5, 479.5]")


def _size(value: object) -> Pair:
    return _extent(value, "[width, height], both positive and in px")


def _distortion(value: object) -> Distortion:
    allowed = "[k_1, k_2, p_1, p_2, k_3], or the first two or four of them"
    if not isinstance(value, list) or len(value) not in COEFFICIENTS:
        raise ValueError(allowed)
    found = numbers(value, len(value), allowed)
    if max(map(abs, found)) > WIDEST:
        raise ValueError(allowed)
    k_1, k_2, p_1, p_2, k_3 = (*found, 0.0, 0.0, 0.0)[:5]
    return k_1, k_2, p_1, p_2, k_3


def _between(value: object) -> tuple[str, str]:
    allowed = (
        "two different names, such as [front/0, front/1] (in quotes if they look like "
        "something else)"
    )
    names = value if isinstance(value, list) else []
    text = all(isinstance(name, str) and name.strip() for name in names)
    if not text or len(names) != 2 or names[0] == names[1]:
        raise ValueError(allowed)
    return names[0], names[1]


def _blur(value: object) -> float:
    sigma = positive(value)
    if sigma > BLURRED:
        raise ValueError(f"a standard deviation in px, at most {BLURRED:g}")
    return sigma


class PlaneSection(Section):
    """A member of `planes`."""

    normal: Annotated[tuple[float, float, float], PlainValidator(_normal)]
    offset: Annotated[float, PlainValidator(_offset)]
    estimate: Flag = True


class PointSection(Section):
    """A member of `targets` or `sockets`."""

    xyz: Position | None = None
    estimate: Flag | None = None

    @model_validator(mode="after")
    def _check_known(self) -> Self:
        if self.estimate is False and self.xyz is None:
            raise ValueError("estimate: false only together with xyz")
        return self


class SphereSection(Section):
    """A member of `spheres`."""

    xyz: Position | None = None
    radius: Length | None = None
    estimate: Flag = True
    estimate_radius: Flag | None = None

    @model_validator(mode="after")
    def _check_known(self) -> Self:
        if not self.estimate and self.xyz is None:
            raise ValueError("estimate: false only together with xyz")
        if self.estimate_radius is False and self.radius is None:
            raise ValueError("estimate_radius: false only together with radius")
        return self


class AnchorSection(Section):
    """A member of `anchors`."""

    xyz: Position | None = None
    bias: Annotated[float, PlainValidator(_bias)] = AnchorSetup.bias
    estimate: Flag = True
    estimate_bias: Flag = False

    @model_validator(mode="after")
    def _check_known(self) -> Self:
        if not self.estimate and self.xyz is None:
            raise ValueError("estimate: false only together with xyz")
        return self


class CameraSection(Section):
    """`camera`."""

    mount: Annotated[Literal["hand", "world"], PlainValidator(_mount)]
    focal: Annotated[Pair, PlainValidator(_focal)]
    center: Annotated[Pair, PlainValidator(_center)]
    distortion: Annotated[Distortion, PlainValidator(_distortion)] = (
        CameraSetup.distortion
    )
    size: Annotated[Pair, PlainValidator(_size)] | None = None
    estimate: Flag = CameraSetup.estimate


class DistanceSection(Section):
    """A member of `distances`."""

    between: Annotated[tuple[str, str], PlainValidator(_between)]
    value: Length
    sigma: Length = DistanceSetup.sigma


class NoiseSection(Section):
    """`noise`."""

    position: Positive | None = None
    orientation: Positive | None = None
    distance: Positive | None = None
    contact: Positive | None = None
    pixel: Annotated[float, PlainValidator(_blur)] | None = None
