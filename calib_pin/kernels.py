"""Compiled kernels: a chain at many configurations, for many parameter values.

They work on the chain as a product of constant links and joint motions,

    T(q) = L_0 Z_1(q_1) L_1 ... Z_n(q_n) L_n

where Z turns about z or shifts along it and only the links depend on parameters
(`calib_pin.segments`). What does not depend on parameters is computed once: `motions`
holds cosine, sine and shift of every joint position.

No pose is multiplied out. A point or a direction of the tool is carried from the tip
to the base, which takes half the operations of a matrix product for a beam and a
quarter for a point. The innermost loops run over a block of configurations in one array
whose parts lie a constant distance apart, so that the compiler sees that they do not
overlap and uses vector instructions.

All functions release the interpreter and take one thread; callers split members or
rows into pieces. Sums run in a fixed order within a member or a block, so that results
do not depend on the number of threads.

numba keeps machine code on disk and notices a change only in a function's own file. So
compiled functions call none of another file: `row_kernels` shares no more than the
layout of blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import atan2, cos, sin, sqrt
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib_pin.spatial import Floats

__all__ = [
    "BLOCK",
    "compiled",
    "links",
    "motions",
    "plane_distance_costs",
    "pose_costs",
    "poses",
    "position_costs",
]

Booleans = NDArray[np.bool_]
Indices = NDArray[np.int64]

BLOCK = 128
"""Configurations in a block; a constant, for the distances within work arrays.

It is compiled in: clear the machine code (`__pycache__`) after a change.
"""

_Function = TypeVar("_Function", bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile at the first call and keep the machine code on disk.

    Sums may be reordered and contracted, which vector instructions need; not-a-number
    and infinity keep their meaning.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"reassoc", "contract", "nsz", "arcp"},
    }
    try:
        jit = njit(**options, cache=True)(function)
    except RuntimeError:  # No folder to keep it in: a read-only installation.
        jit = njit(**options)(function)
    return cast(_Function, jit)


def motions(
    q: Floats, revolute: Booleans, groups: Sequence[int] = ()
) -> tuple[Floats, Indices]:
    """Joint motions of configurations in blocks.

    Args:
        q: Joint positions, shape (N, n) [rad, m], signs of reversed joints applied.
        revolute: True for joints that turn, shape (n,).
        groups: Sizes of successive groups of rows, each of which begins a new block;
            default one group.

    Returns:
        Cosines, then sines, then shifts of every block, shape (blocks, n, 3 BLOCK), and
        the first row of every block with the number of rows behind, (blocks + 1,).
    """
    first = np.cumsum([0, *(groups or [len(q)])])
    cuts = [np.arange(start, stop, BLOCK) for start, stop in pairwise(first)]
    starts = np.concatenate([*cuts, first[-1:]])
    result = np.zeros((len(starts) - 1, q.shape[1], 3 * BLOCK))
    _fill_motions(q, revolute, starts, result)
    return result, starts


@compiled
def _fill_motions(
    q: Floats, revolute: Booleans, starts: Indices, result: Floats
) -> None:
    for block in range(len(result)):
        for row in range(starts[block], starts[block + 1]):
            k = row - starts[block]
            for joint in range(q.shape[1]):
                motion, position = result[block, joint], q[row, joint]
                if revolute[joint]:
                    motion[k], motion[BLOCK + k] = cos(position), sin(position)
                else:
                    motion[k], motion[2 * BLOCK + k] = 1.0, position


@compiled
def links(
    constants: Floats,
    segment: Indices,
    parameter: Indices,
    twists: Floats,
    theta: Floats,
    result: Floats,
) -> None:
    """Links of a population: constants times the screws of their segment in order.

    Args:
        constants: Nominal links as rows of (R | p), shape (n + 1, 12).
        segment: Link of each screw, shape (K,).
        parameter: Parameter of each screw, shape (K,).
        twists: Unit twists (linear, angular), shape (K, 6).
        theta: Parameter values, shape (S, P).
        result: Filled with the links, shape (S, n + 1, 12).
    """
    for member in range(theta.shape[0]):
        result[member] = constants
        for k in range(len(segment)):
            amount = theta[member, parameter[k]]
            if amount == 0.0:
                continue
            link = result[member, segment[k]]
            x, y, z, px, py, pz = _exponential(twists[k], amount)
            (r00, r10, r20), (r01, r11, r21), (r02, r12, r22) = x, y, z
            for i in range(0, 12, 4):
                a, b, c = link[i], link[i + 1], link[i + 2]
                link[i] = a * r00 + b * r10 + c * r20
                link[i + 1] = a * r01 + b * r11 + c * r21
                link[i + 2] = a * r02 + b * r12 + c * r22
                link[i + 3] += a * px + b * py + c * pz


_Column: TypeAlias = tuple[float, float, float]


# Within the loop over screws a call would cost as much as the work.
@njit(inline="always")
def _exponential(
    twist: Floats, amount: float
) -> tuple[_Column, _Column, _Column, float, float, float]:
    """Exp(twist amount): the columns of its rotation, and its translation."""
    vx, vy, vz = twist[0], twist[1], twist[2]
    x, y, z = twist[3], twist[4], twist[5]
    square = x * x + y * y + z * z
    angle = sqrt(square) * amount
    if abs(angle) < 1e-2:
        # Series: the closed forms below cancel at small angles.
        a2 = angle * angle
        first = amount * (1.0 - a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0)))
        second = 0.5 * amount**2 * (1.0 - a2 / 12.0 * (1.0 - a2 / 30.0))
        third = amount**3 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0))
    else:
        first = amount * sin(angle) / angle
        second = 2.0 * (sin(0.5 * angle) / angle * amount) ** 2
        third = (amount - first) / square
    # R = I + first W + second W^2, p = (amount + second W + third W^2) v.
    cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    return (
        (
            1.0 + second * (x * x - square),
            second * x * y + first * z,
            second * x * z - first * y,
        ),
        (
            second * x * y - first * z,
            1.0 + second * (y * y - square),
            second * y * z + first * x,
        ),
        (
            second * x * z + first * y,
            second * y * z - first * x,
            1.0 + second * (z * z - square),
        ),
        amount * vx + second * cx + third * (y * cz - z * cy),
        amount * vy + second * cy + third * (z * cx - x * cz),
        amount * vz + second * cz + third * (x * cy - y * cx),
    )


@compiled
def _carry(
    chain: Floats, motion: Floats, size: int, work: Floats, directions: int
) -> None:
    """Carry the tool's origin and some of its axes through one block to the base.

    Args:
        chain: Links, shape (n + 1, 12).
        motion: Joint motions of the block, shape (n, 3 BLOCK).
        size: Configurations in the block.
        work: Filled: x, y, z of the point, then of each direction, BLOCK each.
        directions: The axes z, y, x of the tool, the first so many of them.
    """
    last = chain[len(chain) - 1]
    for i in range(3):
        for k in range(size):
            work[i * BLOCK + k] = last[4 * i + 3]
    for axis in range(directions):
        for i in range(3):
            for k in range(size):
                work[(3 * (axis + 1) + i) * BLOCK + k] = last[4 * i + 2 - axis]
    for joint in range(len(chain) - 2, -1, -1):
        if directions == 0:
            _step(chain[joint], motion[joint], size, work)
            continue
        # In pairs: a pair reads the motions and runs its loop once.
        for first in range(0, directions, 2):
            pair = work[3 * first * BLOCK : 3 * (first + 2) * BLOCK]
            weight = 1.0 if first == 0 else 0.0
            _step_pair(chain[joint], motion[joint], size, pair, weight)


@compiled
def _step(link: Floats, motion: Floats, size: int, point: Floats) -> None:
    """Carry a point through one joint and the link before it."""
    r00, r01, r02, px = link[0], link[1], link[2], link[3]
    r10, r11, r12, py = link[4], link[5], link[6], link[7]
    r20, r21, r22, pz = link[8], link[9], link[10], link[11]
    for k in range(size):
        cosine, sine = motion[k], motion[k + BLOCK]
        u, v = point[k], point[k + BLOCK]
        x, y = cosine * u - sine * v, sine * u + cosine * v
        z = point[k + 2 * BLOCK] + motion[k + 2 * BLOCK]
        point[k] = r00 * x + r01 * y + r02 * z + px
        point[k + BLOCK] = r10 * x + r11 * y + r12 * z + py
        point[k + 2 * BLOCK] = r20 * x + r21 * y + r22 * z + pz


@compiled
def _step_pair(
    link: Floats, motion: Floats, size: int, pair: Floats, weight: float
) -> None:
    """The same for two vectors: a point or, with weight 0, a direction; a direction."""
    r00, r01, r02, px = link[0], link[1], link[2], weight * link[3]
    r10, r11, r12, py = link[4], link[5], link[6], weight * link[7]
    r20, r21, r22, pz = link[8], link[9], link[10], weight * link[11]
    for k in range(size):
        cosine, sine = motion[k], motion[k + BLOCK]
        u, v = pair[k], pair[k + BLOCK]
        x, y = cosine * u - sine * v, sine * u + cosine * v
        z = pair[k + 2 * BLOCK] + weight * motion[k + 2 * BLOCK]
        u, v, bz = pair[k + 3 * BLOCK], pair[k + 4 * BLOCK], pair[k + 5 * BLOCK]
        bx, by = cosine * u - sine * v, sine * u + cosine * v
        pair[k] = r00 * x + r01 * y + r02 * z + px
        pair[k + BLOCK] = r10 * x + r11 * y + r12 * z + py
        pair[k + 2 * BLOCK] = r20 * x + r21 * y + r22 * z + pz
        pair[k + 3 * BLOCK] = r00 * bx + r01 * by + r02 * bz
        pair[k + 4 * BLOCK] = r10 * bx + r11 * by + r12 * bz
        pair[k + 5 * BLOCK] = r20 * bx + r21 * by + r22 * bz


@compiled
def position_costs(
    chains: Floats,
    motion: Floats,
    starts: Indices,
    values: Floats,
    weights: Floats,
    costs: Floats,
) -> None:
    """Half the sum of squared whitened residuals of positions, for every member.

    Args:
        chains: Links of the members, shape (S, n + 1, 12).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        values: Measured x, y, z, shape (3, N) [m].
        weights: Reciprocal standard deviations, shape (3, N) [1/m].
        costs: Filled, shape (S,).
    """
    work = np.empty(3 * BLOCK)
    for member in range(len(chains)):
        total = 0.0
        for block in range(len(motion)):
            start, size = starts[block], starts[block + 1] - starts[block]
            _carry(chains[member], motion[block], size, work, 0)
            for i in range(3):
                value, weight = values[i, start:], weights[i, start:]
                for k in range(size):
                    residual = (work[i * BLOCK + k] - value[k]) * weight[k]
                    total += residual * residual
        costs[member] = 0.5 * total


@compiled
def plane_distance_costs(
    chains: Floats,
    motion: Floats,
    starts: Indices,
    planes: Floats,
    index: Indices,
    values: Floats,
    weights: Floats,
    costs: Floats,
) -> None:
    """Half the sum of squared whitened residuals of distances along the tool's z axis.

    Args:
        chains: Links of the members, shape (S, n + 1, 12).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        planes: Normal and offset of each plane and member, shape (S, planes, 4).
        index: Plane of each block, shape (blocks,).
        values: Measured distances, shape (1, N) [m].
        weights: Reciprocal standard deviations, shape (1, N) [1/m].
        costs: Filled, shape (S,).
    """
    work = np.empty(6 * BLOCK)
    for member in range(len(chains)):
        total = 0.0
        for block in range(len(motion)):
            start, size = starts[block], starts[block + 1] - starts[block]
            _carry(chains[member], motion[block], size, work, 1)
            nx, ny, nz, offset = planes[member, index[block]]
            value, weight = values[0, start:], weights[0, start:]
            for k in range(size):
                height = offset + nx * work[k]
                height += ny * work[k + BLOCK] + nz * work[k + 2 * BLOCK]
                fall = nx * work[k + 3 * BLOCK]
                fall += ny * work[k + 4 * BLOCK] + nz * work[k + 5 * BLOCK]
                residual = -height / fall - value[k]
                residual *= weight[k]
                total += residual * residual
        costs[member] = 0.5 * total


@compiled
def pose_costs(
    chains: Floats,
    motion: Floats,
    starts: Indices,
    values: Floats,
    weights: Floats,
    costs: Floats,
) -> None:
    """Half the sum of squared whitened residuals of poses, for every member.

    Args:
        chains: Links of the members, shape (S, n + 1, 12).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        values: Measured x, y, z and rotation matrix by rows, shape (12, N).
        weights: Reciprocal standard deviations, shape (6, N) [1/m, 1/rad].
        costs: Filled, shape (S,).
    """
    work = np.empty(12 * BLOCK)
    R = np.empty((3, 3))
    for member in range(len(chains)):
        total = 0.0
        for block in range(len(motion)):
            start, size = starts[block], starts[block + 1] - starts[block]
            _carry(chains[member], motion[block], size, work, 3)
            for k in range(size):
                row = start + k
                for i in range(3):
                    residual = (work[i * BLOCK + k] - values[i, row]) * weights[i, row]
                    total += residual * residual
                for i in range(3):
                    for axis in range(3):
                        # Measured axis i against predicted axis, R_y^T R.
                        at = 3 * (3 - axis) * BLOCK + k
                        R[i, axis] = values[3 + i, row] * work[at]
                        R[i, axis] += values[6 + i, row] * work[at + BLOCK]
                        R[i, axis] += values[9 + i, row] * work[at + 2 * BLOCK]
                x, y, z = _rotation_vector(R)
                total += (x * weights[3, row]) ** 2
                total += (y * weights[4, row]) ** 2
                total += (z * weights[5, row]) ** 2
        costs[member] = 0.5 * total


@compiled
def _rotation_vector(R: Floats) -> tuple[float, float, float]:
    """Logarithm of a rotation matrix, by its quaternion as in `spatial.so3_log`."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    largest = max(trace, R[0, 0], R[1, 1], R[2, 2])
    if largest == trace:
        w = 1.0 + trace
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif largest == R[0, 0]:
        w, x = R[2, 1] - R[1, 2], 1.0 + 2.0 * R[0, 0] - trace
        y, z = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif largest == R[1, 1]:
        w, y = R[0, 2] - R[2, 0], 1.0 + 2.0 * R[1, 1] - trace
        x, z = R[0, 1] + R[1, 0], R[1, 2] + R[2, 1]
    else:
        w, z = R[1, 0] - R[0, 1], 1.0 + 2.0 * R[2, 2] - trace
        x, y = R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = sqrt(x * x + y * y + z * z)
    factor = 2.0 * atan2(sine, w) / sine if sine > 1e-12 * w else 2.0 / w
    return factor * x, factor * y, factor * z


@compiled
def poses(chain: Floats, motion: Floats, starts: Indices, result: Floats) -> None:
    """Tool poses of one chain.

    Args:
        chain: Links, shape (n + 1, 12).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        result: Filled with poses, shape (N, 4, 4).
    """
    work = np.empty(12 * BLOCK)
    for block in range(len(motion)):
        start, size = starts[block], starts[block + 1] - starts[block]
        _carry(chain, motion[block], size, work, 3)
        for k in range(size):
            T = result[start + k]
            for i in range(3):
                T[i, 3] = work[i * BLOCK + k]
                T[3, i] = 0.0
                for axis in range(3):
                    T[i, axis] = work[(3 * (3 - axis) + i) * BLOCK + k]
            T[3, 3] = 1.0
