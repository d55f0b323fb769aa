"""The report of an acceptance test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite, isinf

from calib_pin.report.blocks import Block, Cell, Column, Line, Table, Tone, columns
from calib_pin.report.tables import amount, quantity
from calib_pin.setup import LimitSetup
from calib_pin.units import DISPLAY
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

SHOWN = 12
"""Pairs of poses whose distance is shown: those that err most."""


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
        yield Table("Path", ROBOTS, [*_paths(found)])
        yield Line(
            "AT and RT: AP and RP of the worst point; the 95 % intervals are those of "
            "this point alone.",
            "note",
        )
        return
    for name, test in found.items():
        title = f"Poses, {name}" if len(found) > 1 else "Poses"
        yield Table(title, POSES, [*_poses(test)])
    yield Line(
        "AP: distance of the mean of the visits from the commanded position; RP: mean "
        "distance from that mean and three standard deviations; vAP: distance between "
        "means of approaches from different poses. The 95 % intervals hold for many "
        "visits.",
        "note",
    )
    if last.poses[0].angle_repeatability:
        yield Table("Orientations", ANGLES, [*_angles(last)])
    if last.distances:
        yield Table("Distances between poses", DISTANCES, [*_distances(last)])
    if last.drift is not None:
        sizes = zip(("AP", "RP"), last.drift, strict=True)
        changes = [
            f"{n} by {amount(size, 'm')}" for n, size in sizes if size is not None
        ]
        yield Line(
            "Largest changes from the first to the last third of the visits: "
            f"{', '.join(changes)}."
        )


def limit_lines(
    test: Acceptance, limit: LimitSetup, *, path: bool = False
) -> Iterator[Line]:
    """Whether each limit is met, by how much, in a sentence each."""
    for name, status, interval, allowed, unit in judged(test, limit):
        tone, name = TONES[status], PATH.get(name, name) if path else name
        shown = f"{amount(interval.value, unit)} ({ends(interval, unit)})"
        if not isfinite(interval.high):
            shown = f"is {ends(interval, unit)}"
        said = (
            f"{status.upper()}: {name} {shown}, the limit is {amount(allowed, unit)}."
        )
        yield Line(said, tone)


def doubt_lines(test: Acceptance) -> Iterator[Line]:
    """Why AP is not testable, and why nothing passes, in a sentence each."""
    if (bound := test.bound) is not None:
        said = f"AP is not testable: {bound.fitted} was fitted to these visits"
        if " and " in bound.fitted:
            said = said.replace(" was ", " were ")
        said += f", {bound.unknowns} unknowns of {bound.values} values"
        if bound.accuracy is None:
            yield Line(
                f"{said}: from {bound.least} poses on AP has a lower bound.", "bad"
            )
        else:
            low, rms = amount(bound.accuracy.low, "m"), amount(bound.rms, "m")
            yield Line(
                f"{said}. AP of the worst pose is at least {low}; by the degrees of "
                f"freedom that remain, errors are {rms} rms. Test with a calibration, "
                "'frames' in the setup, or --registration.",
                "bad",
            )
    for doubt in test.doubts:
        yield Line(f"No PASS: {doubt.rstrip('.')}.", "bad")


POSES = columns("pose", ("visits", "AP", "95 %", "RP", "95 %", "vAP", "unit"))
ROBOTS = columns("", ("points", "AT", "95 %", "RT", "95 %", "unit"))
ANGLES = columns("pose", ("about", "mean", "95 %", "3 sigma", "95 %", "unit"))
DISTANCES = (
    Column("poses", "word"),
    *columns("poses", ("distance", "AD", "95 %", "RD", "95 %", "unit"))[1:],
)


def _poses(test: Acceptance) -> Iterator[tuple[Cell, ...]]:
    for pose in test.poses:
        varies = pose.directions
        yield (
            Cell(f"P{pose.pose}"),
            Cell(str(pose.visits)),
            *_cells(pose.accuracy, "m"),
            *_cells(pose.repeatability, "m"),
            Cell("-") if varies is None else quantity(varies, "m"),
            Cell(DISPLAY["m"][0]),
        )


def _paths(found: Mapping[str, Acceptance]) -> Iterator[tuple[Cell, ...]]:
    for name, test in found.items():
        yield (
            Cell(name),
            Cell(str(len(test.poses))),
            *_cells(worst(measured(test)["AP"][0]), "m"),
            *_cells(worst(measured(test)["RP"][0]), "m"),
            Cell(DISPLAY["m"][0]),
        )


def _angles(test: Acceptance) -> Iterator[tuple[Cell, ...]]:
    for pose in test.poses:
        means = pose.angles or [None] * 3
        rows = zip("xyz", means, pose.angle_repeatability, strict=True)
        for axis, mean, sigma in rows:
            yield (
                Cell(f"P{pose.pose}" if axis == "x" else ""),
                Cell(axis),
                *_cells(mean, "rad"),
                *_cells(sigma, "rad"),
                Cell(DISPLAY["rad"][0]),
            )


def _distances(test: Acceptance) -> Iterator[tuple[Cell, ...]]:
    worst = sorted(test.distances, key=lambda d: -abs(d.accuracy.value))
    for pair in worst[:SHOWN]:
        yield (
            Cell("-".join(f"P{pose}" for pose in pair.poses)),
            quantity(pair.commanded, "m"),
            *_cells(pair.accuracy, "m"),
            *_cells(pair.repeatability, "m"),
            Cell(DISPLAY["m"][0]),
        )


def _cells(interval: Interval | None, unit: str) -> tuple[Cell, Cell]:
    if interval is None:
        return Cell("-"), Cell("-")
    return quantity(interval.value, unit), Cell(ends(interval, unit))


def ends(interval: Interval, unit: str) -> str:
    """Both ends of an interval, in the unit in which people read it."""
    if not isfinite(interval.high):
        return "not testable" if isinf(interval.high) else "not measured"
    low, high = (quantity(end, unit).text for end in (interval.low, interval.high))
    return f"{low} ... {high}"
