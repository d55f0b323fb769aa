"""Trapezoidal joint trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats

SAME = 1e-9
"""Part of a period that is not worth a sample of its own."""


@dataclass(frozen=True)
class Trajectory:
    """Samples of a joint motion.

    Attributes:
        time: Time since the start, shape (N,) [s].
        q: Joint positions, shape (N, n) [rad, m].
        velocity: Joint velocities, shape (N, n) [rad/s, m/s].
    """

    time: Floats
    q: Floats
    velocity: Floats

    @property
    def duration(self) -> float:
        """Time from start to goal [s]."""
        return float(self.time[-1])


def trapezoidal(
    start: Sequence[float] | Floats,
    goal: Sequence[float] | Floats,
    velocity: float | Floats,
    acceleration: float | Floats,
    period: float,
) -> Trajectory:
    """The fastest trapezoidal motion on the straight line between two configurations.

    All joints share one profile: they accelerate, cruise and stop together, so fast
    that one of them is at its limit. Where the way is too short to reach full speed
    there is no cruise, and the profile is a triangle (Lynch and Park, Modern Robotics,
    2017, section 9.2.2.2).

    Args:
        start: First configuration, shape (n,) [rad, m].
        goal: Last configuration, shape (n,) [rad, m].
        velocity: Largest velocity of every joint, shape (n,), or one for all
            [rad/s, m/s].
        acceleration: Largest acceleration, in the same form [rad/s^2, m/s^2].
        period: Time between samples [s]; the last interval may be shorter.

    Returns:
        Samples from exactly the start to exactly the goal; a single one where they
        are the same.

    Example:
        >>> motion = trapezoidal([0.0, 1.0], [3.0, 0.0], 1.0, [2.0, 1.0], 0.5)
        >>> motion.time.tolist()
        [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]
        >>> motion.velocity[:, 0].tolist()
        [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    """
    first, last = np.asarray(start, np.float64), np.asarray(goal, np.float64)
    way = last - first
    profile = _Profile.fastest(
        float(np.max(np.abs(way) / velocity, initial=0.0)),
        float(np.max(np.abs(way) / acceleration, initial=0.0)),
    )
    moves = profile.duration > 0.0
    count = max(int(np.ceil(profile.duration / period - SAME)), int(moves))
    time: Floats = np.append(period * np.arange(count), profile.duration)
    # Seen from the nearer end: both ends are met without rounding.
    early = time < 0.5 * profile.duration
    near = np.where(early, time, profile.duration - time)
    covered, speed = (x[:, None] for x in profile.sample(near))
    q = np.where(early[:, None], first + covered * way, last - covered * way)
    return Trajectory(time, q, speed * way)


@dataclass(frozen=True)
class _Profile:
    """Speed along a way of length one.

    Attributes:
        duration: Time of the whole way [s].
        ramp: Time to reach full speed [s].
        peak: Full speed [1/s].
    """

    duration: float
    ramp: float
    peak: float

    @staticmethod
    def fastest(at_speed: float, squared: float) -> _Profile:
        """The fastest profile that keeps the limits of all joints.

        Args:
            at_speed: Time at full speed that the slowest joint needs, max |d| / v [s].
            squared: The same for accelerations, max |d| / a [s^2].
        """
        if at_speed == 0.0 or squared == 0.0:
            return _Profile(0.0, 0.0, 0.0)
        if squared >= at_speed * at_speed:
            ramp = float(np.sqrt(squared))
            return _Profile(2.0 * ramp, ramp, 1.0 / ramp)
        ramp = squared / at_speed
        return _Profile(at_speed + ramp, ramp, 1.0 / at_speed)

    def sample(self, time: Floats) -> tuple[Floats, Floats]:
        """Covered part and speed [1/s] within the first half, shape (N,) each."""
        if self.duration == 0.0:
            return np.zeros_like(time), np.zeros_like(time)
        part = np.minimum(time / self.ramp, 1.0)
        cruised = np.maximum(time - self.ramp, 0.0)
        return self.peak * (0.5 * self.ramp * part**2 + cruised), self.peak * part
