"""Solutions of inverse kinematics that collide with nothing, near one another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from calib_pin.control.descent import descend
from calib_pin.control.joints import (
    EXACT,
    Booleans,
    Joints,
    Kinematics,
    Solutions,
    Task,
)
from calib_pin.kinematics.spatial import Floats

Free: TypeAlias = Callable[[Floats], Booleans]
"""Joint positions of a chain, (N, n), to whether nothing touches there, (N,)."""

STARTS = 48
"""Configurations from which solutions for a target are sought."""

BLOCK = 64
"""Targets that are solved together."""

SAME = 1e-3
"""Distance up to which two solutions are the same, whatever the turns [rad, m]."""


def free_solutions(
    evaluate: Kinematics,
    targets: Floats,
    own: Solutions,
    joints: Joints,
    free: Free,
    *,
    start: Floats | None = None,
    orientation: bool = True,
) -> Solutions:
    """Solutions at which nothing touches; not reached where none was found.

    Of all that are found from many starts those are chosen that make the way from
    target to target the shortest (by dynamic programming), or that are nearest to
    given joint positions. An arm that keeps its elbow up has seldom to go around
    anything.

    Args:
        evaluate: The kinematics.
        targets: Poses to reach, shape (N, 4, 4).
        own: Solutions for them, without regard to collisions.
        joints: Limits, which are never left, and which joints follow others.
        free: Where nothing touches.
        start: Joint positions that solutions shall be close to, shape (N, n) [rad, m].
        orientation: Whether orientations count.
    """
    driven = joints.driven(own.q)
    near = driven if start is None else joints.driven(start)
    task = Task(joints.driving(evaluate), targets, near, joints, orientation)
    found: list[Solutions] = []
    for first in range(0, len(targets), BLOCK):
        found += _each(task, driven, slice(first, first + BLOCK), free)
    options = [rows.q for rows in found]
    if start is not None:
        chosen = [
            int(_ways(q, at[None], joints).argmin()) if len(q) else 0
            for q, at in zip(options, near, strict=True)
        ]
    else:
        chosen = _shortest(options, joints)
    rows = [
        some.rows(np.array([k])) if len(some) else Solutions.none(at[None])
        for some, k, at in zip(found, chosen, driven, strict=True)
    ]
    best = Solutions.joined(rows) if rows else Solutions.none(driven)
    return Solutions(
        joints.positions(best.q), best.reached, best.position, best.orientation
    )


def _each(task: Task, own: Floats, rows: slice, free: Free) -> Iterator[Solutions]:
    """The solutions of each of some targets that differ and are free."""
    joints, targets = task.joints, task.targets[rows]
    samples = joints.samples(STARTS)
    guess = np.concatenate([own[rows, None], np.tile(samples, (len(targets), 1, 1))], 1)
    count = guess.shape[1]
    each = np.repeat(np.arange(len(targets)), count)
    near = np.repeat(task.start[rows], count, axis=0)
    some = Task(task.evaluate, targets[each], near, joints, task.orientation)
    tries = descend(some, guess.reshape(len(each), -1), EXACT)
    # The turns nearest to where they shall be, if they are solutions as well.
    turned = joints.turned(tries.q, near)
    others = descend(some, turned, EXACT)
    (there,) = np.nonzero(others.reached)
    tries = tries.replaced(there, others.rows(there))
    for k in range(len(targets)):
        (reached,) = np.nonzero(tries.reached & (each == k))
        kept: list[int] = []
        for row in reached:
            if all(joints.distances(tries.q[row], tries.q[kept]) > SAME**2):
                kept.append(int(row))
        found = tries.rows(np.array(kept, np.int64))
        yield found.rows(free(joints.positions(found.q)))


def _ways(a: Floats, b: Floats, joints: Joints) -> Floats:
    """Ways between solutions, (K, n) and (L, n), whatever the turns, shape (K, L)."""
    way = a[:, None] - b[None]
    turns = np.where(joints.revolute, np.round(way / (2.0 * np.pi)), 0.0)
    return np.asarray(np.abs(way - 2.0 * np.pi * turns).sum(axis=2))


def _shortest(options: Sequence[Floats], joints: Joints) -> list[int]:
    """One of the solutions of each target, none of targets without; the rest is 0."""
    known = [k for k, q in enumerate(options) if len(q)]
    chosen = [0] * len(options)
    if not known:
        return chosen
    # The first ones are compared by their way from the middle.
    total = _ways(options[known[0]], joints.home[None], joints)[:, 0] * SAME
    best = []
    for last, k in pairwise(known):
        ways = total[:, None] + _ways(options[last], options[k], joints)
        best.append(ways.argmin(axis=0))
        total = ways.min(axis=0)
    at = int(total.argmin())
    for k, back in zip(reversed(known[1:]), reversed(best), strict=True):
        chosen[k] = at
        at = int(back[at])
    chosen[known[0]] = at
    return chosen
