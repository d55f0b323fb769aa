"""Acceptance test in the terms of ISO 9283: how repeated visits of poses scatter.

A robot goes to the same poses again and again, and an instrument measures where it
comes to rest. With attained positions x_j of a commanded one x_c, their mean m and the
lengths l_j = |x_j - m|, of n visits

    AP  = |m - x_c|                                  pose accuracy
    RP  = mean(l) + 3 S(l)                           pose repeatability
    vAP = max |m_h - m_k| over directions h, k       multi-directional variation
    AD  = mean(D) - D_c,  D_j = |x_1j - x_2j|        distance accuracy
    RD  = 3 S(D)                                     distance repeatability

with S the standard deviation of n - 1 degrees of freedom. Of orientations, mean and
three standard deviations of each angle. Every value has a 95 % interval for what more
and more visits would give: Student's t for means, chi-square for standard deviations,
and for AP and RP, which have no such distribution, that of the estimate itself,
simulated with the covariance that the visits show (of AP it holds where AP is beyond
the scatter of means).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import stats

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.setup import LimitSetup

LEVEL = 0.95
"""Probability that an interval holds the true value."""

DRAWS = 4000
"""Simulated tests from which intervals of AP and RP are taken."""

LEAST = 3
"""Visits of a pose from which it has a repeatability."""

STEPS = 60
"""Steps of a bisection."""


@dataclass(frozen=True)
class Interval:
    """A value with its interval.

    Attributes:
        value: The value.
        low: Lower end.
        high: Upper end.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class PoseTest:
    """The visits of one pose.

    Attributes:
        pose: Number of the pose.
        visits: Number of its visits.
        accuracy: AP [m].
        components: Mean deviation along x, y and z of the measurement frame [m].
        repeatability: RP [m].
        angles: Mean deviation about x, y and z of the tool [rad]; empty without
            orientations.
        angle_repeatability: Three standard deviations of each [rad].
        directions: vAP [m]; None where it was not approached from several poses.
    """

    pose: int
    visits: int
    accuracy: Interval
    components: tuple[Interval, ...]
    repeatability: Interval
    angles: tuple[Interval, ...]
    angle_repeatability: tuple[Interval, ...]
    directions: float | None


@dataclass(frozen=True)
class DistanceTest:
    """The distance between two poses, cycle by cycle.

    Attributes:
        poses: Their numbers.
        cycles: Number of cycles.
        commanded: The commanded distance [m].
        accuracy: AD [m].
        repeatability: RD [m].
    """

    poses: tuple[int, int]
    cycles: int
    commanded: float
    accuracy: Interval
    repeatability: Interval


@dataclass(frozen=True)
class Acceptance:
    """An acceptance test.

    Attributes:
        poses: By pose.
        distances: By pair of poses.
        drift: Largest change of AP and of RP from the first to the last third of the
            visits [m]; None with less than three visits each.
    """

    poses: tuple[PoseTest, ...]
    distances: tuple[DistanceTest, ...]
    drift: tuple[float, float] | None

    @property
    def accuracy(self) -> Interval:
        """AP of the worst pose [m]."""
        return worst([p.accuracy for p in self.poses])

    @property
    def repeatability(self) -> Interval:
        """RP of the worst pose [m]."""
        return worst([p.repeatability for p in self.poses])


def acceptance(
    attained: Floats,
    commanded: Floats,
    group: Indices,
    angles: Floats | None = None,
    numbers: Indices | None = None,
) -> Acceptance:
    """Evaluate visits of poses in the order in which they were made.

    Args:
        attained: Measured positions, shape (N, 3) [m].
        commanded: Commanded ones, shape (N, 3) [m].
        group: Pose of each visit, shape (N,), any numbers.
        angles: Deviations of the orientation about the axes of the tool, shape (N, 3)
            [rad]; None where none was measured.
        numbers: Number of the pose of each visit, shape (N,); by default in the order
            of the first visits, from 1.

    Raises:
        InputError: If no pose was visited often enough, or two have one number.
    """
    _, first, pose = np.unique(group, return_index=True, return_inverse=True)
    pose = np.argsort(np.argsort(first))[pose]
    before = np.concatenate([[-1], pose[:-1]])
    visits = [np.flatnonzero(pose == k) for k in range(len(first))]
    kept = [k for k, rows in enumerate(visits) if len(rows) >= LEAST]
    if not kept:
        most = max(map(len, visits), default=0)
        raise InputError(
            f"no pose was visited {LEAST} times: {len(first)} poses, at most {most} "
            "visits of one",
            allowed="repeated poses; 'plan --repeats' asks for them",
        )
    called = list(range(1, len(first) + 1))
    if numbers is not None:
        called = numbers[np.sort(first)].tolist()
        if len(set(called)) < len(called):
            raise InputError("two configurations have one number in the column 'pose'")
        kept.sort(key=called.__getitem__)
    rng = np.random.default_rng(0)
    poses = tuple(
        _pose(
            called[k],
            attained[visits[k]] - commanded[visits[k]],
            None if angles is None else angles[visits[k]],
            before[visits[k]],
            rng,
        )
        for k in kept
    )
    distances = tuple(
        _distance(
            (int(called[a]), int(called[b])), attained, commanded, visits[a], visits[b]
        )
        for a, b in combinations(kept, 2)
        if min(len(visits[a]), len(visits[b])) >= LEAST
    )
    deviations = [attained[visits[k]] - commanded[visits[k]] for k in kept]
    return Acceptance(poses, distances, _drift(deviations))


def _pose(
    number: int,
    deviations: Floats,
    angles: Floats | None,
    before: Indices,
    rng: np.random.Generator,
) -> PoseTest:
    turned = np.zeros((len(deviations), 0)) if angles is None else angles
    return PoseTest(
        number,
        len(deviations),
        mean_distance(deviations, rng),
        tuple(mean(column) for column in deviations.T),
        repeatability(deviations, rng),
        tuple(mean(column) for column in turned.T),
        tuple(three_sigma(column) for column in turned.T),
        _directions(deviations, before),
    )


def _directions(deviations: Floats, before: Indices) -> float | None:
    """Largest distance of the means of approaches from different poses."""
    origins, counts = np.unique(before, return_counts=True)
    means = [deviations[before == o].mean(axis=0) for o in origins[counts >= LEAST]]
    if len(means) < 2:
        return None
    return max(float(np.linalg.norm(a - b)) for a, b in combinations(means, 2))


def _distance(
    poses: tuple[int, int],
    attained: Floats,
    commanded: Floats,
    first: Indices,
    second: Indices,
) -> DistanceTest:
    """The k-th visits of both belong together."""
    count = min(len(first), len(second))
    a, b = first[:count], second[:count]
    D = np.linalg.norm(attained[a] - attained[b], axis=1)
    D_c = float(np.linalg.norm(commanded[a] - commanded[b], axis=1).mean())
    return DistanceTest(poses, count, D_c, mean(D - D_c), three_sigma(D))


def _drift(deviations: Sequence[Floats]) -> tuple[float, float] | None:
    thirds = [np.array_split(d, 3) for d in deviations if len(d) >= 3 * LEAST]
    if not thirds:
        return None

    def change(of: Callable[[Floats], float]) -> float:
        return max(abs(of(last) - of(first)) for first, _, last in thirds)

    return change(_accuracy), change(_repeatability)


def mean(values: Floats) -> Interval:
    """A mean with Student's interval, of shape (n,)."""
    n, m = len(values), float(values.mean())
    half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, n - 1) * values.std(ddof=1) / n**0.5)
    return Interval(m, m - half, m + half)


def three_sigma(values: Floats) -> Interval:
    """Three standard deviations with the chi-square interval, of shape (n,)."""
    dof, s = len(values) - 1, 3.0 * float(values.std(ddof=1))
    few, many = (
        float(stats.chi2.ppf(p, dof)) for p in (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL)
    )
    return Interval(s, s * (dof / many) ** 0.5, s * (dof / few) ** 0.5)


def mean_distance(deviations: Floats, rng: np.random.Generator) -> Interval:
    """AP: the length of a mean, shape (n, 3).

    The true length is one with which the simulated length of the mean is neither below
    nor above the one found in all but a small part of the tests. The scatter of the
    mean has Student's distribution, with the covariance of the visits.
    """
    n, m = len(deviations), deviations.mean(axis=0)
    found = float(np.linalg.norm(m))
    L = _root(np.cov(deviations.T)) / n**0.5
    noise = rng.standard_normal((DRAWS, 3)) @ L.T
    noise /= np.sqrt(rng.chisquare(n - 1, DRAWS) / (n - 1))[:, None]
    along = m / found if found > 0.0 else np.eye(3)[0]
    longest = found + 10.0 * float(np.linalg.norm(noise, axis=1).max())

    def least(part: float) -> float:
        """The true length of which a part of the tests finds less than was found."""
        low, high = 0.0, longest
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            lengths = np.linalg.norm(middle * along + noise, axis=1)
            if np.mean(lengths < found) > part:
                low = middle
            else:
                high = middle
        return high if high > longest * 2.0**-STEPS * 4.0 else 0.0

    tail = 0.5 - 0.5 * LEVEL
    return Interval(found, least(1.0 - tail), least(tail))


def repeatability(deviations: Floats, rng: np.random.Generator) -> Interval:
    """RP, shape (n, 3), by the distribution of its ratio to the true one."""
    n, found = len(deviations), _repeatability(deviations)
    if not found > 0.0:
        return Interval(0.0, 0.0, 0.0)
    L = _root(np.cov(deviations.T))
    many = rng.standard_normal((20 * DRAWS, 3)) @ L.T
    lengths = np.linalg.norm(many, axis=1)
    true = float(lengths.mean() + 3.0 * lengths.std())
    tests = rng.standard_normal((DRAWS, n, 3)) @ L.T
    away = np.linalg.norm(tests - tests.mean(axis=1, keepdims=True), axis=2)
    ratios = (away.mean(axis=1) + 3.0 * away.std(axis=1, ddof=1)) / true
    low, high = np.quantile(ratios, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return Interval(found, found / float(high), found / float(low))


def _accuracy(deviations: Floats) -> float:
    return float(np.linalg.norm(deviations.mean(axis=0)))


def _repeatability(deviations: Floats) -> float:
    away = np.linalg.norm(deviations - deviations.mean(axis=0), axis=1)
    return float(away.mean() + 3.0 * away.std(ddof=1))


def _root(C: Floats) -> Floats:
    """A square root of a covariance that may be singular."""
    s, V = np.linalg.eigh(C)
    return np.asarray(V * np.sqrt(np.maximum(s, 0.0)))


def judged(
    test: Acceptance, limit: LimitSetup
) -> Iterator[tuple[str, str, Interval, float, str]]:
    """Each limit with its quantity, `pass`, `fail` or `undecided`, interval and unit.

    The worst pose counts: it passes where all of its interval is below the limit, and
    fails where all of it is above.
    """
    limits = {
        "AP": limit.position,
        "RP": limit.repeatability,
        "AD": limit.distance,
        "orientation": limit.orientation,
    }
    for name, (intervals, unit) in measured(test).items():
        if (allowed := limits[name]) is None:
            continue
        status = "undecided"
        if max(i.high for i in intervals) <= allowed:
            status = "pass"
        elif max(i.low for i in intervals) > allowed:
            status = "fail"
        yield name, status, worst(intervals), allowed, unit


def measured(test: Acceptance) -> dict[str, tuple[list[Interval], str]]:
    """Intervals of absolute values, and their unit, of each quantity that there is."""
    angles = [_away(angle) for p in test.poses for angle in p.angles]
    found = {
        "AP": ([p.accuracy for p in test.poses], "m"),
        "RP": ([p.repeatability for p in test.poses], "m"),
        "AD": ([_away(d.accuracy) for d in test.distances], "m"),
        "orientation": (angles, "rad"),
    }
    return {name: (values, unit) for name, (values, unit) in found.items() if values}


def worst(intervals: Sequence[Interval]) -> Interval:
    """That of the largest value."""
    return max(intervals, key=lambda i: i.value)


def _away(interval: Interval) -> Interval:
    """The interval of an absolute value."""
    ends = abs(interval.low), abs(interval.high)
    low = 0.0 if interval.low * interval.high < 0.0 else min(ends)
    return Interval(abs(interval.value), low, max(ends))
