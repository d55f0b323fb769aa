"""Random configurations at which an instrument can measure.

A camera must see its points and a beam must meet its plane, so configurations are drawn
until enough of them can be measured. For a contact measurement, the tool is brought
into contact.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import linearized_at
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import (
    UNSTATED,
    BlockKey,
    Conditions,
    Labels,
    Measurements,
    Targets,
    approached,
)

DRAWS = 400
"""Largest number of rounds of random draws: a camera on a small arm sees its board from
one configuration of two hundred."""

AT_ONCE = 4
"""Candidates per round for each missing configuration; at least K in all."""

PATIENCE = 25
"""Rounds after which a missing configuration tries other targets."""

NEWTON = 15
"""Largest number of Newton steps to a contact; a random start needs five to ten."""

TOUCHING = 1e-13
"""Gap below which the tool touches: numerically zero [m]."""

FARTHEST = 0.5
"""Longest step of a joint on the way to a contact [rad, m]."""


def asked(
    problem: Problem,
    key: BlockKey,
    q: Floats,
    target: Targets,
    conditions: Conditions = UNSTATED,
    start: Floats | None = None,
) -> Measurements:
    """Configurations at which to evaluate the model of a block; nothing is measured.

    Args:
        problem: The problem; its measurements name the payloads.
        key: The block.
        q: Positions of all joints, shape (K, n) [rad, m].
        target: Target of each.
        conditions: What holds at each. Where it states none the payloads are
            `payloads_in_turn`, joints come as from one to the next, and temperatures
            and times are spread over those of the measurements.
        start: Start configurations of relative measurements, shape (K, n) [rad, m];
            default the configuration before each.
    """
    if start is None:
        relative = problem.terms[key].measurement.declaration.relative
        start = np.roll(q, 1, axis=0) if relative else np.zeros((0, 0))
    if not len(conditions.payload):
        names = payloads_in_turn(problem, key, len(q))
        conditions = replace(conditions, payload=Labels.of(names))
    if not conditions.direction.size:
        conditions = replace(conditions, direction=approached(q), source="order")
    for name in ("temperature", "time"):
        known = [
            getattr(b.conditions, name) for b in problem.data.blocks if b.key == key
        ]
        if known and len(known[0]) and not len(getattr(conditions, name)):
            rows = np.linspace(0.0, len(known[0]) - 1.0, len(q)).astype(np.intp)
            conditions = replace(conditions, **{name: known[0][rows]})
    return Measurements(
        problem.chains.joints,
        q,
        values=np.zeros((len(q), 0)),
        target=Labels.of(target),
        conditions=conditions,
        start=start,
        **key._asdict(),
    )


def named_targets(problem: Problem, key: BlockKey) -> tuple[str, ...]:
    """The targets that the measurements of a block name."""
    blocks = [block for block in problem.data.blocks if block.key == key]
    return blocks[0].target.distinct if blocks else ("",)


def payloads_in_turn(problem: Problem, key: BlockKey, count: int) -> tuple[str, ...]:
    """Default payloads: those of the data in turn, length `count`.

    Each stays for as many configurations as there are targets, so that every payload
    meets every target.
    """
    names = problem.data.payload.distinct or ("",)
    targets = len(named_targets(problem, key))
    return tuple(names[k // targets % len(names)] for k in range(count))


def observable_configurations(
    problem: Problem,
    key: BlockKey,
    theta: Floats,
    count: int,
    rng: np.random.Generator,
    payload: Targets = (),
) -> Measurements:
    """Random configurations within the limits at which an instrument can measure.

    Configurations of contact measurements are moved until the tool touches.

    Args:
        problem: Chains, frames, instruments; its data only name the targets.
        key: The block of the instrument.
        theta: Parameter values, shape (P,).
        count: Number K of configurations.
        rng: Random generator.
        payload: Payload of each; default `payloads_in_turn`.

    Raises:
        InputError: If too few configurations can be measured.
    """
    names = named_targets(problem, key)
    target = [names[i % len(names)] for i in range(count)]
    loads = tuple(payload) or payloads_in_turn(problem, key, count)
    declared = problem.terms[key].measurement.declaration
    q_found: Floats = np.empty((count, len(problem.chains.joints)))
    left, tries, drawn = np.arange(count), 0, 0
    while len(left) and tries < DRAWS:
        tries += 1
        if tries > PATIENCE:
            # Some targets are hardly ever observable; others take their place.
            for i in left:
                target[i] = names[(i + tries) % len(names)]
        # More candidates than missing ones: the observable ones are shared out below.
        some = np.resize(left, max(count, AT_ONCE * len(left)) if tries > 1 else count)
        drawn += len(some)
        q = problem.chains.random_configurations(len(some), rng)
        looked, carried = [target[i] for i in some], [loads[i] for i in some]
        at = asked(problem, key, q, looked, Conditions(Labels.of(carried)))
        if declared.contact:
            q, seen = brought_to_contact(problem, theta, at)
        else:
            seen = problem.observable(theta, at)
        found = defaultdict[tuple[str, str], deque[int]](deque)
        for k in np.flatnonzero(seen).tolist():
            found[looked[k], carried[k]].append(k)
        still = np.ones(len(left), bool)
        for k, i in enumerate(left):
            if ready := found[target[i], loads[i]]:
                q_found[i], still[k] = q[ready.popleft()], False
        left = left[still]
    if len(left):
        what = "brought into contact" if declared.contact else "measured"
        few = (
            f"only {count - len(left)} of {count} configurations that can be {what} "
            f"were found among {drawn} random ones within the joint limits "
            f"({key.model})"
        )
        lacking = lacking_frames(problem, (key,))
        raise InputError(
            f"give {lacking}: without, {few}" if lacking else few,
            file=problem.setup.file or None,
        )
    return asked(problem, key, q_found, target, Conditions(Labels.of(loads)))


def lacking_frames(problem: Problem, keys: Iterable[BlockKey]) -> str:
    """The frames of blocks of which a setup gives no first guess, for a message."""
    lacking: dict[str, None] = {}
    for key in keys:
        frames = problem.terms[key].frames
        if frames.base.xyz is None:
            lacking[f"stations.{key.station}" if key.station else "frames.base"] = None
        if frames.end.xyz is None:
            lacking[f"tools.{key.tool}" if key.tool else "frames.tool"] = None
    return f"{' and '.join(lacking)} (first guess, xyz and rpy)" if lacking else ""


def brought_to_contact(
    problem: Problem, theta: Floats, at: Measurements, gap: Floats | None = None
) -> tuple[Floats, NDArray[np.bool_]]:
    """Configurations moved until the tool touches, by damped Newton steps.

    Args:
        problem: Chains, frames, instruments.
        theta: Parameter values, shape (P,).
        at: N configurations of a block of contact measurements.
        gap: Residual to leave, shape (N, d); default zero.

    Returns:
        The configurations, shape (N, n) [rad, m], and the mask of those that lie within
        the joint limits and touch, shape (N,).
    """
    term = problem.terms[at.key]
    robot, instrument = term.values(theta)
    chain, every = term.error.chain, at.q.copy()
    q = every[:, term.columns]
    touches, left = np.zeros(len(q), bool), np.arange(len(q))
    for _ in range(NEWTON):
        names, held = at.target[left], at.conditions.rows(left)
        T, J_q = term.error.kinematics(q[left], robot, held)
        linear = linearized_at(chain, term.measurement, T, instrument, q[left], names)
        short = -linear.residual if gap is None else gap[left] - linear.residual
        size = np.abs(short).max(axis=1)
        touches[left[size < TOUCHING]] = True
        # Not finite: an arm at its stretched singularity never reaches contact.
        moving = (size >= TOUCHING) & np.isfinite(size)
        left, short, J = left[moving], short[moving], (linear.J_pose @ J_q)[moving]
        if not len(left):
            break
        damped = J @ np.swapaxes(J, 1, 2)
        scale = np.trace(damped, axis1=1, axis2=2)[:, None, None]
        damped = damped + (1e-12 * scale + 1e-30) * np.eye(damped.shape[1])
        step = np.swapaxes(J, 1, 2) @ np.linalg.solve(damped, short[:, :, None])
        longest = np.abs(step[:, :, 0]).max(axis=1)
        shorter = np.minimum(1.0, FARTHEST / np.maximum(longest, FARTHEST))
        q[left] += step[:, :, 0] * shorter[:, None]
    within = ((q >= chain.lower) & (q <= chain.upper)).all(axis=1)
    every[:, term.columns] = q
    return every, touches & within
