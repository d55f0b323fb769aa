"""Inverse kinematics from a start and, where there is none or it fails, from many."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.control.descent import descend
from calib_pin.control.joints import (
    EXACT,
    FULL,
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
        rounds: Samples from which a target is tried at once, round after round: most
            targets need few, and some need many.
        spread: Every so many of the nearest samples is tried: nearer ones lead to the
            same end.
        turn: Weight of a rotation matrix beside a position by their spread: a wrist
            turns more easily than an arm reaches.
        away: Weight of a joint's way from the start beside a position by its spread
            [1/rad].
        block: Targets that are compared with all samples at a time: what a cache holds.
    """

    samples: int = 2048
    rounds: tuple[int, ...] = (2, 6, 24)
    spread: int = 4
    turn: float = 0.25
    away: float = 0.15
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
    return _commanded(_descended(task, near, FULL), joints)


def search(
    evaluate: Kinematics,
    targets: Floats,
    joints: Joints,
    start: Floats | None = None,
    *,
    orientation: bool = True,
) -> Solutions:
    """Solutions anywhere within the limits.

    Descents begin at the start and, without one or where that fails, at samples of the
    joint space whose poses are near the target.

    Args:
        evaluate: The kinematics.
        targets: Poses to reach, shape (N, 4, 4).
        joints: Limits, which are never left, and which joints follow others.
        start: Joint positions that solutions shall be close to, shape (N, n)
            [rad, m]; by default those in the middle are preferred, and redundant
            joints stay where they are found.
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
    home = np.tile(joints.home, (len(targets), 1))
    near = home if start is None else joints.driven(start)
    task = Task(joints.driving(evaluate), targets, near, joints, orientation)
    effort, guess = FULL, near
    if start is None:
        effort, guess = EXACT, joints.turned(_nearest(task, 1)[:, 0], near)
    found = _descended(task, guess, effort)
    lost = np.flatnonzero(~found.reached)
    if not len(lost):
        return _commanded(found, joints)
    pool = _nearest(task.rows(lost), OPTIONS.spread * sum(OPTIONS.rounds))[
        :, OPTIONS.spread - 1 :: OPTIONS.spread
    ]
    for count in OPTIONS.rounds:
        tried, pool = pool[:, :count], pool[:, count:]
        each = task.rows(np.repeat(lost, count))
        guess = joints.turned(tried.reshape(-1, tried.shape[2]), each.start)
        tries = _descended(each, guess, effort)
        best = tries.score.reshape(-1, count).argmin(axis=1)
        tries = tries.rows(count * np.arange(len(lost)) + best)
        better = tries.score < found.score[lost]
        found = found.replaced(lost[better], tries.rows(better))
        lost, pool = lost[~tries.reached], pool[~tries.reached]
    return _commanded(found, joints)


def _descended(task: Task, guess: Floats, effort: Effort) -> Solutions:
    """Solutions from a guess, in the turns nearest to the start."""
    found = descend(task, guess, effort)
    turned = task.joints.turned(found.q, task.start)
    (far,) = np.nonzero((turned != found.q).any(axis=1))
    # Corrections need not be periodic: another turn is another descent.
    others = descend(task.rows(far), turned[far], effort)
    closer = others.reached | ~found.reached[far]
    return found.replaced(far[closer], others.rows(closer))


def _commanded(found: Solutions, joints: Joints) -> Solutions:
    """Solutions as positions of all joints of the chain."""
    return replace(found, q=joints.positions(found.q))


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
    half = 0.5 * (known**2).sum(axis=1)
    result = np.empty((len(wanted), count, samples.shape[1]))
    for first in range(0, len(result), OPTIONS.block):
        rows = slice(first, first + OPTIONS.block)
        distances = half - wanted[rows] @ known.T
        if count == 1:  # Sooner than a partition.
            result[rows, 0] = samples[distances.argmin(axis=1)]
            continue
        some = np.argpartition(distances, count, axis=1)[:, :count]
        order = np.take_along_axis(distances, some, axis=1).argsort(axis=1)
        result[rows] = samples[np.take_along_axis(some, order, axis=1)]
    return result
