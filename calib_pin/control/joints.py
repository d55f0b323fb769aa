"""The joints of a chain, and solutions of its inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import Field, dataclass, replace
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.kinematics.joint_space import JointSpace, quasi_random
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.turns import shortest_turns
from calib_pin.observations import Booleans, Indices

Kinematics: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""Joint positions (N, n) to tool poses (N, 4, 4) and the tool's body twists by joint
position (N, 6, n). The twists may neglect small terms; that costs a step or two."""


class Stacked:
    """A dataclass whose arrays all have one row for each target."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def rows(self, rows: Indices | Booleans | slice | list[int]) -> Self:
        """Some of the rows; what is no array stays."""
        return replace(self, **{k: array[rows] for k, array in self._arrays().items()})

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The rows of several parts, one after the other."""
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in parts[0]._arrays()
        }
        return replace(parts[0], **columns)

    def replaced(self, rows: Indices | Booleans, others: Self) -> Self:
        """These rows, but for some, shape (K,), others."""
        columns = {name: array.copy() for name, array in self._arrays().items()}
        for name, column in columns.items():
            column[rows] = getattr(others, name)
        return replace(self, **columns)

    def _arrays(self) -> dict[str, Any]:
        return {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray)}


@dataclass(frozen=True)
class Joints:
    """Limits and kinds of the n joints that move a chain: those with a drive.

    The m joints of a chain are the same, but for those that mimic others.

    Attributes:
        lower: Lower limits, shape (n,) [rad, m]; minus infinity where there is none.
        upper: Upper limits, shape (n,) [rad, m]; infinity where there is none.
        revolute: True for revolute joints of which whole turns move nothing, (n,).
        columns: How the chain's joints follow these.
    """

    lower: Floats
    upper: Floats
    revolute: Booleans
    columns: JointColumns

    @staticmethod
    def of(chain: Chain) -> Joints:
        """The joints of a chain within the limits of its URDF."""
        space = JointSpace(chain.robot.model, chain.joints, chain.robot.mimics)
        lower = np.where(space.limited, space.lower, -np.inf)
        upper = np.where(space.limited, space.upper, np.inf)
        columns = JointColumns.of(chain)
        drives = [space.joints.index(drive) for drive in columns.joints]
        # After a turn of its leader a mimic joint may stand elsewhere.
        turned = columns.factors - np.round(columns.factors)
        of_turn = np.where(chain.revolute[:, None], turned, columns.factors)
        whole = (np.abs(of_turn) < 1e-12).all(axis=0)
        return Joints(lower[drives], upper[drives], columns.revolute & whole, columns)

    def positions(self, q: Floats) -> Floats:
        """Positions of the joints of the chain, shape (N, n) -> (N, m)."""
        return self.columns.positions(q)

    def driven(self, q: Floats) -> Floats:
        """Positions of these joints at those of the chain, shape (N, m) -> (N, n)."""
        return self.columns.values(q)

    def continued(self, q: Floats) -> Floats:
        """Positions of the chain's joints, (N, m), of which continuous ones go on.

        A controller may report them within one turn: 359 degrees, then 0.
        """
        driven = self.driven(q)
        free = self.revolute & np.isinf(self.lower) & np.isinf(self.upper)
        unwound = np.where(free, np.unwrap(driven, axis=0), driven)
        return q if (unwound == driven).all() else self.positions(unwound)

    def driving(self, evaluate: Kinematics) -> Kinematics:
        """The kinematics of a chain as those of the joints that move it."""

        def moved(q: Floats) -> tuple[Floats, Floats]:
            T, J = evaluate(self.positions(q))
            return T, J @ self.columns.factors

        return moved

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

    def samples(self, count: int) -> Floats:
        """Configurations that fill the joint space evenly, shape (count, n).

        A quasi-random sequence from the middle.
        """
        home, n = self.home, len(self.home)
        # Half a turn either way holds every pose of a revolute joint of wider limits.
        far = self.revolute | np.isinf(self.lower) | np.isinf(self.upper)
        lower = np.where(far, np.maximum(self.lower, home - np.pi), self.lower)
        upper = np.where(far, np.minimum(self.upper, home + np.pi), self.upper)
        parts = quasi_random(np.full(n, 0.5), 0, count)
        return np.asarray(lower + parts * (upper - lower))

    def unwound(self, q: Floats) -> Floats:
        """Positions in the turns of the shortest way from row to row, shape (N, n)."""
        return shortest_turns(q, self.lower, self.upper, self.revolute)

    def turned(self, q: Floats, start: Floats) -> Floats:
        """The same positions in the turns nearest to a start, shape (N, n)."""
        turns = np.where(self.revolute, np.round((q - start) / (2.0 * np.pi)), 0.0)
        moved = q - 2.0 * np.pi * turns
        return np.asarray(np.where(self.within(moved) == moved, moved, q))


@dataclass(frozen=True)
class Solutions(Stacked):
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

    @property
    def score(self) -> Floats:
        """Zero where reached, else the error with a radian as a meter, shape (N,)."""
        return np.where(self.reached, 0.0, self.position + self.orientation)
