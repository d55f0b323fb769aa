"""Checks of options that are numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields
from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np

from calib_pin.errors import OptionError


class Limits(NamedTuple):
    """Limits of a number.

    Attributes:
        kind: `Integral` or `Real`.
        least: Least value allowed.
        most: Largest value allowed.
        words: All this in words.
    """

    kind: type
    least: float
    most: float
    words: str


LIMIT = Limits(Integral, 1, np.inf, "a whole number, 1 or more")
"""A limit on something that is counted."""

FRACTION = Limits(Real, 0, 1, "0 to 1")
"""A part, or a probability."""

UP_TO_TWO = Limits(Real, np.nextafter(0.0, 1.0), 2, "more than 0, up to 2")
"""A factor of steps."""

TARGET = Limits(Real, -np.inf, np.finfo(float).max, "a number")
"""A cost to reach; minus infinity for none."""

TOLERANCE = Limits(Real, 0, np.inf, "0 or more")
"""A relative or absolute tolerance."""


class NumericOptions:
    """A dataclass of options, some of them numbers within limits, see `limited`.

    Raises:
        OptionError: If a number is not within its limits.
    """

    def __post_init__(self) -> None:
        """Check the numbers."""
        limits = {each.name: each.metadata for each in fields(self)}  # type: ignore[arg-type]
        stated = {k: v["limits"] for k, v in limits.items() if "limits" in v}
        require_numbers(vars(self), stated)


def limited(default: float, limits: Limits) -> Any:
    """A field of `NumericOptions` that is a number."""
    return field(default=default, metadata={"limits": limits})


def whole(least: int, most: int) -> Limits:
    """Limits of a whole number."""
    return Limits(Integral, least, most, f"a whole number, {least} to {most}")


def require_numbers(values: Mapping[str, object], limits: Mapping[str, Limits]) -> None:
    """Refuse numbers that are not within their limits.

    Args:
        values: Options by name; others than those with limits are not looked at.
        limits: Limits of those that are numbers.

    Raises:
        OptionError: Names the first option that cannot be used.
    """
    for name, (kind, least, most, words) in limits.items():
        value = values[name]
        # Here True is no number, and NaN is within no limits.
        number = isinstance(value, kind) and not isinstance(value, bool)
        if not number or not least <= value <= most:  # type: ignore[operator]
            raise OptionError(f"{name} cannot be used", value=value, allowed=words)
