"""Values that setup files are made of, for pydantic.

Every check raises a `ValueError` whose message is what is allowed instead. pydantic is
slow to import; import this module where a file is read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, PlainValidator, model_validator

from calib_pin.io.columns import ANGLE, LENGTH
from calib_pin.io.yaml_tree import as_number

__all__ = [
    "Angles",
    "Flag",
    "Length",
    "Number",
    "Position",
    "Positive",
    "Section",
    "Text",
    "number",
    "numbers",
    "positive",
]

Triple = tuple[float, float, float]

SMALLEST = 1e-12
"""Smallest standard deviation that can be meant [m, rad]."""


def number(value: object) -> float:
    """A finite number."""
    # Numbers in quotes are numbers too, so that no one has to know YAML's rules.
    plain = as_number(value) if isinstance(value, str) else value
    if isinstance(plain, bool) or not isinstance(plain, float | int):
        raise ValueError("a number")
    try:
        plain = float(plain)
    except OverflowError:  # A JSON file may hold integers of any length.
        plain = math.inf
    if not math.isfinite(plain):
        raise ValueError("a finite number")
    return plain


def positive(value: object) -> float:
    """A positive number."""
    plain = number(value)
    if plain <= 0.0:
        raise ValueError("a positive number")
    if plain < SMALLEST:
        raise ValueError(f"a number of at least {SMALLEST:g}")
    return plain


def _length(value: object) -> float:
    length = positive(value)
    if length > LENGTH.largest:
        raise ValueError(f"a length in m, at most {LENGTH.largest:g}")
    return length


def _text(value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError("text (in quotes if it looks like something else)")
    return value


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true, false")
    return value


def numbers(value: object, count: int, allowed: str) -> tuple[float, ...]:
    """A list of so many finite numbers."""
    if not isinstance(value, list) or len(value) != count:
        raise ValueError(allowed)
    try:
        return tuple(map(number, value))
    except ValueError:
        raise ValueError(allowed) from None


def _position(value: object) -> Triple:
    allowed = "three finite numbers in m, such as [0, 0, 0.1]"
    x, y, z = numbers(value, 3, allowed)
    if max(map(abs, (x, y, z))) > LENGTH.largest:
        raise ValueError(allowed)
    return x, y, z


def _angles(value: object) -> Triple:
    allowed = "three finite numbers in rad, such as [0, 0, 1.57]"
    roll, pitch, yaw = numbers(value, 3, allowed)
    if max(map(abs, (roll, pitch, yaw))) > ANGLE.largest:
        raise ValueError(allowed)
    return roll, pitch, yaw


Number = Annotated[float, PlainValidator(number)]
Positive = Annotated[float, PlainValidator(positive)]
Length = Annotated[float, PlainValidator(_length)]
Text = Annotated[str, PlainValidator(_text)]
Flag = Annotated[bool, PlainValidator(_flag)]
Position = Annotated[Triple, PlainValidator(_position)]
Angles = Annotated[Triple, PlainValidator(_angles)]


class Section(BaseModel):
    """A mapping with known keys; a key without a value counts as not written."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _drop_empty(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        return {
            key: value
            for key, value in data.items()
            if value is not None or key not in cls.model_fields
        }
