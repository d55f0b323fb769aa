"""Solutions of inverse kinematics that collide with nothing, near one another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
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
"""Configurations from which solutions for a target are sought: from half as many, ways
to a start are a sixth longer."""

BLOCK = 64
"""Targets that are solved together: one at a time they take four times as long."""

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
    if start is None:
        chosen = _shortest(options, joints)
    else:
        pairs = zip(options, near, strict=True)
        ways = [_ways(q, at[None], joints) for q, at in pairs]
        chosen = [int(way.argmin()) if len(way) else 0 for way in ways]
    none = Solutions(driven, own.reached & False, own.position, own.orientation)
    rows = [
        some.rows([k]) if len(some) else none.rows([at])
        for at, (some, k) in enumerate(zip(found, chosen, strict=True))
    ]
    best = Solutions.joined([none.rows([]), *rows])
    return replace(best, q=joints.positions(best.q))


def _each(task: Task, own: Floats, rows: slice, free: Free) -> Iterator[Solutions]:
    """The solutions of each of some targets that differ and are free."""
    joints, targets = task.joints, task.targets[rows]
    samples = joints.samples(STARTS)
    some = np.tile(samples, (len(targets), 1, 1))
    guess = np.concatenate([own[rows, None], some], axis=1)
    each = np.repeat(np.arange(len(targets)), guess.shape[1])
    repeated = task.rows(rows).rows(each)
    tries = descend(repeated, guess.reshape(len(each), -1), EXACT)
    # The turns nearest to where they shall be, if they are solutions as well.
    turned = joints.turned(tries.q, repeated.start)
    others = descend(repeated, turned, EXACT)
    tries = tries.replaced(others.reached, others.rows(others.reached))
    for k in range(len(targets)):
        (reached,) = np.nonzero(tries.reached & (each == k))
        kept: list[int] = []
        for row in reached:
            if all(joints.distances(tries.q[row], tries.q[kept]) > SAME**2):
                kept.append(int(row))
        found = tries.rows(kept)
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
