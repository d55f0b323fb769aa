"""Checks of options that are numbers."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Integral, Real
from typing import NamedTuple

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

TARGET = Limits(Real, -np.inf, np.finfo(float).max, "a number")
"""A cost to reach; minus infinity for none."""

TOLERANCE = Limits(Real, 0, np.inf, "0 or more")
"""A relative or absolute tolerance."""


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
