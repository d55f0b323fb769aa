"""Input and output of inverse kinematics: kinematics, joints and solutions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats

Kinematics: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""Joint positions (N, n) to tool poses (N, 4, 4) and the tool's body twists by joint
position (N, 6, n). The twists may neglect small terms; that costs a step or two."""

Booleans: TypeAlias = NDArray[np.bool_]
Indices: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True)
class Joints:
    """Limits and kinds of the joints of a chain.

    Attributes:
        lower: Lower limits, shape (n,) [rad, m]; minus infinity where there is none.
        upper: Upper limits, shape (n,) [rad, m]; infinity where there is none.
        revolute: True for revolute joints, shape (n,).
    """

    lower: Floats
    upper: Floats
    revolute: Booleans

    @staticmethod
    def of(chain: Chain) -> Joints:
        """The joints of a chain within the limits of its URDF."""
        model = chain.robot.model
        index = [model.idx_qs[model.getJointId(name)] for name in chain.joints]
        lower, upper = model.lowerPositionLimit[index], model.upperPositionLimit[index]
        # A chain gives limits of its own to joints whose URDF states none.
        free = (chain.lower != lower) | (chain.upper != upper)
        return Joints(
            np.where(free, -np.inf, chain.lower),
            np.where(free, np.inf, chain.upper),
            chain.revolute,
        )

    @property
    def home(self) -> Floats:
        """Zero, or the middle of the limits where it is not within, shape (n,)."""
        inside = (self.lower <= 0.0) & (self.upper >= 0.0)
        middle = 0.5 * np.where(inside, 0.0, self.lower)
        return np.asarray(middle + 0.5 * np.where(inside, 0.0, self.upper))

    def within(self, q: Floats) -> Floats:
        """Positions moved into the limits, shape (N, n)."""
        return np.asarray(np.clip(q, self.lower, self.upper))

    def at_limit(self, q: Floats) -> Booleans:
        """Whether joints stand at a limit, shape (N, n)."""
        return np.asarray((q <= self.lower) | (q >= self.upper))

    def distances(self, q: Floats, other: Floats) -> Floats:
        """Squared distances of joint positions, shape (..., n), whatever the turns."""
        way = q - other
        return np.asarray(
            np.where(self.revolute, 2.0 - 2.0 * np.cos(way), way**2).sum(axis=-1)
        )

    def samples(self, count: int) -> Floats:
        """Configurations that fill the joint space evenly, shape (count, n).

        An additive recurrence whose steps are the powers of the root of
        x^(n+1) = x + 1 (Roberts' generalized golden ratio), from the middle.
        """
        home, n = self.home, len(self.home)
        # Half a turn either way holds every pose of a revolute joint of wider limits.
        far = self.revolute | np.isinf(self.lower) | np.isinf(self.upper)
        lower = np.where(far, np.maximum(self.lower, home - np.pi), self.lower)
        upper = np.where(far, np.minimum(self.upper, home + np.pi), self.upper)
        ratio = 2.0
        for _ in range(60):
            ratio = (1.0 + ratio) ** (1.0 / (n + 1))
        parts = 0.5 + np.outer(np.arange(count), ratio ** -np.arange(1.0, n + 1.0))
        return np.asarray(lower + parts % 1.0 * (upper - lower))

    def turned(self, q: Floats, start: Floats) -> Floats:
        """The same positions in the turns nearest to a start, shape (N, n)."""
        turns = np.where(self.revolute, np.round((q - start) / (2.0 * np.pi)), 0.0)
        moved = q - 2.0 * np.pi * turns
        return np.asarray(np.where(self.within(moved) == moved, moved, q))


@dataclass(frozen=True)
class Solutions:
    """Joint positions for N targets.

    Attributes:
        q: Joint positions, the best attempt where a target is not reached, shape
            (N, n) [rad, m].
        reached: Whether both errors are below 1e-9, shape (N,).
        position: Distance that remains, shape (N,) [m].
        orientation: Angle that remains, shape (N,) [rad]; zero where only positions
            are asked for.
    """

    q: Floats
    reached: Booleans
    position: Floats
    orientation: Floats

    def __len__(self) -> int:
        """Number of targets."""
        return len(self.q)

    @staticmethod
    def none(q: Floats) -> Solutions:
        """Unreached targets, at joint positions of shape (N, n)."""
        unknown = np.full(len(q), np.inf)
        return Solutions(q, np.zeros(len(q), bool), unknown, unknown)

    @staticmethod
    def joined(parts: Sequence[Solutions]) -> Solutions:
        """The rows of several solutions, one after the other."""
        columns = zip(*(part._columns for part in parts), strict=True)
        return Solutions(*(np.concatenate(column) for column in columns))

    @property
    def score(self) -> Floats:
        """Zero where reached, else the error with a radian as a meter, shape (N,)."""
        return np.where(self.reached, 0.0, self.position + self.orientation)

    def rows(self, rows: Indices | Booleans) -> Solutions:
        """Some of the rows."""
        return Solutions(*(column[rows] for column in self._columns))

    def replaced(self, rows: Indices, others: Solutions) -> Solutions:
        """These solutions, but for some rows, shape (K,), others."""
        columns = [column.copy() for column in self._columns]
        for column, other in zip(columns, others._columns, strict=True):
            column[rows] = other
        return Solutions(*columns)

    @property
    def _columns(self) -> tuple[Any, ...]:
        return tuple(getattr(self, field.name) for field in fields(self))
