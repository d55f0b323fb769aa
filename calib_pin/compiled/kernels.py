"""Compiled kernels: a chain at many configurations, for many parameter values.

They work on the chain as a product of constant links and joint motions,

    T(q) = L_0 Z_1(q_1) L_1 ... Z_n(q_n) L_n

where Z turns about z or shifts along it. The links depend on parameters
(`calib_pin.estimation.many_rows`); the motions (`calib_pin.compiled.blocks`) do so
where joint corrections add to them.

No pose is multiplied out. A point or a direction of the tool is carried from the tip
to the base, which takes half the operations of a matrix product for a beam and a
quarter for a point; there it is compared with what was measured. Each comparison gives
the sum of squared whitened residuals of one block; vectors stand by components, BLOCK
apart. A sum of squares is called a cost here, without the half.

Measured against batches of numpy (one thread): a population costs 1/11 to 1/110 of the
time, a whole differential evolution 1/5 (60 members, 20 measurements) to 1/20, and the
normal equations of very many measurements 1/8.

All functions release the interpreter and take one thread; callers split members or
rows into pieces. Sums run in a fixed order within a member or a block, so that results
do not depend on the number of threads.
"""

from __future__ import annotations

from math import atan2, cos, nan, sin, sqrt
from typing import NamedTuple

import numpy as np

from calib_pin.compiled.blocks import BLOCK, Booleans, Indices, compiled
from calib_pin.kinematics.spatial import Floats


@compiled
def position_cost(p: Floats, centers: Floats, values: Floats, weights: Floats) -> float:
    """Sum of squares of points against centers (x, y, z)."""
    total = 0.0
    for i in range(3):
        value, weight = values[i], weights[i]
        for k in range(len(value)):
            at = i * BLOCK + k
            residual = (p[at] - centers[at] - value[k]) * weight[k]
            total += residual * residual
    return total


@compiled
def distance_cost(p: Floats, centers: Floats, value: Floats, weight: Floats) -> float:
    """Sum of squares of distances from centers (x, y, z, bias)."""
    total = 0.0
    for k in range(len(value)):
        x, y = p[k] - centers[k], p[k + BLOCK] - centers[k + BLOCK]
        z = p[k + 2 * BLOCK] - centers[k + 2 * BLOCK]
        length = sqrt(x * x + y * y + z * z) + centers[k + 3 * BLOCK]
        residual = (length - value[k]) * weight[k]
        total += residual * residual
    return total


@compiled
def height_cost(p: Floats, planes: Floats, value: Floats, weight: Floats) -> float:
    """Sum of squares of heights above planes (normal, offset)."""
    total = 0.0
    for k in range(len(value)):
        height = planes[k + 3 * BLOCK] + planes[k] * p[k]
        height += planes[k + BLOCK] * p[k + BLOCK]
        height += planes[k + 2 * BLOCK] * p[k + 2 * BLOCK]
        residual = (height - value[k]) * weight[k]
        total += residual * residual
    return total


@compiled
def beam_cost(p: Floats, planes: Floats, value: Floats, weight: Floats) -> float:
    """Sum of squares of distances along the tool's z axis to planes."""
    total = 0.0
    for k in range(len(value)):
        nx, ny, nz = planes[k], planes[k + BLOCK], planes[k + 2 * BLOCK]
        height = planes[k + 3 * BLOCK] + nx * p[k]
        height += ny * p[k + BLOCK] + nz * p[k + 2 * BLOCK]
        fall = nx * p[k + 3 * BLOCK]
        fall += ny * p[k + 4 * BLOCK] + nz * p[k + 5 * BLOCK]
        residual = (-height / fall - value[k]) * weight[k]
        total += residual * residual
    return total


@compiled
def pixel_cost(p: Floats, camera: Floats, values: Floats, weights: Floats) -> float:
    """Sum of squares of pixels, see `measurement_models.pinhole`.

    Args:
        p: Points in the camera by components.
        camera: Intrinsics, and the depth from which on a point is seen, shape (10,).
        values: Measured pixels, shape (2, rows).
        weights: Reciprocal standard deviations, shape (2, rows).
    """
    f_x, f_y, c_x, c_y, k_1, k_2, p_1, p_2, k_3, near = camera
    total = 0.0
    for k in range(values.shape[1]):
        depth = p[k + 2 * BLOCK]
        depth = depth if depth > near else nan
        x, y = p[k] / depth, p[k + BLOCK] / depth
        xx, yy, xy = x * x, y * y, 2.0 * x * y
        rr = xx + yy
        s = 1.0 + rr * (k_1 + rr * (k_2 + rr * k_3))
        u = f_x * (x * s + p_1 * xy + p_2 * (rr + 2.0 * xx)) + c_x
        v = f_y * (y * s + p_1 * (rr + 2.0 * yy) + p_2 * xy) + c_y
        u = (u - values[0, k]) * weights[0, k]
        v = (v - values[1, k]) * weights[1, k]
        total += u * u + v * v
    return total


@compiled
def pose_cost(p: Floats, values: Floats, weights: Floats) -> float:
    """Sum of squares of poses: measured x, y, z and rotation matrix by rows."""
    total, least = 0.0, 3.0
    turned = np.empty(9 * BLOCK)
    for i in range(3):
        value, weight = values[i], weights[i]
        for k in range(len(value)):
            residual = (p[i * BLOCK + k] - value[k]) * weight[k]
            total += residual * residual
        # Measured axis i against predicted axes, R_y^T R.
        a, b, c = values[3 + i], values[6 + i], values[9 + i]
        for axis in range(3):
            at = p[3 * (3 - axis) * BLOCK : 3 * (4 - axis) * BLOCK]
            result = turned[(3 * i + axis) * BLOCK : (3 * i + axis + 1) * BLOCK]
            for k in range(len(a)):
                result[k] = a[k] * at[k] + b[k] * at[k + BLOCK]
                result[k] += c[k] * at[k + 2 * BLOCK]
    for k in range(values.shape[1]):
        trace = turned[k] + turned[k + 4 * BLOCK] + turned[k + 8 * BLOCK]
        least = min(least, trace)
    if least > 2.0:
        return total + little_turned(turned, weights[3:])
    for k in range(values.shape[1]):
        x, y, z = rotation_vector(turned[k::BLOCK].copy().reshape(3, 3))
        total += (x * weights[3, k]) ** 2
        total += (y * weights[4, k]) ** 2
        total += (z * weights[5, k]) ** 2
    return total


@compiled
def little_turned(R: Floats, weights: Floats) -> float:
    """Sum of squares of rotation vectors below 60 degrees, by vector instructions.

    With the quaternion (w, v) the angle is 4 atan(x), x^2 = (1 - w) / (1 + w), and the
    first term of the series left out is below rounding.
    """
    total = 0.0
    one, two, three = weights[0], weights[1], weights[2]
    for k in range(len(one)):
        w = 0.5 * sqrt(1.0 + R[k] + R[k + 4 * BLOCK] + R[k + 8 * BLOCK])
        s = -(1.0 - w) / (1.0 + w)
        series = 1.0 / 25.0 + s * (1.0 / 27.0)
        series = 1.0 / 19.0 + s * (1.0 / 21.0 + s * (1.0 / 23.0 + s * series))
        series = 1.0 / 13.0 + s * (1.0 / 15.0 + s * (1.0 / 17.0 + s * series))
        series = 1.0 / 7.0 + s * (1.0 / 9.0 + s * (1.0 / 11.0 + s * series))
        series = 1.0 + s * (1.0 / 3.0 + s * (1.0 / 5.0 + s * series))
        factor = series / (w * (1.0 + w))
        x = factor * (R[k + 7 * BLOCK] - R[k + 5 * BLOCK]) * one[k]
        y = factor * (R[k + 2 * BLOCK] - R[k + 6 * BLOCK]) * two[k]
        z = factor * (R[k + 3 * BLOCK] - R[k + BLOCK]) * three[k]
        total += x * x + y * y + z * z
    return total


@compiled
def rotation_vector(R: Floats) -> tuple[float, float, float]:
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


COMPARISONS = ("position", "distance", "height", "beam", "pixel", "pose")
"""How the tool can be compared with measured values."""

POSITION, DISTANCE, HEIGHT, BEAM, PIXEL, POSE = range(len(COMPARISONS))


@compiled
def _carry(
    chain: Floats,
    tips: Floats,
    index: Indices,
    motion: Floats,
    size: int,
    work: Floats,
    directions: int,
) -> None:
    """Carry a point and some axes of the tool through one block to the base.

    Args:
        chain: Links, shape (n + 1, 12).
        tips: Points behind the last joint, shape (J, 3) [m].
        index: Which of them each configuration looks at.
        motion: Joint motions of the block, shape (n, 3 BLOCK).
        size: Configurations in the block.
        work: Filled: x, y, z of the point, then of each direction, BLOCK each.
        directions: The axes z, y, x of the tool, the first so many of them.
    """
    _gather(tips, index, work)
    last = chain[len(chain) - 1]
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


class Rows(NamedTuple):
    """Data of N rows that do not depend on a member's parameters.

    Attributes:
        starts: First row of every block, shape (blocks + 1,).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        begin: Those where relative measurements start; no blocks where rows are none.
        revolute: True for joints that turn, shape (n,).
        joints: Joint of each correction, shape (C,).
        factors: Change of its position by the correction's amount, shape (C, N).
        begin_factors: The same where relative measurements start.
        point: Which point of the tool a row looks at, shape (N,).
        site: Which site it is compared with, shape (N,).
        values: Measured values, shape (D, N).
        weights: Reciprocal standard deviations of the residual, shape (d, N).
    """

    starts: Indices
    motion: Floats
    begin: Floats
    revolute: Booleans
    joints: Indices
    factors: Floats
    begin_factors: Floats
    point: Indices
    site: Indices
    values: Floats
    weights: Floats


@compiled
def population_costs(
    comparison: int,
    chains: Floats,
    amounts: Floats,
    points: Floats,
    sites: Floats,
    rows: Rows,
    costs: Floats,
) -> None:
    """Half the sum of squared whitened residuals, for every member.

    Args:
        comparison: Position in `COMPARISONS`.
        chains: Links of the members, shape (S, n + 1, 12).
        amounts: Their joint corrections, shape (S, C).
        points: Points of the tool, shape (S, J, 3) [m].
        sites: References that these are compared with, shape (S, L, w).
        rows: The rows.
        costs: Filled, shape (S,).
    """
    directions = 3 if comparison == POSE else 1 if comparison == BEAM else 0
    work, begin = np.empty(12 * BLOCK), np.empty(3 * BLOCK)
    against = np.empty(10 * BLOCK)
    moved = np.empty(rows.motion.shape[1:])
    for member in range(len(chains)):
        chain, amount, total = chains[member], amounts[member], 0.0
        tips = _at_last_joint(chain[len(chain) - 1], points[member])
        for block in range(len(rows.motion)):
            start, stop = rows.starts[block], rows.starts[block + 1]
            size, point = stop - start, rows.point[start:stop]
            motion = rows.motion[block]
            if len(amount):
                factors = rows.factors[:, start:stop]
                _move(motion, rows.revolute, rows.joints, factors, amount, moved)
                motion = moved
            _carry(chain, tips, point, motion, size, work, directions)
            if len(rows.begin):
                motion = rows.begin[block]
                if len(amount):
                    factors = rows.begin_factors[:, start:stop]
                    _move(motion, rows.revolute, rows.joints, factors, amount, moved)
                    motion = moved
                _carry(chain, tips, point, motion, size, begin, 0)
                for k in range(3 * BLOCK):
                    work[k] -= begin[k]
            _gather(sites[member], rows.site[start:stop], against)
            value, weight = rows.values[:, start:stop], rows.weights[:, start:stop]
            if comparison == POSITION:
                total += position_cost(work, against, value, weight)
            elif comparison == DISTANCE:
                total += distance_cost(work, against, value[0], weight[0])
            elif comparison == HEIGHT:
                total += height_cost(work, against, value[0], weight[0])
            elif comparison == BEAM:
                total += beam_cost(work, against, value[0], weight[0])
            elif comparison == PIXEL:
                total += pixel_cost(work, sites[member, 0], value, weight)
            else:
                total += pose_cost(work, value, weight)
        costs[member] = 0.5 * total


@compiled
def move(
    motion: Floats,
    starts: Indices,
    revolute: Booleans,
    joints: Indices,
    factors: Floats,
    amounts: Floats,
    moved: Floats,
) -> None:
    """Joint motions of all blocks with corrections of the joint positions.

    Args:
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        revolute: True for joints that turn, shape (n,).
        joints: Joint of each correction, shape (C,).
        factors: Change of its position by the amount, shape (C, N).
        amounts: Amounts of the corrections, shape (C,).
        moved: Filled as motion.
    """
    for block in range(len(motion)):
        part = factors[:, starts[block] : starts[block + 1]]
        _move(motion[block], revolute, joints, part, amounts, moved[block])


@compiled
def _at_last_joint(link: Floats, points: Floats) -> Floats:
    """Points of the tool behind the last joint."""
    result = np.empty_like(points)
    for k in range(len(points)):
        x, y, z = points[k]
        for i in range(3):
            a, b, c, p = link[4 * i : 4 * i + 4]
            result[k, i] = a * x + b * y + c * z + p
    return result


@compiled
def _gather(table: Floats, index: Indices, result: Floats) -> None:
    """Entries of every row, shape (L, w), by components BLOCK apart."""
    for i in range(table.shape[1]):
        first = i * BLOCK
        if len(table) == 1:
            value = table[0, i]
            for k in range(len(index)):
                result[first + k] = value
            continue
        for k in range(len(index)):
            result[first + k] = table[index[k], i]


@compiled
def _move(
    motion: Floats,
    revolute: Booleans,
    joints: Indices,
    factors: Floats,
    amounts: Floats,
    moved: Floats,
) -> None:
    """Joint motions of a block with corrections of the joint positions.

    Args:
        motion: Joint motions of the block, shape (n, 3 BLOCK).
        revolute: True for joints that turn, shape (n,).
        joints: Joint of each correction, shape (C,).
        factors: Change of its position by the amount, shape (C, rows).
        amounts: Amounts of the corrections, shape (C,).
        moved: Filled as motion.
    """
    size = factors.shape[1]
    for joint in range(len(motion)):
        source, result = motion[joint], moved[joint]
        # The corrections first stand where the cosines will.
        for k in range(size):
            result[k] = 0.0
        for correction, of_joint in enumerate(joints):
            if of_joint == joint:
                amount, factor = amounts[correction], factors[correction]
                for k in range(size):
                    result[k] += amount * factor[k]
        if not revolute[joint]:
            for k in range(size):
                result[2 * BLOCK + k] = source[2 * BLOCK + k] + result[k]
                result[k], result[BLOCK + k] = 1.0, 0.0
            continue
        largest = 0.0
        for k in range(size):
            largest = max(largest, abs(result[k]))
            result[2 * BLOCK + k] = 0.0
        if largest < 0.5:
            _turn_little(source, size, result)
            continue
        for k in range(size):
            c, s = cos(result[k]), sin(result[k])
            result[k] = source[k] * c - source[BLOCK + k] * s
            result[BLOCK + k] = source[BLOCK + k] * c + source[k] * s


@compiled
def _turn_little(given: Floats, size: int, result: Floats) -> None:
    """Cosines and sines of sums of angles, by series, which vector instructions take.

    Below half a radian the first term left out is below rounding.
    """
    for k in range(size):
        angle = result[k]
        a = angle * angle
        s = 1.0 - a / 110.0 * (1.0 - a / 156.0 * (1.0 - a / 210.0))
        s = angle * (
            1.0 - a / 6.0 * (1.0 - a / 20.0 * (1.0 - a / 42.0 * (1.0 - a / 72.0 * s)))
        )
        c = 1.0 - a / 90.0 * (1.0 - a / 132.0 * (1.0 - a / 182.0))
        c = 1.0 - a / 2.0 * (1.0 - a / 12.0 * (1.0 - a / 30.0 * (1.0 - a / 56.0 * c)))
        result[k] = given[k] * c - given[BLOCK + k] * s
        result[BLOCK + k] = given[BLOCK + k] * c + given[k] * s


@compiled
def poses(chain: Floats, motion: Floats, starts: Indices, result: Floats) -> None:
    """Tool poses of one chain.

    Args:
        chain: Links, shape (n + 1, 12).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        result: Filled with poses, shape (N, 4, 4).
    """
    work, origin = np.empty(12 * BLOCK), np.zeros(BLOCK, np.int64)
    tips = _at_last_joint(chain[len(chain) - 1], np.zeros((1, 3)))
    for block in range(len(motion)):
        start, size = starts[block], starts[block + 1] - starts[block]
        _carry(chain, tips, origin[:size], motion[block], size, work, 3)
        for k in range(size):
            T = result[start + k]
            for i in range(3):
                T[i, 3] = work[i * BLOCK + k]
                T[3, i] = 0.0
                for axis in range(3):
                    T[i, axis] = work[(3 * (3 - axis) + i) * BLOCK + k]
            T[3, 3] = 1.0
