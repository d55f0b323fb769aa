"""Random configurations at which an instrument can measure.

A camera must see its points and a beam must meet its plane, so configurations are drawn
until enough of them can be measured. For a contact measurement, the tool is brought
into contact.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.estimation.model import Configurations, linearized_at
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.mixed import contact_rows, relative_rows
from calib_pin.observations import Measurements

DRAWS = 50
"""Largest number of rounds of random draws."""

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
    q: Floats,
    target: Sequence[str],
    payload: Sequence[str] = (),
    start: Floats | None = None,
) -> Configurations:
    """Configurations at which to evaluate the measurement model of a problem.

    Args:
        problem: The problem; its measurements name the payloads.
        q: Joint positions, shape (K, n) [rad, m].
        target: Target of each.
        payload: Payload of each; default `payloads_in_turn`.
        start: Start configurations of relative measurements, shape (K, n) [rad, m];
            default the configuration before each.
    """
    if problem.measurement.declaration.relative and start is None:
        start = np.roll(q, 1, axis=0)
        start[~relative_rows(problem.measurement, target)] = np.nan
    return Configurations(
        q,
        tuple(target),
        tuple(payload) or payloads_in_turn(problem.data, len(q)),
        np.zeros((0, 0)) if start is None else start,
    )


def payloads_in_turn(data: Measurements, count: int) -> tuple[str, ...]:
    """Default payloads: those of the data in turn, length `count`.

    Each stays for as many configurations as there are targets, so that every payload
    meets every target.
    """
    names = tuple(dict.fromkeys(data.payload)) or ("",)
    targets = len(set(data.target)) or 1
    return tuple(names[k // targets % len(names)] for k in range(count))


def observable_configurations(
    problem: Problem, theta: Floats, count: int, rng: np.random.Generator
) -> tuple[Floats, tuple[str, ...]]:
    """Random configurations within the limits at which the instrument can measure.

    Configurations of contact measurements are moved until the tool touches.

    Args:
        problem: Chain, frames, instrument; its data only name the targets.
        theta: Parameter values, shape (P,).
        count: Number K of configurations.
        rng: Random generator.

    Returns:
        Joint positions, shape (K, n) [rad, m], and the target of each.

    Raises:
        InputError: If too few configurations can be measured.
    """
    names = tuple(dict.fromkeys(problem.data.target)) or ("",)
    target = [names[i % len(names)] for i in range(count)]
    loads = payloads_in_turn(problem.data, count)
    chain, measurement = problem.error.chain, problem.measurement
    q_found: Floats = np.empty((count, len(chain.joints)))
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
        q = chain.random_configurations(len(some), rng)
        looked, carried = [target[i] for i in some], [loads[i] for i in some]
        touching = contact_rows(measurement, looked)
        seen = np.ones(len(some), bool)
        if touching.any():
            q, seen = brought_to_contact(
                problem, theta, q, looked, touching, payload=carried
            )
        if not touching.all():
            seen &= problem.observable(theta, asked(problem, q, looked, carried))
        found: dict[tuple[str, str], deque[int]] = {}
        for k in np.flatnonzero(seen):
            found.setdefault((looked[k], carried[k]), deque()).append(int(k))
        still = []
        for i in left:
            if ready := found.get((target[i], loads[i])):
                q_found[i] = q[ready.popleft()]
            else:
                still.append(i)
        left = np.array(still, np.int64)
    if len(left):
        what = "brought into contact" if measurement.declaration.contact else "measured"
        raise InputError(
            f"only {count - len(left)} of {count} configurations that can be {what} "
            f"were found among {drawn} random ones within the joint limits "
            f"({measurement.name})"
        )
    return q_found, tuple(target)


def brought_to_contact(
    problem: Problem,
    theta: Floats,
    q: Floats,
    target: Sequence[str],
    rows: NDArray[np.bool_],
    gap: Floats | None = None,
    payload: Sequence[str] = (),
) -> tuple[Floats, NDArray[np.bool_]]:
    """Configurations moved until the tool touches, by damped Newton steps.

    Args:
        problem: Chain, frames, instrument.
        theta: Parameter values, shape (P,).
        q: Configurations, shape (N, n) [rad, m].
        target: Target of each.
        rows: Mask of contact measurements, shape (N,); the others stay.
        gap: Residual to leave, shape (N, d); default zero.
        payload: Payload of each; default `payloads_in_turn`.

    Returns:
        The configurations, shape (N, n) [rad, m], and the mask of those that lie within
        the joint limits and touch if they are to, shape (N,).
    """
    robot, instrument = problem.split(theta)
    chain, measurement = problem.error.chain, problem.measurement
    q, touches = q.copy(), ~rows
    payload = payload or payloads_in_turn(problem.data, len(q))
    left = np.flatnonzero(rows)
    for _ in range(NEWTON):
        names = [target[int(k)] for k in left]
        loads = [payload[int(k)] for k in left]
        T, J_q = problem.error.kinematics(q[left], robot, loads)
        linear = linearized_at(chain, measurement, T, instrument, q[left], names)
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
    return q, touches & within
