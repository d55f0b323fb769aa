"""Rotations or poses as matrices: a column for each element, such as `r11` to `r33`.

Elements are counted from 0 or 1, row by row as their names say; of three columns they
are a rotation, of four a pose. Twelve or sixteen that have one number each are a pose
by rows or by columns. Any orthonormal matrix is taken, whatever its name is.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Floats
from calib_pin.kinematics.spatial import nearest_rotation, to_quaternion

ELEMENT = re.compile(r"(.*?)[ _\[(]*([0-4])[ _,]*([0-4])[\])]*")

PLACE = re.compile(r"(.*?)[ _\[(]*\d+[\])]*")
"""Names of the elements of a pose, one after the other by rows or by columns."""

ROUNDED = 1e-2
"""Largest error of an orthonormal matrix that rounding explains."""


class Matrices(base.Dialect):
    """Matrices whose elements are columns."""

    def read(self, columns: base.Columns, file: Path) -> base.Reading | None:
        """The columns with quaternions in the place of a matrix."""
        for elements in _elements(columns):
            ends = range(first := min(elements)[0], first + 3)
            turned = [elements.get((i, j), "") for i in ends for j in ends]
            R = np.array([columns[name].numbers for name in turned if name]).T
            below = [elements.get((first + 3, j), "") for j in ends]
            last = np.array([columns[name].numbers for name in below if name])
            if (
                not all(turned)
                or not _orthonormal(R)
                or np.nanmax(abs(last), initial=0)
            ):
                continue
            read = {name: c for name, c in columns.items() if name not in turned}
            read |= base.oriented(R, _quaternions)
            for axis, i in zip("xyz", ends, strict=True):
                if (moved := elements.get((i, first + 3))) and axis not in columns:
                    read[axis] = base.named(read.pop(moved), axis)
            return base.Reading(read, f"matrices of '{turned[0]}' to '{turned[-1]}'")
        return None


def _elements(columns: base.Columns) -> Iterator[dict[tuple[int, int], str]]:
    """Columns that may be a matrix, by row and column: by name, or by order."""
    found = defaultdict[str, dict[tuple[int, int], str]](dict)
    ordered = defaultdict[str, list[str]](list)
    for name in columns:
        if match := ELEMENT.fullmatch(name):
            found[match[1]][int(match[2]), int(match[3])] = name
        if match := PLACE.fullmatch(name):
            ordered[match[1]].append(name)
    yield from found.values()
    for names in (names for names in ordered.values() if len(names) in (12, 16)):
        yield {(k // 4, k % 4): name for k, name in enumerate(names)}
        rows = len(names) // 4
        yield {(k % rows, k // rows): name for k, name in enumerate(names)}


def _quaternions(R: Floats) -> Floats:
    return to_quaternion(nearest_rotation(R.reshape(-1, 3, 3)))


def _orthonormal(R: Floats) -> bool:
    """Whether most of the matrices are orthonormal, row by row, shape (N, 9)."""
    R = R[np.isfinite(R).all(axis=1)].reshape(-1, 3, 3)
    errors = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return bool(len(R)) and bool(np.quantile(errors, 0.9) < ROUNDED)
