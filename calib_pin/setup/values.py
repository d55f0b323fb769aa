"""The numbers, texts and names that setups are made of, and what limits them.

The limits of a field stand in its annotation, and `arguments` takes values by them,
from a file as from Python: `Value` limits numbers, `OneOf` and `Family` names, a
function checks or changes what has been taken, and `Written` says how a file may write
it otherwise. Where a value cannot be used, a `ValueError` says what is allowed instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, dataclass_transform, get_args

from calib_pin.units import as_number

Triple = tuple[float, float, float]
Pair = tuple[float, float]

LARGEST_LENGTH = 100.0
"""Largest length that can be meant [m]; no instrument here measures farther."""

LARGEST_ANGLE = 4.0 * math.pi
"""Largest angle that can be meant [rad]: two turns, as far as joint counters go."""

LARGEST_ERROR = 0.02
"""Largest error of an instrument, and largest one that a robot may have, that can be
meant [m]: a ruler is better, and 0.05 stands for 0.05 mm."""

LARGEST_TURN = 0.05
"""The same of orientations [rad]: three degrees, so that 0.1 stands for degrees."""

SMALLEST = 1e-12
"""Smallest positive number that can be meant, such as a standard deviation [m, rad]."""

MOST = 100
"""Most rows or columns of a board."""


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Section:
    """Base of the sections of a setup file, which are frozen dataclasses."""

    def __init_subclass__(cls) -> None:
        """Declare the fields of a section."""
        dataclass(frozen=True)(cls)

    def _rules(self) -> Iterator[tuple[bool, str]]:
        """Whether keys fit together, and what is allowed instead."""
        yield from ()


REST = "*"
"""Stands for all keys of a section that are no fields."""


def number(value: object) -> float:
    """A finite number; one in quotes too, so that no one has to know YAML's rules.

    Raises:
        ValueError: If the value is not one; says what is allowed.
    """
    plain = as_number(value) if isinstance(value, str) else value
    if isinstance(plain, bool) or not isinstance(plain, float | int):
        raise ValueError("a number")
    # A JSON file may hold integers of any length.
    if not abs(plain) <= 1.7e308:
        raise ValueError("a finite number")
    return float(plain)


@dataclass(frozen=True, eq=False)  # Annotations are hashed, mappings cannot be.
class Value:
    """Limits of a number, or of every number in a list of fixed length.

    Attributes:
        unit: Unit of the numbers; empty if they have none, or several.
        least: Least value.
        most: Largest value.
        rising: Whether each must exceed the one before.
        shorter: Makes all numbers of fewer, by how many may be written instead; a
            single number may stand alone.
    """

    unit: str = ""
    least: float = -math.inf
    most: float = math.inf
    rising: bool = False
    shorter: Mapping[int, Callable[..., Sequence[float]]] = field(default_factory=dict)

    def parse(self, value: object, kind: Any) -> Any:
        """The number or numbers, as a type has them.

        Raises:
            ValueError: If they cannot be used; the message is what is allowed.
        """
        count = len(get_args(kind))
        value = value.tolist() if hasattr(value, "tolist") else value
        entries = value if count and isinstance(value, list | tuple) else [value]
        try:
            numbers = [number(entry) for entry in entries]
        except ValueError:
            numbers = []
        if (whole := self.shorter.get(len(numbers))) is not None:
            numbers = [*whole(*numbers)]
        fits = len(numbers) == max(count, 1)
        fits &= all(self.least <= entry <= self.most for entry in numbers)
        fits &= not self.rising or sorted(set(numbers)) == numbers
        if not fits or (kind is int and not numbers[0].is_integer()):
            raise ValueError(self.allowed(kind))
        return tuple(numbers) if count else kind(numbers[0])

    def allowed(self, kind: Any) -> str:
        """Allowed numbers, in words."""
        count, positive = len(get_args(kind)), self.least == SMALLEST
        noun = f"number{'s' if count else ''}{f' [{self.unit}]' if self.unit else ''}"
        which = "positive" if positive else "whole" if kind is int else "finite"
        words = [f"{count or 'a'} {which} {noun}"]
        for word, limit in (("least", self.least), ("most", self.most)):
            if math.isfinite(limit) and limit != SMALLEST:
                words.append(f"at {word} {limit:.6g}".replace("e+0", "e"))
        words += ["each larger than the one before"] * self.rising
        return ", ".join([*words, *(f"or {n} of them" for n in self.shorter)])


@dataclass(frozen=True)
class OneOf:
    """One of a few names or numbers."""

    values: tuple[str | int, ...]

    def __call__(self, value: Any) -> Any:
        """The name or number."""
        if value not in self.values:
            raise ValueError(", ".join(map(str, self.values)))
        return value


@dataclass(frozen=True)
class Family:
    """Names whose family stands above the setup; known where a file is read.

    Attributes:
        name: Name of the family.
        joined: Separator of several names in one text; empty for a single name.
    """

    name: str
    joined: str = ""


@dataclass(frozen=True)
class Written:
    """How a file may write a value otherwise than the setup has it.

    Attributes:
        kind: Type of what it may write.
        function: Makes the setup's value of it, and leaves that as it is.
    """

    kind: Any
    function: Callable[[Any], Any]


@dataclass(frozen=True)
class Check:
    """A condition that a value fulfills.

    Attributes:
        fits: Whether a value does.
        allowed: Values that do, in words.
    """

    fits: Callable[[Any], object]
    allowed: str

    def __call__(self, value: Any) -> Any:
        """The value."""
        if not self.fits(value):
            raise ValueError(self.allowed)
        return value


WORDS = Check(str.strip, "text (in quotes if it looks like something else)")
Text = Annotated[str, WORDS]
