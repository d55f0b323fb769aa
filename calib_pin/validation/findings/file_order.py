"""Measurements in the order of their files, divided where a frame differs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.observations import BlockKey, Indices, Observations

Kind = Literal["station", "tool"]
KINDS: tuple[Kind, ...] = ("station", "tool")


class Move(NamedTuple):
    """A frame that differs from some measurement on.

    Attributes:
        kind: Whose frame.
        keys: Blocks that have the frame, before they are divided.
        rank: Place of the first measurement after the move, in the order of the files.
    """

    kind: Kind
    keys: frozenset[BlockKey]
    rank: int


@dataclass(frozen=True)
class Job:
    """Measurements in the order of their files.

    Attributes:
        data: The measurements.
        rank: Place of each in that order among all of the job, shape (N,).
    """

    data: Observations
    rank: Indices

    @staticmethod
    def of(data: Observations) -> Job:
        """All measurements of a job, none of them set aside."""
        rank = np.argsort(data.in_order)
        return Job(data.weighted(np.ones(len(data))), rank)

    def rows(self, index: NDArray[np.generic]) -> Job:
        """Those of a mask, or of ascending positions."""
        return Job(self.data.rows(index), self.rank[index])

    def sample(self, count: int) -> Job:
        """About so many, evenly over the files."""
        if len(self.data) <= count:
            return self
        ranks = np.linspace(0, len(self.data) - 1, count).astype(np.int64)
        return self.rows(np.isin(self.rank, ranks))

    def divided(self, moves: Sequence[Move]) -> tuple[Job, Indices]:
        """The same with a name of its own for each frame behind a move.

        Returns:
            The measurements in their new blocks, and the position of each of these
            among what they were.
        """
        blocks = list(self.data.blocks)
        index = [np.arange(s.start, s.stop) for s in self.data.slices]
        for number, (kind, keys, at) in enumerate(moves):
            for k in [k for k, block in enumerate(blocks) if block.key in keys]:
                block, own = blocks[k], index[k]
                after = self.rank[own] >= at
                if kind == "station":
                    moved = replace(block, station=f"{block.station}~{number}")
                else:
                    moved = replace(block, tool=f"{block.tool}~{number}")
                blocks[k], index[k] = block.rows(~after), own[~after]
                blocks.append(moved.rows(after))
                index.append(own[after])
        kept = [k for k, block in enumerate(blocks) if len(block)]
        where = np.concatenate([index[k] for k in kept])
        data = Observations(tuple(blocks[k] for k in kept))
        return Job(data, self.rank[where]), where
