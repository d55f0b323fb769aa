"""The numbers, texts and flags that setups are made of, with their constraints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from calib_pin.setup.constraints import Checked, Constraint, Json, listed
from calib_pin.units import as_number

Triple = tuple[float, float, float]
Pair = tuple[float, float]

LARGEST_LENGTH = 100.0
"""Largest length that can be meant [m]; no instrument here measures farther."""

LARGEST_ANGLE = 4.0 * math.pi
"""Largest angle that can be meant [rad]: two turns, as far as joint counters go."""

SMALLEST = 1e-12
"""Smallest standard deviation that can be meant [m, rad]."""


def number(value: object) -> float:
    """A finite number.

    Raises:
        ValueError: If the value is not one; says what is allowed.
    """
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
    """A positive number.

    Raises:
        ValueError: If the value is not one; says what is allowed.
    """
    plain = number(value)
    if plain <= 0.0:
        raise ValueError("a positive number")
    if plain < SMALLEST:
        raise ValueError(f"a number of at least {SMALLEST:g}")
    return plain


@dataclass(frozen=True)
class Number(Constraint):
    """A finite number within limits.

    Attributes:
        unit: Unit of the number; empty if pure.
        above: Limit that it must exceed.
        least: Least value.
        most: Largest value.
        below: Limit that it must stay under.
        words: Allowed values, for the message on a number beyond its limits.
        apart: Distance from 0 that it must have; 0 is allowed where there is none.
    """

    unit: str = ""
    above: float = -math.inf
    least: float = -math.inf
    most: float = math.inf
    below: float = math.inf
    words: str = ""
    apart: float = 0.0

    def check(self, value: object) -> float:
        """The number."""
        plain = number(value)
        within = self.above < plain < self.below and self.least <= plain <= self.most
        within &= abs(plain) >= self.apart
        if not within:
            raise ValueError(self.words)
        return plain

    def schema(self) -> Json:
        """A number with its limits."""
        found = _number(self.above, self.least, self.most, self.below)
        if self.apart:
            found["not"] = _number(above=-self.apart, below=self.apart)
        return _with_unit(found, self.unit)


@dataclass(frozen=True)
class Positive(Constraint):
    """A positive number.

    Attributes:
        unit: Unit of the number; empty if pure, or if the name says it.
        most: Largest value.
        words: Allowed values, for the message on a larger number.
        always: Whether the words answer every other wrong value as well.
    """

    unit: str = ""
    most: float = math.inf
    words: str = ""
    always: bool = False

    def check(self, value: object) -> float:
        """The number."""
        try:
            plain = positive(value)
        except ValueError as error:
            raise ValueError(self.words if self.always else error) from None
        if plain > self.most:
            raise ValueError(self.words)
        return plain

    def schema(self) -> Json:
        """A number above 0."""
        return _with_unit(_number(above=0.0, most=self.most), self.unit)


@dataclass(frozen=True)
class Vector(Constraint):
    """A list of finite numbers.

    Attributes:
        count: How many.
        words: Allowed values, for the message on any other value.
        unit: Unit of the numbers; empty if they have none, or several.
        above: Limit that each must exceed.
        least: Least value of each.
        limit: Largest absolute value of each.
        rising: Whether each must exceed the one before.
        norm: Least and largest Euclidean norm.
        shorter: Numbers of components that may be written instead; 0 for the rest.
        scalar: List that a single number stands for, given the number.
    """

    count: int
    words: str
    unit: str = ""
    above: float = -math.inf
    least: float = -math.inf
    limit: float = math.inf
    rising: bool = False
    norm: Pair = (0.0, math.inf)
    shorter: tuple[int, ...] = ()
    scalar: Callable[[object], list[object]] | None = None

    def check(self, value: object) -> tuple[float, ...]:
        """The numbers."""
        if self.scalar is not None and not isinstance(value, list):
            value = self.scalar(value)
        counts = (self.count, *self.shorter)
        if not isinstance(value, list) or len(value) not in counts:
            raise ValueError(self.words)
        try:
            found = tuple(map(number, value))
        except ValueError:
            raise ValueError(self.words) from None
        within = self.above < min(found) and self.least <= min(found)
        within &= max(map(abs, found)) <= self.limit
        shortest, longest = self.norm
        if not within or not shortest <= math.hypot(*found) <= longest:
            raise ValueError(self.words)
        if self.rising and sorted(set(found)) != list(found):
            raise ValueError(self.words)
        return found + (0.0,) * (self.count - len(found))

    def schema(self) -> Json:
        """A list of so many numbers, or what stands for it."""
        least = max(self.least, -self.limit)
        entry = _number(self.above, least, self.limit)
        found = listed(entry, self.count, min((self.count, *self.shorter)))
        if self.scalar is not None:
            found = {"anyOf": [entry, found]}
        return _with_unit(found, self.unit)


@dataclass(frozen=True)
class OneOf(Constraint):
    """One of a few names, or of a few numbers.

    Attributes:
        values: All that are allowed.
    """

    values: tuple[str | int, ...]

    def check(self, value: object) -> str | int:
        """The name or number."""
        if isinstance(self.values[0], int):
            value = number(value)
        if not isinstance(value, str | float) or value not in self.values:
            raise ValueError(", ".join(map(str, self.values)))
        return self.values[self.values.index(value)]

    def schema(self) -> Json:
        """The allowed names or numbers."""
        return {"enum": list(self.values)}


def _number(
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    below: float = math.inf,
) -> Json:
    """The JSON schema of a number within limits, of which the infinite are none."""
    limits = {
        "exclusiveMinimum": above,
        "minimum": least,
        "maximum": most,
        "exclusiveMaximum": below,
    }
    finite = {key: limit for key, limit in limits.items() if math.isfinite(limit)}
    return {"type": "number", **finite}


def _with_unit(schema: Json, unit: str) -> Json:
    return {**schema, "unit": unit} if unit else schema


MOST = 100
"""Most rows or columns of a board."""


def _count(value: object) -> int:
    plain = number(value)
    if not (1 <= plain <= MOST and plain.is_integer()):
        raise ValueError(f"a whole number from 1 to {MOST}")
    return int(plain)


def _text(value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError("text (in quotes if it looks like something else)")
    return value


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true, false")
    return value


Length = Annotated[
    float, Positive("m", LARGEST_LENGTH, f"a length in m, at most {LARGEST_LENGTH:g}")
]
Position = Annotated[
    Triple,
    Vector(
        3, "three finite numbers in m, such as [0, 0, 0.1]", "m", limit=LARGEST_LENGTH
    ),
]
Angles = Annotated[
    Triple,
    Vector(
        3,
        "three finite numbers in rad, such as [0, 0, 1.57]",
        "rad",
        limit=LARGEST_ANGLE,
    ),
]
Count = Annotated[
    int, Checked(_count, {"type": "integer", "minimum": 1, "maximum": MOST})
]
Text = Annotated[str, Checked(_text, {"type": "string", "minLength": 1})]
Flag = Annotated[bool, Checked(_flag, {"type": "boolean"})]
