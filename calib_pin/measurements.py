"""Measurements: configurations of a chain and what an instrument saw there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError

__all__ = ["Measurements"]

Floats = NDArray[np.float64]

SAME = 1e-6
"""Largest difference of joint positions within one configuration [rad, m]."""


@dataclass(frozen=True)
class Measurements:
    """N measurements of one chain with one measurement model.

    Attributes:
        joints: Names of the chain's joints, the columns of `q`.
        q: Commanded joint positions, shape (N, n) [rad, m].
        model: Name of the measurement model, such as `position`.
        values: Measured values in the layout of the model, shape (N, D), SI units:
            `position` x y z [m]; `pose` x y z [m] and the quaternion qx qy qz qw;
            `plane-distance` the distance [m].
        sigma: Standard deviations of the residual components, shape (N, d), or
            None where the file does not state them. For `pose` the last three belong
            to the rotation vector in the tool frame [rad].
        target: Name of the plane or reference point of each row, length N; empty
            strings where the file names none.
        validate: True for the rows that must not be fitted, shape (N,).
        lines: Line of each row in its file, shape (N,); 0 where there is no file.
        files: File of each row, length N; empty strings where there is none.

    Raises:
        InputError: If the shapes disagree or a number is not finite.
    """

    joints: tuple[str, ...]
    q: Floats
    model: str
    values: Floats
    sigma: Floats | None = None
    target: tuple[str, ...] = ()
    validate: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    lines: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Fill the optional columns and check shapes and values."""
        count = len(self.q)
        defaults = {
            "target": ("",) * count,
            "files": ("",) * count,
            "validate": np.zeros(count, bool),
            "lines": np.zeros(count, np.int64),
        }
        for name, default in defaults.items():
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, default)
        if self.q.shape != (count, len(self.joints)):
            raise InputError(
                f"q has shape {self.q.shape}, expected ({count}, {len(self.joints)})"
            )
        for name in ("values", "target", "validate", "lines", "files"):
            if len(getattr(self, name)) != count:
                raise InputError(f"'{name}' has not the {count} rows of q")
        if not (np.isfinite(self.q).all() and np.isfinite(self.values).all()):
            raise InputError("measurements must be finite numbers")
        if self.values.ndim != 2 or (
            self.sigma is not None
            and (self.sigma.ndim != 2 or len(self.sigma) != count)
        ):
            raise InputError(f"values and sigma must be tables of {count} rows")
        if self.sigma is not None and not (
            np.isfinite(self.sigma).all() and (self.sigma > 0).all()
        ):
            raise InputError("standard deviations must be positive finite numbers")

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.q)

    def rows(self, index: NDArray[Any]) -> Measurements:
        """The rows picked by a boolean mask or an index array, in its order."""
        order = np.arange(len(self))[index]
        return replace(
            self,
            q=self.q[order],
            values=self.values[order],
            sigma=None if self.sigma is None else self.sigma[order],
            target=tuple(map(self.target.__getitem__, order.tolist())),
            validate=self.validate[order],
            lines=self.lines[order],
            files=tuple(map(self.files.__getitem__, order.tolist())),
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

    def split(self) -> tuple[Measurements, Measurements]:
        """The training rows and the validation rows, by the `set` column."""
        if not self.validate.any():
            return self, self.rows(self.validate)
        return self.rows(~self.validate), self.rows(self.validate)

    def groups(self) -> NDArray[np.int64]:
        """Label rows that must stay together when data are split, shape (N,).

        Rows of one configuration are repetitions: with one of them fitted the others
        are no longer unseen. Labels count from 0 and are read-only.
        """
        return self._groups

    @cached_property
    def _groups(self) -> NDArray[np.int64]:
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
        result: NDArray[np.int64] = (np.cumsum(used) - 1)[label]
        result.setflags(write=False)
        return result

    @property
    def configurations(self) -> int:
        """Number of different configurations; repetitions show nothing new."""
        return int(self.groups().max(initial=-1)) + 1

    def place(self, row: int) -> str:
        """Where a row stands, as `file:line`, or `row k` where there is no file."""
        if self.files[row]:
            return f"{self.files[row]}:{self.lines[row]}"
        return f"row {row}"

    @staticmethod
    def concatenate(parts: list[Measurements]) -> Measurements:
        """Join measurements of the same chain and model.

        Raises:
            InputError: If the joints or the models differ, or only some have sigmas.
        """
        first = parts[0]
        for part in parts[1:]:
            if part.joints != first.joints or part.model != first.model:
                raise InputError(
                    f"cannot join '{part.model}' measurements with '{first.model}' ones"
                )
            if (part.sigma is None) != (first.sigma is None):
                raise InputError(
                    "cannot join measurements with and without standard deviations",
                    file=part.files[0] or None,
                )
        sigmas = [part.sigma for part in parts if part.sigma is not None]
        return Measurements(
            joints=first.joints,
            q=np.concatenate([part.q for part in parts]),
            model=first.model,
            values=np.concatenate([part.values for part in parts]),
            sigma=np.concatenate(sigmas) if sigmas else None,
            target=sum((part.target for part in parts), ()),
            validate=np.concatenate([part.validate for part in parts]),
            lines=np.concatenate([part.lines for part in parts]),
            files=sum((part.files for part in parts), ()),
        )


def _split_groups(
    label: NDArray[np.int64], shared: NDArray[np.int64], position: Floats
) -> NDArray[np.int64]:
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
