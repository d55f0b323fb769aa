"""Conditions of a measurement beside the joint positions: load, approach, warmth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.observations.labels import SAME, Floats, Labels
from calib_pin.setup.arguments import settle

Signs = NDArray[np.int8]
Source = Literal["", "order", "time", "columns"]

SOURCES: tuple[Source, ...] = ("", "order", "time", "columns")
"""How directions may be known, the least certain first."""

ROWS = ("payload", "direction", "temperature", "time")
"""Attributes of `Conditions` with one entry for each row, where they are stated."""


@dataclass(frozen=True)
class Conditions:
    """Conditions of N rows beside the joint positions.

    An empty array says that nothing is stated. Names may be given as any sequence of
    strings.

    Attributes:
        payload: Name of what the robot carries, length N; empty where none is named.
        direction: Sign of the last motion of each joint, shape (N, n), -1 or +1; 0
            where it is not known.
        temperature: Of the robot, shape (N,) [degC].
        time: When the row was measured, shape (N,) [s].
        spare: Further positions by joint and column of the file, each of shape (N,)
            [rad, m]: of joints that are no part of the chains, and of joints whose
            positions another column states as well.
        steps: Steps of a turn by joint, of those whose columns count steps.
        source: How directions are known: by the `order` of rows, by their `time`, or
            from `columns`; empty where they are not.

    Examples:
        >>> loaded = Conditions(("heavy", "none"))
        >>> loaded.rows(np.array([1])).payload[0], loaded.direction.shape
        ('none', (0, 0))
    """

    payload: Labels = field(default_factory=Labels.none)
    direction: Signs = field(default_factory=lambda: np.zeros((0, 0), np.int8))
    temperature: Floats = field(default_factory=lambda: np.zeros(0))
    time: Floats = field(default_factory=lambda: np.zeros(0))
    spare: Mapping[tuple[str, str], Floats] = field(default_factory=dict)
    steps: Mapping[str, float] = field(default_factory=dict)
    source: Source = ""

    def __post_init__(self) -> None:
        """Take names as labels, and numbers as arrays."""
        object.__setattr__(self, "payload", Labels.of(self.payload))
        settle(self)

    def of(self, count: int, joints: int) -> Conditions:
        """The same with a payload for each of some rows.

        Args:
            count: Number of rows.
            joints: Number of joints.

        Raises:
            InputError: If shapes are not those of the rows, or a number is not finite.
        """
        result = self
        if not len(self.payload):
            result = replace(self, payload=Labels.all("", count))
        for name in ROWS:
            array, width = getattr(result, name), {"direction": (joints,)}.get(name, ())
            array = array.codes if name == "payload" else array  # Not name by name.
            if len(array) and array.shape != (count, *width):
                raise InputError(f"'{name}' has not the {count} rows of q")
            if not np.isfinite(array).all():
                raise InputError(f"'{name}' must be finite numbers")
        return result

    def rows(self, index: NDArray[Any] | slice) -> Conditions:
        """Those of the rows that a mask, a slice or an index array picks."""
        columns = {
            name: getattr(self, name)[index]
            for name in ROWS
            if len(getattr(self, name))
        }
        spare = {name: column[index] for name, column in self.spare.items()}
        return replace(self, **columns, spare=spare)

    @property
    def at_start(self) -> Conditions:
        """Where relative measurements start; what came before is not known there."""
        return replace(self, direction=np.zeros((0, 0), np.int8), source="")

    @staticmethod
    def concatenate(parts: Sequence[Conditions]) -> Conditions:
        """Conditions behind one another, with a payload for each row.

        Directions that only some state are unknown in the others. Times and
        temperatures that only some state are dropped: a row without has none that
        could be assumed.
        """
        if len(parts) == 1:
            return parts[0]
        payload = Labels.concatenate([part.payload for part in parts])
        width = max(part.direction.shape[1] for part in parts)
        directions = [
            part.direction
            if part.direction.size
            else np.zeros((len(part.payload), width), np.int8)
            for part in parts
        ]
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("temperature", "time")
            if all(len(getattr(part, name)) for part in parts)
        }
        spare = {
            name: np.concatenate([part.spare[name] for part in parts])
            for name in parts[0].spare
            if all(name in part.spare for part in parts)
        }
        sources = [part.source for part in parts if part.source]
        return Conditions(
            payload,
            np.concatenate(directions) if width else np.zeros((0, 0), np.int8),
            **columns,
            spare=spare,
            steps={joint: n for part in parts for joint, n in part.steps.items()},
            source=min(sources, key=SOURCES.index, default=""),
        )


UNSTATED = Conditions()
"""Nothing is stated."""


def approached(q: Floats) -> Signs:
    """Sign of the last motion of each joint, shape (N, n).

    A joint that stood still keeps the sign that it had; before its first motion it is
    0, unknown.

    Args:
        q: Joint positions in the order of measuring, shape (N, n) [rad, m].

    Examples:
        >>> approached(np.array([[0.0], [0.1], [0.1], [0.0]])).ravel().tolist()
        [0, 1, 1, -1]
    """
    result = np.zeros(q.shape, np.int8)
    # Joint by joint: there may be millions of rows.
    for column, position in zip(result.T, q.T, strict=True):
        moved = np.diff(position)
        (rows,) = np.nonzero(np.abs(moved) > SAME)
        signs = np.sign(moved[rows]).astype(np.int8)
        if len(rows):
            column[rows[0] + 1 :] = np.repeat(signs, np.diff(rows, append=len(q) - 1))
    return result
