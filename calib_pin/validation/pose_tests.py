"""Acceptance tests of robots: commanded poses by models, attained ones measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, enumerated
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.identifiability import column_space
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.estimation.registration import extended, registered, relocated
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Observations
from calib_pin.parameters import matching
from calib_pin.setup import Setup
from calib_pin.validation.acceptance import (
    DRAWS,
    Acceptance,
    FrameErrors,
    acceptance,
    cycles_in_order,
    ranked,
    told,
)
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.model_errors import registered as registered_on
from calib_pin.validation.result import CalibrationResult

MODELS = ("position", "pose")
"""Measurement models that tell where a point is."""

Names = Mapping[str, Mapping[tuple[str, int], int]]
"""Numbers in the columns `pose` and `cycle` by file and line."""

ELSEWHERE = "the station is not where it was at the calibration; --register fits it"

MOVED = 5.0
"""Errors of a calibration, by those with another station, from which that is told."""

NOW = "calibrated"
"""The robot that is tested, of a calibration."""

NEAR = 0.1
"""Part of its distance from its own pose within which a visit is at another one."""


@dataclass(frozen=True)
class Tested:
    """An acceptance test.

    Attributes:
        tests: The test by the robot that the commanded poses are of, `nominal` before
            `calibrated`.
        about: The robot, the poses and the frames, in a sentence.
    """

    tests: Mapping[str, Acceptance]
    about: str

    def table(self) -> dict[str, Sequence[object]]:
        """A table by robot and pose, in SI units."""
        poses = [(name, pose) for name, t in self.tests.items() for pose in t.poses]
        found: dict[str, Sequence[object]] = {
            "robot": [name for name, _ in poses],
            "pose": [pose.pose for _, pose in poses],
            "visits": [pose.visits for _, pose in poses],
        }
        for title, of in (("AP", "accuracy"), ("RP", "repeatability")):
            ends = zip(*(getattr(pose, of) for _, pose in poses), strict=True)
            for end, values in zip(("", "_low", "_high"), ends, strict=True):
                found[f"{title}{end} [m]"] = values
        known = (pose.directions for _, pose in poses)
        return found | {"vAP [m]": ["" if size is None else size for size in known]}


@serial_blas
def tested(
    robot: Chains | CalibrationResult,
    rows: Observations,
    setup: Setup,
    *,
    registration: bool = False,
    named: Names | None = None,
    doubts: Sequence[str] = (),
) -> Tested:
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

    Raises:
        InputError: If they are of something else, no pose was visited often enough, or
            names contradict each other.
    """
    if len(rows.blocks) != 1 or rows.blocks[0].model not in MODELS:
        listed = ", ".join(dict.fromkeys(block.model for block in rows.blocks))
        reason = "an acceptance test needs positions or poses from one station"
        raise InputError(reason, value=listed, allowed=" or ".join(MODELS))
    visits, others = rows, None
    if rows.validate.any() and not rows.validate.all():
        visits, others = rows.rows(rows.validate), rows.rows(~rows.validate)
    time = visits.conditions.time if len(visits.conditions.time) else visits.lines
    order = np.lexsort((visits.lines, time, visits.files.codes))
    visits = Observations((visits.only.rows(order),))
    group, _ = ranked(visits.groups())
    number, cycle, missing = _named(visits, group, named or {})
    x = visits.only.values[:, :3]
    good = ~np.isin(np.arange(len(x)), bad_visits(x, group))
    places = [f"{visits.source(k)} (P{p})" for k, p in enumerate(number)]
    doubts = [*doubts, *missing, *_misplaced(x, number, good, places)]
    visits, x, group = visits.rows(good), x[good], group[good]
    moved = moved_after(x, group)
    if moved is not None:
        at = places[np.flatnonzero(good)[moved]]
        doubts += [f"the instrument was moved before {at}; test both parts alone"]
    frames, fitted, how, more = _frames(robot, visits, others, setup, registration)
    tests = {}
    for name, fit in frames.items():
        there = registered_on(fit.problem, fit.theta, visits)
        errors = error_table(there.problem, there.theta)
        effects = derivatives(there.problem, there.theta) @ fit.known
        commanded, said = x + errors[:, :3], (*doubts, *more)
        angles = -errors[:, 3:6] if errors.shape[1] > 3 else None
        visited = group, angles, number[good], cycle[good]
        off = FrameErrors(effects, fit.dof or np.inf, fitted)
        test = acceptance(x, commanded, *visited, off)
        tests[name] = replace(test, moved=moved is not None, doubts=said)
    name = (robot if isinstance(robot, Chains) else robot.model.chains).robot.name
    about = f"{name}: {len(x)} visits of {len(test.poses)} poses; {how}."
    return Tested(tests, about)


def _frames(
    robot: Chains | CalibrationResult,
    visits: Observations,
    others: Observations | None,
    setup: Setup,
    registration: bool,
) -> tuple[dict[str, FrameFit], str, str, list[str]]:
    """Robots, what of them was fitted to the visits, where frames are of, and doubts.

    Registered frames come before stated ones.
    """
    on, own, doubts = visits, "fitted to these visits", list[str]()
    if others is not None:
        on, own = others, f"registered on {len(others)} other measurements"
    if isinstance(robot, Chains):
        fit = frames_alone(robot, on, setup)
        what, how = "base and tool were", "base and tool as stated"
        if others is not None or not np.isfinite(fit.known).all():
            problem, found = register(fit.problem, fit.theta)
            nuisance = problem.parameters.free & problem.parameters.nuisance
            fit = _fitted(problem, found.x, nuisance, others is None)
            how = f"base and tool {own}"
        fits = {"robot": fit}
    else:
        what, how = "the station was", "base and tool as calibrated"
        models = {"nominal": robot.reference, "calibrated": robot.model}
        there = visits.keys[0] in robot.model.terms
        if registration or others is not None or not there:
            alone = others is None
            fits = {n: fitted_station(model, on, alone) for n, model in models.items()}
            said, unlikely = misfit(robot, fits[NOW])
            doubts += [said] * unlikely
            how = f"tool as calibrated, station {own}; {said}"
        else:
            none = np.zeros((len(robot.model.theta), 0))
            given = {n: (m.problem(visits), m.theta) for n, m in models.items()}
            fits = {name: FrameFit(*own, none) for name, own in given.items()}
            pair = fits[NOW], fitted_station(robot.model, visits)
            sizes = [np.linalg.norm(error_table(f.problem, f.theta)) for f in pair]
            doubts += [ELSEWHERE] * bool(sizes[0] > MOVED * sizes[1])
        how += " (nominal robot: as registered on the calibration's measurements)"
    *_, fit = fits.values()
    return fits, "" if fit.dof else f"{what} {own}", how, doubts


def _named(
    visits: Observations, group: Indices, named: Names
) -> tuple[Indices, Indices, list[str]]:
    """Number of the pose and cycle of each visit in their order, and what is missing.

    Raises:
        InputError: If a configuration has two names, or a name two configurations, or a
            pose has two visits in a cycle.
    """
    places = [*zip(visits.files, visits.lines.tolist(), strict=True)]
    given = (named.get(column, {}) for column in ("pose", "cycle"))
    pose, turn = (of if all(p in of for p in places) else {} for of in given)
    number = np.array([pose[p] for p in places]) if pose else group + 1
    cycle = np.array([turn[p] for p in places]) if turn else cycles_in_order(group)
    poses, cycles = {*number, *pose.values()}, {*cycle, *turn.values()}
    if max(poses) <= 2 * len(poses):
        poses |= {*range(1, max(poses))}
    seen: dict[tuple[object, ...], tuple[int, int]] = {}
    for row, (g, p, c) in enumerate(zip(group, number, cycle, strict=True)):
        for column, key, value, said in (
            ("pose", (g,), p, f"the configuration of P{p} has another name"),
            ("pose", (p, "P"), g, f"P{p} has another configuration"),
            ("cycle", (g, c, visits.files[row]), row, f"cycle {c} has had P{p}"),
        ):
            first, there = seen.setdefault((column, *key), (int(value), row))
            if first != value:
                reason = f"{said} in line {visits.lines[there]}"
                raise visits.error(row, reason, column=column)
    if len({*zip(group, cycle, strict=True)}) < len(cycle):
        # Every file counts its own cycles.
        cycle = cycle + visits.files.codes * int(cycle.max())
        cycles = {*cycle}
    missing = [
        f"P{p} lacks {len(gone)} of {len(cycles)} cycles: {enumerated(map(str, gone))}"
        for p in sorted(poses)
        if (gone := sorted(cycles - {*cycle[number == p]}))
    ]
    return number, cycle, missing


def _misplaced(
    attained: Floats, number: Indices, good: NDArray[np.bool_], places: Sequence[str]
) -> Iterator[str]:
    """Which visits are left out, and why, in sentences."""
    means = {p: attained[good & (number == p)].mean(axis=0) for p in set(number[good])}
    for k in np.flatnonzero(~good).tolist():
        away = {p: float(np.linalg.norm(attained[k] - m)) for p, m in means.items()}
        near, own = min(away, key=away.__getitem__), away[number[k]]
        other = f", where P{near} is" if away[near] < NEAR * own else ""
        said = f"{told(own)} from the other visits of its pose{other}"
        yield f"{places[k]} is left out: {said}"


UNLIKELY = 0.01
"""Probability of a misfit by chance below which no test passes."""


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


def frames_alone(chains: Chains, rows: Observations, setup: Setup) -> FrameFit:
    """The nominal robot with frames as a setup states them, and their priors."""
    bare = replace(setup, parameters=(), learned=None, fixed=(), bounds={}, prior={})
    names = make_problem(chains, rows, bare).parameters.names
    fixed = tuple(glob for glob in setup.fixed if matching(glob, names))
    priors = setup.prior_by_glob
    prior = {glob: priors[glob] for glob in priors if matching(glob, names)}
    problem = make_problem(chains, rows, replace(bare, fixed=fixed, prior=prior))
    theta, parameters = np.zeros(len(names)), problem.parameters
    known = np.diag(parameters.priors)[:, parameters.free]
    return FrameFit(registered(problem, theta), theta, known)


def fitted_station(
    model: CalibratedModel, rows: Observations, alone: bool = True
) -> FrameFit:
    """A robot with its tool, whose station is fitted to measurements of one block."""
    problem, theta = extended(model.problem(rows), model.theta, rows)
    term = problem.terms[rows.only.key]
    problem = relocated(problem, theta, term.frames.station)
    free = np.isin(np.arange(len(theta)), term.index[:FRAME])
    basis = np.diag(problem.parameters.scales)[:, free]
    return _fitted(problem, least_squares(problem, theta, basis).x, free, alone)


def derivatives(problem: Problem, theta: Floats) -> Floats:
    """Derivatives of the errors of one block by all parameters, shape (N, D, P)."""
    sigma = problem.sigma
    J = problem.linearize_rows(theta)[1][: len(sigma)] * sigma[:, None]
    return np.asarray(J.reshape(len(problem.data), -1, len(theta)))


def _fitted(
    problem: Problem, theta: Floats, free: NDArray[np.bool_], alone: bool
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


def misfit(calibration: CalibrationResult, fit: FrameFit) -> tuple[str, bool]:
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
    J = derivatives(problem, fit.theta)[first, :3].reshape(len(d), -1)
    # Another station has parameters beside those of the calibration, in their order.
    own = np.isin(problem.parameters.names, calibration.covariance.rows)
    S = J[:, own] @ C @ J[:, own].T
    S += noise[0].estimate ** 2 * np.eye(len(d))
    Q = np.linalg.qr(J[:, problem.terms[problem.data.only.key].index[:FRAME]])[0]
    left = np.eye(len(d)) - Q @ Q.T
    squares = np.maximum(np.linalg.eigvalsh(left @ S @ left), 0.0)
    draws = np.random.default_rng(0).standard_normal((DRAWS, len(d))) ** 2 @ squares
    found = float(np.sum((left @ d) ** 2))
    sizes = [told((square / len(first)) ** 0.5) for square in (found, squares.sum())]
    said = f"the misfit of the station is {sizes[0]} where {sizes[1]} is expected"
    return said, float(np.mean(draws >= found)) < UNLIKELY


CHANCE = 0.01
"""Probability with which a test without any fault is told to have one of a kind."""

MOST = 5
"""Of so many visits of a pose one is bad at most."""

RESOLUTION = 1e-6
"""Scatter of visits that no instrument resolves [m]."""

SPLITS = 200
"""Places at which a move is sought."""

FEW = 6
"""Visits by whose number the scatter of all poses counts for each."""

DEGREES = (2, 4)
"""Degrees of the drift beside which a move is sought, and of that which it beats."""


def bad_visits(attained: Floats, pose: Indices) -> list[int]:
    """Visits that do not belong to the others of their pose.

    Args:
        attained: Measured positions, shape (N, 3) [m].
        pose: Pose of each visit from 0, shape (N,).
    """
    count, found = int(pose.max()) + 1, list[int]()
    for k in range(count):
        left, gone, last = np.flatnonzero(pose == k).tolist(), list[int](), 0
        most = len(left) // MOST
        while len(gone) < most and (n := len(left)) > 4:
            d = attained[left] - attained[left].mean(axis=0)
            C = d.T @ d / (n - 1) + RESOLUTION**2 * np.eye(3)
            squares = np.einsum("ni,ij,nj->n", d, np.linalg.inv(C), d)
            worst = int(np.argmax(squares))
            gone.append(left.pop(worst))
            # The part that one of n visits has of their scatter.
            part = n * squares[worst] / (n - 1) ** 2
            ratio = part / max(1.0 - part, np.finfo(float).eps) * (n - 4) / 3.0
            if n * count * f_tail(ratio, 3, n - 4) < CHANCE:
                last = len(gone)
        found += gone[:last]
    return sorted(found)


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
    every = np.concatenate(steps)
    shared = FEW * (every.T @ every) / max(len(every), 1)
    scatter = np.array([(s.T @ s + shared) / (len(s) + FEW) for s in steps])
    W = np.linalg.inv(np.linalg.cholesky(scatter + RESOLUTION**2 * np.eye(3)))[pose]
    turns = np.cross(np.eye(3), centered[:, None]).transpose(0, 2, 1)
    rigid = W @ np.concatenate([np.tile(np.eye(3), (n, 1, 1)), turns], axis=2)
    own = np.einsum("nk,ij->nikj", np.eye(K)[pose], np.eye(3)).reshape(3 * n, -1)
    values = (W @ d[:, :, None]).reshape(-1)

    def smooth(degree: int) -> tuple[Floats, Floats]:
        """Orthonormal poses' own means and a drift, and what they leave."""
        time = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), degree)
        drift = np.einsum("np,nij->nipj", time[:, 1:], rigid).reshape(3 * n, -1)
        Q = column_space(np.column_stack([own, drift]))
        return Q, values - Q @ (Q.T @ values)

    def gain(k: int) -> float:
        Z = np.where(np.arange(n)[:, None, None] >= k, rigid, 0.0).reshape(3 * n, 6)
        return float(np.sum((column_space(Z - few @ (few.T @ Z)).T @ r) ** 2))

    (few, r), (many, rest) = map(smooth, DEGREES)
    least = max(2 * K, n // 10)
    places = np.unique(np.linspace(least, n - least, SPLITS).astype(int))
    free = 3 * n - few.shape[1] - 6
    if free <= 0 or least > n - least:
        return None
    place = max(places.tolist(), key=gain)
    best = gain(place)
    # No scatter is that of rounding.
    left = max((float(r @ r) - best) / free, 1e-3)
    beaten = left * (3 * n - many.shape[1]) < float(rest @ rest)
    sure = n * f_tail(best / 6.0 / left, 6, free) < CHANCE
    return place if beaten and sure else None
