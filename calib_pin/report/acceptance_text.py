"""The report of an acceptance test, and its schedule."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import chain
from math import isfinite, nan

import numpy as np
import pinocchio as pin

import calib_pin.validation.acceptance as tested
from calib_pin.control.acceptance_poses import ORDER, AcceptancePoses
from calib_pin.kinematics.spatial import Floats
from calib_pin.report.blocks import Block, Line, Table, Tone, note, table
from calib_pin.report.tables import UNIT, amount, quantity, unit_of
from calib_pin.setup import LimitSetup

TONES: Mapping[str, Tone] = {"pass": "good", "fail": "bad", "undecided": "strong"}

REMEDY = "Base and tool must be of a calibration, of the setup, or of other poses."
"""Advice where they were fitted to the visits."""

SHOWN = 12
"""Pairs of poses whose distance is shown: those that err most."""


def acceptance_report(
    tests: Mapping[str, tested.Acceptance],
    limit: LimitSetup,
    about: str,
) -> Iterator[Block]:
    """The test of a robot, or of it as it was and is.

    Args:
        tests: The test by the robot that the commanded poses are of.
        limit: What must be reached.
        about: The robot, the poses and the frame, in a sentence.
    """
    *_, last = tests.values()
    yield from limit_lines(last, limit)
    yield from doubt_lines(last)
    yield Line(about)
    for name, test in tests.items():
        title = f"Poses, {name}" if len(tests) > 1 else "Poses"
        visited = [
            (f"P{p.pose}", str(p.visits), p.accuracy, p.repeatability, p.directions)
            for p in test.poses
        ]
        titles = ("pose", "visits", "AP", "95 %", "RP", "95 %", "vAP")
        yield _table(title, titles, visited)
    yield note(
        "AP: distance of the mean of the visits from the commanded position; RP: mean "
        "distance from that mean and three standard deviations; vAP: distance between "
        "means of approaches from different poses. The 95 % intervals hold for many "
        "visits."
    )
    if last.poses[0].angles:
        turned = [
            (f"P{p.pose}", *cells)
            for p in last.poses
            for cells in zip("xyz", p.angles, p.angle_repeatability, strict=True)
        ]
        angles = ("pose", "about", "mean", "95 %", "3 sigma", "95 %")
        yield _table("Orientations", angles, turned, "rad")
    if last.distances:
        pairs = sorted(last.distances, key=lambda d: -abs(d.accuracy.value))
        apart = [
            ("P{}-P{}".format(*p.poses), p.commanded, p.accuracy, p.repeatability)
            for p in pairs[:SHOWN]
        ]
        lengths = ("poses|word", "distance", "AD", "95 %", "RD", "95 %")
        yield _table("Distances between poses", lengths, apart)
    if last.drift is not None and not last.untestable:
        accuracy, spread = (amount(size, "m") for size in last.drift)
        yield Line(
            "From the first to the last third of the visits AP changes by at most "
            f"{accuracy}, RP by {spread}."
        )


def _table(
    title: str, titles: Sequence[str], rows: Iterable[Sequence[object]], unit: str = "m"
) -> Table:
    """A table of words, numbers and intervals of one unit."""

    def cells(item: object) -> Sequence[object]:
        if isinstance(item, tested.Interval):
            return [quantity(item.value, unit), ends(item, unit)]
        if item is None or isinstance(item, float):
            return [quantity(nan if item is None else item, unit)]
        return [item]

    shown = unit_of(unit)[0]
    lines = [[*chain.from_iterable(map(cells, row)), shown] for row in rows]
    return table(title, (*titles, UNIT), lines, grouped=1)


def limit_lines(test: tested.Acceptance, limit: LimitSetup) -> Iterator[Line]:
    """Whether each limit is met, by how much, in a sentence each."""
    for name, status, interval, allowed, unit in tested.judged(test, limit):
        tone = TONES[status]
        text = f"{amount(interval.value, unit)} ({ends(interval, unit)})"
        if not isfinite(interval.high):
            least = f", at least {amount(interval.low, unit)}" * (interval.low > 0.0)
            text = f"is not testable{least}"
        limited = f"the limit is {amount(allowed, unit)}"
        yield Line(f"{status.upper()}: {name} {text}, {limited}.", tone)


def doubt_lines(test: tested.Acceptance) -> Iterator[Line]:
    """Why AP is not testable, and why nothing passes, in a sentence each."""
    if test.untestable:
        yield Line(f"AP is not testable: {test.untestable}. {REMEDY}", "bad")
    for doubt in test.doubts:
        yield Line(f"No PASS: {doubt.rstrip('.')}.", "bad")


def ends(interval: tested.Interval, unit: str) -> str:
    """Both ends of an interval, in the unit in which people read it."""
    low, high = (quantity(end, unit).text for end in (interval.low, interval.high))
    if not isfinite(interval.high):
        return f"from {low}" if interval.low > 0.0 else "-"
    return f"{low} ... {high}"


PAUSE = 5.0
"""Time to settle and to be measured at a pose [s]."""


def acceptance_schedule(
    poses: AcceptancePoses, robot: str, cycles: int, speeds: Floats | None, command: str
) -> str:
    """The poses and what to do on the day, in lines of ASCII.

    Args:
        poses: The poses.
        robot: Name of the robot.
        cycles: Number of cycles.
        speeds: Largest speeds of the joints, shape (n,) [rad/s, m/s]; None if the URDF
            does not state them.
        command: The command line to type when it is done.
    """
    places = np.round(1e3 * poses.T[:, :3, 3], 1) + 0.0  # No negative zeros.
    oriented = "A robot of fewer than six joints: positions only, orientations follow."
    if poses.oriented:
        turns = np.degrees(pin.rpy.matrixToRpy(poses.T[0, :3, :3]))
        roll, pitch, yaw = np.round(turns, 1) + 0.0
        oriented = "The tool has one orientation at all of them:\n"
        oriented += f"  roll {roll:.1f}, pitch {pitch:.1f}, yaw {yaw:.1f} deg"
    waits = PAUSE * len(ORDER) * cycles
    moves, tail = 0.0, ", and the moves."
    if speeds is not None:
        q = poses.q[[pose - 1 for pose in ORDER]]
        durations = np.abs(np.diff(np.concatenate([q[-1:], q]), axis=0)) / speeds
        moves = cycles * float(durations.max(axis=1).sum())
        tail = f";\n  the moves take {moves / 60.0:.1f} min of it at full joint speeds."
    # How well so many visits tell RP, with the same scatter along all axes, exactly.
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((max(cycles, 4), 3))
    u, _, v = np.linalg.svd(noise - noise.mean(axis=0), full_matrices=False)
    interval = tested.repeatability(np.asarray(u @ v), rng)
    text = (files("calib_pin.report") / "page" / "schedule.txt").read_text("utf-8")
    return text.format(
        robot=robot,
        center=1e3 * poses.center,
        edge=1e3 * poses.edge,
        poses="\n".join(
            f"  P{k}  x {x:8.1f}  y {y:8.1f}  z {z:8.1f} mm"
            for k, (x, y, z) in enumerate(places, 1)
        ),
        oriented=oriented,
        cycles=cycles,
        order=", ".join(f"P{pose}" for pose in ORDER),
        minutes=(waits + moves) / 60.0,
        pause=PAUSE,
        moves=tail,
        low=100.0 * (interval.low / interval.value - 1.0),
        high=100.0 * (interval.high / interval.value - 1.0),
        half=tested.student(cycles - 1) / cycles**0.5,
        command=command,
    )
