"""Joint commands that make up for the errors of a calibrated robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.control.calibrated import Frame, Point, has_sides, kinematics
from calib_pin.control.joints import Joints, Solutions
from calib_pin.control.reaching import Task, reach, search
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Signs, approached
from calib_pin.progress import Progress
from calib_pin.setup.arguments import Brief, as_array
from calib_pin.validation.calibrated_model import CalibratedChain

JUMP = 0.1
"""Change of the corrections between neighboring configurations that no smooth
motion has [rad, m]."""

ROUNDS = 10
"""Most rounds until commands come from the sides they reckon with; it takes two."""

BLOCK = 2000
"""Targets between two reports of the progress."""


@dataclass(frozen=True, repr=False)
class Compensation(Brief, Solutions):
    """Commands of a calibrated robot with n joints for N targets.

    Attributes:
        nominal: Commands of the nominal robot; not a number where it cannot reach a
            target, shape (N, n).
        position_before: Distance from the target at the nominal command, (N,) [m].
        orientation_before: Angle at the nominal command, (N,) [rad].
        at_limit: Whether a joint stands at its limit, shape (N,).
        outside: Whether the command is outside the region in which the learned
            correction was trained, shape (N,); False where nothing was learned.
        sides: Sign of the last motion of each joint that the command reckons with,
            shape (N, n); 0 where it is not known, or makes no difference.
        oriented: Whether orientations count.
    """

    nominal: Floats
    position_before: Floats
    orientation_before: Floats
    at_limit: NDArray[np.bool_]
    outside: NDArray[np.bool_]
    sides: Signs
    oriented: bool

    @property
    def corrections(self) -> Floats:
        """Differences from the nominal commands, of rows that both reach, (K, n)."""
        dq = (self.q - self.nominal)[self.reached]
        return np.asarray(dq[np.isfinite(dq).all(axis=1)])

    @property
    def complete(self) -> bool:
        """Whether all targets are reached."""
        return bool(self.reached.all())

    @property
    def jumps(self) -> NDArray[np.bool_]:
        """Whether the corrections change too much from the row before, shape (N,).

        A robot that follows such commands would leave the way between the rows.
        """
        change = np.abs(np.diff(self.q - self.nominal, axis=0)).max(axis=1, initial=0.0)
        return np.concatenate([[False], change > JUMP])[: len(self)]


@serial_blas
def compensate(
    model: CalibratedChain,
    targets: Floats,
    start: Floats | None = None,
    *,
    frame: Frame = "measuring",
    point: Point = "tool",
    orientation: bool = True,
    before: Floats | None = None,
    progress: Progress | None = None,
) -> Compensation:
    """Commands that bring the real robot to targets.

    Without a start, revolute joints take the turns that make the way from target to
    target the shortest. Lost motion is made up for as commands follow one another: each
    joint comes to a command from the side of its last motion, and until its first one
    it is taken to stand in the middle.

    Args:
        model: The calibrated chain.
        targets: Poses to reach, shape (N, 4, 4).
        start: Joint positions that commands shall be close to, shape (N, n) [rad, m].
        frame: Frame of the targets, see `kinematics`.
        point: The point that shall reach them.
        orientation: Whether orientations count; else only positions do.
        before: Where the robot stands before the first command, shape (n,) [rad, m].
        progress: Told the part that is done, 0 to 1.

    Examples:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space6", "measurements.csv"), chain
        ... )
        >>> model = calib_pin.calibrate(chain, rows, setup).model.of()
        >>> commands = compensate(model, model.poses(rows.q), rows.q)
        >>> bool(commands.position.max() < 1e-9)
        True
    """
    real = kinematics(model, frame=frame, point=point)
    joints, count = Joints.of(model.chain), len(model.chain.joints)
    targets = as_array("targets", targets, "N", 4, 4)
    start = start if start is None else as_array("start", start, len(targets), count)
    before = before if before is None else as_array("before", before, count)
    task = Task.of(real, targets, joints, start, orientation)
    solutions = _in_parts(search, task, progress)
    if start is None:
        reached = np.flatnonzero(solutions.reached)
        driven = joints.driven(solutions.q[reached])
        unwound = joints.unwound(driven)
        turned = (unwound != driven).any(axis=1)
        rows = reached[turned]
        # Corrections need not be periodic: another turn is another descent.
        others = reach(replace(task.rows(rows), start=unwound[turned]))
        better = others.reached
        solutions = solutions.replaced(rows[better], others.rows(better))
    imagined = kinematics(model, frame=frame, point=point, nominal=True)
    nominal = reach(Task.of(imagined, targets, joints, solutions.q, orientation))
    plain = np.where(nominal.reached[:, None], nominal.q, np.nan)
    commands = _compensation(model, task, solutions, plain)
    return _from_sides(model, targets, commands, before, frame, point)


@serial_blas
def follow(
    model: CalibratedChain,
    q: Floats,
    *,
    orientation: bool = True,
    before: Floats | None = None,
    progress: Progress | None = None,
) -> Compensation:
    """Commands at which the real tip is where the nominal robot's would be.

    Every command is close to the configuration it replaces; there is no search, so a
    motion is not torn.

    Args:
        model: The calibrated chain.
        q: Commands meant for the nominal robot, shape (N, n) [rad, m].
        orientation: Whether orientations count; else only positions do.
        before: As for `compensate`.
        progress: Told the part that is done, 0 to 1.
    """
    targets = model.chain.poses(q)
    real = kinematics(model, frame="base", point="tip")
    task = Task.of(real, targets, Joints.of(model.chain), q, orientation)
    commands = _compensation(model, task, _in_parts(reach, task, progress), q)
    return _from_sides(model, targets, commands, before, "base", "tip")


def _from_sides(
    model: CalibratedChain,
    targets: Floats,
    commands: Compensation,
    before: Floats | None,
    frame: Frame,
    point: Point,
) -> Compensation:
    """Commands that make up for lost motion, as they follow one another.

    Those of joints that turn back move by all of it, and those of others by nothing, so
    that no correction makes a joint turn back: where a second round finds other sides,
    these are of joints that hardly move at all.
    """
    if not has_sides(model):
        return commands
    joints, (reached,) = Joints.of(model.chain), np.nonzero(commands.reached)
    for _ in range(ROUNDS):
        q = commands.q[reached]
        ahead = q[:1] if before is None else before[None]
        sides = approached(np.concatenate([ahead, q]))[1:]
        changed = (sides != commands.sides[reached]).any(axis=1)
        if not changed.any():
            break
        ways, which = np.unique(sides[changed], axis=0, return_inverse=True)
        for k, side in enumerate(ways):
            rows = reached[changed][which.reshape(-1) == k]
            part, T = commands.rows(rows), targets[rows]
            real = kinematics(model, frame=frame, point=point, side=side)
            task = Task.of(real, T, joints, part.q, part.oriented)
            moved = _compensation(model, task, reach(task), part.nominal)
            moved = replace(moved, sides=np.tile(side, (len(rows), 1)))
            commands = commands.replaced(rows, moved)
    return commands


def _in_parts(
    solve: Callable[[Task], Solutions], task: Task, progress: Progress | None
) -> Solutions:
    """All rows, some at a time; nobody can tell how far a single descent is."""
    parts, count = [], max(len(task.targets), 1)
    for start in range(0, count, BLOCK):
        if progress is not None:
            progress(start / count)
        parts.append(solve(task.rows(slice(start, start + BLOCK))))
    return Solutions.joined(parts)


def _compensation(
    model: CalibratedChain, task: Task, solutions: Solutions, nominal: Floats
) -> Compensation:
    joints, before = task.joints, np.full((2, len(nominal)), np.nan)
    (known,) = np.nonzero(np.isfinite(nominal).all(axis=1))
    if len(known):
        e, _ = task.rows(known).errors(joints.driven(nominal[known]))
        for sizes, part in zip(before, np.split(e, [3], axis=1), strict=True):
            sizes[known] = np.linalg.norm(part, axis=1)
    return Compensation(
        **vars(solutions),
        nominal=nominal,
        position_before=before[0],
        orientation_before=before[1],
        at_limit=np.asarray(joints.at_limit(joints.driven(solutions.q)).any(axis=1)),
        outside=model.outside(solutions.q),
        sides=np.zeros(solutions.q.shape, np.int8),
        oriented=task.orientation,
    )
