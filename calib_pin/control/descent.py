"""Joint positions that reach targets, from a start, for many targets at once.

Damped least squares: the damping is in proportion to the squared error (Sugihara, IEEE
Trans. Robotics 27(5), 2011), so that it ends as fast as Newton's method. With more
joints than a target has components, every step solves

    min  |q + dq - start|^2     such that     J dq = e,

so that the joints slide along their self-motion to the solution closest to the start. A
joint that a step would lead beyond a limit stops there, and the others go on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.control.joints import (
    Booleans,
    Effort,
    Indices,
    Joints,
    Solutions,
    Stacked,
    Task,
)
from calib_pin.kinematics.spatial import Floats, times


@dataclass(frozen=True)
class DescentOptions:
    """Tolerances of a descent.

    Attributes:
        reached: Error of a target that counts as reached [m, rad]: rounding of a large
            arm.
        settled: Motion towards the start that is not worth a step [rad, m].
        near: Error below which joints slide towards the start [m, rad]: farther, a step
            along the self-motion is one of another target.
        longest: Longest step of a joint [rad, m], for which twists still say where it
            leads.
        damping: Damping by squared error: first, least, and that with which no step is
            better.
        floor: Least square of a singular value that is inverted: rounding of double
            precision.
        farthest: Largest part of the way to the start that a step tries, where a slide
            bends away.
        stalled: Part of the squared error that a step must promise to remove.
        block: Rows that are solved together; more would need gigabytes.
    """

    reached: float = 1e-9
    settled: float = 1e-8
    near: float = 0.05
    longest: float = 1.0
    damping: tuple[float, float, float] = 0.05, 0.01, 1e10
    floor: float = 1e-12
    farthest: float = 4.0
    stalled: float = 1e-5
    block: int = 16384


OPTIONS = DescentOptions()
"""The default options."""


def descend(task: Task, guess: Floats, effort: Effort) -> Solutions:
    """Solutions from a guess.

    Args:
        task: The targets.
        guess: Joint positions to begin at, shape (N, n) [rad, m].
        effort: Tolerance and number of steps.
    """
    if not len(guess):
        none = np.zeros(0)
        return Solutions(guess, none > 0.0, none, none)
    # Not by their number: the three joints of a planar arm are redundant as well.
    slides = effort.slides if guess.shape[1] > task.rank else 0
    blocks = [slice(k, k + OPTIONS.block) for k in range(0, len(guess), OPTIONS.block)]
    return Solutions.joined(
        [_descended(task.rows(rows), guess[rows], effort, slides) for rows in blocks]
    )


@dataclass
class _Rows(Stacked):
    """Rows that are not finished, A of N.

    Attributes:
        index: Their indices among all rows, shape (A,).
        q: Joint positions, shape (A, n).
        e: Errors, as far as they count, in the axes of the tool, shape (A, m).
        J: Body twists of the tool by joint position, shape (A, 6, n).
        damping: Damping by squared error, shape (A,).
        pull: Part of the way to the start that a step tries, shape (A,).
        dq: The next step, shape (A, n).
        slide: Step to the start with all of the pull, shape (A, n).
        moved: The last step, zero where it was not taken, shape (A, n).
    """

    index: Indices
    q: Floats
    e: Floats
    J: Floats
    damping: Floats
    pull: Floats
    dq: Floats
    slide: Floats
    moved: Floats


def _descended(task: Task, guess: Floats, effort: Effort, slides: int) -> Solutions:
    """Solutions of rows that are solved together."""
    q = task.joints.within(guess)
    e, J = task.errors(q)
    count = len(q)
    first = np.full(count, OPTIONS.damping[0]), np.full(count, 0.5)
    none = 0.0 * q, 0.0 * q, 0.0 * q
    rows = _Rows(np.arange(count), q.copy(), e.copy(), J, *first, *none)
    for iteration in range(effort.iterations + 1):
        exact = _below(rows.e, effort.error)
        # At the end joints stop where they are.
        sliding = (iteration < slides) & (np.linalg.norm(rows.e, axis=1) < OPTIONS.near)
        sliding &= rows.pull > 1e-3
        way = np.where(sliding, rows.pull, 0.0)[:, None]
        way = way * (task.start[rows.index] - rows.q)
        squared = (rows.e**2).sum(axis=1)
        damping = rows.damping * squared + OPTIONS.floor
        J = rows.J[:, : task.size]
        rows.dq = _step(task.joints, rows.q, J, rows.e, way, damping)
        _adapt(rows)
        left = ((rows.e - times(J, rows.dq)) ** 2).sum(axis=1)
        stalled = ~exact & (squared - left <= OPTIONS.stalled * squared)
        # Before it gives up, a row tries without being pulled to the start.
        rows.pull[stalled] *= 0.25
        moves = sliding & (np.abs(rows.dq).max(axis=1, initial=0.0) > OPTIONS.settled)
        done = (
            (exact & ~moves)
            | (stalled & ~sliding)
            | (rows.damping > OPTIONS.damping[2])
        )
        # Where an error is not a number, nothing is.
        done |= np.isnan(squared) | (iteration == effort.iterations)
        q[rows.index[done]], e[rows.index[done]] = rows.q[done], rows.e[done]
        rows, sliding = rows.rows(~done), sliding[~done]
        if not len(rows.index):
            break
        _move(task, rows, sliding)
    position = np.linalg.norm(e[:, :3], axis=1)
    angle = np.linalg.norm(e[:, 3:], axis=1)
    return Solutions(q, _below(e, max(OPTIONS.reached, effort.error)), position, angle)


def _adapt(rows: _Rows) -> None:
    """The part of the way with which the next slide ends, by the last one's curvature.

    As in a secant method: it is superlinear along one self-motion.
    """
    slide = rows.dq / rows.pull[:, None]
    curved = (rows.moved * (rows.slide - slide)).sum(axis=1)
    size = (rows.moved**2).sum(axis=1)
    ratio = np.full(len(size), OPTIONS.farthest)
    np.divide(size, curved, out=ratio, where=curved > size / OPTIONS.farthest)
    rows.pull, rows.slide = np.where(size > 0.0, ratio, rows.pull), slide


def _below(e: Floats, error: float) -> Booleans:
    """Whether position and orientation are off by less, shape (A,)."""
    position = np.linalg.norm(e[:, :3], axis=1)
    angle = np.linalg.norm(e[:, 3:], axis=1)
    return np.asarray((position < error) & (angle < error))


def _step(
    joints: Joints, q: Floats, J: Floats, e: Floats, way: Floats, damping: Floats
) -> Floats:
    """Steps that stay within the limits, shape (A, n).

    Of the joints that would leave, the one that does so first is held at its limit,
    until none leaves.

    Args:
        joints: The limits.
        q: Joint positions, shape (A, n).
        J: Derivative of the components of the target, shape (A, m, n).
        e: Errors, shape (A, m).
        way: Step that is wanted beside them, shape (A, n).
        damping: Squares of singular values below it are not inverted, shape (A,).
    """
    m, n = J.shape[1:]
    held, moves, e = np.zeros(q.shape, bool), way.copy(), e.copy()
    dq, some = np.empty_like(q), np.arange(len(q))
    for k in range(n + 1):
        free = np.where(held[some, None], 0.0, J[some])
        S = free @ np.swapaxes(free, 1, 2)
        S[:, range(m), range(m)] += damping[some, None]
        rest = e[some] - times(J[some], moves[some])
        y = np.linalg.solve(S, rest[:, :, None])[:, :, 0]
        dq[some] = moves[some] + times(np.swapaxes(free, 1, 2), y)
        if k == 0:
            # Before limits are looked at: many would be in the way of a long step.
            longest = np.abs(dq).max(axis=1, initial=OPTIONS.longest)[:, None]
            for whole in (dq, moves, e):
                whole *= OPTIONS.longest / longest
        room = np.where(dq > 0.0, joints.upper - q, q - joints.lower)
        leaves = ~held & (np.abs(dq) > room)
        parts = np.full(q.shape, np.inf)
        np.divide(room, np.abs(dq), out=parts, where=leaves)
        some = np.flatnonzero(leaves.any(axis=1))
        if not len(some):
            break
        first = some, parts[some].argmin(axis=1)
        held[first], moves[first] = True, (np.sign(dq) * room)[first]
    # Held joints may have been in the way of a step that was shorter before.
    longest = np.abs(dq).max(axis=1, initial=OPTIONS.longest)[:, None]
    return np.asarray(dq * (OPTIONS.longest / longest))


def _move(task: Task, rows: _Rows, sliding: Booleans) -> None:
    """Take the steps that lead closer to the targets, or slide beside them."""
    q = task.joints.within(rows.q + rows.dq)
    e, J = task.rows(rows.index).errors(q)
    error, before = np.linalg.norm(e, axis=1), np.linalg.norm(rows.e, axis=1)
    better = error < before
    taken = better | (sliding & (error < 2.0 * OPTIONS.near))
    away, was = (
        np.linalg.norm(at - task.start[rows.index], axis=1) for at in (q, rows.q)
    )
    # Where the error is small, a step along the self-motion must come closer.
    worse = (away > was) & (before < 0.1 * np.abs(rows.dq).max(axis=1))
    rows.pull = np.where(sliding & (~taken | worse), 0.5 * rows.pull, rows.pull)
    eased = np.maximum(0.5 * rows.damping, OPTIONS.damping[1])
    rows.damping = np.where(better | sliding, eased, 8.0 * rows.damping)
    rows.moved = np.where(taken[:, None], q - rows.q, 0.0)
    rows.q = np.where(taken[:, None], q, rows.q)
    rows.e = np.where(taken[:, None], e, rows.e)
    rows.J = np.where(taken[:, None, None], J, rows.J)
