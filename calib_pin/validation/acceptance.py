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
the scatter of means). How far the commanded poses are uncertain, as base and tool are,
is part of the intervals of AP and AD.

Where base and tool were fitted to the visits, there is no AP: of K poses with means d_k
and commanded ones that may move by the columns of B, `max |d_k|` is at least the root
mean square of what no motion takes away, `|(I - B B^+) d| / sqrt(K)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
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

TOGETHER = 0.04
"""Probability that the lower end of any pose is above the truth: less than that a limit
fails by chance. With the upper ends of single poses, the interval of the worst holds in
95 to 97 of 100, whether poses are alike or one is the worst by far."""

NOTHING = 1e-4
"""Part of the largest motion by a meter or radian of a frame that moves nothing."""


@dataclass(frozen=True)
class Interval:
    """A value with its interval.

    Attributes:
        value: The value.
        low: Lower end.
        high: Upper end.
        sure: Lower end of its size, which those of all poses or pairs keep together.
    """

    value: float
    low: float
    high: float
    sure: float = 0.0


@dataclass(frozen=True)
class FrameErrors:
    """How far commanded poses may be off, as base and tool are known.

    Attributes:
        effects: Changes of the commanded pose of each visit by independent deviations
            of base and tool, shape (N, D, r) [m, rad].
        motions: The same by a meter or radian of what was fitted, shape (N, D, p).
        dof: Degrees of freedom that tell the size of deviations; infinite where it was
            stated.
        fitted: What was fitted to the visits themselves; empty for nothing.
    """

    effects: Floats
    motions: Floats
    dof: float = np.inf
    fitted: str = ""

    @staticmethod
    def none(count: int) -> FrameErrors:
        """Those of frames that are known."""
        return FrameErrors(np.zeros((count, 6, 0)), np.zeros((count, 6, 0)))

    def rows(self, index: Indices) -> FrameErrors:
        """Those of some visits."""
        return replace(self, effects=self.effects[index], motions=self.motions[index])


@dataclass(frozen=True)
class Bound:
    """The least AP of the worst pose, where frames were fitted to the visits.

    Attributes:
        fitted: What was fitted.
        values: Number of coordinates of poses.
        unknowns: Number of these that the fit takes.
        least: Poses from which a fit leaves something.
        accuracy: The bound with its interval [m]; None where nothing is left.
        rms: Position error, root mean square, if all directions are as the remaining
            ones [m].
    """

    fitted: str
    values: int
    unknowns: int
    least: int
    accuracy: Interval | None
    rms: float


@dataclass(frozen=True)
class PoseTest:
    """The visits of one pose.

    Attributes:
        pose: Number of the pose.
        visits: Number of its visits.
        accuracy: AP [m]; None where frames were fitted to the visits.
        components: Mean deviation along x, y and z of the measurement frame [m].
        repeatability: RP [m].
        angles: Mean deviation about x, y and z of the tool [rad]; empty without
            orientations, and where frames were fitted to the visits.
        angle_repeatability: Three standard deviations of each [rad].
        directions: vAP [m]; None where it was not approached from several poses.
    """

    pose: int
    visits: int
    accuracy: Interval | None
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
            visits [m]; None with less than three visits each, and of AP where there is
            none.
        bound: What is known of AP instead, where frames were fitted to the visits.
        doubts: Why no limit passes, in sentences.
        moved: Whether the instrument was moved: no limit fails either.
    """

    poses: tuple[PoseTest, ...]
    distances: tuple[DistanceTest, ...]
    drift: tuple[float | None, float] | None
    bound: Bound | None = None
    doubts: tuple[str, ...] = ()
    moved: bool = field(default=False, kw_only=True)


def acceptance(
    attained: Floats,
    commanded: Floats,
    group: Indices,
    angles: Floats | None = None,
    numbers: Indices | None = None,
    cycles: Indices | None = None,
    frames: FrameErrors | None = None,
) -> Acceptance:
    """Evaluate visits of poses in the order in which they were made.

    Args:
        attained: Measured positions, shape (N, 3) [m].
        commanded: Commanded ones, shape (N, 3) [m].
        group: Pose of each visit, shape (N,), any numbers.
        angles: Deviations of the orientation about the axes of the tool, shape (N, 3)
            [rad]; None where none was measured.
        numbers: Number of the pose of each visit, shape (N,), another for each pose; by
            default in the order of the first visits, from 1.
        cycles: Cycle of each visit, shape (N,), another for each visit of a pose; by
            default as their order tells, see `cycles_in_order`.
        frames: How far commanded poses may be off; default not at all.

    Raises:
        InputError: If no pose was visited often enough.
    """
    pose, first = ranked(group)
    frames = frames or FrameErrors.none(len(pose))
    cycles = cycles_in_order(pose) if cycles is None else cycles
    before = np.concatenate([[-1], pose[:-1]])
    visits = [np.flatnonzero(pose == k) for k in range(len(first))]
    kept = [k for k, rows in enumerate(visits) if len(rows) >= LEAST]
    if not kept:
        most = max(map(len, visits), default=0)
        raise InputError(
            f"no pose was visited {LEAST} times: {len(first)} poses, at most {most} "
            "visits of one",
            allowed="repeated poses; 'plan --accept --cycles N' asks for them",
        )
    called = np.arange(1, len(first) + 1) if numbers is None else numbers[first]
    kept.sort(key=called.tolist().__getitem__)
    rng = np.random.default_rng(0)
    deviations = [attained[visits[k]] - commanded[visits[k]] for k in kept]
    poses = tuple(
        _pose(
            int(called[k]),
            own,
            None if angles is None else angles[visits[k]],
            before[visits[k]],
            frames,
            int(first[k]),
            len(kept),
            rng,
        )
        for k, own in zip(kept, deviations, strict=True)
    )
    pairs = [
        (k, m, a, b)
        for k, m in combinations(kept, 2)
        for a, b in [_together(cycles, visits[k], visits[m])]
        if len(a) >= LEAST
    ]
    distances = tuple(
        _distance(
            (int(called[k]), int(called[m])),
            attained[a] - attained[b],
            commanded[a] - commanded[b],
            frames,
            (a[0], b[0]),
            len(pairs),
        )
        for k, m, a, b in pairs
    )
    drift = _drift(deviations, bool(frames.fitted))
    bound = None
    if frames.fitted:
        bound = _bound(deviations, frames, first[kept], rng)
    return Acceptance(poses, distances, drift, bound)


def ranked(group: Indices) -> tuple[Indices, Indices]:
    """Poses from 0 in the order of their first visits, (N,), and these visits, (K,)."""
    _, first, pose = np.unique(group, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[pose], np.sort(first)


def cycles_in_order(pose: Indices) -> Indices:
    """Cycles from 1 in which visits were made, shape (N,), by their order.

    Poses that follow each other as at first are of one cycle, so that a missing visit
    moves no other one into its place. Where they follow in several ways, the k-th
    visits of all poses belong together.

    Args:
        pose: Pose of each visit, see `ranked`.
    """
    counts = np.zeros(len(pose), np.int64)
    for k in range(pose.max(initial=-1) + 1):
        counts[pose == k] = np.arange(1, np.sum(pose == k) + 1)
    cycle = 1 + np.cumsum(np.diff(pose, prepend=pose[:1] - 1) <= 0)
    return cycle if cycle.max(initial=0) == counts.max(initial=0) else counts


def _together(
    cycles: Indices, first: Indices, second: Indices
) -> tuple[Indices, Indices]:
    """The visits of both poses in the cycles that have both."""
    _, a, b = np.intersect1d(cycles[first], cycles[second], return_indices=True)
    return first[a], second[b]


def _pose(
    number: int,
    deviations: Floats,
    angles: Floats | None,
    before: Indices,
    frames: FrameErrors,
    row: int,
    count: int,
    rng: np.random.Generator,
) -> PoseTest:
    turned = np.zeros((len(deviations), 0)) if angles is None else angles
    effects, dof = frames.effects[row], frames.dof
    accuracy, components, means = None, (), ()
    if not frames.fitted:
        accuracy = mean_distance(deviations, rng, effects[:3], dof, count)
        components = _means(deviations, effects[:3], dof)
        means = _means(turned, effects[3:], dof, 3 * count)
    return PoseTest(
        number,
        len(deviations),
        accuracy,
        components,
        repeatability(deviations, rng, count),
        means,
        tuple(three_sigma(column) for column in turned.T),
        _directions(deviations, before),
    )


def _means(
    values: Floats, effects: Floats, dof: float, count: int = 1
) -> tuple[Interval, ...]:
    columns = zip(values.T, effects, strict=False)
    return tuple(mean(column, effect, dof, count) for column, effect in columns)


def _bound(
    deviations: Sequence[Floats],
    frames: FrameErrors,
    rows: Indices,
    rng: np.random.Generator,
) -> Bound:
    """The least AP of the worst pose, whatever the frames are."""
    B = frames.motions[rows, :3]
    least = int((np.abs(B) > NOTHING).any(axis=(0, 1)).sum()) // 3 + 1
    U, s, _ = np.linalg.svd(B.reshape(3 * len(rows), -1), full_matrices=False)
    U = U[:, s > NOTHING * s.max(initial=0.0)]
    values, unknowns = U.shape
    accuracy, rms = None, 0.0
    if values > unknowns:
        d = np.concatenate([own.mean(axis=0) for own in deviations])
        noise = np.column_stack([_of_mean(own, rng) for own in deviations])
        r = d - U @ (U.T @ d)
        found = _length(r, noise - noise @ U @ U.T)
        by = len(rows) ** -0.5
        accuracy = Interval(by * found.value, by * found.low, np.inf, by * found.low)
        rms = float(np.linalg.norm(r)) * (3.0 / (values - unknowns)) ** 0.5
    return Bound(frames.fitted, values, unknowns, least, accuracy, rms)


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
    frames: FrameErrors,
    rows: tuple[int, int],
    count: int,
) -> DistanceTest:
    """The test of two poses by their differences in the same cycles, shape (n, 3)."""
    D, lengths = (np.linalg.norm(x, axis=1) for x in (attained, commanded))
    along = commanded[0] / (lengths[0] or 1.0)
    effect = along @ (frames.effects[rows[0], :3] - frames.effects[rows[1], :3])
    D_c = float(lengths.mean())
    accuracy = mean(D - D_c, effect, frames.dof, count)
    return DistanceTest(poses, len(D), D_c, accuracy, three_sigma(D))


def _drift(
    deviations: Sequence[Floats], fitted: bool
) -> tuple[float | None, float] | None:
    thirds = [np.array_split(d, 3) for d in deviations if len(d) >= 3 * LEAST]
    if not thirds:
        return None

    def change(of: Callable[[Floats], float]) -> float:
        return max(abs(of(last) - of(first)) for first, _, last in thirds)

    return None if fitted else change(_accuracy), change(_repeatability)


def mean(
    values: Floats, effect: Floats | None = None, dof: float = np.inf, count: int = 1
) -> Interval:
    """A mean with Student's interval, of shape (n,).

    Args:
        values: The values.
        effect: Changes of all of them by independent deviations, shape (r,).
        dof: Degrees of freedom that tell the size of these.
        count: Number of means that are judged together.
    """
    n, m = len(values), float(values.mean())
    own = float(values.std(ddof=1)) / n**0.5
    common = 0.0 if effect is None else float(np.linalg.norm(effect))

    def half(tail: float) -> float:
        few, many = stats.t.ppf(1.0 - tail, [n - 1, max(dof, 1.0)])
        return float(np.hypot(few * own, many * common))

    wide = half(0.5 - 0.5 * LEVEL)
    sure = max(abs(m) - half(0.5 * TOGETHER / count), 0.0)
    return Interval(m, m - wide, m + wide, sure)


def three_sigma(values: Floats) -> Interval:
    """Three standard deviations with the chi-square interval, of shape (n,)."""
    dof, s = len(values) - 1, 3.0 * float(values.std(ddof=1))
    few, many = (
        float(stats.chi2.ppf(p, dof)) for p in (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL)
    )
    return Interval(s, s * (dof / many) ** 0.5, s * (dof / few) ** 0.5)


def mean_distance(
    deviations: Floats,
    rng: np.random.Generator,
    effects: Floats | None = None,
    dof: float = np.inf,
    count: int = 1,
) -> Interval:
    """AP: the length of a mean, shape (n, 3).

    The scatter of the mean has Student's distribution, with the covariance of the
    visits, and so has what frames do, (3, r), by the degrees of freedom that tell it.
    """
    noise = _of_mean(deviations, rng)
    if effects is not None and effects.size:
        known = rng.standard_normal((DRAWS, effects.shape[1])) @ effects.T
        if np.isfinite(dof):
            known /= np.sqrt(rng.chisquare(dof, DRAWS) / dof)[:, None]
        noise += known
    return _length(deviations.mean(axis=0), noise, count)


def _of_mean(deviations: Floats, rng: np.random.Generator) -> Floats:
    """Simulated errors of the mean of visits, shape (DRAWS, 3)."""
    n = len(deviations)
    L = _root(np.cov(deviations.T)) / n**0.5
    noise = rng.standard_normal((DRAWS, 3)) @ L.T
    return np.asarray(noise / np.sqrt(rng.chisquare(n - 1, DRAWS) / (n - 1))[:, None])


def _length(m: Floats, noise: Floats, count: int = 1) -> Interval:
    """The length of a vector, shape (d,), with simulated errors of it, (DRAWS, d).

    The true length is one with which the simulated length is neither below nor above
    the one found in all but a small part of the tests.
    """
    found = float(np.linalg.norm(m))
    along = m / found if found > 0.0 else np.eye(len(m))[0]
    longest = found + 10.0 * float(np.linalg.norm(noise, axis=1).max())
    # Along the vector, and across it.
    ahead = noise @ along
    across = np.maximum(np.sum(noise**2, axis=1) - ahead**2, 0.0)

    def least(part: float) -> float:
        """The true length of which a part of the tests finds less than was found."""
        low, high = 0.0, longest
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            if np.mean((middle + ahead) ** 2 + across < found**2) > part:
                low = middle
            else:
                high = middle
        return high if high > longest * 2.0**-STEPS * 4.0 else 0.0

    tail = 0.5 - 0.5 * LEVEL
    tails = 1.0 - tail, tail, 1.0 - TOGETHER / count
    return Interval(found, *map(least, tails))


def repeatability(
    deviations: Floats, rng: np.random.Generator, count: int = 1
) -> Interval:
    """RP, shape (n, 3), by the distribution of its ratio to the true one.

    Args:
        deviations: The deviations.
        rng: Random generator.
        count: Number of poses that are judged together.
    """
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
    tail = 0.5 - 0.5 * LEVEL
    ends = np.quantile(ratios, [1.0 - tail, tail, 1.0 - TOGETHER / count])
    return Interval(found, *(found / ends).tolist())


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

    The worst pose counts: it passes where all of its interval is below the limit and
    nothing is in doubt, and fails where all of it is above. The interval is NaN where
    nothing was tested.
    """
    limits = {
        "AP": (limit.position, "m"),
        "RP": (limit.repeatability, "m"),
        "AD": (limit.distance, "m"),
        "orientation": (limit.orientation, "rad"),
    }
    found = measured(test)
    for name, (allowed, unit) in limits.items():
        if allowed is None:
            continue
        interval, status = Interval(np.nan, np.nan, np.nan, np.nan), "undecided"
        if name in found:
            interval = worst(found[name][0])
        if interval.high <= allowed and not test.doubts:
            status = "pass"
        elif interval.sure > allowed and not test.moved:
            status = "fail"
        yield name, status, interval, allowed, unit


def measured(test: Acceptance) -> dict[str, tuple[list[Interval], str]]:
    """Intervals of absolute values, and their unit, of each quantity that there is.

    That of AP has no upper end where frames were fitted to the visits.
    """
    angles = [_away(angle) for p in test.poses for angle in p.angles]
    accuracies = [p.accuracy for p in test.poses if p.accuracy is not None]
    if test.bound is not None:
        accuracies = [test.bound.accuracy or Interval(np.nan, 0.0, np.inf)]
    found = {
        "AP": (accuracies, "m"),
        "RP": ([p.repeatability for p in test.poses], "m"),
        "AD": ([_away(d.accuracy) for d in test.distances], "m"),
        "orientation": (angles, "rad"),
    }
    return {name: (values, unit) for name, (values, unit) in found.items() if values}


def worst(intervals: Sequence[Interval]) -> Interval:
    """The largest value, with an interval for the largest true one."""
    sure = max(i.sure for i in intervals)
    high = max(i.high for i in intervals)
    return Interval(max(i.value for i in intervals), sure, high, sure)


def _away(interval: Interval) -> Interval:
    """The interval of an absolute value."""
    ends = abs(interval.low), abs(interval.high)
    low = 0.0 if interval.low * interval.high < 0.0 else min(ends)
    return Interval(abs(interval.value), low, max(ends), interval.sure)
