"""A document's values, written and read; nothing in it is ever run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from calib_pin.kinematics.spatial import Floats

LARGEST = 1e12
"""Largest number in a document: beyond, squares and products would overflow."""

MOST = 4_000_000
"""Most numbers in one array of a document."""


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
    if empty and 0 in shape and found.size == 0:
        # Lists cannot tell how long the rows of nothing are.
        return np.zeros([length or 0 for length in shape])
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
