"""Compiled kernels for very many rows: normal equations and triangular factors.

The columns are those of the chain of `kernels`: the body twists at the ends of its
links. A row of the Jacobian acts on twists as a wrench does, and is carried as one from
the tool to the base, block by block; the columns of a block are multiplied or reflected
while they are in the cache.

A correction of a joint's position is a twist along the joint's own motion, which is one
component of the wrench at the joint, times a basis function of the row.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from calib_pin.compiled.blocks import BLOCK, Indices, compiled
from calib_pin.kinematics.spatial import Floats


class Corrections(NamedTuple):
    """Corrections of joint positions at N rows.

    Attributes:
        twists: Column of each among the twists of the links: the motion of its joint,
            at the end of the link before that, shape (C,).
        factors: Change of the joint's motion by the correction's amount, shape (C, N).
    """

    twists: Indices
    factors: Floats


@compiled
def normal_equations(
    chain: Floats,
    motion: Floats,
    starts: Indices,
    corrections: Corrections,
    J_pose: Floats,
    others: Floats,
    weights: Floats,
    result: Floats,
) -> None:
    """Products of all pairs of columns of a Jacobian by the twists of every link.

    Args:
        chain: Links, shape (n + 1, 12).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        corrections: What moves the joints beside.
        J_pose: Derivatives by the tool's body twist, shape (N, d, 6).
        others: Further columns of the same rows, shape (N, d, K).
        weights: Factors of the rows' components, shape (N, d).
        result: Filled, lower half, shape (M, M), M >= 6 (n + 1) + C + K a multiple of
            4: the twists at the ends of the links from base to tool, then the
            corrections, then the others.
    """
    panel = np.zeros((weights.shape[1], len(result), BLOCK))
    first = 6 * len(chain) + len(corrections.twists)
    result[:] = 0.0
    for block in range(len(motion)):
        rows = slice(starts[block], starts[block + 1])
        given = J_pose[rows], others[rows], weights[rows]
        _fill(chain, motion[block], *given, panel, first)
        _correct(corrections, starts[block], starts[block + 1], 6 * len(chain), panel)
        _gram(panel, starts[block + 1] - starts[block], result)


@compiled
def triangular_factor(
    chain: Floats,
    motion: Floats,
    starts: Indices,
    corrections: Corrections,
    J_pose: Floats,
    others: Floats,
    weights: Floats,
    result: Floats,
) -> None:
    """Factor R of the same columns `A = Q R`, by Householder reflections.

    Takes what `normal_equations` takes; fills the upper half of result, (M, M).
    """
    panel = np.zeros((weights.shape[1], len(result), BLOCK))
    first = 6 * len(chain) + len(corrections.twists)
    result[:] = 0.0
    for block in range(len(motion)):
        rows = slice(starts[block], starts[block + 1])
        given = J_pose[rows], others[rows], weights[rows]
        _fill(chain, motion[block], *given, panel, first)
        _correct(corrections, starts[block], starts[block + 1], 6 * len(chain), panel)
        # One column after the other: the loops over them are many and short.
        size = starts[block + 1] - starts[block]
        columns = panel[:, :, :size].transpose(1, 0, 2).copy()
        _eliminate(columns.reshape(len(result), -1), result)


@compiled
def _fill(
    chain: Floats,
    motion: Floats,
    J_pose: Floats,
    others: Floats,
    weights: Floats,
    panel: Floats,
    first: int,
) -> None:
    """Columns of one block by components, shape (d, M, BLOCK).

    The others begin at the first; those of the corrections stand before, left out.
    """
    size, components = weights.shape
    joints = len(motion)
    for c in range(components):
        for k in range(size):
            weight = weights[k, c]
            for i in range(6):
                panel[c, 6 * joints + i, k] = weight * J_pose[k, c, i]
            for i in range(others.shape[2]):
                panel[c, first + i, k] = weight * others[k, c, i]
        flat = panel[c].reshape(-1)
        for joint in range(joints, 0, -1):
            middle = 6 * joint * BLOCK
            source = flat[middle : middle + 6 * BLOCK]
            target = flat[middle - 6 * BLOCK : middle]
            _carry_wrench(chain[joint], motion[joint - 1], size, source, target)


@compiled
def _correct(
    corrections: Corrections, start: int, stop: int, first: int, panel: Floats
) -> None:
    """Columns of the corrections, from the first, of a block of rows."""
    for c in range(len(panel)):
        for i in range(len(corrections.twists)):
            factors = corrections.factors[i, start:stop]
            source, target = panel[c, corrections.twists[i]], panel[c, first + i]
            for k in range(len(factors)):
                target[k] = factors[k] * source[k]


@compiled
def _carry_wrench(
    link: Floats, motion: Floats, size: int, source: Floats, target: Floats
) -> None:
    """Carry covectors of a body twist from the end of a link to that of the one before.

    A covector acts on twists as a wrench does: force f and moment m move through a
    transform (R, p) as `R f` and `R m + p x R f`.
    """
    r00, r01, r02, px = link[0], link[1], link[2], link[3]
    r10, r11, r12, py = link[4], link[5], link[6], link[7]
    r20, r21, r22, pz = link[8], link[9], link[10], link[11]
    for k in range(size):
        u, v, w = source[k], source[k + BLOCK], source[k + 2 * BLOCK]
        x = r00 * u + r01 * v + r02 * w
        y = r10 * u + r11 * v + r12 * w
        z = r20 * u + r21 * v + r22 * w
        u, v, w = source[k + 3 * BLOCK], source[k + 4 * BLOCK], source[k + 5 * BLOCK]
        mx = r00 * u + r01 * v + r02 * w + py * z - pz * y
        my = r10 * u + r11 * v + r12 * w + pz * x - px * z
        mz = r20 * u + r21 * v + r22 * w + px * y - py * x
        cosine, sine, shift = motion[k], motion[k + BLOCK], motion[k + 2 * BLOCK]
        fx, fy = cosine * x - sine * y, sine * x + cosine * y
        target[k] = fx
        target[k + BLOCK] = fy
        target[k + 2 * BLOCK] = z
        target[k + 3 * BLOCK] = cosine * mx - sine * my - shift * fy
        target[k + 4 * BLOCK] = sine * mx + cosine * my + shift * fx
        target[k + 5 * BLOCK] = mz


@compiled
def _gram(panel: Floats, size: int, result: Floats) -> None:
    """Add the products of all pairs of a panel's rows, `A A^T` in its lower half.

    Four rows by four at a time: sixteen sums stay in registers while eight rows are
    read.

    Args:
        panel: Rows in components, shape (d, M, BLOCK), M a multiple of 4.
        size: Columns that count.
        result: Added to, shape (M, M).
    """
    components, rows = panel.shape[:2]
    for c in range(components):
        for i in range(0, rows, 4):
            a0, a1 = panel[c, i], panel[c, i + 1]
            a2, a3 = panel[c, i + 2], panel[c, i + 3]
            for j in range(0, i + 1, 4):
                b0, b1 = panel[c, j], panel[c, j + 1]
                b2, b3 = panel[c, j + 2], panel[c, j + 3]
                s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = 0.0
                s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = 0.0
                for k in range(size):
                    s00 += a0[k] * b0[k]
                    s01 += a0[k] * b1[k]
                    s02 += a0[k] * b2[k]
                    s03 += a0[k] * b3[k]
                    s10 += a1[k] * b0[k]
                    s11 += a1[k] * b1[k]
                    s12 += a1[k] * b2[k]
                    s13 += a1[k] * b3[k]
                    s20 += a2[k] * b0[k]
                    s21 += a2[k] * b1[k]
                    s22 += a2[k] * b2[k]
                    s23 += a2[k] * b3[k]
                    s30 += a3[k] * b0[k]
                    s31 += a3[k] * b1[k]
                    s32 += a3[k] * b2[k]
                    s33 += a3[k] * b3[k]
                result[i, j] += s00
                result[i, j + 1] += s01
                result[i, j + 2] += s02
                result[i, j + 3] += s03
                result[i + 1, j] += s10
                result[i + 1, j + 1] += s11
                result[i + 1, j + 2] += s12
                result[i + 1, j + 3] += s13
                result[i + 2, j] += s20
                result[i + 2, j + 1] += s21
                result[i + 2, j + 2] += s22
                result[i + 2, j + 3] += s23
                result[i + 3, j] += s30
                result[i + 3, j + 1] += s31
                result[i + 3, j + 2] += s32
                result[i + 3, j + 3] += s33


@compiled
def _eliminate(columns: Floats, R: Floats) -> None:
    """Reflect rows into the triangular factor above them.

    The vector of the j-th reflection is (R_jj + sign(R_jj) |.|, a_j), zero between.

    Args:
        columns: Columns of the rows, shape (M, W); destroyed.
        R: Upper triangular factor so far, shape (M, M); replaced.
    """
    for j in range(len(R)):
        a = columns[j]
        square = _dot(a, a)
        # With fewer rows than columns rounding of rounding is left, down to underflow.
        if square < 1e-290:
            continue
        head = R[j, j]
        length = hypot(head, sqrt(square))
        top = head + length if head > 0.0 else head - length
        R[j, j] = -length if head > 0.0 else length
        scale = 2.0 / (top * top + square)
        for i in range(j + 1, len(R)):
            along = scale * (R[j, i] * top + _dot(a, columns[i]))
            R[j, i] -= along * top
            _subtract(along, a, columns[i])


@compiled
def _dot(a: Floats, b: Floats) -> float:
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@compiled
def _subtract(factor: float, a: Floats, b: Floats) -> None:
    """Subtract a multiple of a from b, in place."""
    for k in range(len(a)):
        b[k] -= factor * a[k]
