"""A document's arrays, written and read; nothing in it is ever run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, TypeVar, cast, get_origin, get_type_hints

import numpy as np

from calib_pin.setup.arguments import Parser

LARGEST = 1e12
"""Largest number in a document: beyond, squares and products would overflow."""

_Part = TypeVar("_Part")


@dataclass(frozen=True)
class Array:
    """An array of numbers in a document, as the annotation of a field.

    Attributes:
        shape: Its shape, by numbers and by names of sizes.
        positive: Whether all numbers must be larger than zero.
        empty: Whether there may be none.
    """

    shape: str = ""
    positive: bool = False
    empty: bool = False

    def require(self, name: str, value: object, sizes: dict[str, int]) -> None:
        """Refuse numbers that are not such.

        Args:
            name: Their name, for messages.
            value: The numbers.
            sizes: Known sizes by name; the first array of another one tells it.

        Raises:
            ValueError: If they are not.
        """
        array, names = np.asarray(value), self.shape.split()
        known = {k: n for k, n in zip(names, array.shape, strict=False)} | sizes
        shape = tuple(int(k) if k.isdigit() else known.get(k) for k in names)
        if array.shape != shape or not (array.size or self.empty):
            want = self.shape or "that of one number"
            raise ValueError(f"'{name}' has the shape {array.shape}, not {want}")
        if not (np.abs(array) <= LARGEST).all():
            raise ValueError(f"'{name}' holds a number that is not finite or too large")
        if self.positive and not (array > 0.0).all():
            raise ValueError(f"'{name}' holds a number that is not positive")
        sizes |= known


def restored(
    kind: type[_Part], document: Mapping[str, Any], sizes: Mapping[str, int]
) -> _Part:
    """A dataclass of a document, by the annotations of its fields.

    Args:
        kind: The dataclass; arrays in it have an `Array`.
        document: The document.
        sizes: Known sizes by name.

    Raises:
        ValueError: If it is not one.
    """
    part = Parser(document=True).record(document, kind)
    _check(part, dict(sizes))
    return cast(_Part, part)


def _check(part: object, sizes: dict[str, int]) -> None:
    """Refuse arrays of a dataclass, and of those in it, that are not as annotated."""
    for name, hint in get_type_hints(type(part), include_extras=True).items():
        value = getattr(part, name)
        if is_dataclass(value):
            _check(value, dict(sizes))
        elif get_origin(hint) is Annotated:
            hint.__metadata__[0].require(name, value, sizes)


def written(part: object) -> Any:
    """The fields of a dataclass by name, as numbers, strings and lists."""
    if is_dataclass(part):
        return {each.name: written(getattr(part, each.name)) for each in fields(part)}
    if isinstance(part, np.ndarray):
        return part.tolist()
    return list(part) if isinstance(part, tuple) else part
