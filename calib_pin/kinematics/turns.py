"""Whole turns of revolute joints: which of them make a sequence the shortest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

TURN = 2.0 * np.pi

PREFERENCE = 1e-6
"""Weight of a joint's way from its middle beside its way from row to row: it decides
between sequences that are as short as each other."""


def shortest_turns(
    q: Floats,
    lower: Floats,
    upper: Floats,
    revolute: NDArray[np.bool_],
) -> Floats:
    """The same positions in the turns in which the joints move least from row to row.

    The joints do not matter to one another, so the sum of the ways of each is least: by
    dynamic programming over the turns within its limits. A greedy choice would run into
    a limit and have to come back. Of joints without limits the nearest turn is best.

    Args:
        q: Joint positions in their order, shape (N, n) [rad, m].
        lower: Lower limits, shape (n,); minus infinity where there is none.
        upper: Upper limits, shape (n,); infinity where there is none.
        revolute: The joints of which whole turns move nothing, shape (n,).

    Examples:
        >>> q = np.array([[1.0], [3.0], [-3.0]])
        >>> limit = np.array([6.0])
        >>> shortest_turns(q, -limit, limit, np.array([True])).round(3).tolist()
        [[1.0], [3.0], [3.283]]
    """
    result = np.array(q, float)
    for k in np.flatnonzero(revolute) if len(q) else ():
        if np.isinf(lower[k]) or np.isinf(upper[k]):
            result[:, k] = np.unwrap(q[:, k])
        else:
            result[:, k] = _shortest(q[:, k], float(lower[k]), float(upper[k]))
    return result


def _shortest(q: Floats, lower: float, upper: float) -> Floats:
    """The turns of one joint with limits, shape (N,)."""
    most = int(np.ceil((upper - lower) / TURN))
    turns = np.arange(-most, most + 1)
    allowed = q[:, None] + TURN * turns
    # A position beyond its limits is left where it is.
    inside = (allowed >= lower) & (allowed <= upper) | (turns == 0)
    at = np.where(inside, allowed, np.inf)
    cost = PREFERENCE * np.abs(at - 0.5 * (lower + upper))
    total = cost[0]
    best = np.empty(at.shape, np.intp)
    for row in range(1, len(q)):
        # From the turns along the first axis to those along the second.
        known = np.isfinite(total)
        ways = np.full((len(turns), len(turns)), np.inf)
        ways[known] = total[known, None] + np.abs(at[row] - at[row - 1, known, None])
        best[row] = ways.argmin(axis=0)
        total = ways.min(axis=0) + cost[row]
    chosen = np.empty(len(q), np.intp)
    chosen[-1] = total.argmin()
    for row in range(len(q) - 1, 0, -1):
        chosen[row - 1] = best[row, chosen[row]]
    return np.asarray(q + TURN * turns[chosen])
