"""Acceptance tests of robots: commanded poses by models, attained ones measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, enumerated
from calib_pin.estimation.problem import error_table
from calib_pin.estimation.system import FRAME
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Indices, Observations
from calib_pin.setup import Setup
from calib_pin.units import DISPLAY
from calib_pin.validation.acceptance import (
    DRAWS,
    LEAST,
    Acceptance,
    acceptance,
    cycles_in_order,
    ranked,
)
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.frame_fit import (
    FrameFit,
    derivatives,
    fitted_frames,
    fitted_station,
    refitted_frames,
    stated_frames,
)
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.visit_faults import VisitFaults, visit_faults

MODELS = ("position", "pose")
"""Measurement models that tell where a point is."""

UNLIKELY = 0.01
"""Probability of a misfit by chance below which no test passes."""


@dataclass(frozen=True)
class Schedule:
    """The poses and cycles that files name, empty where they name none.

    Attributes:
        pose: Number of the pose of each visit, shape (N,).
        cycle: Cycle of each visit, shape (N,).
        lacking: Pose and cycle, as far as they are named, of visits without a reading.
    """

    pose: Sequence[int] = ()
    cycle: Sequence[int] = ()
    lacking: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True)
class Tested:
    """An acceptance test.

    Attributes:
        tests: The test by the robot that the commanded poses are of, `nominal` before
            `calibrated`.
        about: The robot, the poses and the frames, in sentences.
    """

    tests: Mapping[str, Acceptance]
    about: str

    def doubted(self, doubts: Sequence[str]) -> Tested:
        """The same with further doubts before those of the tests."""
        tests = {
            name: replace(test, doubts=(*doubts, *test.doubts))
            for name, test in self.tests.items()
        }
        return replace(self, tests=tests)

    def table(self) -> dict[str, Sequence[object]]:
        """A table by robot and pose, in SI units."""
        rows = [
            (name, pose) for name, test in self.tests.items() for pose in test.poses
        ]
        table: dict[str, Sequence[object]] = {
            "robot": [name for name, _ in rows],
            "pose": [pose.pose for _, pose in rows],
            "visits": [pose.visits for _, pose in rows],
        }
        for key, of in (
            ("AP", [pose.accuracy for _, pose in rows]),
            ("RP", [pose.repeatability for _, pose in rows]),
        ):
            for end, name in (("", "value"), ("_low", "low"), ("_high", "high")):
                values = ("" if i is None else getattr(i, name) for i in of)
                table[f"{key}{end} [m]"] = [*values]
        table["vAP [m]"] = [
            "" if pose.directions is None else pose.directions for _, pose in rows
        ]
        return table


@serial_blas
def tested(
    robot: Chains | CalibrationResult,
    rows: Observations,
    setup: Setup,
    *,
    registration: bool = False,
    located: Observations | None = None,
    schedule: Schedule | None = None,
) -> Tested:
    """Test a robot on repeated visits of poses.

    Args:
        robot: A robot, whose base and tool the setup states, or a calibration, beside
            which the nominal robot is told.
        rows: The visits, of positions or poses; where some are marked for validation,
            these alone, and the others are registration measurements.
        setup: Known quantities of frames and instrument, for a robot.
        registration: Whether a calibrated robot stands before another station.
        located: Registration measurements: base and tool, or the station of a
            calibrated robot, are fitted to them. Without any, what is unknown is fitted
            to the visits, which then have no AP.
        schedule: The poses and cycles that the files name.

    Raises:
        InputError: If they are of something else, no pose was visited often enough, or
            poses and cycles contradict each other.
    """
    named = schedule or Schedule()
    if len(rows.blocks) != 1 or rows.blocks[0].model not in MODELS:
        told = ", ".join(dict.fromkeys(block.model for block in rows.blocks))
        raise InputError(
            "an acceptance test needs positions or poses from one station",
            value=told,
            allowed=" or ".join(MODELS),
        )
    visits, own = rows, np.ones(len(rows), bool)
    if rows.validate.any() and not rows.validate.all():
        own = rows.validate
        visits, others = rows.rows(own), rows.rows(~own)
        located = others if located is None else Observations.of(located, others)
    if located is not None and located.keys != rows.keys:
        raise InputError(
            "registration measurements must be of the kind of the visits",
            value=", ".join(map(str, located.keys)),
            allowed=str(rows.keys[0]),
        )
    pose, cycle = _labeled(
        visits,
        *(np.array(of)[own] if len(of) else None for of in (named.pose, named.cycle)),
    )
    order = visits.in_order
    if len(time := visits.conditions.time):
        order = np.lexsort((visits.lines, time, visits.files.codes))
    ordered = [None if of is None else of[order] for of in (pose, cycle)]
    group, _ = ranked(visits.groups()[order])
    cycle = cycles_in_order(group) if ordered[1] is None else ordered[1]
    number = group + 1 if ordered[0] is None else ordered[0]
    faults = visit_faults(visits.only.values[order, :3], group)
    doubts = [*_missing(number, cycle, named, pose)]
    doubts += _told(visits, order, number, group, faults)
    good = np.ones(len(order), bool)
    good[[*faults.bad]] = False
    kept = order[good]
    tests, values = {}, visits.only.values[:, :3]
    subjects = _subjects(
        robot,
        visits,
        setup,
        kept=np.sort(kept),
        registration=registration,
        located=located,
    )
    for name, (frames, fitted) in subjects.frames.items():
        errors, known = frames.at(visits, fitted)
        tests[name] = replace(
            acceptance(
                values[kept],
                (values + errors[:, :3])[kept],
                visits.groups()[kept],
                -errors[kept, 3:6] if visits.only.model == "pose" else None,
                number[good],
                cycle[good],
                known.rows(kept),
            ),
            moved=faults.moved is not None,
            doubts=(*doubts, *subjects.doubts),
        )
    poses = f"{len(kept)} visits of {len(tests[name].poses)} poses"
    return Tested(tests, f"{subjects.robot}: {poses}; {subjects.about}.")


@dataclass(frozen=True)
class _Subjects:
    """Robots to be tested.

    Attributes:
        robot: Name of the robot.
        frames: Each robot with its frames, and what of these was fitted to the visits.
        about: Where the frames come from.
        doubts: Why they must not be trusted.
    """

    robot: str
    frames: Mapping[str, tuple[FrameFit, str]]
    about: str
    doubts: tuple[str, ...] = ()


def _subjects(
    robot: Chains | CalibrationResult,
    visits: Observations,
    setup: Setup,
    *,
    kept: Indices,
    registration: bool,
    located: Observations | None,
) -> _Subjects:
    good = visits.rows(kept)
    own = "" if located is None else f"{len(located)} measurements of their own"
    if isinstance(robot, Chains):
        found, how, fitted = stated_frames(robot, visits, setup), "as stated", ""
        if located is not None:
            found, how = fitted_frames(robot, located, setup), f"registered on {own}"
        if found is None or found.dof == 0:
            found, how = fitted_frames(robot, good, setup), "fitted to these visits"
            fitted = "base and tool"
        return _Subjects(
            robot.robot.name, {"robot": (found, fitted)}, f"base and tool {how}"
        )
    name, reference = robot.model.chains.robot.name, robot.reference
    nominal = FrameFit.given(reference.problem(visits), reference.theta)
    calibrated = FrameFit.given(robot.model.problem(visits), robot.model.theta)
    if len(robot.fitted.rows.blocks) == 1 and np.isfinite(robot.fitted.before).all():
        nominal = refitted_frames(reference, robot.fitted.rows)
    about, fitted, doubts = "base and tool as calibrated", "", ()
    new = visits.keys[0] not in robot.model.parts
    if registration or new or located is not None:
        on = good if located is None else located
        model = CalibratedModel.create(nominal.problem, nominal.theta)
        nominal, calibrated = (fitted_station(m, on) for m in (model, robot.model))
        fitted = "the station" if located is None or calibrated.dof == 0 else ""
        said, beyond = _expected(robot, calibrated)
        doubts = (said,) if beyond else ()
        to = f"registered on {own}" if own else "fitted to these visits"
        about = f"tool as calibrated, station {to}; {said}"
    frames = {"nominal": (nominal, fitted), "calibrated": (calibrated, fitted)}
    about += "; of the nominal robot as registered on the calibration's measurements"
    return _Subjects(name, frames, about, doubts)


def _labeled(
    visits: Observations, pose: Indices | None, cycle: Indices | None
) -> tuple[Indices | None, Indices | None]:
    """Poses and cycles as the files name them.

    Raises:
        InputError: If a configuration has two names, or a name two configurations, or a
            pose has two visits in a cycle.
    """
    group, files = visits.groups(), visits.files.codes
    named: dict[int, int] = {}
    first: dict[int, int] = {}
    there: dict[tuple[int, int], int] = {}
    apart = False
    for row in visits.in_order.tolist():
        if pose is not None:
            p = int(pose[row])
            same = named.setdefault(int(group[row]), row)
            other = first.setdefault(p, row)
            if pose[same] != p:
                said = f"the configuration of P{p} is that of P{pose[same]} in line"
                raise visits.error(row, f"{said} {visits.lines[same]}", column="pose")
            if group[other] != group[row]:
                said = f"P{p} has another configuration in line"
                raise visits.error(row, f"{said} {visits.lines[other]}", column="pose")
        if cycle is not None:
            twin = there.setdefault((int(group[row]), int(cycle[row])), row)
            apart |= files[twin] != files[row]
            if twin != row and files[twin] == files[row]:
                said = f"cycle {cycle[row]} has this pose in line {visits.lines[twin]}"
                raise visits.error(row, f"{said} already", column="cycle")
    if cycle is not None and apart:  # Each file counts its own cycles.
        cycle = cycle + files * int(cycle.max())
    return pose, cycle


def _missing(
    number: Indices, cycle: Indices, named: Schedule, pose: Indices | None
) -> Iterator[str]:
    """Which visits of the schedule there are not, in sentences by pose."""
    cycles = sorted({*cycle.tolist(), *(c for _, c in named.lacking)})
    poses = {*number.tolist(), *(p for p, _ in named.lacking)}
    if pose is not None and max(poses) <= 2 * len(poses):
        poses |= {*range(1, max(poses))}
    for p in sorted(poses):
        there = {*cycle[number == p].tolist()}
        if gone := [c for c in cycles if c not in there]:
            said = f"P{p} has {len(there)} of {len(cycles)} visits"
            few = f"; {LEAST} are the least" if len(there) < LEAST else ""
            yield f"{said}: none in cycle {_spans(gone)}{few}"


def _spans(numbers: Sequence[int]) -> str:
    """Ascending numbers, those that follow one another as `2 to 6`."""
    ends = [[n, n] for n in numbers]
    for k in range(len(ends) - 1, 0, -1):
        if ends[k][0] == ends[k - 1][1] + 1:
            ends[k - 1][1] = ends.pop(k)[1]
    return enumerated([str(a) if a == b else f"{a} to {b}" for a, b in ends])


def _told(
    visits: Observations,
    order: Indices,
    number: Indices,
    group: Indices,
    faults: VisitFaults,
) -> Iterator[str]:
    """The faults among visits in their order, in sentences."""
    called = dict(zip(group.tolist(), number.tolist(), strict=True))
    named = [
        f"{visits.source(row)} (P{p})"
        for row, p in zip(order.tolist(), number.tolist(), strict=True)
    ]
    places = {(int(group[k]), to): k for k, to in faults.bad.items()}
    for k, to in faults.bad.items():
        own = int(group[k])
        other = places.get((to, own), k) if to != own else k
        if other != k and places[own, to] == k:
            if k < other:
                yield f"{named[k]} and {named[other]}: their values are exchanged"
        elif to != own:
            yield f"{named[k]}: the values are those of P{called[to]}"
        else:
            away = _length(faults.away[k])
            yield f"{named[k]}: {away} from the other visits of its pose"
    if faults.moved is not None:
        yield (
            f"the instrument was moved before {named[faults.moved]}, which shifts "
            f"visits by {_length(faults.step)}: test those before and after alone"
        )


def _expected(robot: CalibrationResult, frames: FrameFit) -> tuple[str, bool]:
    """The misfit of a station beside that which the calibration expects, in words.

    And whether chance does not explain it.
    """
    problem, theta, C = frames.problem, frames.theta, np.asarray(robot.covariance)
    noise = [n for n in robot.statistics.noise if n.quantity == "position"]
    if not np.isfinite(C).all() or not noise:
        return "the calibration does not say which misfit to expect", False
    names = {name: k for k, name in enumerate(robot.covariance.rows)}
    rows, base = problem.data, problem.parts[problem.data.only.key].index[:FRAME]
    pose, first = ranked(rows.groups())
    visits = [rows.only.values[pose == k, :3] for k in range(len(first))]
    d = error_table(problem, theta)[:, :3]
    d = np.array([d[pose == k].mean(axis=0) for k in range(len(first))]).reshape(-1)
    J = derivatives(problem, theta)[first, :3].reshape(len(d), -1)
    own = [k for k, n in enumerate(problem.parameters.names) if n in names]
    of_fit = [names[problem.parameters.names[k]] for k in own]
    S = J[:, own] @ C[np.ix_(of_fit, of_fit)] @ J[:, own].T
    # Errors that no parameter describes are those of a pose, not of a visit.
    unmodeled = noise[0].estimate if noise[0].unmodeled is None else noise[0].unmodeled
    S += unmodeled**2 * np.eye(len(d))
    for k, x in enumerate(visits):
        if len(x) > 1:
            S[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += np.cov(x.T) / len(x)
    Q = np.linalg.qr(J[:, base])[0]
    left = np.eye(len(d)) - Q @ Q.T
    variances = np.maximum(np.linalg.eigvalsh(left @ S @ left), 0.0)
    draws = np.random.default_rng(0).standard_normal((DRAWS, len(d))) ** 2 @ variances
    found, by = float(np.sum((left @ d) ** 2)), len(first)
    expected = float(np.sqrt(variances.sum() / by))
    beyond = float(np.mean(draws >= found)) < UNLIKELY
    said = f"the misfit of the station is {_length((found / by) ** 0.5)} where "
    return f"{said}{_length(expected)} is expected", beyond


def _length(size: float) -> str:
    unit, factor = DISPLAY["m"]
    return f"{factor * size:.3g} {unit}"
