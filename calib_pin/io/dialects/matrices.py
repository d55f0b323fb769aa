"""Rotations or poses as matrices: a column for each element, such as `r11` to `r33`.

Elements are counted from 0 or 1, row by row as their names say; of three columns they
are a rotation, of four a pose. Nine that have one number each are a rotation by rows,
twelve or sixteen a pose by rows or by columns. Any orthonormal matrix is taken,
whatever its name is; of several in a file the name stands before what they become.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
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

ROUNDED = 1e-2
"""Largest error of an orthonormal matrix that rounding explains."""


class Matrices(base.Dialect):
    """Matrices whose elements are columns."""

    def read(self, columns: base.Columns, file: Path) -> base.Reading | None:
        """The columns with a position and a quaternion in the place of each matrix."""
        matrices = dict[str, tuple[dict[tuple[int, int], str], Floats]]()
        for name, elements in _elements(columns):
            if (R := _rotations(columns, elements)) is not None:
                matrices.setdefault(name, (elements, R))
        if not matrices:
            return None
        used, read = set[str](), dict[str, Column]()
        for name, (elements, R) in matrices.items():
            stem = f"{name}_" if len(matrices) > 1 else ""
            ends = range(first := min(elements)[0], first + 3)
            for axis, column in base.oriented(R, _quaternions).items():
                read[stem + axis] = replace(column, header=stem + axis)
            used |= {elements[i, j] for i in ends for j in ends}
            for axis, i in zip("xyz", ends, strict=True):
                if (
                    moved := elements.get((i, first + 3))
                ) and stem + axis not in columns:
                    read[stem + axis] = base.named(columns[moved], stem + axis)
                    used.add(moved)
        rest = {name: column for name, column in columns.items() if name not in used}
        names = enumerated(name or "r" for name in matrices)
        return base.Reading(rest | read, f"matrices {names}")


def _rotations(
    columns: base.Columns, elements: dict[tuple[int, int], str]
) -> Floats | None:
    """The rotations that elements are, row by row, shape (N, 9).

    None where they are no rotations, or their last row, if any, is not of zeros.
    """
    ends = range(first := min(elements)[0], first + 3)
    turned = [elements.get((i, j), "") for i in ends for j in ends]
    below = [elements.get((first + 3, j), "") for j in ends]
    if not all(turned):
        return None
    R = np.array([columns[name].numbers for name in turned]).T
    last = np.array([columns[name].numbers for name in below if name])
    whole = _orthonormal(R) and not np.nanmax(abs(last), initial=0)
    return R if whole else None


def _elements(
    columns: base.Columns,
) -> Iterator[tuple[str, dict[tuple[int, int], str]]]:
    """Columns that may be a matrix, by row and column: by name, or by order."""
    matrices = defaultdict[str, dict[tuple[int, int], str]](dict)
    ordered = defaultdict[str, list[str]](list)
    for name in columns:
        if match := ELEMENT.fullmatch(name):
            matrices[match[1]][int(match[2]), int(match[3])] = name
        if match := PLACE.fullmatch(name):
            ordered[match[1]].append(name)
    yield from matrices.items()
    for stem, names in ordered.items():
        if len(names) == 9:
            yield stem, {(k // 3, k % 3): name for k, name in enumerate(names)}
        elif len(names) in (12, 16):
            yield stem, {(k // 4, k % 4): name for k, name in enumerate(names)}
            rows = len(names) // 4
            yield stem, {(k % rows, k // rows): name for k, name in enumerate(names)}


def _quaternions(R: Floats) -> Floats:
    return to_quaternion(nearest_rotation(R.reshape(-1, 3, 3)))


def _orthonormal(R: Floats) -> bool:
    """Whether most of the matrices are orthonormal, row by row, shape (N, 9)."""
    R = R[np.isfinite(R).all(axis=1)].reshape(-1, 3, 3)
    errors = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return bool(len(R)) and bool(np.quantile(errors, 0.9) < ROUNDED)
