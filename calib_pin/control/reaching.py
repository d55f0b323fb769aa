"""Inverse kinematics: from a start, and from many.

A descent is by damped least squares for many targets at once: the damping is in
proportion to the squared error (Sugihara, IEEE Trans. Robotics 27(5), 2011), so that it
ends as fast as Newton's method. With more joints than a target has components, every
step solves

    min  |q + dq - start|^2     such that     J dq = e,

so that the joints slide along their self-motion to the solution closest to the start. A
joint that a step would lead beyond a limit stops there, and the others go on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.control.joints import Joints, Kinematics, Solutions, Stacked
from calib_pin.kinematics.spatial import Floats, so3_log, times
from calib_pin.observations import Booleans, Indices


@dataclass(frozen=True)
class ReachingOptions:
    """Tolerances of a descent, sizes and weights of a search.

    Attributes:
        reached: Error of a target that counts as reached [m, rad]: rounding of a large
            arm.
        exact: Error at which a descent is finished [m, rad].
        settled: Motion towards the start that is not worth a step [rad, m].
        near: Error below which joints slide towards the start [m, rad]: farther, a step
            along the self-motion is one of another target.
        longest: Longest step of a joint [rad, m], for which twists still say where it
            leads.
        damping: Damping by squared error: first, least, and that with which no step is
            better.
        floor: Least square of a singular value that is inverted: rounding of double
            precision.
        stalled: Part of the squared error that a step must promise to remove.
        samples: Configurations among which those with poses near a target are looked
            for.
        rounds: Samples from which a target is tried at once, round after round: most
            targets need few, and some need many.
        spread: Every so many of the nearest samples is tried: nearer ones lead to the
            same end.
        turn: Weight of a rotation matrix beside a position by their spread: a wrist
            turns more easily than an arm reaches.
        away: Weight of a joint's way from the start beside a position by its spread
            [1/rad].
    """

    reached: float = 1e-9
    exact: float = 1e-10
    settled: float = 2e-9
    near: float = 0.05
    longest: float = 1.0
    damping: tuple[float, float, float] = 0.05, 0.01, 1e10
    floor: float = 1e-12
    stalled: float = 1e-5
    samples: int = 2048
    rounds: tuple[int, ...] = (2, 6, 24)
    spread: int = 4
    turn: float = 0.25
    away: float = 0.15


OPTIONS = ReachingOptions()
"""The default options."""

EXACT, FULL = (30, 0), (100, 60)
"""Most steps of a descent, and most along the self-motion to the start, before joints
stop where they are: for any way to the target, and for the one close to the start."""


@dataclass(frozen=True)
class Task(Stacked):
    """Targets that n joints shall reach.

    Attributes:
        evaluate: The kinematics of the joints that move the chain.
        targets: Poses, shape (N, 4, 4).
        joints: Limits, which are never left, and which joints follow others.
        start: Joint positions that solutions shall be close to, shape (N, n) [rad, m].
        given: Whether these are given; else those in the middle are preferred, and
            redundant joints stay where they are found.
        orientation: Whether orientations count; else only positions do.
    """

    evaluate: Kinematics
    targets: Floats
    joints: Joints
    start: Floats
    given: bool
    orientation: bool

    @staticmethod
    def of(
        evaluate: Kinematics,
        targets: Floats,
        joints: Joints,
        start: Floats | None = None,
        orientation: bool = True,
    ) -> Task:
        """The task of a chain, by its kinematics and positions of all its joints."""
        near = np.tile(joints.home, (len(targets), 1))
        if start is not None:
            near = joints.driven(start)
        given = near, start is not None, orientation
        return Task(joints.driving(evaluate), targets, joints, *given)

    def errors(self, q: Floats) -> tuple[Floats, Floats]:
        """Errors in the axes of the tool, (N, m), and their derivative, (N, m, n)."""
        T, J = self.evaluate(q)
        R_transposed = np.swapaxes(T[:, :3, :3], 1, 2)
        position = times(R_transposed, self.targets[:, :3, 3] - T[:, :3, 3])
        if not self.orientation:
            return position, J[:, :3]
        turn = so3_log(R_transposed @ self.targets[:, :3, :3])
        return np.hstack([position, turn]), J


def reach(task: Task) -> Solutions:
    """Solutions close to the start.

    With more joints than a target has components, the sum of the squared ways of the
    joints from the start is least, among the solutions that a descent can slide to.

    Examples:
        >>> import calib_pin
        >>> from calib_pin.parameterizations.error_model import ErrorModel
        >>> chain = calib_pin.load_chain("space6")
        >>> error = ErrorModel.create(chain, [])
        >>> def evaluate(q):
        ...     linear = error.linearize(q, np.zeros(len(error.parameters)))
        ...     return linear.T, linear.joint_twists()
        >>> q = np.array([[0.1, -0.5, 0.4, 0.3, 0.6, 0.2]])
        >>> T, joints = evaluate(q)[0], Joints.of(chain)
        >>> found = reach(Task.of(evaluate, T, joints, q + 0.01))
        >>> bool(np.abs(found.q - q).max() < 1e-8)
        True
        >>> bool(search(Task.of(evaluate, T, joints)).reached.all())
        True
    """
    return _with_all_joints(_descend_to_start(task, task.start, FULL), task.joints)


def search(task: Task) -> Solutions:
    """Solutions anywhere within the limits.

    Descents begin at the start and, without one or where that fails, at samples of the
    joint space whose poses are near the target.
    """
    joints, steps, guess = task.joints, FULL, task.start
    if not task.given:
        steps, guess = EXACT, joints.turned(_nearest(task, 1)[:, 0], guess)
    solutions = _descend_to_start(task, guess, steps)
    lost = np.flatnonzero(~solutions.reached)
    if not len(lost):
        return _with_all_joints(solutions, joints)
    pool = _nearest(task.rows(lost), OPTIONS.spread * sum(OPTIONS.rounds))[
        :, OPTIONS.spread - 1 :: OPTIONS.spread
    ]
    for count in OPTIONS.rounds:
        tried, pool = pool[:, :count], pool[:, count:]
        each = task.rows(np.repeat(lost, count))
        guess = joints.turned(tried.reshape(-1, tried.shape[2]), each.start)
        tries = _descend_to_start(each, guess, steps)
        best = tries.score.reshape(-1, count).argmin(axis=1)
        tries = tries.rows(count * np.arange(len(lost)) + best)
        better = tries.score < solutions.score[lost]
        solutions = solutions.replaced(lost[better], tries.rows(better))
        lost, pool = lost[~tries.reached], pool[~tries.reached]
    return _with_all_joints(solutions, joints)


def _descend_to_start(task: Task, guess: Floats, steps: tuple[int, int]) -> Solutions:
    """Solutions from a guess, in the turns nearest to the start."""
    solutions = descend(task, guess, steps)
    turned = task.joints.turned(solutions.q, task.start)
    (far,) = np.nonzero((turned != solutions.q).any(axis=1))
    # Corrections need not be periodic: another turn is another descent.
    others = descend(task.rows(far), turned[far], steps)
    closer = others.reached | ~solutions.reached[far]
    return solutions.replaced(far[closer], others.rows(closer))


def _with_all_joints(solutions: Solutions, joints: Joints) -> Solutions:
    """Solutions as positions of all joints of the chain."""
    return replace(solutions, q=joints.positions(solutions.q))


def _nearest(task: Task, count: int) -> Floats:
    """The samples nearest to targets and start, the nearest first, (N, count, n)."""
    samples = task.joints.samples(OPTIONS.samples)
    T, _ = task.evaluate(samples)
    spread = float(np.sqrt(T[:, :3, 3].var(axis=0).sum()))

    def features(T: Floats, q: Floats) -> Floats:
        parts = [T[:, :3, 3], OPTIONS.away * spread * q]
        if task.orientation:
            parts.append(OPTIONS.turn * spread * T[:, :3, :3].reshape(-1, 9))
        return np.hstack(parts).astype(np.float32)

    known, wanted = features(T, samples), features(task.targets, task.start)
    # Half the squared distance, without the part that all samples share.
    distances = 0.5 * (known**2).sum(axis=1) - wanted @ known.T
    nearest = np.argpartition(distances, count, axis=1)[:, :count]
    order = np.take_along_axis(distances, nearest, axis=1).argsort(axis=1)
    return np.asarray(samples[np.take_along_axis(nearest, order, axis=1)])


# Descents.


@dataclass
class _Rows(Stacked):
    """Rows that are not finished, A of N.

    Attributes:
        index: Their indices among all rows, shape (A,).
        q: Joint positions, shape (A, n).
        e: Errors, as far as they count, in the axes of the tool, shape (A, m).
        J: Motion of the tool in these by joint position, shape (A, m, n).
        damping: Damping by squared error, shape (A,).
        pull: Part of the way to the start that a step tries, shape (A,).
        dq: The next step, shape (A, n).
    """

    index: Indices
    q: Floats
    e: Floats
    J: Floats
    damping: Floats
    pull: Floats
    dq: Floats


def descend(task: Task, guess: Floats, steps: tuple[int, int]) -> Solutions:
    """Solutions from a guess.

    Args:
        task: The targets.
        guess: Joint positions to begin at, shape (N, n) [rad, m].
        steps: `EXACT` or `FULL`.
    """
    most, slides = steps
    # Not by their number: the three joints of a planar arm are redundant as well.
    _, J = task.evaluate(task.joints.samples(8))
    J = J[:, : 6 if task.orientation else 3]
    if guess.shape[1] <= np.linalg.matrix_rank(J, tol=1e-9).max():
        slides = 0
    q = task.joints.within(guess)
    e, J = task.errors(q)
    count = len(q)
    first = np.full(count, OPTIONS.damping[0]), np.full(count, 1.0)
    rows = _Rows(np.arange(count), q.copy(), e.copy(), J, *first, 0.0 * q)
    for iteration in range(most + 1):
        squared = (rows.e**2).sum(axis=1)
        exact = squared < OPTIONS.exact**2
        # At the end joints stop where they are.
        sliding = (iteration < slides) & (squared < OPTIONS.near**2)
        sliding &= rows.pull > 1e-3
        pull = np.where(sliding, rows.pull, 0.0)[:, None]
        pull = pull * (task.start[rows.index] - rows.q)
        damping = rows.damping * squared + OPTIONS.floor
        rows.dq = _step(task.joints, rows.q, rows.J, rows.e, pull, damping)
        predicted = ((rows.e - times(rows.J, rows.dq)) ** 2).sum(axis=1)
        stalled = ~exact & (squared - predicted <= OPTIONS.stalled * squared)
        # Before it gives up, a row tries without being pulled to the start.
        rows.pull[stalled] *= 0.25
        moves = sliding & (np.abs(rows.dq).max(axis=1, initial=0.0) > OPTIONS.settled)
        done = (exact & ~moves) | (stalled & ~sliding)
        done |= rows.damping > OPTIONS.damping[2]
        # Where an error is not a number, nothing is.
        done |= np.isnan(squared) | (iteration == most)
        q[rows.index[done]], e[rows.index[done]] = rows.q[done], rows.e[done]
        rows, sliding = rows.rows(~done), sliding[~done]
        if not len(rows.index):
            break
        _move(task, rows, sliding)
    position = np.linalg.norm(e[:, :3], axis=1)
    angle = np.linalg.norm(e[:, 3:], axis=1)
    reached = np.maximum(position, angle) < OPTIONS.reached
    return Solutions(q, reached, position, angle)


def _step(
    joints: Joints, q: Floats, J: Floats, e: Floats, pull: Floats, damping: Floats
) -> Floats:
    """Steps that stay within the limits, shape (A, n).

    Of the joints that would leave, the one that does so first is held at its limit,
    until none leaves.

    Args:
        joints: The limits.
        q: Joint positions, shape (A, n).
        J: Derivative of the components of the target, shape (A, m, n).
        e: Errors, shape (A, m).
        pull: Step that is wanted beside them, shape (A, n).
        damping: Squares of singular values below it are not inverted, shape (A,).
    """
    m, n = J.shape[1:]
    held, moves, e = np.zeros(q.shape, bool), pull.copy(), e.copy()
    dq, active = np.empty_like(q), np.arange(len(q))
    for k in range(n + 1):
        free = np.where(held[active, None], 0.0, J[active])
        S = free @ np.swapaxes(free, 1, 2)
        S[:, range(m), range(m)] += damping[active, None]
        rest = e[active] - times(J[active], moves[active])
        y = np.linalg.solve(S, rest[:, :, None])[:, :, 0]
        dq[active] = moves[active] + times(np.swapaxes(free, 1, 2), y)
        if k == 0:
            # Before limits are looked at: many would be in the way of a long step.
            longest = np.abs(dq).max(axis=1, initial=OPTIONS.longest)[:, None]
            for whole in (dq, moves, e):
                whole *= OPTIONS.longest / longest
        room = np.where(dq > 0.0, joints.upper - q, q - joints.lower)
        leaves = ~held & (np.abs(dq) > room)
        parts = np.full(q.shape, np.inf)
        np.divide(room, np.abs(dq), out=parts, where=leaves)
        active = np.flatnonzero(leaves.any(axis=1))
        if not len(active):
            break
        first = active, parts[active].argmin(axis=1)
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
    accepted = better | (sliding & (error < 2.0 * OPTIONS.near))
    away, was = (
        np.linalg.norm(at - task.start[rows.index], axis=1) for at in (q, rows.q)
    )
    # Where the error is small, a step along the self-motion must come closer.
    # Nobody sees rounding.
    worse = (away > (1.0 + 1e-12) * was) & (before < 0.1 * np.abs(rows.dq).max(axis=1))
    shorter = np.where(sliding & (~accepted | worse), 0.5, 1.5)
    rows.pull = np.minimum(shorter * rows.pull, 1.0)
    eased = np.maximum(0.5 * rows.damping, OPTIONS.damping[1])
    rows.damping = np.where(better | sliding, eased, 8.0 * rows.damping)
    rows.q = np.where(accepted[:, None], q, rows.q)
    rows.e = np.where(accepted[:, None], e, rows.e)
    rows.J = np.where(accepted[:, None, None], J, rows.J)
