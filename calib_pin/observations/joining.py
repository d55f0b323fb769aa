"""Two logs by time: where the robot stood still, and what was measured there.

A robot's log says when its joints stood; an instrument's log, by a clock of its own,
what it read. While the robot moves between two standstills, everything that is measured
is a smooth function of the way that the joints have gone. The one log tells that way,
so the other one's clock is the one with which polynomials of it fit best: linear
least squares for the polynomials of all motions and, by Gauss-Newton, one offset. At
0.2 m/s and 0.05 mm of noise a single reading tells it to 0.25 ms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats, from_quaternion, so3_log

STILL = 1e-4
"""Way of a joint in half a second that still counts as standing [rad, m]."""

EDGE = 0.1
"""Time before a motion is seen in which readings do not count [s]."""

NOISES = 6.0
"""Standard deviations of the noise beyond which a value has moved."""

ORDER = 6
"""Order of the polynomials of a motion."""

READINGS = 3
"""Readings of a motion for each coefficient from which it tells the clock."""

ALIKE = 0.6
"""Correlation of both logs' motions from which they are of one recording."""

LIKE = 0.1
"""Difference in thousands of the spans of two logs, as a power, that is theirs."""

COARSE = 0.02
"""Step of the first search for the clock [s]."""

HALF_HOUR = 1800.0
ZONES = [HALF_HOUR * count for count in range(-28, 29)]
"""Differences of time zones, of which one clock may show another than the other [s]."""

HARDLY, MOSTLY = 0.5, 0.9
"""Part of the readings in standstills below which a time zone is sought, and from which
it is one."""

LEAST = 0.1
"""Part of the joints' sampling time to which the clock is known at best."""

MARGIN = 0.2
"""Time before and behind a motion that belongs to it [s]."""

FAR = 6.0
"""Robust standard deviations from a standstill's median from which a reading is out."""

TINY = float(np.finfo(float).tiny)

WINDOW = 5.0
"""Lags over which an autocorrelation is summed, in its sum."""

SURE = 3.0
"""Standard deviations of the clock that a reading keeps from a standstill's ends."""


@dataclass(frozen=True)
class Log:
    """Values by time.

    Attributes:
        time: Ascending, shape (N,) [s]; equal only for values of different kinds.
        values: Shape (N, k) [SI units].
        kind: Point, tool or station that each is of, shape (N,); None if of one.
    """

    time: Floats
    values: Floats
    kind: NDArray[np.int64] | None = None

    @property
    def kinds(self) -> list[NDArray[np.int64]]:
        """The rows of each kind."""
        if self.kind is None:
            return [np.arange(len(self.time))]
        return [np.flatnonzero(self.kind == k) for k in np.unique(self.kind)]


@dataclass(frozen=True)
class Clock:
    """The clock of the readings against that of the joints.

    Attributes:
        ahead: Time of a reading minus that of the joints at the same instant [s].
        sigma: Its standard deviation [s].
        motions: Number of motions that tell it; 0 where only the standstills do: it is
            anywhere in an interval of this standard deviation then.
    """

    ahead: float
    sigma: float
    motions: int


@dataclass(frozen=True)
class Standstill:
    """A time in which all joints stood, and the readings of one point in it.

    Attributes:
        start: When they had stood for long enough [s, clock of the joints].
        q: Means of the joints, shape (n,).
        readings: Rows of the readings that count.
    """

    start: float
    q: Floats
    readings: NDArray[np.int64]


@dataclass(frozen=True)
class Joined:
    """Both logs together.

    Attributes:
        clock: The clock of the readings; None where no time joins them.
        standstills: Those with a reading, in order, one for each point that was read.
        empty: Number of standstills without one.
        moving: Number of readings during a motion, or too close to one.
        scattered: Number of readings in a standstill that are far from its others.
        alone: Names of rows or readings that have no partner, where names join them.
    """

    clock: Clock | None
    standstills: tuple[Standstill, ...]
    empty: int
    moving: int
    scattered: int
    alone: tuple[str, ...] = ()

    @property
    def stands(self) -> int:
        """Number of standstills with a reading, whatever was read."""
        return len({standstill.start for standstill in self.standstills})

    @property
    def used(self) -> int:
        """Number of readings that count."""
        return sum(len(standstill.readings) for standstill in self.standstills)


def join(joints: Log, readings: Log, settle: float, gap: float) -> Joined:
    """Find the readings of each standstill.

    Args:
        joints: Positions of the joints.
        readings: Measured values; their clock may be any.
        settle: Time that joints stand before readings count [s].
        gap: Longest time without a sample of the joints [s].

    Raises:
        InputError: If the joints never stand, or the logs are of no common time.
    """
    motion = _Motion(joints, settle, gap)
    if not motion.standstills:
        raise InputError(f"the joints never stand still for {settle:g} s")
    # Of several points that are read by turns, one moves smoothly.
    most = max(readings.kinds, key=len)
    clock = motion.clock(Log(readings.time[most], readings.values[most]))
    time = readings.time - clock.ahead
    guard = SURE * clock.sigma if clock.motions else 0.0
    standstills, empty, used, scattered = [], 0, 0, 0
    for start, end in motion.standstills:
        within = (time >= start + guard) & (time <= end - guard)
        empty += not within.any()
        inside = (joints.time >= start) & (joints.time <= end)
        # A slow log has no sample between both; the one that is nearest stood as well.
        inside[np.argmin(np.abs(joints.time - 0.5 * (start + end)))] = True
        for kind in readings.kinds:
            rows = kind[within[kind]]
            kept = rows[_near_median(readings.values[rows])]
            scattered += len(rows) - len(kept)
            used += len(rows)
            if len(kept):
                q = joints.values[inside].mean(axis=0)
                standstills.append(Standstill(start, q, kept))
    return Joined(clock, tuple(standstills), empty, len(time) - used, scattered)


def _near_median(values: Floats) -> NDArray[np.bool_]:
    """Readings of a standstill that are not far from its median, shape (N,)."""
    if len(values) < 4:
        return np.ones(len(values), bool)
    away = np.abs(values - np.median(values, axis=0))
    size = 1.4826 * np.median(away, axis=0)
    return np.asarray(np.all(away <= FAR * size + 1e-12, axis=1))


class _Motion:
    """The motion of a robot: when it stood still, and how far its joints have gone."""

    def __init__(self, joints: Log, settle: float, gap: float) -> None:
        time, values = joints.time, joints.values
        steps = np.diff(time)
        self.step = float(np.median(steps))
        grid = np.arange(time[0], time[-1] + 0.5 * self.step, self.step)
        q = np.column_stack([np.interp(grid, time, column) for column in values.T])
        changes = np.abs(np.diff(q, axis=0))
        # Second differences see no smooth motion; a quarter of those of a normal
        # deviate is below 0.78 of its sigma.
        noise = np.quantile(np.abs(np.diff(q, 2, axis=0)), 0.25, axis=0) / 0.78
        self.settle = settle
        width = max(round(settle / self.step), 2)
        allowed = STILL * max(settle / 0.5, 1.0) + NOISES * noise
        high = maximum_filter1d(q, width, axis=0, mode="nearest")
        low = minimum_filter1d(q, width, axis=0, mode="nearest")
        quiet = np.all(high - low <= allowed, axis=1)
        far = np.searchsorted(time, grid)
        before = time[np.maximum(far - 1, 0)]
        quiet &= time[np.minimum(far, len(time) - 1)] - before <= gap
        # A window that is quiet is so from its first to its last sample.
        first, behind = _runs(quiet).T
        half = 0.5 * width * self.step
        starts = grid[first] + half
        ends = np.minimum(grid[behind - 1] + half, grid[-1])
        ends -= max(EDGE, 3.0 * self.step)
        pairs = zip(starts.tolist(), ends.tolist(), strict=True)
        self.standstills = [(start, end) for start, end in pairs if end > start]
        standing = maximum_filter1d(quiet, 2 * (width // 2) + 1, mode="constant")
        self.grid, self.moving = grid, ~standing
        gone = np.sqrt(np.sum(changes**2, axis=1)) * self.moving[1:]
        self.way: Floats = np.concatenate([[0.0], np.cumsum(gone)])
        self.speed: Floats = np.gradient(self.way, self.step)

    def clock(self, readings: Log) -> Clock:
        """The clock of readings by motions, or else by the standstills alone."""
        ahead = self._coarse(readings)
        clock = None if ahead is None else self._fine(readings, ahead)
        return clock or self._by_standstills(readings)

    def _coarse(self, readings: Log) -> float | None:
        """The offset with which both move at the same times; None if neither tells."""
        time, values = readings.time, readings.values
        gaps = np.diff(time)
        if np.mean(gaps < 1.0) < 0.5 or not self.moving.any():
            return None
        size = values.std(axis=0)
        scaled = values / np.where(size > 0.0, size, 1.0)
        rates = np.sqrt(np.sum(np.diff(scaled, axis=0) ** 2, axis=1)) / gaps
        step = max(COARSE, self.step)
        first = np.arange(self.grid[0], self.grid[-1], step)
        second = np.arange(time[0], time[-1], step)
        by_joints = np.interp(first, self.grid, np.sqrt(self.speed))
        middle = 0.5 * (time[1:] + time[:-1])
        by_readings = np.interp(second, middle, np.sqrt(rates))
        a, b = by_joints - by_joints.mean(), by_readings - by_readings.mean()
        one_a, one_b = np.ones(len(a)), np.ones(len(b))
        products, shared = _correlated(b, a), _correlated(one_b, one_a)
        ones = _correlated(b**2, one_a), _correlated(one_b, a**2)
        enough = shared >= 0.5 * min(len(a), len(b))
        scale = np.sqrt(np.maximum(ones[0] * ones[1], 1e-300))
        likeness = np.where(enough, products / scale, -1.0)
        best = int(np.argmax(likeness))
        if likeness[best] < ALIKE:
            return None
        return float(second[0] - first[0] + (best - (len(a) - 1)) * step)

    def _fine(self, readings: Log, ahead: float) -> Clock | None:
        """The offset with which readings are smooth functions of the way."""
        ends = [(start, end) for (_, start), (end, _) in pairwise(self.standstills)]
        for _ in range(30):
            each = (self._motion_part(readings, ahead, *motion) for motion in ends)
            parts = [part for part in each if part is not None]
            if not parts:
                return None
            slopes, weights, values, dof = np.array(parts).T
            moved = float(slopes.sum() / weights.sum())
            ahead += np.clip(moved, -0.2, 0.2)
            if abs(moved) < 1e-6:
                break
        each = slopes / weights
        sigma = np.sqrt(values.sum() / max(dof.sum(), 1.0) / weights.sum())
        spread = np.sqrt(np.sum(weights**2 * (each - moved) ** 2)) / weights.sum()
        least = LEAST * self.step
        return Clock(float(ahead), float(max(sigma, spread, least)), len(parts))

    def _motion_part(
        self, readings: Log, ahead: float, start: float, end: float
    ) -> tuple[float, float, float, float] | None:
        """A motion's part: slope, weight, number of values and of those to spare."""
        time = readings.time - ahead
        rows = slice(*np.searchsorted(time, [start - MARGIN, end + MARGIN]))
        t, y = time[rows], readings.values[rows]
        inside = np.count_nonzero((t > start) & (t < end))
        if inside < READINGS * (ORDER + 1):
            return None
        way = np.interp(t, self.grid, self.way)
        length = way[-1] - way[0]
        if not length > 0.0:
            return None
        x = 2.0 * (way - way[0]) / length - 1.0
        V = np.polynomial.chebyshev.chebvander(x, ORDER)
        c = np.linalg.lstsq(V, y, rcond=None)[0]
        rest = y - V @ c
        rate = 2.0 * np.interp(t, self.grid, self.speed) / length
        by_way = np.polynomial.chebyshev.chebder(c)
        slope = np.polynomial.chebyshev.chebval(x, by_way).T * rate[:, None]
        # A clock that is further ahead puts readings earlier on their way.
        d = -slope
        d = d - V @ np.linalg.lstsq(V, d, rcond=None)[0]
        noise = np.maximum(np.mean(rest**2, axis=0), 1e-300)
        weight = float(np.sum(d**2 / noise))
        if not weight > 0.0:
            return None
        spare = y.size - V.shape[1] * y.shape[1] - 1
        return float(np.sum(d * rest / noise)), weight, y.size, spare

    def _by_standstills(self, readings: Log) -> Clock:
        """The offset nearest zero with which most readings are in standstills.

        Where hardly any are, it may be one of a time zone, with which nearly all are.
        """
        # The instrument need not have waited.
        sooner, later = self.settle + 2.0 * COARSE, EDGE + 2.0 * COARSE
        starts, ends = np.array(self.standstills).T + np.array([[-sooner], [later]])
        longest = float((ends - starts).max())
        near = np.arange(-longest, longest + COARSE, COARSE)

        def inside(ahead: float) -> int:
            t = readings.time - ahead
            k = np.searchsorted(starts, t, side="right") - 1
            return int(np.count_nonzero((k >= 0) & (t <= ends[np.maximum(k, 0)])))

        def counted(zone: float) -> NDArray[np.int64]:
            return np.array([inside(zone + ahead) for ahead in near], np.int64)

        zone, counts, count = 0.0, counted(0.0), len(readings.time)
        for other in ZONES if counts.max() < HARDLY * count else ():
            time = readings.time - other
            common = (time > starts[0] - longest) & (time < ends[-1] + longest)
            if common.mean() >= MOSTLY:
                more = counted(other)
                if more.max() >= max(MOSTLY * count, counts.max() + 1):
                    zone, counts = other, more
        if not counts.max():
            spans = [f"{t[0]:.1f} to {t[-1]:.1f} s" for t in (self.grid, readings.time)]
            text = "joints are of {}, readings of {}".format(*spans)
            raise InputError(f"the logs have no common time: {text}")
        # Runs of offsets that are as good, of which the one nearest to zero counts.
        runs = near[_runs(counts == counts.max()) - [0, 1]].tolist()
        low, high = min(runs, key=lambda run: max(run[0], -run[1]))
        # Nothing moves it from zero needlessly.
        ahead = 0.0 if low <= 0.0 <= high else 0.5 * (low + high)
        return Clock(zone + ahead, (high - low + COARSE) / np.sqrt(12.0), 0)


def _runs(true: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Where each run of true values begins, and ends before, shape (R, 2)."""
    return np.flatnonzero(np.diff(np.pad(true, 1))).reshape(-1, 2)


def _correlated(b: Floats, a: Floats) -> Floats:
    """Sums of products of b (M,) and a (N,) at all their shifts, shape (M + N - 1,)."""
    count = len(a) + len(b) - 1
    of_both = np.fft.rfft(b, count) * np.fft.rfft(a[::-1], count)
    return np.fft.irfft(of_both, count)


def join_by_name(
    joints: Log, readings: Log, ours: Sequence[str], theirs: Sequence[str]
) -> Joined:
    """The readings of each row of the joints that has the same name, in any case.

    Args:
        joints: Positions of the joints; their times do not count.
        readings: Measured values.
        ours: The name of each row of the joints.
        theirs: The name of each reading.
    """
    poses, names = (np.array([*map(str.lower, words)]) for words in (ours, theirs))
    standstills = [
        Standstill(float(k), joints.values[k], rows)
        for k, name in enumerate(poses)
        for kind in readings.kinds
        if len(rows := kind[names[kind] == name])
    ]
    alone = tuple(sorted({*poses.tolist()} ^ {*names.tolist()}))
    return Joined(None, tuple(standstills), 0, 0, 0, alone)


def in_one_unit(joints: Log, readings: Log) -> tuple[Log, Log, int]:
    """Logs of the same recording, of which one may count milliseconds or less.

    Returns:
        Both in the same unit, and how often the times of the joints were divided by
        1000, negative for those of the readings.
    """
    spans = [float(np.ptp(log.time)) for log in (joints, readings)]
    far = np.log10(spans[0] / spans[1]) / 3.0 if min(spans) > 0.0 else 0.0
    steps = round(far)
    steps = steps if abs(far - steps) < LIKE and abs(steps) <= 3 else 0
    joints = replace(joints, time=joints.time * 1e-3 ** max(steps, 0))
    readings = replace(readings, time=readings.time * 1e-3 ** max(-steps, 0))
    return joints, readings, steps


def continuous(log: Log) -> Log:
    """A log whose last four values are quaternions, of which no sign jumps.

    Both signs are the same orientation, and at half turns either comes out.
    """
    values = log.values.copy()
    for rows in log.kinds:
        q = values[rows, -4:]
        jumps = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)
        values[rows[1:], -4:] *= np.cumprod(jumps)[:, None]
    return replace(log, values=values)


def means(standstills: Sequence[Standstill], values: Floats, oriented: bool) -> Floats:
    """Mean of the readings of each standstill, shape (S, k).

    Args:
        standstills: The standstills.
        values: Values of all readings, shape (N, k).
        oriented: Whether the last four are quaternions.
    """
    averages = np.array([values[stand.readings].mean(axis=0) for stand in standstills])
    for mean in averages if oriented else ():
        mean[-4:] /= np.linalg.norm(mean[-4:])
    return averages


def mean_sigmas(
    standstills: Sequence[Standstill], values: Floats, oriented: bool = False
) -> Floats:
    """Standard deviation of the mean of each standstill, shape (S, k).

    Readings that follow one another are no independent ones: N of them count as N/tau,
    tau the sum of the autocorrelation over the readings of all standstills (window by
    Sokal, Monte Carlo methods in statistical mechanics, 1997, section 3). A deviation
    about a mean lacks the error of the mean, which is put back. An error that stays
    during a standstill does not show in it, and is in no deviation.

    Args:
        standstills: The standstills.
        values: Values of all readings, shape (N, k).
        oriented: Whether the last four are quaternions; the last three deviations are
            those of their rotation vectors then.

    Returns:
        The deviations, zero where no standstill has two readings.
    """
    counts, columns = np.array([len(stand.readings) for stand in standstills]), []
    for stand, mean in zip(
        standstills, means(standstills, values, oriented), strict=True
    ):
        away = values[stand.readings]
        if oriented:
            R = from_quaternion(mean[-4:]).T @ from_quaternion(away[:, -4:])
            away = np.hstack([away[:, :-4], so3_log(R)])
        away = away - away.mean(axis=0)
        columns.append(np.pad(away, ((0, counts.max() - len(away)), (0, 0))))
    rest = np.array(columns)
    tau, total, lacking = np.ones(rest.shape[2]), np.zeros(rest.shape[2]), 0.0
    if counts.max() < 2:
        return np.zeros((len(counts), len(tau)))
    for lag in range(max(counts.max() // 2, 1)):
        # Parts of the readings that have a partner, and covariances about the means.
        shares = np.maximum(counts - lag, 0) / counts
        pairs, part = float(shares @ counts), shares.mean() * (2.0 if lag else 1.0)
        products = np.sum(rest[:, lag:] * rest[:, : rest.shape[1] - lag], axis=(0, 1))
        total = total + part * products / pairs
        lacking += part * shares.sum() / pairs
        of_mean = total / (1.0 - lacking)  # Times the number of readings.
        if not lag:
            variance = products / pairs
        of_one = np.maximum(variance + len(counts) / counts.sum() * of_mean, TINY)
        still = lag < WINDOW * tau
        if not still.any():
            break
        tau = np.where(still, np.maximum(of_mean / of_one, 1.0), tau)
    share = np.minimum(tau / counts[:, None], 1.0)
    return np.asarray(np.sqrt(of_one * share))
