"""Joint positions that reach targets, from a start, for many targets at once.

Newton's method, damped where it is far away or near a singularity: the damping is in
proportion to the squared error (Sugihara, IEEE Trans. Robotics 27(5), 2011), so that
it ends as fast as Newton's method. With more joints than a target has components,
every step solves

    min  |q + dq - start|^2 / 2 - y' D(dq, dq) / 2     such that     J dq = e

with estimates y of the multipliers and the second derivative D of the pose: the joints
slide along their self-motion to the solution closest to the start, and the last steps
converge quadratically. A joint is held at a limit when a step meets it, and let go when
the force of the limit turns its sign.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.control.joints import (
    Booleans,
    Effort,
    Indices,
    Solutions,
    Stacked,
    Task,
)
from calib_pin.kinematics.spatial import Floats, times


@dataclass(frozen=True)
class DescentOptions:
    """Tolerances of a descent.

    Attributes:
        reached: Error of a target that counts as reached [m, rad].
        settled: Motion towards the start that is not worth a step [rad, m].
        near: Error below which the joints slide towards the start [m, rad].
        longest: Longest step of a joint [rad, m]; half of it along the self-motion.
        narrow: Steps along the self-motion shorter than this lead nowhere [rad, m].
        damping: Damping at the start, by squared error.
        least_damping: Least damping, by squared error.
        hopeless: Damping, by squared error, at which no step makes the error smaller.
        floor: Least square of a singular value that is inverted.
        stalled: Part of the squared error that a step must promise to remove.
        block: Rows that are solved together; more would need gigabytes.
    """

    reached: float = 1e-9
    settled: float = 1e-8
    near: float = 0.05
    longest: float = 1.0
    narrow: float = 1e-3
    damping: float = 0.05
    least_damping: float = 0.01
    hopeless: float = 1e10
    floor: float = 1e-12
    stalled: float = 1e-5
    block: int = 16384


OPTIONS = DescentOptions()
"""The default options."""

WEIGHT = 1e3
"""Weight of the directions of the target in a Hessian."""

LEAST = 0.05
"""Least curvature along the self-motion."""

ROUNDING = 1e-12
"""Least square of a singular value that is a direction of the target."""


def descend(task: Task, guess: Floats, effort: Effort) -> Solutions:
    """Solutions from a guess.

    Args:
        task: The targets.
        guess: Joint positions to begin at, shape (N, n) [rad, m].
        effort: Tolerance and number of steps.
    """
    if not len(guess):
        return Solutions.none(guess)
    blocks = [slice(k, k + OPTIONS.block) for k in range(0, len(guess), OPTIONS.block)]
    return Solutions.joined(
        [_Descent(task.rows(rows), effort).run(guess[rows]) for rows in blocks]
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
        held: Joints held at a limit, shape (A, n).
        radius: Longest step along the self-motion, shape (A,).
        away: Distance from the start, shape (A,).
        dq: The next step, shape (A, n).
        promised: Part of the squared error that it removes, were J constant, (A,).
        frees: Whether a joint leaves its limit at the step after that, shape (A,).
    """

    index: Indices
    q: Floats
    e: Floats
    J: Floats
    damping: Floats
    held: Booleans
    radius: Floats
    away: Floats
    dq: Floats
    promised: Floats
    frees: Booleans

    @staticmethod
    def of(task: Task, q: Floats) -> _Rows:
        """All rows, at joint positions, shape (N, n)."""
        e, J = task.errors(q)
        count = len(q)
        return _Rows(
            index=np.arange(count),
            q=q,
            e=e,
            J=J,
            damping=np.full(count, OPTIONS.damping),
            held=np.zeros(q.shape, bool),
            radius=np.full(count, 0.5 * OPTIONS.longest),
            away=np.linalg.norm(q - task.start, axis=1),
            dq=np.zeros(q.shape),
            promised=np.zeros(count),
            frees=np.zeros(count, bool),
        )


@dataclass(frozen=True)
class _Descent:
    """Newton's method on many rows at once."""

    task: Task
    effort: Effort

    def run(self, guess: Floats) -> Solutions:
        """Solutions from a guess, shape (N, n)."""
        rows = _Rows.of(self.task, self.task.joints.within(guess))
        q, errors = rows.q.copy(), rows.e.copy()

        def finish(done: Booleans) -> _Rows:
            q[rows.index[done]], errors[rows.index[done]] = rows.q[done], rows.e[done]
            return rows.rows(~done) if done.any() else rows

        # Not by their number: the three joints of a planar arm are redundant as well.
        redundant = guess.shape[1] > self.task.rank
        for iteration in range(self.effort.iterations):
            slides = redundant and iteration < self.effort.slides
            if not slides:
                rows = finish(self._exact(rows.e))
            near = np.linalg.norm(rows.e, axis=1) < OPTIONS.near
            sliding = slides & near & (rows.radius > OPTIONS.narrow)
            length = self._step(rows, sliding)
            exact = self._exact(rows.e)
            settled = exact & (~sliding | ((length < OPTIONS.settled) & ~rows.frees))
            stalled = ~exact & (rows.promised < OPTIONS.stalled) & ~rows.frees
            # Before it gives up, a row tries without being pulled to the start.
            rows.radius[stalled] *= 0.25
            done = settled | (stalled & ~sliding) | (rows.damping > OPTIONS.hopeless)
            rows = finish(done)
            if not len(rows.index):
                break
            self._move(rows, sliding[~done], length[~done])
        finish(np.ones(len(rows.index), bool))
        position = np.linalg.norm(errors[:, :3], axis=1)
        angle = np.linalg.norm(errors[:, 3:], axis=1)
        limit = max(OPTIONS.reached, self.effort.error)
        return Solutions(q, (position < limit) & (angle < limit), position, angle)

    def _exact(self, e: Floats) -> Booleans:
        """Whether nothing is left to do, shape (A,)."""
        position = np.linalg.norm(e[:, :3], axis=1)
        angle = np.linalg.norm(e[:, 3:], axis=1)
        return np.asarray((position < self.effort.error) & (angle < self.effort.error))

    def _step(self, rows: _Rows, sliding: Booleans) -> Floats:
        """Find the next step; returns its length before it is shortened, (A,)."""
        start = self.task.start[rows.index]
        way = np.where(sliding[:, None], start - rows.q, 0.0)
        squared = (rows.e**2).sum(axis=1)
        system = _System(
            J=rows.J[:, : self.task.size],
            e=rows.e.copy(),
            pull=way.copy(),
            damping=rows.damping * squared + OPTIONS.floor,
            # A step that was not taken, or shortened, has not come to its limits.
            held=rows.held & self.task.joints.at_limit(rows.q),
            moves=np.zeros(rows.q.shape),
            hessian=None,
        )
        if sliding.any():
            # The force that keeps the target must not contain the part of the error.
            still = replace(system, e=np.zeros_like(rows.e))
            system.curve(rows.J, still.solve()[1], sliding)
        dq, y = system.solve()
        length: Floats = np.abs(dq).max(axis=1)
        longest = np.where(sliding, rows.radius, OPTIONS.longest)
        # Before limits are looked at: many would be in the way of a long step. First
        # the motion to the start is shortened, then, if need be, all.
        (long,) = np.nonzero(sliding & (length > longest))
        if len(long):
            part = (longest[long] / length[long])[:, None]
            system.pull[long] -= (1.0 - part) * way[long]
            dq[long], y[long] = system.rows(long).solve()
        part = longest / np.maximum(np.abs(dq).max(axis=1), longest)
        for whole in (system.e, system.pull, dq, y):
            whole *= part[:, None]
        self._hold(rows, system, dq, y)
        left = rows.e - times(system.J, dq)
        rows.promised = 1.0 - (left**2).sum(axis=1) / np.maximum(squared, 1e-300)
        rows.frees = self._free(rows, system, dq, y)
        rows.held = system.held
        excess = np.abs(dq).max(axis=1) / longest
        rows.dq = dq / np.maximum(1.0, excess)[:, None]
        return length

    def _hold(self, rows: _Rows, system: _System, dq: Floats, y: Floats) -> None:
        """Change steps that leave the limits.

        Of the joints that leave, the one that does so first is held at its limit, until
        none leaves.
        """
        joints, q, held = self.task.joints, rows.q, system.held
        for _ in range(q.shape[1]):
            room = np.where(dq > 0.0, joints.upper - q, q - joints.lower)
            leaves = ~held & (np.abs(dq) > room)
            (some,) = np.nonzero(leaves.any(axis=1))
            if not len(some):
                break
            parts = np.full(leaves[some].shape, np.inf)
            np.divide(room[some], np.abs(dq[some]), out=parts, where=leaves[some])
            first = parts.argmin(axis=1)
            held[some, first] = True
            system.moves[some, first] = (np.sign(dq) * room)[some, first]
            dq[some], y[some] = system.rows(some).solve()

    def _free(self, rows: _Rows, system: _System, dq: Floats, y: Floats) -> Booleans:
        """Let go the joint that its limit pushes outward most; whether there is one."""
        joints, held = self.task.joints, system.held
        if not held.any():
            return np.zeros(len(held), bool)
        at_upper = joints.upper - rows.q < rows.q - joints.lower
        force = system.force(dq, y)
        inward = np.where(at_upper, -force, force)
        stays = held & (np.abs(system.moves) < OPTIONS.settled)
        inward = np.where(stays, inward, 0.0)
        worst = inward.argmax(axis=1)[:, None]
        frees = np.take_along_axis(inward, worst, axis=1)[:, 0] > OPTIONS.settled
        held[frees, worst[frees, 0]] = False
        return np.asarray(frees)

    def _move(self, rows: _Rows, sliding: Booleans, length: Floats) -> None:
        """Take the steps that lead closer to the targets, or slide beside them."""
        q = self.task.joints.within(rows.q + rows.dq)
        e, J = self.task.rows(rows.index).errors(q)
        error, before = np.linalg.norm(e, axis=1), np.linalg.norm(rows.e, axis=1)
        better = error < before
        taken = better | (sliding & (error < 2.0 * OPTIONS.near))
        rows.q = np.where(taken[:, None], q, rows.q)
        rows.e = np.where(taken[:, None], e, rows.e)
        rows.J = np.where(taken[:, None, None], J, rows.J)
        eased = np.maximum(0.5 * rows.damping, OPTIONS.least_damping)
        rows.damping = np.where(better | sliding, eased, 8.0 * rows.damping)
        # Where the error is small, a step along the self-motion must come closer.
        away = np.linalg.norm(q - self.task.start[rows.index], axis=1)
        worse = (away > rows.away) & (before < 0.1 * rows.radius * length)
        factor = np.where(~taken | worse, 0.5, 2.0)
        radius = np.minimum(factor * rows.radius, 0.5 * OPTIONS.longest)
        rows.radius = np.where(sliding, radius, rows.radius)
        rows.away = np.where(taken, away, rows.away)


@dataclass
class _System(Stacked):
    """The linear system of one step.

    Attributes:
        J: Derivative of the components of the target, shape (A, m, n).
        e: Errors, shape (A, m).
        pull: Way towards the start, shape (A, n).
        damping: Squares of singular values below it are not inverted, shape (A,).
        held: Joints that do not take part, shape (A, n).
        moves: Steps of these, zero for others, shape (A, n).
        hessian: Second derivative by dq, shape (A, n, n); None for unity.
    """

    J: Floats
    e: Floats
    pull: Floats
    damping: Floats
    held: Booleans
    moves: Floats
    hessian: Floats | None

    def solve(self) -> tuple[Floats, Floats]:
        """Steps, shape (A, n), and multipliers of the pose, shape (A, m)."""
        J = np.where(self.held[:, None], 0.0, self.J)
        m, n = J.shape[1:]
        e = self.e - times(self.J, self.moves)
        if self.hessian is None:
            pull, Y = np.where(self.held, 0.0, self.pull), np.swapaxes(J, 1, 2)
        else:
            pull = self.pull - times(self.hessian, self.moves)
            pull = np.where(self.held, 0.0, pull)
            either = self.held[:, :, None] | self.held[:, None, :]
            H = np.where(either, 0.0, self.hessian)
            H[:, range(n), range(n)] += self.held
            both = np.concatenate([pull[:, :, None], np.swapaxes(J, 1, 2)], axis=2)
            solved = np.linalg.solve(H, both)
            pull, Y = solved[:, :, 0], solved[:, :, 1:]
        S = J @ Y
        S[:, range(m), range(m)] += self.damping[:, None]
        y = np.linalg.solve(S, (e - times(J, pull))[:, :, None])[:, :, 0]
        return self.moves + pull + times(Y, y), y

    def force(self, dq: Floats, y: Floats) -> Floats:
        """Force on each joint, shape (A, n); zero for those that are not held."""
        resistance = dq if self.hessian is None else times(self.hessian, dq)
        return np.asarray(self.pull + times(np.swapaxes(self.J, 1, 2), y) - resistance)

    def curve(self, J: Floats, y: Floats, sliding: Booleans) -> None:
        """Add the second derivative of the pose, weighted by multipliers.

        It follows from the twists: with columns (v, w), for i <= j the position bends
        by w_i x v_j and the orientation by half of w_i x w_j, which is zero for i = j.

        Args:
            J: Body twists of the tool, shape (A, 6, n).
            y: Multipliers, shape (A, m).
            sliding: Rows that need it, shape (A,).
        """
        y = np.where(sliding[:, None], y, 0.0)
        v, w = np.swapaxes(J[:, :3], 1, 2), np.swapaxes(J[:, 3:], 1, 2)
        bends = np.cross(y[:, None, :3], w) @ np.swapaxes(v, 1, 2)
        if y.shape[1] == 6:
            bends += 0.5 * np.cross(y[:, None, 3:], w) @ np.swapaxes(w, 1, 2)
        upper = np.triu(bends)
        unity = np.eye(J.shape[2])
        H = unity - upper - np.swapaxes(np.triu(bends, 1), 1, 2)
        (far,) = np.nonzero(np.linalg.norm(H - unity, axis=(1, 2)) > 0.5)
        if len(far):
            H[far] = self._definite(far, H[far])
        self.hessian = H

    def _definite(self, rows: Indices, H: Floats) -> Floats:
        """Hessians that are definite along the self-motion, shape (K, n, n).

        A large weight on the directions of the target changes no step, since the step
        is given there; a curvature that is still negative lies along the self-motion.
        """
        held, J = self.held[rows], self.J[rows]
        J = np.where(held[:, None], 0.0, J)
        S = J @ np.swapaxes(J, 1, 2)
        S[:, range(S.shape[1]), range(S.shape[1])] += ROUNDING
        pseudo_inverse = np.swapaxes(np.linalg.solve(S, J), 1, 2)
        size = 1.0 + np.linalg.norm(H, axis=(1, 2))
        weight = WEIGHT * size**2
        self.pull[rows] += weight[:, None] * times(pseudo_inverse, self.e[rows])
        H = H + weight[:, None, None] * (pseudo_inverse @ J)
        block = np.where(held[:, :, None] | held[:, None, :], 0.0, H)
        values, vectors = np.linalg.eigh(0.5 * (block + np.swapaxes(block, 1, 2)))
        # Uphill turns into downhill, and level ground into a gentle slope.
        change = (np.maximum(np.abs(values), LEAST) - values)[:, None]
        return np.asarray(H + (vectors * change) @ np.swapaxes(vectors, 1, 2))
