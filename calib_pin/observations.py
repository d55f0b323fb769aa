"""Measurements: configurations of a chain and what an instrument saw there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Targets = Sequence[str]
"""The name of the target of each measurement."""

PLUS = "+"
"""Stands between the names of models that are measured together."""

PART = ":"
"""Stands between the name of a model and a target in mixed measurements."""

AT = "@"
"""Stands between a point of the tool and the place it is measured against."""

SAME = 1e-6
"""Largest difference of joint positions within one configuration [rad, m]."""

ARRAYS = ("q", "values", "validate", "lines", "weight")
WORDS = ("target", "payload", "files")
"""Attributes of `Measurements` with one entry for each, beside sigma and start."""


@dataclass(frozen=True)
class Measurements:
    """N measurements of one chain with one measurement model, or with several.

    Attributes:
        joints: Names of the chain's joints, the columns of `q`.
        q: Commanded joint positions, shape (N, n) [rad, m].
        model: Name of the measurement model, such as `position`; of several with a
            plus between them.
        values: Measured values in the layout of the model, shape (N, D), SI units:
            the columns that it declares and, where an orientation is measured, the
            quaternion qx qy qz qw; contacts none. Of several models side by side, zero
            where a row has none.
        sigma: Standard deviations of the residual components, shape (N, d), or
            None where the file does not state them. Of an orientation they belong to
            the rotation vector in the tool frame [rad]. Of several models side by
            side: infinite for those of another model, NaN where none is stated.
        target: Name of the plane, socket or reference point of each row, length N;
            empty strings where the file names none. Of several models with the name
            of the row's model before it, `model:front/0`.
        payload: Name of what the robot carried, length N; empty strings where the
            file names none.
        start: Joint positions at which the relative measurement of a row starts, shape
            (N, n) [rad, m]; NaN in rows of other models, empty where all are.
        validate: True for the rows that must not be fitted, shape (N,).
        lines: Line of each row in its file, shape (N,); 0 where there is no file.
        files: File of each row, length N; empty strings where there is none.
        weight: Factor of the precision of each row, shape (N,); default one. Zero sets
            a measurement aside: it keeps its place and has no say.

    Raises:
        InputError: If the shapes disagree or a number is not finite.
    """

    joints: tuple[str, ...]
    q: Floats
    model: str
    values: Floats
    sigma: Floats | None = None
    target: tuple[str, ...] = ()
    payload: tuple[str, ...] = ()
    start: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    validate: Booleans = field(default_factory=lambda: np.zeros(0, bool))
    lines: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    files: tuple[str, ...] = ()
    weight: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Fill the optional columns and check shapes and values."""
        count = len(self.q)
        defaults = {
            **dict.fromkeys(WORDS, ("",) * count),
            "validate": np.zeros(count, bool),
            "lines": np.zeros(count, np.int64),
            "weight": np.ones(count),
        }
        for name, default in defaults.items():
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, default)
        if self.q.shape != (count, len(self.joints)):
            raise InputError(
                f"q has shape {self.q.shape}, expected ({count}, {len(self.joints)})"
            )
        for name in ("values", *defaults):
            if len(getattr(self, name)) != count:
                raise InputError(f"'{name}' has not the {count} rows of q")
        if self.start.size and self.start.shape != self.q.shape:
            raise InputError(f"start has shape {self.start.shape}, not that of q")
        if not (np.isfinite(self.q).all() and np.isfinite(self.values).all()):
            raise InputError("measurements must be finite numbers")
        if self.values.ndim != 2 or (
            self.sigma is not None
            and (self.sigma.ndim != 2 or len(self.sigma) != count)
        ):
            raise InputError(f"values and sigma must be tables of {count} rows")
        if self.sigma is not None:
            told = np.isfinite(self.sigma) | (len(self.parts) > 1)
            if not told.all() or (self.sigma <= 0.0).any():
                raise InputError("standard deviations must be positive finite numbers")

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.q)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the models."""
        return tuple(self.model.split(PLUS))

    def rows(self, index: NDArray[Any]) -> Measurements:
        """The rows picked by a boolean mask or an index array, in its order."""
        order = np.arange(len(self))[index]
        arrays = {name: getattr(self, name)[order] for name in ARRAYS}
        words: dict[str, Any] = {
            name: tuple(map(getattr(self, name).__getitem__, order.tolist()))
            for name in WORDS
        }
        return replace(
            self,
            **arrays,
            **words,
            sigma=None if self.sigma is None else self.sigma[order],
            start=self.start[order] if self.start.size else self.start,
        )

    @staticmethod
    def concatenate(parts: Sequence[Measurements]) -> Measurements:
        """Join measurements of one chain and one model, or of the same side by side.

        Those of different models are joined by `side_by_side.concatenate`.

        Raises:
            InputError: If joints or models differ, or only some of the measurements
                have standard deviations.
        """
        first = parts[0]
        for part in parts[1:]:
            if part.joints != first.joints:
                raise InputError("cannot join measurements of different joints")
            if part.model != first.model:
                raise InputError("cannot join measurements of different models")
        parts = [part for part in parts if len(part)] or parts[:1]
        first = parts[0]
        if len(parts) == 1:
            return first
        for part in parts:
            require_alike(part, (part.sigma is None) == (first.sigma is None))
        sigmas = [part.sigma for part in parts if part.sigma is not None]
        starts = [
            part.start if part.start.size else np.full(part.q.shape, np.nan)
            for part in parts
        ]
        started = any(part.start.size for part in parts)
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ARRAYS
        }
        words: dict[str, Any] = {
            name: tuple(chain.from_iterable(getattr(part, name) for part in parts))
            for name in WORDS
        }
        return replace(
            first,
            **arrays,
            **words,
            sigma=np.concatenate(sigmas) if sigmas else None,
            start=np.concatenate(starts) if started else first.start,
        )

    def sample(self, count: int) -> Measurements:
        """About `count` rows, spread evenly over the rows of every target.

        A target with few rows keeps up to twenty, unless there are too many of them.
        """
        if len(self) <= count:
            return self
        names = {name: k for k, name in enumerate(dict.fromkeys(self.target))}
        label = np.zeros(len(self), np.int64)
        if 1 < len(names) <= count // 20:
            label[:] = [names[name] for name in self.target]
        order = np.argsort(label, kind="stable")
        sizes = np.bincount(label)
        few = np.minimum(sizes, min(20, count))
        shares = np.maximum(sizes * count // len(self), few)
        chosen = [
            rows[np.linspace(0, len(rows) - 1, share).astype(np.int64)]
            for rows, share in zip(
                np.split(order, np.cumsum(sizes)[:-1]), shares, strict=True
            )
        ]
        return self.rows(np.sort(np.concatenate(chosen)))

    def groups(self) -> Indices:
        """Label rows that must stay together when data are split, shape (N,).

        Rows of one configuration are repetitions: if one of them is fitted, the others
        are no longer held out. Labels count from 0 and are read-only.
        """
        return self._groups

    @cached_property
    def _groups(self) -> Indices:
        # A label is the number of rows in the groups before: to split a group leaves
        # all others as they are, and a row that stands alone is done with.
        label = np.zeros(len(self), np.int64)
        shared = np.arange(len(self))
        # Split by one joint after the other at gaps in the sorted positions, until
        # nothing splits: rounding to a grid would part neighbors across its edges.
        before = label - 1
        while not np.array_equal(label, before):
            before = label.copy()
            for position in self.q.T:
                shared = _split_groups(label, shared, position)
        used = np.zeros(len(self) + 1, np.int64)
        used[label] = 1
        result: Indices = (np.cumsum(used) - 1)[label]
        result.setflags(write=False)
        return result

    @property
    def configurations(self) -> int:
        """Number of different configurations; repetitions show nothing new."""
        return int(self.groups().max(initial=-1)) + 1

    def source(self, row: int) -> str:
        """Where a row stands, as `file:line`, or `row k` where there is no file."""
        if self.files[row]:
            return f"{self.files[row]}:{self.lines[row]}"
        return f"row {row}"

    def error(
        self,
        row: int,
        reason: str,
        *,
        column: str | None = None,
        allowed: str | None = None,
    ) -> InputError:
        """The error that refuses a row, with the place where the row stands."""
        told: dict[str, Any] = {"column": column, "allowed": allowed}
        if file := self.files[row]:
            return InputError(reason, file=file, line=int(self.lines[row]), **told)
        return InputError(f"{self.source(row)}: {reason}", **told)


def states_sigmas(data: Measurements) -> bool:
    """Whether the measurements state all their standard deviations."""
    return data.sigma is not None and not bool(np.isnan(data.sigma).any())


def trusted(data: Measurements) -> Measurements:
    """The measurements that have a weight; of a target that has none, all of them."""
    if data.weight.all():
        return data
    left = {data.target[row] for row in np.flatnonzero(data.weight)}
    lost = np.array([name not in left for name in data.target], bool)
    return data.rows((data.weight > 0.0) | lost)


def fitted_and_held_out(data: Measurements) -> tuple[Measurements, Measurements]:
    """The training and the validation measurements, by the `set` column."""
    if not data.validate.any():
        return data, data.rows(data.validate)
    return data.rows(~data.validate), data.rows(data.validate)


def require_alike(part: Measurements, alike: bool) -> None:
    """Refuse measurements that state standard deviations, or do not, unlike others.

    Raises:
        InputError: If they are not alike.
    """
    if not alike:
        raise InputError(
            "cannot join measurements with and without standard deviations",
            file=part.files[0] or None,
        )


def rows_by_part(target: Sequence[str]) -> dict[str, NDArray[np.intp]]:
    """The rows of each model in mixed measurements, by the model that targets name.

    Args:
        target: Target of each row.
    """
    found: dict[str, list[int]] = {}
    for row, name in enumerate(target):
        found.setdefault(name.partition(PART)[0], []).append(row)
    return {model: np.array(rows, np.intp) for model, rows in found.items()}


def _split_groups(label: Indices, shared: Indices, position: Floats) -> Indices:
    """Split groups of rows at gaps between the positions of one joint.

    Args:
        label: Label of every row, shape (N,); changed in place.
        shared: The rows of groups of more than one, ascending order not needed.
        position: Positions of the joint, shape (N,).

    Returns:
        The rows of groups of more than one that are left.
    """
    order = shared[np.lexsort((position[shared], label[shared]))]
    if len(order) == 0:
        return order
    old = label[order]
    place = np.arange(len(order))
    begins = np.concatenate([[True], np.diff(old) != 0])
    apart = begins.copy()
    apart[1:] |= np.diff(position[order]) > SAME
    group_begin = np.maximum.accumulate(np.where(begins, place, 0))
    begin = np.maximum.accumulate(np.where(apart, place, 0))
    label[order] = old + begin - group_begin
    sizes = np.diff(np.append(np.flatnonzero(apart), len(order)))
    return np.asarray(order[np.repeat(sizes > 1, sizes)])
