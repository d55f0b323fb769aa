"""Trapezoidal motions within their limits."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from studies.trajectory import Trajectory, trapezoidal

angle = st.floats(-3.2, 3.2)
limit = st.floats(0.01, 100.0)
joints = st.integers(1, 7).flatmap(
    lambda n: st.tuples(
        *(st.lists(angle, min_size=n, max_size=n) for _ in range(2)),
        *(st.lists(limit, min_size=n, max_size=n) for _ in range(2)),
    )
)


def check_limits(
    motion: Trajectory, velocity: np.ndarray | float, acceleration: np.ndarray | float
) -> None:
    """Of what is stated, and of differences between samples."""
    assert (np.abs(motion.velocity) <= velocity * (1 + 1e-9)).all()
    step = np.diff(motion.time)[:, None]
    # Rounding of the positions grows as the steps shrink.
    rounding = 1e-12 / step
    moved = np.abs(np.diff(motion.q, axis=0)) / step
    assert (moved <= velocity * (1 + 1e-9) + rounding).all()
    changed = np.abs(np.diff(motion.velocity, axis=0)) / step
    rounding = 1e-12 * np.max(velocity) / step
    assert (changed <= acceleration * (1 + 1e-9) + rounding).all()


@given(joints, st.integers(1, 300))
def test_limits_ends_and_synchronization(given, samples):
    start, goal, velocity, acceleration = map(np.array, given)
    whole = trapezoidal(start, goal, velocity, acceleration, 1e5)
    assert len(whole.q) == 1 + (whole.duration > 0.0)
    period = whole.duration / samples or 1.0
    motion = trapezoidal(start, goal, velocity, acceleration, period)
    assert motion.duration == whole.duration
    assert motion.q[-1].tolist() == goal.tolist()
    assert not motion.velocity[[0, -1]].any()
    if whole.duration == 0.0:
        return
    assert len(motion.time) == samples + 1
    assert motion.q[0].tolist() == start.tolist()
    steps = np.diff(motion.time)
    assert (steps > 0.0).all() and (steps <= period * (1 + 1e-8)).all()
    check_limits(motion, velocity, acceleration)
    # All joints move and rest together.
    way = goal - start
    moving = np.abs(way) > 1e-6
    part = (motion.q - start)[:, moving] / way[moving]
    assert (np.abs(part - part[:, :1]) < 1e-8).all()


@given(joints)
def test_no_motion_is_faster(given: tuple[list[float], ...]) -> None:
    """Alone, a joint takes no longer; one limit is met."""
    start, goal, velocity, acceleration = map(np.array, given)
    together = trapezoidal(start, goal, velocity, acceleration, 1e5)
    for k in range(len(start)):
        alone = trapezoidal(
            start[k : k + 1], goal[k : k + 1], velocity[k], acceleration[k], 1e5
        )
        assert alone.duration <= together.duration * (1 + 1e-9)
    if together.duration > 0.0:
        fine = trapezoidal(
            start, goal, velocity, acceleration, together.duration / 1000
        )
        steepest = np.abs(fine.velocity[1]) / (fine.time[1] * acceleration)
        fastest = np.abs(fine.velocity).max(axis=0) / velocity
        assert max(steepest.max(), fastest.max()) > 1 - 1e-2
