"""Rotations or poses as matrices: a column for each element, such as `r11` to `r33`.

Elements are counted from 0 or 1, row by row as their names say; of three columns they
are a rotation, of four a pose. Any orthonormal matrix is taken, whatever its name is.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Column, Floats

ELEMENT = re.compile(r"(.*?)[ _\[(]*([0-4])[ _,]*([0-4])[\])]*")

ROUNDED = 1e-2
"""Largest error of an orthonormal matrix that rounding explains."""


class Matrices(base.Dialect):
    """Matrices whose elements are columns."""

    def read(self, columns: Mapping[str, Column], file: Path) -> base.Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        found = defaultdict[str, dict[tuple[int, int], str]](dict)
        for name in columns:
            if match := ELEMENT.fullmatch(name):
                found[match[1]][int(match[2]), int(match[3])] = name
        for elements in found.values():
            first = min(i for i, _ in elements)
            names = [
                elements.get((first + i, first + j), "")
                for i in range(3)
                for j in range(4)
            ]
            turned = [name for k, name in enumerate(names) if k % 4 < 3]
            if all(turned) and _orthonormal(columns, turned):
                return _read(columns, turned, names[3::4])
        return None


def _numbers(columns: Mapping[str, Column], names: list[str]) -> Floats:
    return np.column_stack([columns[name].numbers for name in names])


def _orthonormal(columns: Mapping[str, Column], names: list[str]) -> bool:
    R = _numbers(columns, names).reshape(-1, 3, 3)
    R = R[np.isfinite(R).all(axis=(1, 2))]
    errors = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3))
    return bool(len(R)) and bool(np.quantile(errors.max(axis=(1, 2)), 0.9) < ROUNDED)


def _read(
    columns: Mapping[str, Column], turned: list[str], moved: list[str]
) -> base.Reading:
    """The columns, with a quaternion in the place of the matrix."""
    read = {name: c for name, c in columns.items() if name not in turned}
    read |= base.oriented(_numbers(columns, turned), base.from_rows)
    for axis, name in zip("xyz", moved, strict=True):
        if name and axis not in columns:
            read[axis] = base.named(read.pop(name), axis)
    return base.Reading(read, f"matrices of '{turned[0]}' to '{turned[-1]}'")
