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
is part of the intervals of AP, AD and angles.

Where base and tool were fitted to the visits, there is no AP: of K poses with means d_k
and commanded ones that move by the columns of B, `max |d_k|` is at least the root mean
square of what no motion takes away, `|(I - B B^+) d| / sqrt(K)`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, repeat
from typing import NamedTuple

import numpy as np

from calib_pin.errors import InputError
from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    student_quantile,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.setup import LimitSetup
from calib_pin.units import DISPLAY

LEVEL = 0.95
"""Probability that an interval holds the true value."""

DRAWS = 4000
"""Simulated tests from which intervals of AP and RP are taken."""

LEAST = 3
"""Visits of a pose from which it has a repeatability."""

STEPS = 60
"""Steps of a bisection."""

NOTHING = 1e-4
"""Part of the largest motion by a meter or radian of a frame that moves nothing."""

ENDLESS = 1e6
"""Degrees of freedom of a size that is known."""


class Interval(NamedTuple):
    """A value with its interval.

    Attributes:
        value: The value.
        low: Lower end.
        high: Upper end.
    """

    value: float
    low: float
    high: float


UNTESTABLE = Interval(np.nan, 0.0, np.inf)
"""The interval of what a test does not tell."""


@dataclass(frozen=True)
class FrameErrors:
    """How far commanded poses may be off, as base and tool are known.

    Attributes:
        effects: Changes of the commanded pose of each visit by independent deviations
            of base and tool, shape (N, D, r) [m, rad].
        dof: Degrees of freedom that tell the size of these; infinite where it was
            stated.
        fitted: What was fitted to the visits themselves, in words; then deviations are
            a meter and a radian. Empty for nothing.
    """

    effects: Floats
    dof: float = np.inf
    fitted: str = ""


@dataclass(frozen=True)
class PoseTest:
    """The visits of one pose.

    Attributes:
        pose: Number of the pose.
        visits: Number of its visits.
        accuracy: AP [m]; unknown where frames were fitted to the visits.
        components: Mean deviation along x, y and z of the measurement frame [m].
        repeatability: RP [m].
        angles: Mean deviation about x, y and z of the tool [rad]; empty without
            orientations, unknown where frames were fitted to the visits.
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
        untestable: Why there is no AP, in words; empty where there is.
        bound: The least AP of the worst pose then [m].
        doubts: Why no limit passes, in sentences.
        moved: Whether the instrument was moved: no limit fails either.
    """

    poses: tuple[PoseTest, ...]
    distances: tuple[DistanceTest, ...]
    drift: tuple[float, float] | None
    untestable: str = ""
    bound: Interval = UNTESTABLE
    doubts: tuple[str, ...] = ()
    moved: bool = False


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
    called = np.arange(1, len(first) + 1) if numbers is None else numbers[first]
    cycles = cycles_in_order(pose) if cycles is None else cycles
    errors = attained - commanded
    errors = errors if angles is None else np.hstack([errors, angles])
    frames = frames or FrameErrors(np.zeros((*errors.shape, 0)))
    visits = [np.flatnonzero(pose == k) for k in range(len(first))]
    kept = [k for k in np.argsort(called) if len(visits[k]) >= LEAST]
    if not kept:
        most = max(map(len, visits), default=0)
        reason = f"no pose was visited {LEAST} times: {len(first)} poses, at most "
        allowed = "repeated poses; 'plan --accept --cycles N' asks for them"
        raise InputError(f"{reason}{most} visits of one", allowed=allowed)
    rng, before = np.random.default_rng(0), np.concatenate([[-1], pose[:-1]])
    poses, distances = [], []
    for k in kept:
        own, effects = errors[visits[k]], frames.effects[first[k]]
        means = tuple(map(mean, own.T, effects, repeat(frames.dof)))
        place, accuracy, turns = own[:, :3], UNTESTABLE, means[3:]
        if frames.fitted:
            turns = (UNTESTABLE,) * len(turns)
        else:
            accuracy = mean_distance(place, rng, effects[:3], frames.dof)
        positions = accuracy, means[:3], repeatability(place, rng)
        angles_of = turns, tuple(map(three_sigma, own.T[3:]))
        ways = _directions(place, before[visits[k]])
        found = *positions, *angles_of, ways
        poses.append(PoseTest(int(called[k]), len(own), *found))
    for k, m in combinations(kept, 2):
        turns_of = cycles[visits[k]], cycles[visits[m]]
        _, a, b = np.intersect1d(*turns_of, return_indices=True)
        if len(a) < LEAST:
            continue
        one, other = visits[k][a], visits[m][b]
        apart = commanded[one] - commanded[other]
        D_c = np.linalg.norm(apart, axis=1)
        D = np.linalg.norm(attained[one] - attained[other], axis=1)
        effect = frames.effects[one[0], :3] - frames.effects[other[0], :3]
        accuracy = mean(D - D_c, apart[0] @ effect / (D_c[0] or 1.0), frames.dof)
        pair, distance = (int(called[k]), int(called[m])), float(D_c.mean())
        distances.append(DistanceTest(pair, len(D), distance, accuracy, three_sigma(D)))
    deviations = [errors[visits[k], :3] for k in kept]
    test = Acceptance(tuple(poses), tuple(distances), _drift(deviations))
    if not frames.fitted:
        return test
    bound, said = _bound(deviations, frames.effects[first[kept], :3], rng)
    return replace(test, bound=bound, untestable=f"{frames.fitted}, {said}")


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
    each = pose[:, None] == np.arange(pose.max(initial=-1) + 1)
    counts = np.cumsum(each, axis=0)[each]
    cycles = 1 + np.cumsum(np.diff(pose, prepend=-1) <= 0)
    return cycles if cycles.max(initial=0) == counts.max(initial=0) else counts


def _bound(
    deviations: Sequence[Floats], motions: Floats, rng: np.random.Generator
) -> tuple[Interval, str]:
    """The least AP of the worst pose whatever the frames are, and that in words.

    Args:
        deviations: Those of each pose, shape (n, 3).
        motions: Motions of poses with frames, shape (K, 3, p).
        rng: Random generator.
    """
    values, count = 3 * len(motions), int(motions.any(axis=(0, 1)).sum())
    U, s, _ = np.linalg.svd(motions.reshape(values, -1), full_matrices=False)
    U = U[:, s > NOTHING * s.max(initial=0.0)]
    left, said = values - U.shape[1], f"{U.shape[1]} unknowns of {values} values"
    if left == 0:
        return UNTESTABLE, f"{said}; from {count // 3 + 1} poses on AP has a bound"
    d = np.concatenate([own.mean(axis=0) for own in deviations])
    noise = np.column_stack([_of_mean(own, rng) for own in deviations])
    found = _length(d - U @ (U.T @ d), noise - noise @ U @ U.T)
    low, rms = found.low / len(motions) ** 0.5, found.value * (3.0 / left) ** 0.5
    return Interval(np.nan, low, np.inf), (
        f"{said}; AP is at least {told(low)}, and {told(rms)} rms if the fit took the "
        "same from all directions"
    )


def _directions(deviations: Floats, before: Indices) -> float | None:
    """Largest distance of the means of approaches from different poses."""
    origins, counts = np.unique(before, return_counts=True)
    means = [deviations[before == o].mean(axis=0) for o in origins[counts >= LEAST]]
    if len(means) < 2:
        return None
    return max(float(np.linalg.norm(a - b)) for a, b in combinations(means, 2))


def _drift(deviations: Sequence[Floats]) -> tuple[float, float] | None:
    """Largest change of AP and of RP from the first to the last third of the visits."""
    thirds = [np.array_split(d, 3) for d in deviations if len(d) >= 3 * LEAST]
    ends = [(_sizes(first), _sizes(last)) for first, _, last in thirds]
    if not ends:
        return None
    accuracy, scatter = np.abs(np.diff(ends, axis=1)[:, 0]).max(axis=0).tolist()
    return accuracy, scatter


def _sizes(deviations: Floats) -> tuple[float, float]:
    """AP and RP of the visits of a pose, shape (n, 3)."""
    m = deviations.mean(axis=0)
    away = np.linalg.norm(deviations - m, axis=1)
    return float(np.linalg.norm(m)), float(away.mean() + 3.0 * away.std(ddof=1))


def mean(values: Floats, effect: Floats | None = None, dof: float = np.inf) -> Interval:
    """A mean with Student's interval, of shape (n,).

    Args:
        values: The values.
        effect: Changes of all of them by independent deviations, shape (r,).
        dof: Degrees of freedom that tell the size of these.
    """
    n, m = len(values), float(values.mean())
    common = 0.0 if effect is None else np.linalg.norm(effect)
    few, many = student(n - 1), student(dof)
    half = float(np.hypot(few * values.std(ddof=1) / n**0.5, many * common))
    return Interval(m, m - half, m + half)


def student(dof: float) -> float:
    """Standard deviations of Student's t to either side that hold `LEVEL`."""
    return student_quantile(dof, 0.5 - 0.5 * LEVEL)


def three_sigma(values: Floats) -> Interval:
    """Three standard deviations with the chi-square interval, of shape (n,)."""
    dof, s = len(values) - 1, 3.0 * float(values.std(ddof=1))
    few, many = (chi_square_quantile(dof, 0.5 + k * LEVEL) for k in (0.5, -0.5))
    return Interval(s, s * (dof / many) ** 0.5, s * (dof / few) ** 0.5)


def mean_distance(
    deviations: Floats,
    rng: np.random.Generator,
    effects: Floats | None = None,
    dof: float = np.inf,
) -> Interval:
    """AP: the length of a mean, shape (n, 3).

    The scatter of the mean has Student's distribution, with the covariance of the
    visits, and so have the effects of frames, (3, r), by what tells their size.
    """
    noise = _of_mean(deviations, rng)
    if effects is not None and effects.size:
        common = rng.standard_normal((DRAWS, effects.shape[1])) @ effects.T
        noise += common / _chi(dof, rng)
    return _length(deviations.mean(axis=0), noise)


def _of_mean(deviations: Floats, rng: np.random.Generator) -> Floats:
    """Simulated errors of the mean of visits, shape (DRAWS, 3)."""
    n = len(deviations)
    noise = rng.standard_normal((DRAWS, 3)) @ _root(np.cov(deviations.T) / n).T
    return np.asarray(noise / _chi(n - 1, rng))


def _chi(dof: float, rng: np.random.Generator) -> Floats:
    """Simulated standard deviations of true ones, shape (DRAWS, 1)."""
    known = min(dof, ENDLESS)
    return np.sqrt(rng.chisquare(known, (DRAWS, 1)) / known)


def _length(m: Floats, noise: Floats) -> Interval:
    """The length of a vector, shape (d,), with simulated errors of it, (DRAWS, d).

    The true length is one with which the simulated length is neither below nor above
    the one found in all but a small part of the tests.
    """
    found = float(np.linalg.norm(m))
    along = m / found if found > 0.0 else np.eye(len(m))[0]
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
    n, found = len(deviations), _sizes(deviations)[1]
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


def _root(C: Floats) -> Floats:
    """A square root of a covariance that may be singular."""
    s, V = np.linalg.eigh(C)
    return np.asarray(V * np.sqrt(np.maximum(s, 0.0)))


def judged(
    test: Acceptance, limit: LimitSetup
) -> Iterator[tuple[str, str, Interval, float, str]]:
    """Each limit with its quantity, `pass`, `fail` or `undecided`, interval and unit.

    The worst pose counts: it passes where all of its interval is below the limit and
    nothing is in doubt, and fails where all of it is above.
    """
    found = measured(test)
    allowed = limit.position, limit.repeatability, limit.distance, limit.orientation
    for name, most in zip(("AP", "RP", "AD", "orientation"), allowed, strict=True):
        if most is None:
            continue
        unit, status = "rad" if name == "orientation" else "m", "undecided"
        interval = worst(found[name][0]) if name in found else UNTESTABLE
        if interval.high <= most and not test.doubts:
            status = "pass"
        elif interval.low > most and not test.moved:
            status = "fail"
        yield name, status, interval, most, unit


def measured(test: Acceptance) -> dict[str, tuple[list[Interval], str]]:
    """Intervals of absolute values, and their unit, of each quantity that there is."""
    accuracies = [p.accuracy for p in test.poses]
    found = {
        "AP": ([test.bound] if test.untestable else accuracies, "m"),
        "RP": ([p.repeatability for p in test.poses], "m"),
        "AD": ([_away(d.accuracy) for d in test.distances], "m"),
        "orientation": ([_away(a) for p in test.poses for a in p.angles], "rad"),
    }
    return {name: both for name, both in found.items() if both[0]}


def worst(intervals: Sequence[Interval]) -> Interval:
    """The largest value, and the largest ends: those that decide."""
    return Interval(*(max(ends) for ends in zip(*intervals, strict=True)))


def told(length: float) -> str:
    """A length in the unit in which people read it, in a sentence."""
    unit, factor = DISPLAY["m"]
    return f"{factor * length:.3g} {unit}"


def _away(interval: Interval) -> Interval:
    """The interval of an absolute value."""
    ends = abs(interval.low), abs(interval.high)
    low = 0.0 if interval.low * interval.high < 0.0 else min(ends)
    return Interval(abs(interval.value), low, max(ends))
