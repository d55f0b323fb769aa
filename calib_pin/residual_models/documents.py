"""A document's values, written and read; nothing in it is ever run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from calib_pin.kinematics.spatial import Floats

LARGEST = 1e12
"""Largest number in a document: beyond, squares and products would overflow."""

MOST = 4_000_000
"""Most numbers in one array of a document."""


MADE: Mapping[Any, Callable[[Floats], Any]] = {float: float, tuple[float, float]: tuple}
"""Values of numbers that are no arrays, by their type."""

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


def restored(
    kind: type[_Part],
    document: object,
    what: str,
    sizes: Mapping[str, int],
    **known: object,
) -> _Part:
    """A dataclass of a document, by the annotations of its fields.

    Args:
        kind: The dataclass; its fields are dataclasses, or have an `Array`.
        document: The document.
        what: Name of the document.
        sizes: Known sizes by name; the first array of another one tells it.
        known: Values that are known.

    Raises:
        ValueError: If it is not one.
    """
    parts, sizes = checked(document, what), dict(sizes)
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if is_dataclass(hint):
            known[name] = restored(hint, parts.get(name), name, sizes)  # type: ignore[arg-type]
        elif get_origin(hint) is Annotated:
            made, array = get_args(hint)
            names = array.shape.split()
            shape = tuple(int(k) if k.isdigit() else sizes.get(k) for k in names)
            allowed = {"positive": array.positive, "empty": array.empty}
            found = numbers(parts, name, shape, **allowed)
            sizes |= zip(names, found.shape, strict=True)
            known[name] = MADE.get(made, np.asarray)(found)
    return kind(**known)


def written(part: object) -> Any:
    """The fields of a dataclass by name, as numbers, strings and lists."""
    if is_dataclass(part):
        return {each.name: written(getattr(part, each.name)) for each in fields(part)}
    if isinstance(part, np.ndarray):
        return part.tolist()
    return list(part) if isinstance(part, tuple) else part


def checked(document: object, what: str) -> Mapping[str, Any]:
    """A part of a document that must be a mapping.

    Raises:
        ValueError: If it is not.
    """
    if not isinstance(document, Mapping):
        raise ValueError(f"'{what}' is not a mapping")
    return document


def stated(document: Mapping[str, Any], key: str, allowed: Sequence[str]) -> str:
    """A word of a document.

    Raises:
        ValueError: If it is missing or not one of those allowed.
    """
    found = document.get(key)
    if not isinstance(found, str) or found not in allowed:
        raise ValueError(f"'{key}' is not one of {', '.join(allowed)}")
    return found


def numbers(
    document: Mapping[str, Any],
    key: str,
    shape: tuple[int | None, ...],
    *,
    positive: bool = False,
    empty: bool = False,
) -> Floats:
    """An array of a document.

    Args:
        document: The document.
        key: Key of the array.
        shape: Its shape; None is any length.
        positive: Whether all numbers must be larger than zero.
        empty: Whether there may be none.

    Raises:
        ValueError: If it is missing or anything else.
    """
    if key not in document:
        raise ValueError(f"'{key}' is missing")
    try:
        found = np.asarray(document[key])
    except (ValueError, OverflowError):
        raise ValueError(f"'{key}' is not an array of numbers") from None
    if found.dtype.kind not in "iuf" and found.size:
        raise ValueError(f"'{key}' is not an array of numbers")
    fits = found.ndim == len(shape) and all(
        want is None or have == want
        for have, want in zip(found.shape, shape, strict=True)
    )
    if not fits or not (found.size or empty):
        want = " x ".join("any" if k is None else str(k) for k in shape) or "one number"
        raise ValueError(f"'{key}' has the shape {found.shape}, not {want}")
    if found.size > MOST:
        raise ValueError(f"'{key}' holds {found.size} numbers, more than {MOST}")
    result = found.astype(float)
    if not (np.abs(result) <= LARGEST).all():
        raise ValueError(f"'{key}' holds a number that is not finite or too large")
    if positive and not (result > 0.0).all():
        raise ValueError(f"'{key}' holds a number that is not positive")
    return result
