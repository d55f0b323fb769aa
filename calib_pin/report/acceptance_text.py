"""The report of an acceptance test, and its schedule."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, nan

import numpy as np
import pinocchio as pin

from calib_pin.control.acceptance_poses import ORDER, AcceptancePoses
from calib_pin.kinematics.spatial import Floats
from calib_pin.report.blocks import Block, Cell, Line, Tone, table
from calib_pin.report.tables import UNIT, amount, quantity, unit_of
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import (
    Acceptance,
    Interval,
    judged,
    measured,
    repeatability,
    student,
    worst,
)

TONES: Mapping[str, Tone] = {"pass": "good", "fail": "bad", "undecided": "strong"}

PATH = {"AP": "AT", "RP": "RT"}
"""Names of the worst pose's values along a path."""

REMEDY = "Base and tool must be of a calibration, of the setup, or of other poses."
"""Advice where they were fitted to the visits."""

SHOWN = 12
"""Pairs of poses whose distance is shown: those that err most."""

MM = unit_of("m")[0]


def acceptance_report(
    found: Mapping[str, Acceptance],
    limit: LimitSetup,
    about: str,
    *,
    path: bool = False,
) -> Iterator[Block]:
    """The test of a robot, or of it as it was and is.

    Args:
        found: The test by the robot that the commanded poses are of.
        limit: What must be reached.
        about: The robot, the poses and the frame, in a sentence.
        path: Whether the poses are points of a path: AT and RT are their worst.
    """
    *_, (_, last) = found.items()
    yield from limit_lines(last, limit, path=path)
    yield from doubt_lines(last)
    yield Line(about)
    if path:
        rows = [
            (
                name,
                str(len(test.poses)),
                *cells_of(worst(measured(test)["AP"][0]), "m"),
                *cells_of(worst(measured(test)["RP"][0]), "m"),
                MM,
            )
            for name, test in found.items()
        ]
        titles = ("", "points", "AT", "95 %", "RT", "95 %", UNIT)
        yield table("Path", titles, rows)
        yield Line(
            "AT and RT: AP and RP of the worst point; the 95 % intervals are those of "
            "this point alone.",
            "note",
        )
        return
    for name, test in found.items():
        yield table(
            f"Poses, {name}" if len(found) > 1 else "Poses",
            ("pose", "visits", "AP", "95 %", "RP", "95 %", "vAP", UNIT),
            [
                (
                    f"P{pose.pose}",
                    str(pose.visits),
                    *cells_of(pose.accuracy, "m"),
                    *cells_of(pose.repeatability, "m"),
                    quantity(nan if pose.directions is None else pose.directions, "m"),
                    MM,
                )
                for pose in test.poses
            ],
        )
    yield Line(
        "AP: distance of the mean of the visits from the commanded position; RP: mean "
        "distance from that mean and three standard deviations; vAP: distance between "
        "means of approaches from different poses. The 95 % intervals hold for many "
        "visits.",
        "note",
    )
    yield from _further(last)


def _further(test: Acceptance) -> Iterator[Block]:
    """Orientations, distances and drift, as far as they were tested."""
    if test.poses[0].angles:
        rows = [
            (
                f"P{pose.pose}" if axis == "x" else "",
                axis,
                *cells_of(mean, "rad"),
                *cells_of(sigma, "rad"),
                unit_of("rad")[0],
            )
            for pose in test.poses
            for axis, mean, sigma in zip(
                "xyz", pose.angles, pose.angle_repeatability, strict=True
            )
        ]
        titles = ("pose", "about", "mean", "95 %", "3 sigma", "95 %", UNIT)
        yield table("Orientations", titles, rows)
    if test.distances:
        pairs = sorted(test.distances, key=lambda d: -abs(d.accuracy.value))
        pairs_told = [
            (
                "-".join(f"P{pose}" for pose in pair.poses),
                quantity(pair.commanded, "m"),
                *cells_of(pair.accuracy, "m"),
                *cells_of(pair.repeatability, "m"),
                MM,
            )
            for pair in pairs[:SHOWN]
        ]
        titles = ("poses|word", "distance", "AD", "95 %", "RD", "95 %", UNIT)
        yield table("Distances between poses", titles, pairs_told)
    if test.drift is not None and not test.untestable:
        accuracy, repeatability = (amount(size, "m") for size in test.drift)
        yield Line(
            "From the first to the last third of the visits AP changes by at most "
            f"{accuracy}, RP by {repeatability}."
        )


def limit_lines(
    test: Acceptance, limit: LimitSetup, *, path: bool = False
) -> Iterator[Line]:
    """Whether each limit is met, by how much, in a sentence each."""
    for name, status, interval, allowed, unit in judged(test, limit):
        tone, name = TONES[status], PATH.get(name, name) if path else name
        said = f"{amount(interval.value, unit)} ({ends(interval, unit)})"
        if not isfinite(interval.high):
            least = f", at least {amount(interval.low, unit)}" * (interval.low > 0.0)
            said = f"is not testable{least}"
        limited = f"the limit is {amount(allowed, unit)}"
        yield Line(f"{status.upper()}: {name} {said}, {limited}.", tone)


def doubt_lines(test: Acceptance) -> Iterator[Line]:
    """Why AP is not testable, and why nothing passes, in a sentence each."""
    if test.untestable:
        yield Line(f"AP is not testable: {test.untestable}. {REMEDY}", "bad")
    for doubt in test.doubts:
        yield Line(f"No PASS: {doubt.rstrip('.')}.", "bad")


def cells_of(interval: Interval, unit: str) -> tuple[Cell, str]:
    """A value, a dash where there is none, and its interval."""
    return quantity(interval.value, unit), ends(interval, unit)


def ends(interval: Interval, unit: str) -> str:
    """Both ends of an interval, in the unit in which people read it."""
    low, high = (quantity(end, unit).text for end in (interval.low, interval.high))
    if not isfinite(interval.high):
        return f"from {low}" if interval.low > 0.0 else "-"
    return f"{low} ... {high}"


PAUSE = 5.0
"""Time to settle and to be measured at a pose [s]."""


def acceptance_schedule(
    found: AcceptancePoses,
    robot: str,
    cycles: int,
    speeds: Floats | None,
    commands: Sequence[str],
) -> Iterator[str]:
    """The poses and what to do on the day, in lines of ASCII.

    Args:
        found: The poses.
        robot: Name of the robot.
        cycles: Number of cycles.
        speeds: Largest speeds of the joints, shape (n,) [rad/s, m/s]; None if the URDF
            does not state them.
        commands: The command lines to type when it is done.
    """
    order = ", ".join(f"P{pose}" for pose in ORDER)
    yield f"Acceptance test of {robot} in the terms of ISO 9283"
    yield ""
    x, y, z = 1e3 * found.center
    yield f"Cube of {1e3 * found.edge:.0f} mm, edges along the base frame, center"
    yield f"({x:.0f}, {y:.0f}, {z:.0f}) mm in the base link. Poses in a diagonal plane:"
    for k, T in enumerate(found.T, 1):
        x, y, z = np.round(1e3 * T[:3, 3], 1) + 0.0  # No negative zeros.
        yield f"  P{k}  x {x:8.1f}  y {y:8.1f}  z {z:8.1f} mm"
    if found.oriented:
        turns = np.degrees(pin.rpy.matrixToRpy(found.T[0, :3, :3]))
        roll, pitch, yaw = np.round(turns, 1) + 0.0
        yield "The tool has one orientation at all of them:"
        yield f"  roll {roll:.1f}, pitch {pitch:.1f}, yaw {yaw:.1f} deg"
    else:
        yield "A robot of fewer than six joints: positions only, orientations follow."
    yield f"Order: from P1 (not measured), then {cycles} cycles of {order}."
    yield ""
    yield "On the day"
    yield "  Robot assembled and adjusted as in use; robot and instrument in the room"
    yield "  long enough to have its temperature, 20 +- 2 degC; note another one."
    yield "  Load: 100 % of the rated load on the flange, its center of mass as the"
    yield "  maker states; with 10 % as a second test."
    yield "  Speed: 100 % of the rated speed; with 50 % and 10 % as further tests."
    yield "  Every load and every speed is a file of its own."
    yield "  Warm-up: run the cycle without measuring until readings drift no more."
    yield "  Instrument: its uncertainty is at most 25 % of the value to be proven."
    yield "  For AP, base and tool come from a calibration or from other poses."
    yield "  Approach every pose only from the one before it, as the file has them."
    yield "  Measure after the robot has settled: try the time out once, then keep it."
    yield from _duration(found, cycles, speeds)
    yield ""
    yield "Power of the test"
    yield from _power(cycles)
    yield ""
    yield "Fill in x, y, z (columns of orientations may be added), then type"
    yield from (f"  {line}" for line in commands)
    yield "A certified test needs the standard itself."


def _duration(
    found: AcceptancePoses, cycles: int, speeds: Floats | None
) -> Iterator[str]:
    waits = PAUSE * len(ORDER) * cycles
    pause = f"{PAUSE:.0f} s to settle and measure at each pose"
    if speeds is None:
        yield f"  Time: {waits / 60.0:.0f} min with {pause}, and the moves."
        return
    q = found.q[[pose - 1 for pose in ORDER]]
    way = np.abs(np.diff(np.concatenate([q[-1:], q]), axis=0)) / speeds
    moves = cycles * float(way.max(axis=1).sum())
    yield f"  Time: {(waits + moves) / 60.0:.0f} min with {pause};"
    yield f"  the moves take {moves / 60.0:.1f} min of it at full joint speeds."


def _power(cycles: int) -> Iterator[str]:
    """How well so many cycles tell AP and RP."""
    half = student(cycles - 1) / cycles**0.5
    rng = np.random.default_rng(0)
    # The same scatter along all axes, exactly.
    noise = rng.standard_normal((max(cycles, 4), 3))
    noise -= noise.mean(axis=0)
    u, _, v = np.linalg.svd(noise, full_matrices=False)
    told = repeatability(np.asarray(u @ v), rng)
    low, high = (100.0 * (end / told.value - 1.0) for end in (told.low, told.high))
    yield f"  {cycles} cycles tell RP to {low:+.0f} % and {high:+.0f} % (95 % interval)"
    yield f"  and each component of AP to +- {half:.2f} standard deviations of a visit."
    yield "  A limit that is nearer to the value than that stays undecided."
