"""Inverse kinematics from a start and, where there is none or it fails, from many."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.control.descent import descend
from calib_pin.control.joints import (
    EXACT,
    FULL,
    ROUGH,
    THOROUGH,
    Effort,
    Joints,
    Kinematics,
    Solutions,
    Task,
)
from calib_pin.kinematics.spatial import Floats


@dataclass(frozen=True)
class SearchOptions:
    """Sizes and weights of a search.

    Attributes:
        samples: Configurations among which those with poses near a target are looked
            for.
        pool: Samples near a target of which some are tried.
        rounds: Samples of the pool from which a target is tried at once, round after
            round.
        turn: Weight of a rotation matrix beside a position, both by their spread: a
            wrist turns more easily than an arm reaches.
        away: Weight of a joint's way from the start beside a position by its spread
            [1/rad].
        most: Targets that are searched for at a time; many more would need gigabytes.
        block: Targets that are compared with all samples at a time.
    """

    samples: int = 2048
    pool: int = 64
    rounds: tuple[int, ...] = (1, 2, 4, 8, 16)
    turn: float = 0.25
    away: float = 0.15
    most: int = 50_000
    block: int = 256


OPTIONS = SearchOptions()
"""The default options."""


def reach(
    evaluate: Kinematics,
    targets: Floats,
    start: Floats,
    joints: Joints,
    *,
    orientation: bool = True,
) -> Solutions:
    """Solutions close to a start.

    With more joints than a target has components, the sum of the squared ways of the
    joints from the start is least, among the solutions that a descent can slide to.

    Args:
        evaluate: The kinematics.
        targets: Poses to reach, shape (N, 4, 4).
        start: Joint positions that solutions shall be close to, shape (N, n) [rad, m].
        joints: Limits, which are never left, and which joints follow others.
        orientation: Whether orientations count; else only positions do.

    Examples:
        >>> import calib_pin
        >>> from calib_pin.parameterizations.error_model import ErrorModel
        >>> chain = calib_pin.load_chain("space6")
        >>> error = ErrorModel.create(chain, [])
        >>> def evaluate(q):
        ...     linear = error.linearize(q, np.zeros(len(error.parameters)))
        ...     return linear.T, linear.joint_twists()
        >>> q = np.array([[0.1, -0.5, 0.4, 0.3, 0.6, 0.2]])
        >>> found = reach(evaluate, evaluate(q)[0], q + 0.01, Joints.of(chain))
        >>> bool(np.abs(found.q - q).max() < 1e-8)
        True
    """
    near = joints.driven(start)
    task = Task(joints.driving(evaluate), targets, near, joints, orientation)
    return _commanded(_reached(task), joints)


def _reached(task: Task) -> Solutions:
    """Solutions close to the start of a task."""
    found = descend(task, task.start, FULL)
    turned = task.joints.turned(found.q, task.start)
    (far,) = np.nonzero((turned != found.q).any(axis=1))
    if not len(far):
        return found
    # Corrections need not be periodic: another turn is another descent.
    others = descend(task.rows(far), turned[far], FULL)
    closer = others.reached | ~found.reached[far]
    return found.replaced(far[closer], others.rows(closer))


def search(
    evaluate: Kinematics,
    targets: Floats,
    joints: Joints,
    start: Floats | None = None,
    *,
    nominal: Kinematics | None = None,
    orientation: bool = True,
) -> Solutions:
    """Solutions anywhere within the limits.

    Descents begin at the start or, without one, at a sample of the joint space whose
    pose is near the target; where that fails, at more samples, as different as they
    can be.

    Args:
        evaluate: The kinematics.
        targets: Poses to reach, shape (N, 4, 4).
        joints: Limits, which are never left, and which joints follow others.
        start: Joint positions that solutions shall be close to, shape (N, n)
            [rad, m]; by default those in the middle are preferred, and redundant
            joints stay where they are found.
        nominal: Kinematics that are nearly the same, on which the first search is done.
        orientation: Whether orientations count; else only positions do.

    Examples:
        >>> import calib_pin
        >>> from calib_pin.parameterizations.error_model import ErrorModel
        >>> chain = calib_pin.load_chain("space6")
        >>> error = ErrorModel.create(chain, [])
        >>> def evaluate(q):
        ...     linear = error.linearize(q, np.zeros(len(error.parameters)))
        ...     return linear.T, linear.joint_twists()
        >>> targets = evaluate(chain.random_configurations(
        ...     5, np.random.default_rng(0)
        ... ))[0]
        >>> bool(search(evaluate, targets, Joints.of(chain)).reached.all())
        True
    """
    if len(targets) > OPTIONS.most:
        halves = slice(len(targets) // 2), slice(len(targets) // 2, None)
        return Solutions.joined(
            [
                search(
                    evaluate,
                    targets[half],
                    joints,
                    None if start is None else start[half],
                    nominal=nominal,
                    orientation=orientation,
                )
                for half in halves
            ]
        )
    home = np.tile(joints.home, (len(targets), 1))
    home = home if start is None else joints.driven(start)
    task = Task(joints.driving(evaluate), targets, home, joints, orientation)
    if start is None:
        rough = task
        if nominal is not None:
            rough = replace(task, evaluate=joints.driving(nominal))
        index = _Index.of(rough)
        first = descend(rough, index.nearest(rough, 1)[:, 0], ROUGH)
        guess = _retried(rough, index, first, ROUGH)
        found = descend(task, joints.turned(guess.q, home), EXACT)
    else:
        found = _reached(task)
    (lost,) = np.nonzero(~found.reached)
    if not len(lost):
        return _commanded(found, joints)
    some, failed = task.rows(lost), found.rows(lost)
    guess = _retried(some, _Index.of(some), failed, THOROUGH)
    turned = joints.turned(guess.q, some.start)
    others = descend(some, turned, EXACT if start is None else FULL)
    better = others.score < failed.score
    return _commanded(found.replaced(lost[better], others.rows(better)), joints)


def _commanded(found: Solutions, joints: Joints) -> Solutions:
    """Solutions as positions of all joints of the chain."""
    return replace(found, q=joints.positions(found.q))


def _retried(task: Task, index: _Index, found: Solutions, effort: Effort) -> Solutions:
    """The solutions, or for rows without success the best of further descents.

    Of the samples near a target, those are tried first whose joint positions are far
    from all where descents began and ended.
    """
    (left,) = np.nonzero(~found.reached)
    if not len(left):
        return found
    pool = index.nearest(task.rows(left), OPTIONS.pool)
    apart = task.joints.distances(pool, found.q[left, None])
    for count in OPTIONS.rounds:
        picked = np.empty((len(left), count, pool.shape[2]))
        for k in range(count):
            best = apart.argmax(axis=1)[:, None, None]
            picked[:, k : k + 1] = np.take_along_axis(pool, best, axis=1)
            others = task.joints.distances(pool, picked[:, k : k + 1])
            apart = np.minimum(apart, others)
        rows = np.repeat(left, count)
        tries = descend(task.rows(rows), picked.reshape(len(rows), -1), effort)
        for ends in np.swapaxes(tries.q.reshape(picked.shape), 0, 1):
            others = task.joints.distances(pool, ends[:, None])
            apart = np.minimum(apart, others)
        best = tries.score.reshape(-1, count).argmin(axis=1)
        tries = tries.rows(count * np.arange(len(left)) + best)
        better = tries.score < found.score[left]
        found = found.replaced(left[better], tries.rows(better))
        kept = ~found.reached[left]
        left, pool, apart = left[kept], pool[kept], apart[kept]
        if not len(left):
            break
    return found


@dataclass(frozen=True)
class _Index:
    """Finds samples of the joint space whose poses are near a target.

    Attributes:
        samples: Joint positions, shape (S, n).
        features: Weighted positions, orientations and joints, shape (S, F).
        weights: Weights of the three.
    """

    samples: Floats
    features: Floats
    weights: tuple[float, float, float]

    @staticmethod
    def of(task: Task) -> _Index:
        """The index of the kinematics of a task."""
        samples = task.joints.samples(OPTIONS.samples)
        T, _ = task.evaluate(samples)
        spread = float(np.sqrt(T[:, :3, 3].var(axis=0).sum()))
        weights = (
            1.0,
            OPTIONS.turn * spread if task.orientation else 0.0,
            OPTIONS.away * spread,
        )
        return _Index(samples, _features(T, samples, weights), weights)

    def nearest(self, task: Task, count: int) -> Floats:
        """The samples nearest to targets and start, shape (N, count, n)."""
        result = np.empty((len(task.targets), count, self.samples.shape[1]))
        # Half the squared distance, without the part that all samples share.
        features = np.vstack([self.features.T, 0.5 * (self.features**2).sum(axis=1)])
        # One array for all: asking for memory takes longer than the products.
        space = np.empty((OPTIONS.block, len(self.samples)), features.dtype)
        for first in range(0, len(result), OPTIONS.block):
            rows = slice(first, first + OPTIONS.block)
            wanted = _features(task.targets[rows], task.start[rows], self.weights)
            ones = np.ones((len(wanted), 1), wanted.dtype)
            distances = space[: len(wanted)]
            np.matmul(np.hstack([-wanted, ones]), features, out=distances)
            if count == 1:
                result[rows, 0] = self.samples[distances.argmin(axis=1)]
            else:
                some = np.argpartition(distances, count, axis=1)[:, :count]
                result[rows] = self.samples[some]
        return result


def _features(T: Floats, q: Floats, weights: tuple[float, float, float]) -> Floats:
    position, turn, away = weights
    parts = [position * T[:, :3, 3], away * q]
    if turn > 0.0:
        parts.append(turn * T[:, :3, :3].reshape(-1, 9))
    return np.hstack(parts).astype(np.float32)
