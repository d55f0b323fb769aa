"""Which of very many measurements are drawn: an even choice, and those that matter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

LARGEST = 100
"""Largest errors of every kind that are always drawn."""


def thinned(
    count: int, limit: int, sizes: Sequence[Floats], always: Sequence[int] = ()
) -> NDArray[np.intp]:
    """Positions of the measurements that are drawn, ascending, shape (M,).

    Args:
        count: Number N of measurements.
        limit: Number that is drawn at most.
        sizes: Sizes of errors, shape (N,) each, NaN where there is none; the largest
            are drawn.
        always: Positions that are drawn as well, the most important ones first; they
            may take half of all.
    """
    if count <= limit:
        return np.arange(count)
    least = max(1, limit // (4 * max(len(sizes), 1)))
    largest = min(LARGEST, least)
    parts = [np.asarray(always[: limit // 2], np.intp)]
    for size in sizes:
        filled = np.where(np.isnan(size), -np.inf, size)
        parts.append(np.argpartition(filled, -largest)[-largest:])
    kept = np.unique(np.concatenate(parts))
    rest = np.setdiff1d(np.arange(count), kept)
    evenly = np.linspace(0, len(rest) - 1, limit - len(kept)).round().astype(np.intp)
    return np.sort(np.concatenate([kept, rest[evenly]]))


def thinning(shown: int, count: int) -> str:
    """A sentence where measurements are left out; empty where none is."""
    if shown == count:
        return ""
    return f" {shown} of {count} measurements are drawn, including the largest errors."
