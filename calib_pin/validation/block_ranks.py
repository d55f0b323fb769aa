"""How many errors of the robot blocks of measurements tell, alone and beside others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import WEAK, column_space, rounding
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.measured import Block
from calib_pin.kinematics.spatial import Floats

ROWS, LEAST = 10_000, 60
"""Measurements that are looked at: of all blocks, and least of each."""


class BlockRanks(NamedTuple):
    """Numbers of errors of the robot that a block of measurements tells.

    Attributes:
        alone: Those that it tells by itself.
        added: Those that the others do not tell without it.
    """

    alone: int
    added: int


def block_ranks(fitted: Fit) -> tuple[BlockRanks, ...]:
    """The ranks of all blocks by what they tell at the solution of a fit.

    A direction counts as in a fit: by its standard deviation, see `directions.WEAK`.
    What only one block has, such as the frame of its station, it absorbs by itself. The
    rest of a block is a triangular factor, and those of all but one are joined from
    those before and those behind it, so the work grows with the number of blocks.
    """
    problem, robot = fitted.problem, fitted.directions.robot
    if len(problem.blocks) == 1:
        return (BlockRanks(robot.shape[1], robot.shape[1]),)
    parameters, further = problem.parameters, problem.further
    known = further.jacobian(fitted.theta)[: len(further) - further.priors]
    indices = [np.unique(block.part.index) for block in problem.blocks]
    used = np.bincount(np.concatenate(indices), minlength=len(parameters))
    used[known.any(axis=0)] += 2
    nuisances = parameters.free & parameters.nuisance
    shared = np.eye(len(parameters))[:, nuisances & (used > 1)]
    every = np.column_stack([shared, robot, fitted.directions.weak])
    share = max(LEAST, ROWS // len(problem.blocks))
    factors = [
        _factor(fitted, block, nuisances & (used == 1), every, share)
        for block in problem.blocks
    ]
    distances = known * parameters.scales @ every
    sigma0 = fitted.sigma0 if np.isfinite(fitted.sigma0) else 0.0

    def rank(*parts: Floats) -> int:
        A = np.concatenate([*parts, distances])
        U = column_space(A[:, : shared.shape[1]])
        rest = A[:, shared.shape[1] :]
        s = np.linalg.svd(rest - U @ (U.T @ rest), compute_uv=False)
        return int((s > max(sigma0 / WEAK, rounding(A) * np.linalg.norm(A, 2))).sum())

    nothing = np.zeros((0, every.shape[1]))
    before, behind = _joined(nothing, factors), _joined(nothing, factors[::-1])[::-1]
    whole = rank(before[-1])
    return tuple(
        BlockRanks(rank(factor), whole - rank(before[k], behind[k + 1]))
        for k, factor in enumerate(factors)
    )


def _joined(first: Floats, factors: Sequence[Floats]) -> list[Floats]:
    """Factors of the first 0, 1, 2, ... of some."""
    result = [first]
    for factor in factors:
        joined = np.concatenate([result[-1], factor])
        result.append(np.asarray(np.linalg.qr(joined, mode="r")))
    return result


def _factor(
    fitted: Fit, block: Block, own: NDArray[np.bool_], every: Floats, count: int
) -> Floats:
    """Triangular factor of a block without what it absorbs by itself, (k, k).

    Args:
        fitted: The fit.
        block: The block.
        own: Parameters that a single block absorbs, shape (P,).
        every: Scaled directions that are looked at, shape (P, k).
        count: Number of measurements that stand for all.
    """
    problem, theta, part, data = fitted.problem, fitted.theta, block.part, block.data
    few = min(count, len(data))
    rows = np.linspace(0, len(data) - 1, few).astype(np.int64)
    sigma = block.table(problem.sigma)[rows]
    J = part.jacobian(theta[part.index], data.rows(rows), sigma)
    scales = problem.parameters.scales[part.index] * np.sqrt(len(data) / few)
    A = J.reshape(-1, J.shape[2]) * scales
    U = column_space(A[:, own[part.index]])
    columns = A @ every[part.index]
    return np.asarray(np.linalg.qr(columns - U @ (U.T @ columns), mode="r"))
