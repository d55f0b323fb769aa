"""Rotations or poses as matrices: a column for each element, such as `r11` to `r33`.

Elements are counted from 0 or 1, row by row as their names say; of three columns they
are a rotation, of four a pose. Nine that have one number each are a rotation by rows,
twelve or sixteen a pose by rows or by columns. Any orthonormal matrix is taken,
whatever its name is; of several in a file the name stands before what they become.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.errors import enumerated
from calib_pin.io.columns import Column, Floats
from calib_pin.kinematics.spatial import nearest_rotation, to_quaternion

ELEMENT = re.compile(r"(.*?)[ _\[(]*([0-4])[ _,]*([0-4])[\])]*")

PLACE = re.compile(r"(.*?)[ _\[(]*\d+[\])]*")
"""Names of the elements of a pose, one after the other by rows or by columns."""

Grid = list[list[str]]
"""Columns of the elements of a matrix, row by row."""

ROUNDED = 1e-2
"""Largest error of an orthonormal matrix that rounding explains."""


class Matrices(base.Dialect):
    """Matrices whose elements are columns."""

    def read(self, columns: base.Columns, file: Path) -> base.Reading | None:
        """The columns with a position and a quaternion in the place of each matrix."""
        matrices = dict[str, tuple[Grid, Floats]]()
        for name, grid in _grids(columns):
            cells = [[columns[one].numbers for one in row[:3]] for row in grid]
            if [len(row) for row in cells[:3]] == [3, 3, 3]:
                R = np.moveaxis(np.array(cells[:3]), 2, 0)
                below = np.abs([numbers for row in cells[3:] for numbers in row])
                if _orthonormal(R) and not np.nanmax(below, initial=0.0):
                    matrices.setdefault(name, (grid, R))
        if not matrices:
            return None
        used, read = set[str](), dict[str, Column]()
        for name, (grid, R) in matrices.items():
            stem = f"{name}_" if len(matrices) > 1 else ""
            for axis, column in base.oriented(R, _quaternions).items():
                read[stem + axis] = replace(column, header=stem + axis)
            for axis, row in zip("xyz", grid, strict=False):
                used |= {*row[:3]}
                if len(row) > 3 and stem + axis not in columns:
                    read[stem + axis] = base.named(columns[row[3]], stem + axis)
                    used.add(row[3])
        rest = {name: column for name, column in columns.items() if name not in used}
        names = enumerated(name or "r" for name in matrices)
        return base.Reading(rest | read, f"matrices {names}")


def _grids(columns: Iterable[str]) -> Iterator[tuple[str, Grid]]:
    """Columns that may be a matrix, row by row: by their numbers, or by order."""
    numbered = defaultdict[str, dict[str, list[str]]](dict)
    ordered = defaultdict[str, list[str]](list)
    for name in columns:
        if match := ELEMENT.fullmatch(name):
            numbered[match[1]].setdefault(match[2], []).append(name)
        if match := PLACE.fullmatch(name):
            ordered[match[1]].append(name)
    for stem, rows in numbered.items():
        yield stem, [sorted(rows[k]) for k in sorted(rows)]
    for stem, names in ordered.items():
        if len(names) in (9, 12, 16):
            width = 3 if len(names) == 9 else 4
            yield stem, np.reshape(names, (-1, width)).tolist()
            if width == 4:
                yield stem, np.reshape(names, (width, -1)).T.tolist()


def _quaternions(R: Floats) -> Floats:
    return to_quaternion(nearest_rotation(R))


def _orthonormal(R: Floats) -> bool:
    """Whether most of the matrices are orthonormal, shape (N, 3, 3)."""
    R = R[np.isfinite(R).all(axis=(1, 2))]
    errors = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return bool(len(R)) and bool(np.quantile(errors, 0.9) < ROUNDED)
