"""Names of measurements as integer codes, and labels of their configurations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]

SAME = 1e-6
"""Largest difference of joint positions within one configuration [rad, m]."""

SPARSE = 8
"""Largest code, by the number of rows, up to which codes are counted, not sorted."""


@dataclass(frozen=True, eq=False)
class Labels(Sequence[str]):
    """A column of names as integer codes; a sequence of the names.

    Attributes:
        names: The names that there are, each once; some may not occur.
        codes: Position of the name of each measurement, shape (N,).
    """

    names: tuple[str, ...]
    codes: Indices

    @staticmethod
    def of(names: Sequence[str]) -> Labels:
        """The labels of a sequence of names."""
        if isinstance(names, Labels):
            return names
        number: dict[str, int] = {}
        codes = [number.setdefault(name, len(number)) for name in names]
        return Labels(tuple(number), np.array(codes, np.int64))

    @staticmethod
    def none() -> Labels:
        """No names; `Measurements` puts empty ones in their place."""
        return Labels((), np.zeros(0, np.int64))

    @staticmethod
    def all(name: str, count: int) -> Labels:
        """One name for every measurement."""
        return Labels((name,), np.zeros(count, np.int64))

    @staticmethod
    def concatenate(parts: Sequence[Labels]) -> Labels:
        """Labels behind one another."""
        number: dict[str, int] = {}
        codes = [np.zeros(0, np.int64)]
        for part in parts:
            numbers = [number.setdefault(name, len(number)) for name in part.names]
            codes.append(np.array(numbers, np.int64)[part.codes])
        return Labels(tuple(number), np.concatenate(codes))

    @property
    def distinct(self) -> tuple[str, ...]:
        """The names that occur, in the order in which they do."""
        return tuple(self.names[k] for k in self.codes[firsts(self.codes)].tolist())

    def map(self, change: Callable[[str], str]) -> Labels:
        """The labels of changed names; a name that does not occur is left out."""
        used = np.flatnonzero(np.bincount(self.codes))
        changed = Labels.of([change(self.names[k]) for k in used.tolist()])
        codes = np.zeros(len(self.names), np.int64)
        codes[used] = changed.codes
        return Labels(changed.names, codes[self.codes])

    def where(self, name: str) -> Booleans:
        """Mask of the measurements of a name, shape (N,)."""
        if name not in self.names:
            return np.zeros(len(self), bool)
        return np.asarray(self.codes == self.names.index(name))

    def __len__(self) -> int:
        """Number of measurements."""
        return len(self.codes)

    def __iter__(self) -> Iterator[str]:
        """The name of each measurement."""
        return map(self.names.__getitem__, self.codes.tolist())

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice | NDArray[Any]) -> Labels: ...
    def __getitem__(self, index: int | slice | NDArray[Any]) -> str | Labels:
        """The name of one measurement, or the labels of some."""
        if isinstance(index, slice | np.ndarray):
            return Labels(self.names, self.codes[index])
        return self.names[int(self.codes[index])]

    def __eq__(self, other: object) -> bool:
        """Whether another sequence has the same names."""
        if not isinstance(other, Sequence) or len(other) != len(self):
            return False
        return all(a == b for a, b in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]


def numbered(codes: Indices) -> tuple[Indices, Indices]:
    """The codes that occur, ascending, and the number of that of each row, (N,).

    As `np.unique` with its inverse, which sorts them: of a million rows that takes as
    long as to evaluate their measurements.

    Args:
        codes: Codes, not negative, shape (N,).

    Examples:
        >>> numbered(np.array([7, 3, 7]))
        (array([3, 7]), array([1, 0, 1]))
    """
    if codes.max(initial=0) > SPARSE * len(codes):
        distinct, number = np.unique(codes, return_inverse=True)
        return distinct, number
    used = np.bincount(codes) > 0
    return np.flatnonzero(used), (np.cumsum(used) - 1)[codes]


def firsts(codes: Indices) -> Indices:
    """The first row of each code that occurs, ascending.

    Args:
        codes: Codes, not negative, shape (N,).

    Examples:
        >>> firsts(np.array([7, 3, 7]))
        array([0, 1])
    """
    distinct, number = numbered(codes)
    first = np.empty(len(distinct), np.int64)
    # Of the rows of one code, the last that is written is the first.
    first[number[::-1]] = np.arange(len(codes))[::-1]
    return np.sort(first)


def grouped(q: Floats) -> Indices:
    """Label rows that must stay together when data are split, shape (N,).

    Rows of one configuration are repetitions: if one of them is fitted, the others
    are no longer held out. Labels count from 0 and are read-only.

    Args:
        q: Joint positions, shape (N, n) [rad, m].
    """
    # What an image shows are equal rows, one behind the other.
    begins = np.ones(len(q), bool)
    begins[1:] = (q[1:] != q[:-1]).any(axis=1)
    run, q = np.cumsum(begins) - 1, q[begins]
    # A label is the number of rows in the groups before: to split a group leaves
    # all others as they are, and a row that stands alone is done with.
    label = np.zeros(len(q), np.int64)
    shared = np.arange(len(q))
    # Split by one joint after the other at gaps in the sorted positions, until
    # nothing splits: rounding to a grid would part neighbors across its edges.
    before = label - 1
    while not np.array_equal(label, before):
        before = label.copy()
        for position in q.T if len(shared) else ():
            order = shared[np.lexsort((position[shared], label[shared]))]
            old, place = label[order], np.arange(len(order))
            begins = np.diff(old, prepend=-1) != 0
            apart = begins | (np.diff(position[order], prepend=-np.inf) > SAME)
            begin, group = (
                np.maximum.accumulate(np.where(at, place, 0)) for at in (apart, begins)
            )
            label[order] = old + begin - group
            sizes = np.diff(np.append(np.flatnonzero(apart), len(order)))
            shared = order[np.repeat(sizes > 1, sizes)]
    result: Indices = numbered(label)[1][run]
    result.setflags(write=False)
    return result
