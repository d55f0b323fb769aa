"""Compiled kernel for very many rows: the triangular factor of their columns.

The columns are those of the chain of `kernels`: the body twists at the ends of its
links. A row of the Jacobian acts on twists as a wrench does, and is carried as one from
the tool to the base, block by block; the columns of a block are reflected into the
factor while they are in the cache.

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
    """Factor R of `A = Q R` by the twists of every link, by Householder reflections.

    Args:
        chain: Links, shape (n + 1, 12).
        motion: Joint motions, shape (blocks, n, 3 BLOCK).
        starts: First row of every block, shape (blocks + 1,).
        corrections: What moves the joints beside.
        J_pose: Derivatives by the tool's body twist, shape (N, d, 6).
        others: Further columns of the same rows, shape (N, d, K).
        weights: Factors of the rows' components, shape (N, d).
        result: Factor of rows before, shape (M, M), M >= 6 (n + 1) + C + K even;
            replaced in its upper half: the twists at the ends of the links from base
            to tool, then the corrections, then the others.
    """
    panel = np.zeros((weights.shape[1], len(result), BLOCK))
    first = 6 * len(chain) + len(corrections.twists)
    for block in range(len(motion)):
        rows = slice(starts[block], starts[block + 1])
        inputs = J_pose[rows], others[rows], weights[rows]
        _fill(chain, motion[block], *inputs, panel, first)
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
def _eliminate(columns: Floats, R: Floats) -> None:
    """Reflect rows into the triangular factor above them, two columns at a time.

    The vector of the j-th reflection is (R_jj + sign(R_jj) |.|, a_j), zero between. Two
    reflections of two columns read each of these once: that takes 0.6 of the time.

    Args:
        columns: Columns of the rows, shape (M, W), M even; destroyed.
        R: Upper triangular factor so far, shape (M, M); replaced.
    """
    for j in range(0, len(R), 2):
        a, b = columns[j], columns[j + 1]
        top_a, scale_a = _reflection(a, R, j)
        along = scale_a * (R[j, j + 1] * top_a + _dot(a, b))
        R[j, j + 1] -= along * top_a
        for k in range(len(a)):
            b[k] -= along * a[k]
        between = _dot(a, b)
        top_b, scale_b = _reflection(b, R, j + 1)
        for i in range(j + 2, len(R), 2):
            x, y = columns[i], columns[i + 1]
            ax = ay = bx = by = 0.0
            for k in range(len(a)):
                ax += a[k] * x[k]
                ay += a[k] * y[k]
                bx += b[k] * x[k]
                by += b[k] * y[k]
            ax = scale_a * (R[j, i] * top_a + ax)
            ay = scale_a * (R[j, i + 1] * top_a + ay)
            bx = scale_b * (R[j + 1, i] * top_b + bx - ax * between)
            by = scale_b * (R[j + 1, i + 1] * top_b + by - ay * between)
            R[j, i] -= ax * top_a
            R[j, i + 1] -= ay * top_a
            R[j + 1, i] -= bx * top_b
            R[j + 1, i + 1] -= by * top_b
            for k in range(len(a)):
                x[k] -= ax * a[k] + bx * b[k]
                y[k] -= ay * a[k] + by * b[k]


@compiled
def _reflection(a: Floats, R: Floats, j: int) -> tuple[float, float]:
    """Reflect column j onto the diagonal: top of the vector, 2 by its square."""
    square, head = _dot(a, a), R[j, j]
    # With fewer rows than columns rounding of rounding is left, down to underflow.
    if square < 1e-290:
        return 0.0, 0.0
    length = hypot(head, sqrt(square))
    R[j, j] = -length if head > 0.0 else length
    top = head - R[j, j]
    return top, 2.0 / (top * top + square)


@compiled
def _dot(a: Floats, b: Floats) -> float:
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
