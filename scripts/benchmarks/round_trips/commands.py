"""Commands, replayed on the true robot in the columns of its controller."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.round_trips.robots import Drive, Floats, Positions, pose, table
from benchmarks.round_trips.trip import (
    JUMP,
    PROMISED,
    STEPS,
    TARGETS,
    Said,
    Silent,
    Skipped,
    Told,
    Trip,
    rows_of,
    said,
    size,
)


@dataclass(frozen=True)
class Commands:
    """Commands in a table.

    Attributes:
        rows: Line of the target of each, counted from 0 behind the header.
        columns: Columns of the controller, each of shape (N,) [rad, m].
        time: Times [s]; empty where there are none.
    """

    rows: list[int]
    columns: Positions
    time: list[float]


def read_commands(trip: Trip, file: Path, headers: bool) -> Commands:
    """Commands in the columns of the controller.

    Args:
        trip: The calibrated robot.
        file: The table.
        headers: Whether headers must be those of the controller's files.

    Raises:
        Silent: If a column is missing, or none of the controller's.
    """
    robot, stated = trip.robot, rows_of(file)
    found, spare = dict[str, Floats](), {*stated[0]} - {"row", "time"}
    for one in robot.controller:
        header = next((h for h in spare if _names(h, one, headers)), None)
        if header is None:
            raise Silent(f"no column '{one.header}' among {[*stated[0]]}")
        spare.remove(header)
        unit = {"deg": np.pi / 180.0, "mm": 1e-3}.get(header[-4:].strip(" []"), 1.0)
        found[one.column] = unit * np.array([float(row[header]) for row in stated])
    followers = {j.name: j.kind for j in robot.nominal.chain if j.mimic}
    if robot.beside and headers:
        q = robot.positions(found)
        for name in followers.keys() & spare:
            off = np.array([float(row[name]) for row in stated]) - q[name]
            if followers[name] == "continuous":  # Reported within one turn.
                off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
            if np.abs(off).max() > 1e-6:
                raise Silent(f"column '{name}' does not follow its leader")
        spare -= followers.keys()
    if spare:
        raise Silent(f"columns that the controller does not have: {sorted(spare)}")
    rows = [int(row["row"]) - 2 for row in stated if row.get("row")]
    return Commands(
        rows, found, [float(row["time"]) for row in stated if "time" in row]
    )


def _names(header: str, one: Drive, headers: bool) -> bool:
    if headers:
        return header == one.header
    units = ("rad", "deg", "m", "mm")
    return header in (one.column, *(f"{one.column} [{unit}]" for unit in units))


def reached(trip: Trip, commands: Commands, targets: Floats, pose: bool) -> None:
    """Commands reach their targets on the true robot.

    Raises:
        Silent: If they do not.
        Told: If many are told as out of reach.
    """
    T = trip.robot.seen(commands.columns)
    wanted = targets[commands.rows]
    far = size(T[:, :3, 3] - wanted[:, :3, 3])
    if far > PROMISED * trip.promised:
        raise Silent(f"{1e3 * far:.3g} mm, promised {1e3 * trip.promised:.3g} mm")
    if pose:
        turn = np.swapaxes(T[:, :3, :3], 1, 2) @ wanted[:, :3, :3]
        angle = size(Rotation.from_matrix(turn).as_rotvec())
        if angle > PROMISED * trip.promised_turn:
            raise Silent(f"turned {1e3 * angle:.3g} mrad away from the target")


def lost(asked: int, commands: Commands, found: Said, few: int = 1) -> None:
    """Tell of targets that were not reached.

    Raises:
        Told: If there are some.
    """
    missing = asked - len(commands.rows)
    if missing > few:
        line = found.word("reach") or " ".join(found.out.split())[:200]
        raise Told(f"{missing} of {asked} targets are told as out of reach: {line}")


@dataclass(frozen=True)
class Asked:
    """Targets that the true robot can reach.

    Attributes:
        columns: Where it does.
        T: The targets, shape (N, 4, 4).
        pose: Whether orientations are asked for.
    """

    columns: Positions
    T: Floats
    pose: bool


def asked(trip: Trip) -> Asked:
    """Targets, with orientations where six drives or more can bring them."""
    robot = trip.robot
    columns = robot.random(TARGETS, trip.rng, 0.8)
    T = robot.seen(columns)
    return Asked(columns, T, robot.pose and len(robot.controller) >= 6)


def compensate(file: str, output: str, *more: str) -> Said:
    """Run the command; status 2 with nothing written is told.

    Raises:
        Internal: If it fails.
        Refused: If it refuses its input.
        Told: If it writes nothing.
    """
    words = ["out/calibration.json", file, "-o", output, "--force", *more]
    Path(output).unlink(missing_ok=True)
    found = said("compensate", *words)
    if not Path(output).exists():
        raise Told(" ".join(found.out.split())[:300])
    return found


def targets(trip: Trip) -> None:
    """A list of targets, without where to begin."""
    of = asked(trip)
    Path("t.csv").write_text(table(trip.robot.points(of.T, of.pose)))
    degrees = ["--degrees"] if trip.rng.random() < 0.5 else []
    found = compensate("t.csv", "c.csv", *degrees)
    commands = read_commands(trip, Path("c.csv"), headers=False)
    reached(trip, commands, of.T, of.pose)
    short_ways(trip, commands.columns)
    lost(TARGETS, commands, found)


def short_ways(trip: Trip, columns: Positions) -> None:
    """Joints that turn without end take the short way.

    Raises:
        Silent: If one does not.
    """
    q = trip.robot.drives(columns)
    for joint in trip.robot.nominal.drives:
        # A leader whose turn moves others elsewhere goes where it must.
        followers = (j for j in trip.robot.nominal.chain if j.mimic)
        leads = any(j.mimic and j.mimic[0] == joint.name for j in followers)
        way = np.abs(np.diff(q[joint.name])).max(initial=0.0)
        if joint.kind == "continuous" and not leads and way > np.pi + 0.01:
            raise Silent(f"'{joint.name}' turns by {np.degrees(way):.0f} deg at once")


def targets_from(trip: Trip) -> None:
    """Targets with the columns of the controller, as they were planned."""
    robot, of = trip.robot, asked(trip)
    cells = robot.cells(of.columns) | robot.points(of.T, of.pose)
    Path("t.csv").write_text(table(cells))
    found = compensate("t.csv", "c.csv")
    commands = read_commands(trip, Path("c.csv"), headers=True)
    reached(trip, commands, of.T, of.pose)
    shown = robot.wrapped(of.columns)
    near = {name: x[commands.rows] for name, x in shown.items()}
    for name, x in commands.columns.items():
        far = np.abs(x - near[name]).max(initial=0.0)
        if len(robot.controller) <= 6 and of.pose and far > 3.0:
            raise Silent(f"column '{name}' goes {far:.3g} rad or m from where it was")
    lost(TARGETS, commands, found)


def follows(trip: Trip, columns: Positions, before: Positions, found: Said) -> None:
    """The true tip goes where the nominal one would have gone.

    Base and tip may be displaced where they were estimated.

    Raises:
        Silent: If it does not.
    """
    robot = trip.robot
    T = robot.flange(columns)
    wanted = robot.nominal.poses(robot.positions(before))
    promised = found.promised(trip.promised)
    if robot.known:
        far = size(T[:, :3, 3] - wanted[:, :3, 3])
    else:

        def residual(x: Floats) -> Floats:
            ends = [pose(p[:3], Rotation.from_rotvec(p[3:])) for p in (x[:6], x[6:])]
            return ((ends[0] @ T @ ends[1])[:, :3, 3] - wanted[:, :3, 3]).ravel()

        best = least_squares(residual, np.zeros(12), x_scale=1e-2)
        far = size(best.fun.reshape(-1, 3))
        if np.abs(best.x).max() > 0.05:
            raise Silent(f"the tip is displaced by {np.abs(best.x).max():.3g}")
    # The tip is as far from the tool as the tool is seen.
    if far > PROMISED * promised:
        raise Silent(f"{1e3 * far:.3g} mm off, promised {1e3 * promised:.3g} mm")


def smooth(trip: Trip, columns: Positions, before: Positions) -> None:
    """Corrections do not jump, but for whole turns of what begins again.

    Raises:
        Silent: If they do.
    """
    for one in trip.robot.controller:
        change = columns[one.column] - before[one.column]
        if one.least is not None:
            change = np.unwrap(change)
        jump = np.abs(np.diff(change)).max()
        if jump > JUMP:
            raise Silent(f"column '{one.column}' jumps by {jump:.3g}")


def motion(trip: Trip) -> None:
    """A motion in the columns of the controller."""
    robot = trip.robot
    way = robot.motion(STEPS, trip.rng)
    Path("way.csv").write_text(table(robot.cells(way)))
    found = compensate("way.csv", "c.csv")
    commands = read_commands(trip, Path("c.csv"), headers=True)
    follows(trip, commands.columns, way, found)
    smooth(trip, commands.columns, robot.wrapped(way))


def least_times(trip: Trip, columns: Positions, part: float) -> tuple[Floats, Floats]:
    """Times of steps at a part of the speeds: of drives, and of all joints."""
    robot = trip.robot
    q = robot.positions(columns)
    times = {}
    for joint in {j.name: j for j in [*robot.nominal.chain, *robot.nominal.drives]}:
        speed = robot.nominal.named[joint].speed
        assert speed, "which `compensate` refuses"
        times[joint] = np.abs(np.diff(q[joint])) / (part * speed)
    drives = [times[joint.name] for joint in robot.nominal.drives]
    return np.max(drives, axis=0), np.max([*times.values()], axis=0)


def paced(trip: Trip, columns: Positions, time: Floats, part: float) -> None:
    """Times are those of the steps.

    Raises:
        Silent: If they are not.
    """
    least, most = least_times(trip, columns, part)
    steps = np.diff(time)
    slow, fast = steps > most * 1.001 + 1e-6, steps < least * 0.999 - 1e-6
    for off, what in ((slow, "slower"), (fast, "faster")):
        if off.any():
            k = int(np.argmax(off))
            raise Silent(
                f"step {k} in {steps[k]:.3g} s, {what} than the speeds of the URDF "
                f"({least[k]:.3g} to {most[k]:.3g} s)"
            )


def unwound(trip: Trip, columns: Positions) -> Positions:
    """Columns of a motion, those that begin again as they go on."""
    ends = [one.column for one in trip.robot.controller if one.least is not None]
    return columns | {name: np.unwrap(columns[name]) for name in ends}


def motion_speed(trip: Trip) -> None:
    """A motion with times that follow from its steps."""
    robot = trip.robot
    way = robot.motion(STEPS, trip.rng)
    Path("way.csv").write_text(table(robot.cells(way)))
    found = compensate("way.csv", "c.csv", "--speed", "0.3")
    commands = read_commands(trip, Path("c.csv"), headers=True)
    if len(commands.time) != STEPS:
        raise Silent("has no times")
    follows(trip, commands.columns, way, found)
    smooth(trip, commands.columns, robot.wrapped(way))
    paced(trip, unwound(trip, commands.columns), np.array(commands.time), 0.3)


def targets_base(trip: Trip) -> None:
    """Targets of the tip link in the base link.

    Raises:
        Skipped: If base and tool are not known.
    """
    if not trip.robot.known:
        raise Skipped
    of = asked(trip)
    T = trip.robot.flange(of.columns)
    Path("t.csv").write_text(table(trip.robot.points(T, of.pose)))
    found = compensate("t.csv", "c.csv", "--frame", "base", "--point", "tip")
    commands = read_commands(trip, Path("c.csv"), headers=False)
    moved = trip.robot.base @ T @ trip.robot.tool
    if of.pose:
        reached(trip, commands, moved, pose=True)
    else:
        far = trip.robot.flange(commands.columns) - T[commands.rows]
        if size(far[:, :3, 3]) > PROMISED * found.promised(trip.promised):
            raise Silent(f"{1e3 * size(far[:, :3, 3]):.3g} mm off")
    lost(TARGETS, commands, found)


def targets_speed(trip: Trip) -> None:
    """Targets with times that follow from the ways between them."""
    of = asked(trip)
    Path("t.csv").write_text(table(trip.robot.points(of.T, of.pose)))
    found = compensate("t.csv", "c.csv", "--speed", "0.3")
    commands = read_commands(trip, Path("c.csv"), headers=False)
    reached(trip, commands, of.T, of.pose)
    short_ways(trip, commands.columns)
    paced(trip, commands.columns, np.array(commands.time), 0.3)
    lost(TARGETS, commands, found)


def read_trajectory(trip: Trip, file: Path) -> tuple[Positions, Floats]:
    """Columns and times of a message of ROS.

    Raises:
        Silent: If it is not of the joints with a drive.
    """
    robot, message = trip.robot, yaml.safe_load(file.read_text())
    names, drives = message["joint_names"], [j.name for j in robot.nominal.drives]
    if set(names) != set(drives):
        raise Silent(f"a trajectory of {names}, drives are {drives}")
    points = message["points"]
    q = dict(zip(names, np.array([p["positions"] for p in points]).T, strict=True))
    stamps = (point["time_from_start"] for point in points)
    time = np.array([s["sec"] + 1e-9 * s["nanosec"] for s in stamps])
    return robot.columns(q), time


def motion_message(trip: Trip) -> None:
    """A motion as a message: joints go on where columns begin again."""
    robot = trip.robot
    way = robot.motion(STEPS, trip.rng)
    Path("way.csv").write_text(table(robot.cells(way)))
    words = "--format", "joint-trajectory", "--speed", "0.3"
    found = compensate("way.csv", "c.yaml", *words)
    columns, time = read_trajectory(trip, Path("c.yaml"))
    follows(trip, columns, way, found)
    smooth(trip, columns, way)
    short_steps(trip, columns, way)
    paced(trip, columns, time, 0.3)


def short_steps(trip: Trip, columns: Positions, way: Positions) -> None:
    """No joint moves much more than the motion does.

    Raises:
        Silent: If one does.
    """
    for name, x in columns.items():
        far = np.abs(np.diff(x) - np.diff(way[name])).max()
        if far > JUMP:
            raise Silent(f"column '{name}' moves by {far:.3g} more than the motion")


def targets_message(trip: Trip) -> None:
    """Targets as a message."""
    robot, of = trip.robot, asked(trip)
    cells = robot.cells(of.columns) | robot.points(of.T, of.pose)
    Path("t.csv").write_text(table(cells))
    found = compensate("t.csv", "c.yaml", "--format", "joint-trajectory")
    columns, time = read_trajectory(trip, Path("c.yaml"))
    rows = [*range(TARGETS)]
    if len(time) != TARGETS:
        lost(TARGETS, Commands([*range(len(time))], columns, []), found, 0)
    reached(trip, Commands(rows, columns, []), of.T, of.pose)
    short_ways(trip, columns)
    paced(trip, columns, time, 0.25)
