"""Trapezoidal joint trajectories, and errors of the tip along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats, so3_log

__all__ = ["TipErrors", "Trajectory", "tip_errors", "trapezoidal"]

MOST = 1_000_000
"""Samples of a trajectory; more come from a mistaken unit."""

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


@dataclass(frozen=True)
class TipErrors:
    """Predicted minus true tip poses, in the base frame.

    Attributes:
        position: Differences of the positions, shape (N, 3) [m].
        orientation: Rotation vectors from true to predicted, shape (N, 3) [rad].
    """

    position: Floats
    orientation: Floats

    @property
    def distances(self) -> Floats:
        """Norms of the position errors, shape (N,) [m]."""
        return np.asarray(np.linalg.norm(self.position, axis=1))

    @property
    def angles(self) -> Floats:
        """Norms of the orientation errors, shape (N,) [rad]."""
        return np.asarray(np.linalg.norm(self.orientation, axis=1))

    @property
    def largest(self) -> tuple[float, float]:
        """Largest component of position [m] and orientation [rad], unsigned."""
        return (
            float(np.abs(self.position).max(initial=0.0)),
            float(np.abs(self.orientation).max(initial=0.0)),
        )


def trapezoidal(
    start: Sequence[float] | Floats,
    goal: Sequence[float] | Floats,
    velocity: float | Sequence[float] | Floats,
    acceleration: float | Sequence[float] | Floats,
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

    Raises:
        OptionError: If the shapes disagree, a number is not finite, a limit or the
            period is not positive, or there were more than a million samples.

    Example:
        >>> motion = trapezoidal([0.0, 1.0], [3.0, 0.0], 1.0, [2.0, 1.0], 0.5)
        >>> motion.time.tolist()
        [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]
        >>> motion.velocity[:, 0].tolist()
        [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    """
    first, last = _finite("start", start), _finite("goal", goal)
    if first.ndim != 1 or first.shape != last.shape:
        raise OptionError(
            f"start has shape {first.shape}, the goal {last.shape}",
            allowed="the same number of joints",
        )
    limits = [
        _positive(name, value, len(first))
        for name, value in (("velocity", velocity), ("acceleration", acceleration))
    ]
    step = float(_positive("period", period, 1)[0])
    with np.errstate(over="ignore", invalid="ignore"):
        way = last - first
        at_speed, squared = (np.max(np.abs(way) / x, initial=0.0) for x in limits)
        profile = _Profile.fastest(float(at_speed), float(squared))
        intervals = profile.duration / step - SAME
    # The negation also catches what is not a number.
    if not intervals <= MOST - 1:
        raise OptionError(
            f"the motion takes {profile.duration:.4g} s, too long for this period",
            value=period,
            allowed=f"at most {MOST} samples",
        )
    moves = profile.duration > 0.0
    count = max(int(np.ceil(intervals)), int(moves))
    time: Floats = np.append(step * np.arange(count), profile.duration)
    # Seen from the nearer end: both ends are met without rounding.
    early = time < 0.5 * profile.duration
    near = np.where(early, time, profile.duration - time)
    covered, speed = (x[:, None] for x in profile.sample(near))
    q = np.where(early[:, None], first + covered * way, last - covered * way)
    return Trajectory(time, q, speed * way)


def tip_errors(true_poses: Floats, predicted_poses: Floats) -> TipErrors:
    """Errors of predicted tip poses, in the base frame.

    Args:
        true_poses: Tip poses of the true robot in the base, shape (N, 4, 4).
        predicted_poses: Those of a model of it, shape (N, 4, 4).

    Raises:
        OptionError: If the shapes disagree.

    Example:
        >>> true = np.eye(4)[None]
        >>> predicted = true + [[[0, 0, 0, 0.5], [0] * 4, [0] * 4, [0] * 4]]
        >>> tip_errors(true, predicted).largest
        (0.5, 0.0)
    """
    true, predicted = np.asarray(true_poses), np.asarray(predicted_poses)
    if true.shape != predicted.shape or true.shape[1:] != (4, 4):
        raise OptionError(
            f"true poses have shape {true.shape}, predicted ones {predicted.shape}",
            allowed="(N, 4, 4) for both",
        )
    turned = predicted[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2)
    return TipErrors((predicted - true)[:, :3, 3], so3_log(turned))


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


def _finite(name: str, values: Sequence[float] | Floats | float) -> Floats:
    try:
        result = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise OptionError(f"{name} does not consist of numbers", value=values) from None
    if not np.isfinite(result).all():
        raise OptionError(
            f"{name} is not finite", value=result.tolist(), allowed="finite numbers"
        )
    return result


def _positive(
    name: str, values: Sequence[float] | Floats | float, count: int
) -> Floats:
    """One positive number for each of some joints, shape (count,)."""
    result = _finite(name, values)
    if result.shape not in ((), (count,)):
        raise OptionError(
            f"{name} has shape {result.shape}", allowed=f"one number, or {count}"
        )
    if not (result > 0.0).all():
        raise OptionError(
            f"{name} is not positive", value=result.tolist(), allowed="above 0"
        )
    return np.broadcast_to(result, (count,))
