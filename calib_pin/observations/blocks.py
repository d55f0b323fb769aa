"""Observations: blocks of measurements, one behind the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.observations.conditions import Conditions, Source, approached
from calib_pin.observations.labels import Booleans, Floats, Indices, Labels
from calib_pin.observations.measurements import (
    BlockKey,
    Measurements,
    SourcedRows,
    with_joints,
)
from calib_pin.setup.arguments import parse, settle

Frame = Literal["station", "tool"]
FRAMES: tuple[Frame, ...] = ("station", "tool")
"""Frames that measurements are taken in, each by its name in their block."""


@dataclass(frozen=True, repr=False)
class Observations(SourcedRows):
    """Blocks of measurements, one behind the other.

    Row k of the N measurements is counted through the blocks in their order; blocks
    without measurements are left out, if there are others.

    Attributes:
        blocks: The blocks, each with another key.

    Raises:
        InputError: If there is no block, or the joints differ.
    """

    blocks: tuple[Measurements, ...]

    def __post_init__(self) -> None:
        """Check the blocks."""
        settle(self)
        if not self.blocks:
            raise InputError("there are no measurements")
        if any(block.joints != self.joints for block in self.blocks):
            raise InputError("cannot join measurements of different joints")

    def __repr__(self) -> str:
        """The number of measurements of each block."""
        blocks = (f"{len(block)} {block.key}" for block in self.blocks)
        return f"Observations({'; '.join(blocks)})"

    @staticmethod
    def of(*parts: Measurements | Observations) -> Observations:
        """Measurements of any blocks together; those of one block are joined.

        Raises:
            InputError: If joints differ, or only some measurements of a block have
                standard deviations.
        """
        if len(parts) == 1 and isinstance(parts[0], Observations):
            return parts[0]
        by_key: dict[BlockKey, list[Measurements]] = {}
        for part in parse("measurements", parts, Sequence[Measurements | Observations]):
            blocks = part.blocks if isinstance(part, Observations) else (part,)
            for block in blocks:
                by_key.setdefault(block.key, []).append(block)
        joined = [Measurements.concatenate(blocks) for blocks in by_key.values()]
        return Observations(
            tuple(block for block in joined if len(block)) or tuple(joined[:1])
        )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, the columns of `q`."""
        return self.blocks[0].joints

    @property
    def keys(self) -> tuple[BlockKey, ...]:
        """Model, chain, station and tool of each block."""
        return tuple(block.key for block in self.blocks)

    @property
    def models(self) -> tuple[str, ...]:
        """Names of the measurement models, each once."""
        return tuple(dict.fromkeys(block.model for block in self.blocks))

    @property
    def only(self) -> Measurements:
        """The only block.

        Raises:
            InputError: If there are several.
        """
        if len(self.blocks) > 1:
            raise InputError(f"there are {len(self.blocks)} blocks of measurements")
        return self.blocks[0]

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Where the measurements of each block stand among all."""
        ends = np.cumsum([0, *map(len, self.blocks)]).tolist()
        return tuple(map(slice, ends[:-1], ends[1:]))

    @cached_property
    def q(self) -> Floats:
        """Commanded joint positions, shape (N, n) [rad, m]."""
        return self._joined("q")

    @cached_property
    def validate(self) -> Booleans:
        """True for the rows that must not be fitted, shape (N,)."""
        return np.concatenate([block.validate for block in self.blocks])

    @cached_property
    def lines(self) -> Indices:
        """Line of each row in its file, shape (N,); 0 where there is no file."""
        return np.concatenate([block.lines for block in self.blocks])

    @cached_property
    def weight(self) -> Floats:
        """Factor of the precision of each row, shape (N,)."""
        return self._joined("weight")

    @cached_property
    def target(self) -> Labels:
        """Target of each row."""
        return Labels.concatenate([block.target for block in self.blocks])

    @cached_property
    def conditions(self) -> Conditions:
        """Conditions of each row beside the joint positions."""
        return Conditions.concatenate([block.conditions for block in self.blocks])

    @cached_property
    def files(self) -> Labels:
        """File of each row."""
        return Labels.concatenate([block.files for block in self.blocks])

    @cached_property
    def block_of(self) -> Indices:
        """Position of the block of each row, shape (N,)."""
        return np.repeat(np.arange(len(self.blocks)), list(map(len, self.blocks)))

    @cached_property
    def in_order(self) -> Indices:
        """The rows in the order of their files and lines, shape (N,)."""
        return np.lexsort((self.lines, self.files.codes))

    def __len__(self) -> int:
        """Number of measurements."""
        return sum(map(len, self.blocks))

    def rows(self, index: NDArray[Any]) -> Observations:
        """The rows of a boolean mask or of ascending positions."""
        positions = np.arange(len(self))
        order = positions[index]
        if np.array_equal(order, positions):
            return self
        picked = [
            block.rows(order[(order >= rows.start) & (order < rows.stop)] - rows.start)
            for block, rows in zip(self.blocks, self.slices, strict=True)
        ]
        return Observations(tuple(b for b in picked if len(b)) or (picked[0],))

    def weighted(self, weight: Floats) -> Observations:
        """The same with other weights, shape (N,)."""
        if np.array_equal(weight, self.weight):
            return self
        parts = zip(self.blocks, self.slices, strict=True)
        blocks = tuple(replace(block, weight=weight[rows]) for block, rows in parts)
        result, known = Observations(blocks), {**self.__dict__}
        # Nothing else changes.
        known.pop("weight")
        result.__dict__.update(known | {"blocks": result.blocks})
        return result

    def sample(self, count: int) -> Observations:
        """About `count` rows, spread evenly over the blocks and their targets."""
        if len(self) <= count:
            return self
        share = count / len(self)
        least = min(20, max(1, count // len(self.blocks)))
        counts = (max(least, int(len(block) * share)) for block in self.blocks)
        return Observations(tuple(map(Measurements.sample, self.blocks, counts)))

    @cached_property
    def things(self) -> Indices:
        """Label of the block and the target of each row, shape (N,)."""
        return np.asarray(self.block_of * len(self.target.names) + self.target.codes)

    def _joined(self, name: str) -> Floats:
        if len(self.blocks) == 1:
            return np.asarray(getattr(self.blocks[0], name))
        return np.concatenate([getattr(block, name) for block in self.blocks])


def apart(
    data: Observations, kind: Frame, names: Labels
) -> tuple[Observations, Indices]:
    """Measurements of which some have a station, or a tool, of their own.

    Args:
        data: The N measurements.
        kind: Whether it is the station or the tool.
        names: What follows the name of that of each, length N; empty if it stays.

    Returns:
        The measurements in their new blocks, and the position of each of these among
        what they were.
    """
    blocks, index = [], []
    for block, rows in zip(data.blocks, data.slices, strict=True):
        for name in names[rows].distinct:
            members = np.flatnonzero(names[rows].where(name))
            whole = (getattr(block, kind) or kind) + name
            named: dict[str, Any] = {kind: whole} if name else {}
            blocks.append(replace(block.rows(members), **named))
            index.append(rows.start + members)
    return Observations.of(*blocks), np.concatenate(index)


def with_directions(data: Observations) -> Observations:
    """Measurements with the directions of approach that nothing states.

    They are those from the measurement of the chain before in the file, by the time of
    the measurements if that is stated, else by their lines. The first motion of a joint
    is not known, and nothing is of relative measurements, whose starts stand elsewhere.

    Args:
        data: Measurements of whole files.
    """
    source: Source = "time" if len(data.conditions.time) else "order"
    order = data.in_order
    if source == "time":
        order = np.lexsort((data.lines, data.conditions.time, data.files.codes))
    directions = np.zeros(data.q.shape, np.int8)
    chains = Labels.of([key.chain for key in data.keys]).codes[data.block_of]
    # Of one file and chain, in their order.
    group = data.files.codes[order] * len(data.keys) + chains[order]
    order = order[np.argsort(group, kind="stable")]
    ends = np.flatnonzero(np.diff(np.sort(group))) + 1
    for run in np.split(order, ends):
        for joint, position in enumerate(data.q.T):
            directions[run, joint] = approached(position[run, None])[:, 0]
    blocks = []
    for block, rows in zip(data.blocks, data.slices, strict=True):
        held, signs = block.conditions, directions[rows]
        if held.direction.size:
            signs = np.where(held.direction.any(axis=0), held.direction, signs)
        if not block.start.size and not np.array_equal(signs, held.direction):
            held = replace(held, direction=signs, source=source)
        blocks.append(replace(block, conditions=held))
    return Observations(tuple(blocks))


def states_sigmas(data: Observations) -> bool:
    """Whether the measurements state all their standard deviations."""
    return all(block.sigma is not None for block in data.blocks)


def fitted_and_held_out(data: Observations) -> tuple[Observations, Observations]:
    """The training and the validation measurements, by the `set` column.

    Raises:
        InputError: If no measurement is left to fit.
    """
    if not len(data):
        raise InputError("there are no measurements")
    if data.validate.all():
        reason = "no measurement is left to fit: all are marked for validation"
        raise InputError(reason, column="set")
    return data.rows(~data.validate), data.rows(data.validate)


def of_joints(data: Observations, joints: tuple[str, ...]) -> Observations:
    """Measurements of other joints; those that they do not state are zero."""
    if joints == data.joints:
        return data
    return Observations(tuple(with_joints(block, joints) for block in data.blocks))
