"""The report of an acceptance test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite, nan

from calib_pin.report.blocks import Block, Cell, Line, Tone, table
from calib_pin.report.tables import UNIT, amount, quantity, unit_of
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import (
    Acceptance,
    Interval,
    judged,
    measured,
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
