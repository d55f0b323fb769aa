"""Stretches of a file along which the configurations follow one another closely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations


@dataclass(frozen=True)
class StretchOptions:
    """Limits of what counts as a path, and how it is cut.

    Attributes:
        close: Mean square of successive distances, by that of random pairs, of a
            path. Random order has 1. Whatever is measured along a path, in
            clusters, or line by line on a grid has less than 0.4 (UR10 Series A
            0.39 and 0.19, the grid of the UR5 0.25, Pandas 0.29 and 0.20); poses
            that somebody chose and ordered at will have more than 0.5 (TALOS 0.56,
            TIAGo 0.95 and 0.76, UR10 Series B 0.81).
        chance: Standard deviations by which it must fall short of 1 (von Neumann's
            ratio).
        unlike: The same ratio at the distance in the file from which they count as
            unlike: 1 - 1/e, where an exponential correlation has decayed to 1/e.
        blocks: Blocks that a file is cut into where its correlation allows it.
        fewest_blocks: Blocks that a file is cut into in any case: as many as there
            are folds.
        jump: Length of a step that is a jump, by that of the step at hand.
        fewest: Configurations whose order can tell anything: chance must not look
            like a path.
    """

    close: float = 0.5
    chance: float = 3.0
    unlike: float = 0.63
    blocks: int = 20
    fewest_blocks: int = 5
    jump: float = 2.0
    fewest: int = 10


OPTIONS = StretchOptions()


def stretches(rows: Observations) -> NDArray[np.int64]:
    """Label of the stretch of the file in which each row stands, shape (N,).

    It is a path if successive configurations z (joint positions in units of their
    scatter) are closer than chance would have them: the variogram

        g(h) = mean |z_(i+h) - z_i|^2 / mean |z_j - z_i|^2

    is 1 for every h in random order; g(1) is half of von Neumann's ratio (1941), with a
    standard deviation of at most 1 / sqrt(N). Then the file is cut into blocks as long
    as the correlation of its configurations: the first h with g(h) > 1 - 1/e. A
    repetition belongs to the block where its configuration first stands. Chains that
    are measured in turn have a path each.

    Returns:
        The labels, from 0; all -1 where the order tells nothing.
    """
    none = np.full(len(rows), -1)
    if len(rows) < OPTIONS.fewest:
        return none
    configuration = rows.groups()
    chain = np.unique([key.chain for key in rows.keys], return_inverse=True)[1]
    paths = np.stack([rows.files.codes, chain.reshape(-1)[rows.block_of]], axis=1)
    path = np.unique(paths, axis=0, return_inverse=True)[1].reshape(-1)
    in_order = rows.in_order[np.argsort(path[rows.in_order], kind="stable")]
    _, first = np.unique(configuration[in_order], return_index=True)
    order = in_order[np.sort(first)]
    file = path[order]
    q, scatter = rows.q[order], rows.q[order].std(axis=0)
    moves = scatter > 1e-9
    # In units of the scatter, without joints that stand still.
    z = (q - q.mean(axis=0))[:, moves] / scatter[moves]
    count = len(order)
    if count < OPTIONS.fewest or not z.any():
        return none
    near = _variogram(z, file, 1)
    if near > min(OPTIONS.close, 1.0 - OPTIONS.chance / np.sqrt(count)):
        return none
    longest = count // OPTIONS.fewest_blocks
    # Every lag of the short ones; of the long ones a tenth apart.
    lags = np.unique(np.geomspace(1, longest, 24 + count.bit_length() * 4).astype(int))
    length = next(
        (h for h in lags.tolist()[1:] if _variogram(z, file, h) > OPTIONS.unlike),
        longest,
    )
    length = max(length, min(count // OPTIONS.blocks, 2 * length), 1)
    block = _blocks(z, file, length)
    of = np.empty(count, np.int64)
    of[configuration[order]] = block
    return of[configuration]


def _variogram(z: Floats, file: NDArray[np.int64], lag: int) -> float:
    """Mean square distance at a distance in the file, by that of random pairs."""
    inside = file[lag:] == file[:-lag]
    if not inside.any():
        return 1.0
    squares = np.sum((z[lag:] - z[:-lag])[inside] ** 2, axis=1)
    # Of two independent configurations: twice the variance, which is 1 per joint.
    return float(squares.mean() / (2.0 * z.shape[1]))


def _blocks(z: Floats, file: NDArray[np.int64], length: int) -> NDArray[np.int64]:
    """Label of blocks of about equal length that end with their file.

    A jump near the nominal end, between two clusters or lines, is where the next block
    begins.
    """
    begins = np.zeros(len(file), bool)
    begins[0] = True
    begins[1:] = np.diff(file) != 0
    step = np.zeros(len(file))
    step[1:] = np.sum(np.diff(z, axis=0) ** 2, axis=1)
    starts = np.flatnonzero(begins)
    for start, stop in zip(starts, [*starts[1:], len(file)], strict=True):
        count = max(1, round((stop - start) / length))
        ends = start + np.arange(1, count) * (stop - start) // count
        for end in ends.tolist():
            low = end - (length - 1) // 2
            high = min(end + length // 2 + 1, stop)
            jump = low + int(np.argmax(step[low:high]))
            begins[jump if step[jump] > OPTIONS.jump**2 * step[end] else end] = True
    return np.asarray(np.cumsum(begins) - 1)
