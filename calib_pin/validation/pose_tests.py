"""Acceptance tests of robots: commanded poses by models, attained ones measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, enumerated
from calib_pin.estimation.problem import error_table
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Observations
from calib_pin.setup import Setup
from calib_pin.validation.acceptance import (
    Acceptance,
    FrameErrors,
    acceptance,
    cycles_in_order,
    ranked,
    told,
)
from calib_pin.validation.frame_fit import (
    FrameFit,
    derivatives,
    fitted_frames,
    fitted_station,
    frames_alone,
    misfit,
)
from calib_pin.validation.model_errors import registered
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.visit_faults import bad_visits, moved_after

MODELS = ("position", "pose")
"""Measurement models that tell where a point is."""

Names = Mapping[str, Mapping[tuple[str, int], int]]
"""Numbers in the columns `pose` and `cycle` by file and line."""

ELSEWHERE = "the station is not where it was at the calibration; --register fits it"

MOVED = 5.0
"""Errors of a calibration, by those with another station, from which that is told."""

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
            table[f"{key} [m]"] = [i.value for i in of]
            table[f"{key}_low [m]"] = [i.low for i in of]
            table[f"{key}_high [m]"] = [i.high for i in of]
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
        raise InputError(
            "an acceptance test needs positions or poses from one station",
            value=listed,
            allowed=" or ".join(MODELS),
        )
    visits, others = rows, None
    if rows.validate.any() and not rows.validate.all():
        visits, others = rows.rows(rows.validate), rows.rows(~rows.validate)
    order = visits.in_order
    if len(time := visits.conditions.time):
        order = np.lexsort((visits.lines, time, visits.files.codes))
    group, _ = ranked(visits.groups()[order])
    number, cycle, missing = _named(visits, order, group, named or {})
    attained = visits.only.values[order, :3]
    bad = bad_visits(attained, group)
    good = ~np.isin(np.arange(len(order)), bad)
    places = [f"{visits.source(k)} (P{p})" for k, p in zip(order, number, strict=True)]
    doubts = [*doubts, *missing, *_misplaced(attained, number, good, places)]
    moved = moved_after(attained[good], group[good])
    if moved is not None:
        at = places[np.flatnonzero(good)[moved]]
        doubts += [f"the instrument was moved before {at}; test both parts alone"]
    kept = visits.rows(np.sort(order[good]))
    frames, fitted, how, further = _frames(robot, kept, others, setup, registration)
    doubts += further
    tests = {}
    for name, fit in frames.items():
        fit = fit.unknown if fitted else fit
        there = registered(fit.problem, fit.theta, visits)
        errors = error_table(there.problem, there.theta)[order][good]
        effects = derivatives(there.problem, there.theta)[order][good] @ fit.known
        test = acceptance(
            attained[good],
            attained[good] + errors[:, :3],
            group[good],
            -errors[:, 3:6] if errors.shape[1] > 3 else None,
            number[good],
            cycle[good],
            FrameErrors(effects, fit.dof, fitted),
        )
        tests[name] = replace(test, moved=moved is not None, doubts=tuple(doubts))
    chains = robot if isinstance(robot, Chains) else robot.model.chains
    about = (
        f"{chains.robot.name}: {len(kept)} visits of {len(test.poses)} poses; {how}."
    )
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
    on, fitted, own = others or visits, "", "fitted to these visits"
    if others is not None:
        own = f"registered on {len(others)} other measurements"
    if isinstance(robot, Chains):
        fit = frames_alone(robot, on, setup)
        if others is None and np.isfinite(fit.known).all():
            return {"robot": fit}, "", "base and tool as stated", []
        fit = fitted_frames(fit.problem, fit.theta)
        if others is None or fit.dof == 0:
            fitted = f"base and tool were {own}"
        return {"robot": fit}, fitted, f"base and tool {own}", []
    models = {"nominal": robot.reference, "calibrated": robot.model}
    fits = {name: FrameFit.of(model, visits) for name, model in models.items()}
    how, doubts = "base and tool as calibrated", list[str]()
    if registration or others is not None or visits.keys[0] not in robot.model.parts:
        fits = {name: fitted_station(model, on) for name, model in models.items()}
        said, unlikely = misfit(robot, fits["calibrated"])
        doubts += [said] * unlikely
        if others is None or fits["calibrated"].dof == 0:
            fitted = f"the station was {own}"
        how = f"tool as calibrated, station {own}; {said}"
    else:
        pair = fits["calibrated"], fitted_station(robot.model, visits)
        sizes = [np.linalg.norm(error_table(f.problem, f.theta)) for f in pair]
        doubts += [ELSEWHERE] * bool(sizes[0] > MOVED * sizes[1])
    how += " (nominal robot: as registered on the calibration's measurements)"
    return fits, fitted, how, doubts


def _named(
    visits: Observations,
    order: Indices,
    group: Indices,
    named: Names,
) -> tuple[Indices, Indices, list[str]]:
    """Number of the pose and cycle of each visit in their order, and what is missing.

    Raises:
        InputError: If a configuration has two names, or a name two configurations, or a
            pose has two visits in a cycle.
    """
    places = [(visits.files[k], int(visits.lines[k])) for k in order]
    given = (named.get(column, {}) for column in ("pose", "cycle"))
    pose, turn = (of if all(p in of for p in places) else {} for of in given)
    number = np.array([pose[p] for p in places]) if pose else group + 1
    cycle = np.array([turn[p] for p in places]) if turn else cycles_in_order(group)
    poses, cycles = {*number, *pose.values()}, {*cycle, *turn.values()}
    if max(poses) <= 2 * len(poses):
        poses |= {*range(1, max(poses))}
    seen: dict[tuple[object, ...], tuple[int, int]] = {}
    for row, g, p, c in zip(order.tolist(), group, number, cycle, strict=True):
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
        cycle = cycle + visits.files.codes[order] * int(cycle.max())
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
