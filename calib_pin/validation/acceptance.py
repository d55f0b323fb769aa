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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, repeat
from typing import Any, NamedTuple

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, counted, enumerated
from calib_pin.estimation.formulation import make_problem, with_parameters
from calib_pin.estimation.identifiability import column_space
from calib_pin.estimation.nominal import extended, register, registered
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    f_tail,
    student_quantile,
)
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Booleans, Indices, Observations
from calib_pin.setup import LimitSetup, Setup
from calib_pin.validation import model_errors
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.sentences import shown
from calib_pin.validation.judgement import error_limit
from calib_pin.validation.result import CalibrationResult

MODELS = ("position", "pose")
"""Measurement models that tell where a point is."""

TAILS = 0.5 - 0.5 * 0.95, 0.5 + 0.5 * 0.95
"""Probabilities of lower values than the ends of an interval."""

CHANCE = 0.01
"""Probability with which a test without any fault is told to have one of a kind."""

DRAWS = 4000
"""Simulated tests from which intervals of AP and RP are taken."""

LEAST = 3
"""Visits of a pose from which it has a repeatability."""

RESOLUTION = 1e-6
"""Scatter of visits that no instrument resolves [m]."""

DEGREES = (2, 4)
"""Degrees of the drift beside which a move is sought, and of that which it beats."""

OF_STATION = ("AP", "orientation")
"""Quantities that depend on where the instrument stands."""

ELSEWHERE = "the station is not where it was at the calibration; --register fits it"

APART = 5.0
"""Errors from where a station was, by those with another one, from which it is not
there; each for a value that is left over."""

ENDS = ("", "_low", "_high")
"""Endings of the columns of an interval."""

NOW = "calibrated"
"""The robot that is tested, of a calibration."""

Names = Mapping[str, Mapping[tuple[str, int], int]]
"""Numbers in the columns `pose` and `cycle` by file and line."""


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


class FrameErrors(NamedTuple):
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
        elsewhere: Whether it stands elsewhere than at the calibration: no limit of what
            depends on that fails.
    """

    poses: tuple[PoseTest, ...]
    distances: tuple[DistanceTest, ...]
    drift: tuple[float, float] | None
    untestable: str = ""
    bound: Interval = UNTESTABLE
    doubts: tuple[str, ...] = ()
    moved: bool = False
    elsewhere: bool = False


def acceptance(
    attained: Floats,
    deviations: Floats,
    number: Indices,
    cycles: Indices | None = None,
    frames: FrameErrors | None = None,
) -> Acceptance:
    """Evaluate visits of poses in the order in which they were made.

    Args:
        attained: Measured positions, shape (N, 3) [m].
        deviations: These minus the commanded ones [m], and where orientations are
            measured their deviations about the axes of the tool [rad], shape (N, D).
        number: Number of the pose of each visit, shape (N,).
        cycles: Cycle of each visit, shape (N,), another for each visit of a pose; by
            default as their order tells, see `cycles_in_order`.
        frames: How far commanded poses may be off; default not at all.

    Raises:
        InputError: If no pose was visited often enough.
    """
    pose, first = ranked(number)
    numbers = number[first]
    cycles = cycles_in_order(pose) if cycles is None else cycles
    frames = frames or FrameErrors(np.zeros((*deviations.shape, 0)))
    visits = [np.flatnonzero(pose == k) for k in range(len(first))]
    tested_poses = [k for k in np.argsort(numbers) if len(visits[k]) >= LEAST]
    if not tested_poses:
        most = max(map(len, visits), default=0)
        reason = f"no pose was visited {LEAST} times: {counted(len(first), 'pose')}, "
        reason += f"at most {counted(most, 'visit')} of one"
        raise InputError(reason, allowed="repeated poses, as of 'plan --accept'")
    rng, before = np.random.default_rng(0), np.concatenate([[-1], pose[:-1]])
    poses, distances = [], []
    for k in tested_poses:
        errors, effects = deviations[visits[k]], frames.effects[first[k]]
        means = tuple(map(_mean, errors.T, effects, repeat(frames.dof)))
        positional, accuracy, turns = errors[:, :3], UNTESTABLE, means[3:]
        if frames.fitted:
            turns = (UNTESTABLE,) * len(turns)
        else:
            accuracy = _mean_length(positional, effects[:3], frames.dof, rng)
        positions = accuracy, means[:3], repeatability(positional, rng)
        angled = turns, tuple(map(_three_sigma, errors.T[3:]))
        vAP = _variation(positional, before[visits[k]])
        poses.append(PoseTest(int(numbers[k]), len(errors), *positions, *angled, vAP))
    commanded = attained - deviations[:, :3]
    for k, m in combinations(tested_poses, 2):
        cycle_pair = cycles[visits[k]], cycles[visits[m]]
        _, a, b = np.intersect1d(*cycle_pair, return_indices=True)
        if len(a) < LEAST:
            continue
        one, other = visits[k][a], visits[m][b]
        vectors = commanded[one] - commanded[other]
        D_c = np.linalg.norm(vectors, axis=1)
        D = np.linalg.norm(attained[one] - attained[other], axis=1)
        effect = frames.effects[one[0], :3] - frames.effects[other[0], :3]
        accuracy = _mean(D - D_c, vectors[0] @ effect / (D_c[0] or 1.0), frames.dof)
        pair, length = (int(numbers[k]), int(numbers[m])), float(D_c.mean())
        distance = DistanceTest(pair, len(D), length, accuracy, _three_sigma(D))
        distances.append(distance)
    by_pose = [deviations[visits[k], :3] for k in tested_poses]
    test = Acceptance(tuple(poses), tuple(distances), _drift(by_pose))
    if not frames.fitted:
        return test
    bound, text = _bound(by_pose, frames.effects[first[tested_poses], :3], rng)
    return replace(test, bound=bound, untestable=f"{frames.fitted}, {text}")


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
    # What moves a ten-thousandth as far as others by a meter or radian moves nothing.
    U = U[:, s > 1e-4 * s.max(initial=0.0)]
    dof, text = values - U.shape[1], f"{U.shape[1]} unknowns of {values} values"
    if dof == 0:
        return UNTESTABLE, f"{text}; from {count // 3 + 1} poses on AP has a bound"
    d = np.concatenate([errors.mean(axis=0) for errors in deviations])
    noise = np.column_stack([_mean_errors(errors, rng) for errors in deviations])
    length = _length(d - U @ (U.T @ d), noise - noise @ U @ U.T)
    low, rms = length.low / len(motions) ** 0.5, length.value * (3.0 / dof) ** 0.5
    text += f"; AP is at least {shown(low, 'm', 3)}, and {shown(rms, 'm', 3)} rms if "
    text += "the fit took the same from all directions"
    return Interval(np.nan, low, np.inf), text


def _variation(deviations: Floats, before: Indices) -> float | None:
    """Largest distance of the means of approaches from different poses."""
    origins, counts = np.unique(before, return_counts=True)
    means = [deviations[before == o].mean(axis=0) for o in origins[counts >= LEAST]]
    distances = [float(np.linalg.norm(a - b)) for a, b in combinations(means, 2)]
    return max(distances, default=None)


def _drift(deviations: Sequence[Floats]) -> tuple[float, float] | None:
    """Largest change of AP and of RP from the first to the last third of the visits."""
    thirds = [np.array_split(d, 3) for d in deviations if len(d) >= 3 * LEAST]
    if not thirds:
        return None
    ends = [(_sizes(first), _sizes(last)) for first, _, last in thirds]
    accuracy, scatter = np.abs(np.diff(ends, axis=1)[:, 0]).max(axis=0).tolist()
    return accuracy, scatter


def _sizes(deviations: Floats) -> tuple[float, float]:
    """AP and RP of the visits of a pose, shape (n, 3)."""
    m = deviations.mean(axis=0)
    radii = np.linalg.norm(deviations - m, axis=1)
    return float(np.linalg.norm(m)), float(radii.mean() + 3.0 * radii.std(ddof=1))


def student(dof: float) -> float:
    """Standard deviations of Student's t to either side that hold an interval."""
    return student_quantile(dof, TAILS[0])


def _mean(values: Floats, effect: Floats, dof: float) -> Interval:
    """A mean with Student's interval, of shape (n,).

    Args:
        values: The values.
        effect: Changes of all of them by independent deviations, shape (r,).
        dof: Degrees of freedom that tell the size of these.
    """
    n, m = len(values), float(values.mean())
    few, many = values.std(ddof=1) / n**0.5, np.linalg.norm(effect)
    half = float(np.hypot(student(n - 1) * few, student(dof) * many))
    return Interval(m, m - half, m + half)


def _three_sigma(values: Floats) -> Interval:
    """Three standard deviations with the chi-square interval, of shape (n,)."""
    dof, s = len(values) - 1, 3.0 * float(values.std(ddof=1))
    few, many = (chi_square_quantile(dof, part) for part in TAILS[::-1])
    return Interval(s, s * (dof / many) ** 0.5, s * (dof / few) ** 0.5)


def _mean_length(
    deviations: Floats, effects: Floats, dof: float, rng: np.random.Generator
) -> Interval:
    """AP: the length of a mean, shape (n, 3).

    The scatter of the mean has Student's distribution, with the covariance of the
    visits, and so have the effects of frames, (3, r), by what tells their size.
    """
    noise = _mean_errors(deviations, rng)
    if effects.size:
        common = rng.standard_normal((DRAWS, effects.shape[1])) @ effects.T
        noise += common / _chi(dof, rng)
    return _length(deviations.mean(axis=0), noise)


def _mean_errors(deviations: Floats, rng: np.random.Generator) -> Floats:
    """Simulated errors of the mean of visits, shape (DRAWS, 3)."""
    n = len(deviations)
    return np.asarray(_normal(np.cov(deviations.T) / n, DRAWS, rng) / _chi(n - 1, rng))


def _chi(dof: float, rng: np.random.Generator) -> Floats:
    """Simulated standard deviations of true ones, shape (DRAWS, 1)."""
    dof = min(dof, 1e6)  # As good as known.
    return np.sqrt(rng.chisquare(dof, (DRAWS, 1)) / dof)


def _normal(C: Floats, shape: int | tuple[int, int], rng: np.random.Generator) -> Any:
    """Normal deviations of a covariance (3, 3) that may be singular, (*shape, 3)."""
    return rng.multivariate_normal(np.zeros(3), C, shape, "ignore", method="eigh")


def _length(m: Floats, noise: Floats) -> Interval:
    """The length of a vector, shape (d,), with simulated errors of it, (DRAWS, d).

    With each error the true length is another one: that which looks like this one.
    """
    length = float(np.linalg.norm(m))
    along = noise @ (m / length if length > 0.0 else np.eye(len(m))[0])
    squares = np.sum(noise**2, axis=1)
    true = np.sqrt(np.maximum(length**2 - squares + along**2, 0.0)) - along
    # A larger error than what was found leaves open whether there is any length.
    least = np.where(squares < length**2, true, 0.0)
    ends = zip((least, np.maximum(true, 0.0)), TAILS, strict=True)
    low, high = (np.quantile(*end, method="inverted_cdf") for end in ends)
    return Interval(length, float(low), float(high))


def repeatability(deviations: Floats, rng: np.random.Generator) -> Interval:
    """RP, shape (n, 3), by the distribution of its ratio to the true one."""
    n, RP = len(deviations), _sizes(deviations)[1]
    if not RP > 0.0:
        return Interval(0.0, 0.0, 0.0)
    C = np.cov(deviations.T)
    lengths = np.linalg.norm(_normal(C, 20 * DRAWS, rng), axis=1)
    true = float(lengths.mean() + 3.0 * lengths.std())
    tests = _normal(C, (DRAWS, n), rng)
    radii = np.linalg.norm(tests - tests.mean(axis=1, keepdims=True), axis=2)
    ratios = (radii.mean(axis=1) + 3.0 * radii.std(axis=1, ddof=1)) / true
    low, high = np.quantile(ratios, TAILS)
    return Interval(RP, RP / float(high), RP / float(low))


def limits(limit: LimitSetup) -> dict[str, tuple[float, str]]:
    """The limits that are stated, and their units, by quantity."""
    values = {
        "AP": (limit.position, "m"),
        "RP": (limit.repeatability, "m"),
        "AD": (limit.distance, "m"),
        "orientation": (limit.orientation, "rad"),
    }
    return {name: (most, unit) for name, (most, unit) in values.items() if most}


def judged(
    test: Acceptance, limit: LimitSetup
) -> Iterator[tuple[str, str, Interval, float, str]]:
    """Each limit with its quantity, `pass`, `fail` or `undecided`, interval and unit.

    The worst pose counts: it passes where all of its interval is below the limit and
    nothing is in doubt, and fails where all of it is above. What depends on where the
    instrument stands fails only where that is known.
    """
    quantities = measured(test)
    unknown = OF_STATION if test.elsewhere else ()
    for name, (most, unit) in limits(limit).items():
        interval = worst(quantities[name][0]) if name in quantities else UNTESTABLE
        if interval.high <= most and not test.doubts:
            status = "pass"
        elif interval.low > most and not test.moved and name not in unknown:
            status = "fail"
        else:
            status = "undecided"
        yield name, status, interval, most, unit


def measured(test: Acceptance) -> dict[str, tuple[list[Interval], str]]:
    """Intervals of absolute values, and their unit, of each quantity that there is."""
    accuracies = [p.accuracy for p in test.poses]
    quantities = {
        "AP": ([test.bound] if test.untestable else accuracies, "m"),
        "RP": ([p.repeatability for p in test.poses], "m"),
        "AD": ([_absolute(d.accuracy) for d in test.distances], "m"),
        "orientation": ([_absolute(a) for p in test.poses for a in p.angles], "rad"),
    }
    return {name: both for name, both in quantities.items() if both[0]}


def _absolute(interval: Interval) -> Interval:
    """The interval of an absolute value."""
    value, *ends = map(abs, interval)
    low = 0.0 if interval.low * interval.high < 0.0 else min(ends)
    return Interval(value, low, max(ends))


def worst(intervals: Sequence[Interval]) -> Interval:
    """The largest value, and the largest ends: those that decide."""
    return Interval(*map(max, zip(*intervals, strict=True)))


def visits_table(tests: Mapping[str, Acceptance]) -> dict[str, Sequence[object]]:
    """A table by robot and pose, in SI units."""
    columns = [f"{quantity}{end} [m]" for quantity in ("AP", "RP") for end in ENDS]
    rows = []
    for name, p in ((name, p) for name, t in tests.items() for p in t.poses):
        vAP = "" if p.directions is None else p.directions
        rows.append((name, p.pose, p.visits, *p.accuracy, *p.repeatability, vAP))
    titles = ("robot", "pose", "visits", *columns, "vAP [m]")
    return dict(zip(titles, zip(*rows, strict=True), strict=True))


@serial_blas
def tested(
    robot: Chains | CalibrationResult,
    rows: Observations,
    setup: Setup,
    *,
    registration: bool = False,
    named: Names | None = None,
    doubts: Sequence[str] = (),
) -> tuple[dict[str, Acceptance], str]:
    """Test a robot on repeated visits of poses.

    Args:
        robot: A robot, whose base and tool the setup states, or a calibration, beside
            which the nominal robot is told.
        rows: The visits, of positions or poses. Where some are marked for validation,
            these alone; base and tool, or the station of a calibration, are registered
            on the others. What nothing tells is fitted to the visits: they have no AP.
        setup: Known quantities of frames and instrument, for a robot.
        registration: Whether a calibrated robot stands before another station.
        named: What files name every visit, read or not, by file and line: its `pose`
            and its `cycle`, each as far as there are such.
        doubts: Why no limit passes whatever the visits are, in sentences.

    Returns:
        The test by the robot that the commanded poses are of, `nominal` before
        `calibrated`; and the robot, the poses and the frames, in a sentence.

    Raises:
        InputError: If they are of something else, no pose was visited often enough, or
            names contradict each other.
    """
    if len(rows.blocks) != 1 or rows.blocks[0].model not in MODELS:
        listed = ", ".join(rows.models)
        reason = "an acceptance test needs positions or poses from one station"
        raise InputError(reason, value=listed, allowed=" or ".join(MODELS))
    visits, others = rows.rows(rows.validate), rows.rows(~rows.validate)
    if alone := len(visits) in (0, len(rows)):
        visits = rows
    time = visits.conditions.time if len(visits.conditions.time) else visits.lines
    order = np.lexsort((visits.lines, time, visits.files.codes))
    visits = Observations((visits.only.rows(order),))
    group, _ = ranked(visits.groups())
    number, cycle, missing = _pose_numbers(visits, group, named or {})
    x = visits.only.values[:, :3]
    good = ~np.isin(np.arange(len(x)), bad_visits(x, group))
    places = [f"{visits.source(k)} (P{p})" for k, p in enumerate(number)]
    doubts = [*doubts, *missing, *_outliers(x, number, good, places)]
    visits, x, group = visits.rows(good), x[good], group[good]
    moved = moved_after(x, group)
    if moved is not None:
        place = places[np.flatnonzero(good)[moved]]
        doubts += [f"the instrument was moved before {place}; test both parts alone"]
    others = visits if alone else others
    frames, fitted, origin, more = _frames(robot, visits, others, setup, registration)
    doubts, elsewhere, shaken = (*doubts, *more), ELSEWHERE in more, moved is not None
    tests = {}
    for name, fit in frames.items():
        there = model_errors.registered(fit.problem, fit.theta, visits)
        deviations = -error_table(there.problem, there.theta)
        effects = _derivatives(there.problem, there.theta) @ fit.known
        uncertainty = FrameErrors(effects, fit.dof or np.inf, fitted)
        test = acceptance(x, deviations, number[good], cycle[good], uncertainty)
        tests[name] = replace(test, doubts=doubts, moved=shaken, elsewhere=elsewhere)
    name = (robot if isinstance(robot, Chains) else robot.model.chains).robot.name
    visited = f"{counted(len(x), 'visit')} of {counted(len(test.poses), 'pose')}"
    return tests, f"{name}: {visited}; {origin}."


def _frames(
    robot: Chains | CalibrationResult,
    visits: Observations,
    rows: Observations,
    setup: Setup,
    registration: bool,
) -> tuple[dict[str, FrameFit], str, str, list[str]]:
    """Robots, what of them was fitted to the visits, where frames are of, and doubts.

    Registered frames, on other rows or on the visits themselves, come before stated
    ones.
    """
    alone, doubts, source = rows is visits, list[str](), "fitted to these visits"
    if not alone:
        source = f"registered on {counted(len(rows), 'other measurement')}"
    if isinstance(robot, Chains):
        fit, origin = _as_stated(robot, rows, setup), "base and tool as stated"
        if not alone or not np.isfinite(fit.known).all():
            problem, solution = register(fit.problem, fit.theta)
            nuisance = problem.parameters.free & problem.parameters.nuisance
            fit = _frame_fit(problem, solution.x, nuisance, alone)
            origin = f"base and tool {source}"
        fitted = f"base and tool were {source}" * (fit.dof == 0)
        return {"robot": fit}, fitted, origin, doubts
    models = {"nominal": robot.reference, NOW: robot.model}
    elsewhere = visits.keys[0] not in robot.model.problem(visits).terms
    if registration or elsewhere or not alone:
        fits = {name: _at_station(model, rows, alone) for name, model in models.items()}
        misfit, unlikely = _misfit(robot, fits[NOW])
        doubts += [misfit] * unlikely
        origin = f"tool as calibrated, station {source}; {misfit}"
    else:
        none = np.zeros((len(robot.model.theta), 0))
        fits = {
            name: FrameFit(model.problem(visits), model.theta, none)
            for name, model in models.items()
        }
        again = _at_station(robot.model, visits)
        tables = (error_table(f.problem, f.theta) for f in (fits[NOW], again))
        was, now = (np.linalg.norm(table[:, :3]) for table in tables)
        # A station uses up all values of a pose: what a robot leaves has to tell.
        limit = error_limit(again.problem, "m") * len(visits) ** 0.5
        if again.dof:
            values = visits.configurations * again.problem.layout.width
            limit = APART * (values / again.dof) ** 0.5 * now
        doubts += [ELSEWHERE] * bool(was > limit)
        origin = "base and tool as calibrated"
    origin += " (nominal robot: as registered on the calibration's measurements)"
    return fits, f"the station was {source}" * (fits[NOW].dof == 0), origin, doubts


def _pose_numbers(
    visits: Observations, group: Indices, named: Names
) -> tuple[Indices, Indices, list[str]]:
    """Number of the pose and cycle of each visit in their order, and what is missing.

    Raises:
        InputError: If a configuration has two names, or a name two configurations, or a
            pose has two visits in a cycle.
    """
    places = [*zip(visits.files, visits.lines.tolist(), strict=True)]
    pose, turn = (named.get(column, {}) for column in ("pose", "cycle"))
    for column, names in named.items():
        lacking = [row for row, place in enumerate(places) if place not in names]
        if names and lacking:
            reason = f"the visit names no {column}, others do"
            raise visits.error(lacking[0], reason, column=column)
    number = np.array([pose[p] for p in places]) if pose else group + 1
    cycle = np.array([turn[p] for p in places]) if turn else cycles_in_order(group)
    poses, cycles = {*number, *pose.values()}, {*cycle, *turn.values()}
    if max(poses) <= 2 * len(poses):
        poses |= {*range(1, max(poses))}
    seen: dict[tuple[object, ...], tuple[int, int]] = {}
    for row, (g, p, c) in enumerate(zip(group, number, cycle, strict=True)):
        for column, key, value, conflict in (
            ("pose", (g,), p, f"the configuration of P{p} has another name"),
            ("pose", (p, "P"), g, f"P{p} has another configuration"),
            ("cycle", (g, c, visits.files[row]), row, f"cycle {c} has had P{p}"),
        ):
            first, earlier = seen.setdefault((column, *key), (int(value), row))
            if first != value:
                reason = f"{conflict} in line {visits.lines[earlier]}"
                allowed = "commanded joint positions, the same at every visit of a pose"
                raise visits.error(row, reason, column=column, allowed=allowed)
    if len({*zip(group, cycle, strict=True)}) < len(cycle):
        # Every file counts its own cycles.
        cycle = cycle + visits.files.codes * int(cycle.max())
        cycles = {*cycle}
    missing = list[str]()
    for p in sorted(poses):
        if gaps := sorted(cycles - {*cycle[number == p]}):
            listed = enumerated(map(str, gaps))
            missing.append(f"P{p} lacks {len(gaps)} of {len(cycles)} cycles: {listed}")
    return number, cycle, missing


def _outliers(
    attained: Floats, number: Indices, good: Booleans, places: Sequence[str]
) -> Iterator[str]:
    """Which visits are left out, and why, in sentences."""
    means = {p: attained[good & (number == p)].mean(axis=0) for p in set(number[good])}
    for k in np.flatnonzero(~good).tolist():
        lengths = {p: float(np.linalg.norm(attained[k] - m)) for p, m in means.items()}
        nearest, distance = min(lengths, key=lengths.__getitem__), lengths[number[k]]
        # A tenth of the distance from its own pose is at the other one.
        other = f", where P{nearest} is" if lengths[nearest] < 0.1 * distance else ""
        text = f"{shown(distance, 'm', 3)} from the other visits of its pose{other}"
        yield f"{places[k]} is left out: {text}"


class FrameFit(NamedTuple):
    """A robot with base and tool, as far as anything tells them.

    Attributes:
        problem: The problem of the measurements that tell them.
        theta: Parameter values, shape (P,).
        known: Deviations of the parameters by independent ones of size one, (P, r); a
            meter and a radian each where nothing tells by how much they are off.
        dof: Degrees of freedom that tell the size of deviations; zero there.
    """

    problem: Problem
    theta: Floats
    known: Floats
    dof: float = np.inf


def _as_stated(chains: Chains, rows: Observations, setup: Setup) -> FrameFit:
    """The nominal robot with frames as a setup states them, and their priors."""
    plain = replace(setup, learned=None, bounds={}, prior=setup.prior_by_glob)
    problem = make_problem(chains, rows, with_parameters(chains, rows, plain, ()))
    theta, parameters = np.zeros(len(problem.parameters)), problem.parameters
    known = np.diag(parameters.priors)[:, parameters.free]
    return FrameFit(registered(problem, theta), theta, known)


def _at_station(
    model: CalibratedModel, rows: Observations, alone: bool = False
) -> FrameFit:
    """A robot with its tool, whose station is fitted to measurements of one block."""
    problem, theta = extended(model.problem(rows), model.theta, rows)
    term = problem.terms[rows.only.key]
    base = term.index[:FRAME]
    moved = model_errors.relocated_station(problem, theta, term.frames.station, base)
    return _frame_fit(*moved, np.isin(np.arange(len(theta)), base), alone)


def _derivatives(problem: Problem, theta: Floats) -> Floats:
    """Derivatives of the errors of one block by all parameters, shape (N, D, P)."""
    sigma = problem.sigma
    J = problem.linearize_rows(theta)[1][: len(sigma)] * sigma[:, None]
    return np.asarray(J.reshape(len(problem.data), -1, len(theta)))


def _frame_fit(
    problem: Problem, theta: Floats, free: Booleans, alone: bool
) -> FrameFit:
    """Free parameters that were fitted to measurements, and how surely.

    Those of one configuration have the errors of the robot in common, and count as one.
    Where these alone are measured, they are tested and tell nothing of it.
    """
    r, J = problem.linearize_rows(theta)
    count, scales = len(problem.sigma), problem.parameters.scales[free]
    A = J[:count, free] * scales
    share = problem.data.configurations / len(problem.data)
    dof = round(share * count) - int(np.linalg.matrix_rank(A, 1e-6 * len(A) ** 0.5))
    back = np.diag(problem.parameters.scales)[:, free]
    if alone or dof <= 0:
        return FrameFit(problem, theta, back, 0)
    square = max(float(r[:count] @ r[:count]) * share / dof, 1e-12)
    # What nothing tells is known to a meter and a radian.
    prior = np.maximum(scales / problem.parameters.priors[free], 1.0)
    C = np.linalg.inv(A.T @ A * (share / square) + np.diag(prior**2))
    return FrameFit(problem, theta, back @ np.linalg.cholesky(C), dof)


def _misfit(calibration: CalibrationResult, fit: FrameFit) -> tuple[str, bool]:
    """The misfit of a fitted station beside that to expect, in words.

    And whether chance does not explain it.

    Args:
        calibration: The calibration, which knows its covariance and its noise.
        fit: Its station by measurements of one block.
    """
    problem, C = fit.problem, np.asarray(calibration.covariance)
    noise = [n for n in calibration.statistics.noise if n.quantity == "position"]
    if not np.isfinite(C).all() or not noise:
        return "which misfit to expect the calibration does not say", False
    _, first = ranked(problem.data.groups())
    d = error_table(problem, fit.theta)[first, :3].reshape(-1)
    J = _derivatives(problem, fit.theta)[first, :3].reshape(len(d), -1)
    # Another station has parameters beside those of the calibration, in their order.
    calibrated = np.isin(problem.parameters.names, calibration.covariance.rows)
    S = J[:, calibrated] @ C @ J[:, calibrated].T
    S += noise[0].estimate ** 2 * np.eye(len(d))
    Q = np.linalg.qr(J[:, problem.terms[problem.data.only.key].index[:FRAME]])[0]
    projector = np.eye(len(d)) - Q @ Q.T
    squares = np.maximum(np.linalg.eigvalsh(projector @ S @ projector), 0.0)
    draws = np.random.default_rng(0).standard_normal((DRAWS, len(d))) ** 2 @ squares
    square = float(np.sum((projector @ d) ** 2))
    sizes = np.sqrt(np.array([square, squares.sum()]) / len(first))
    actual, expected = (shown(size, "m", 3) for size in sizes)
    text = f"the misfit of the station is {actual} where {expected} is expected"
    return text, float(np.mean(draws >= square)) < CHANCE


def bad_visits(attained: Floats, pose: Indices) -> list[int]:
    """Visits that do not belong to the others of their pose.

    Args:
        attained: Measured positions, shape (N, 3) [m].
        pose: Pose of each visit from 0, shape (N,).
    """
    count, bad = int(pose.max()) + 1, list[int]()
    for k in range(count):
        remaining, removed, last = np.flatnonzero(pose == k).tolist(), list[int](), 0
        most = len(remaining) // 5  # Of so many visits of a pose one is bad at most.
        while len(removed) < most and (n := len(remaining)) > 4:
            d = attained[remaining] - attained[remaining].mean(axis=0)
            C = d.T @ d / (n - 1) + RESOLUTION**2 * np.eye(3)
            squares = np.einsum("ni,ij,nj->n", d, np.linalg.inv(C), d)
            worst = int(np.argmax(squares))
            removed.append(remaining.pop(worst))
            # The part that one of n visits has of their scatter.
            part = n * squares[worst] / (n - 1) ** 2
            ratio = part / max(1.0 - part, np.finfo(float).eps) * (n - 4) / 3.0
            if n * count * f_tail(ratio, 3, n - 4) < CHANCE:
                last = len(removed)
        bad += removed[:last]
    return sorted(bad)


def moved_after(attained: Floats, pose: Indices) -> int | None:
    """The first visit after which the instrument was moved; None where it was not.

    Args:
        attained: Measured positions in their order, shape (N, 3) [m].
        pose: Pose of each visit from 0, shape (N,).
    """
    n, K = len(pose), int(pose.max()) + 1
    x = np.array([attained[pose == k].mean(axis=0) for k in range(K)])
    d, centered = attained - x[pose], (x - x.mean(axis=0))[pose]
    # In standard deviations of a visit, which no drift and no move makes larger.
    steps = [np.diff(d[pose == k], axis=0) for k in range(K)]
    all_steps = np.concatenate(steps)
    # The scatter of all counts as much as six visits of each.
    shared = 6 * (all_steps.T @ all_steps) / max(len(all_steps), 1)
    scatter = np.array([(s.T @ s + shared) / (len(s) + 6) for s in steps])
    W = np.linalg.inv(np.linalg.cholesky(scatter + RESOLUTION**2 * np.eye(3)))[pose]
    turns = np.cross(np.eye(3), centered[:, None]).transpose(0, 2, 1)
    rigid = W @ np.concatenate([np.tile(np.eye(3), (n, 1, 1)), turns], axis=2)
    pose_means = np.einsum("nk,ij->nikj", np.eye(K)[pose], np.eye(3)).reshape(3 * n, -1)
    values = (W @ d[:, :, None]).reshape(-1)

    def smooth(degree: int) -> tuple[Floats, Floats]:
        """Orthonormal poses' own means and a drift, and what they leave."""
        time = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), degree)
        drift = np.einsum("np,nij->nipj", time[:, 1:], rigid).reshape(3 * n, -1)
        Q = column_space(np.column_stack([pose_means, drift]))
        return Q, values - Q @ (Q.T @ values)

    def gain(k: int) -> float:
        Z = np.where(np.arange(n)[:, None, None] >= k, rigid, 0.0).reshape(3 * n, 6)
        return float(np.sum((column_space(Z - few @ (few.T @ Z)).T @ r) ** 2))

    (few, r), (many, rest) = map(smooth, DEGREES)
    least = max(2 * K, n // 10)
    places = np.unique(np.linspace(least, n - least, 200).astype(int))
    free = 3 * n - few.shape[1] - 6
    if free <= 0 or least > n - least:
        return None
    place = max(places.tolist(), key=gain)
    best = gain(place)
    # No scatter is that of rounding.
    variance = max((float(r @ r) - best) / free, 1e-3)
    beaten = variance * (3 * n - many.shape[1]) < float(rest @ rest)
    sure = n * f_tail(best / 6.0 / variance, 6, free) < CHANCE
    return place if beaten and sure else None
