"""The likeliest reading of measurement files, by trying: what `init` writes down.

Every reading that names, units and links allow is tried on the robot: the nominal robot
is registered on the measurements, and the reading that leaves the smallest errors is
the one. A wrong unit or another link leaves errors a hundred times as large.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf
from pathlib import Path

import numpy as np

from calib_pin.errors import CalibPinError
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.io.foreign_headers import Foreign, joints_by_name, measured, numbered
from calib_pin.io.measurements import read_measurements
from calib_pin.kinematics.chain import Chain, Robot
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.evaluation import prepared
from calib_pin.validation.findings.case import some_of

USUAL = ("tool0", "tcp", "ee", "tip", "tool", "flange", "hand", "gripper")
"""Parts of the names of links at which a tool is usually mounted."""

TURNED = 2.2 * np.pi
"""Angles beyond this are degrees [rad]."""

DROPPED = 0.17
"""Orientation errors of the nominal robot from which an orientation is read wrongly, as
one of another convention [rad]."""


DATE = 1e11
"""Numbers from here on are dates with their digits in a row, and no seconds."""


CLEAR = 2.0
"""Errors of another reading, in those of the best one, from which it is wrong."""


@dataclass(frozen=True)
class Look:
    """A reading of measurement files.

    Attributes:
        setup: The setup that reads them so.
        data: The measurements; None where they cannot be read or the robot cannot be
            located on them.
        errors: Root mean square errors of the registered nominal robot, by quantity
            [SI units]; empty then.
        share: The first of them as a part of how far the tool moved, or the points
            moved in an image: a wrong unit can make both of them small.
        fault: Why not; None where they can.
        guessed: Ours to theirs: foreign names whose meaning was read off their words.
        units: Column to unit, where nobody stated it.
    """

    setup: Setup
    data: Observations | None = None
    errors: Mapping[str, float] = field(default_factory=dict)
    share: float = inf
    fault: CalibPinError | None = None
    guessed: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)


def tips(robot: Robot, base: str | None, joints: Sequence[str]) -> list[str]:
    """Links that the most of some joints move, and no others.

    Those that are usual for a tool come first, then leaves, in the order of the file.
    """
    moved = dict[str, int]()
    for link in robot.links:
        try:
            chain = Chain(robot, base, link)
        except CalibPinError:
            continue
        if chain.joints and {*chain.joints} <= {*joints}:
            moved[link] = len(chain.joints)
    most = max(moved.values(), default=0)

    def order(link: str) -> tuple[int, bool]:
        parts = re.split(r"[^a-z0-9]+", link.lower())
        ranks = (k for k, part in enumerate(USUAL) if part in parts)
        return next(ranks, len(USUAL)), link not in robot.leaves

    return sorted((link for link, count in moved.items() if count == most), key=order)


def serial_tips(robot: Robot, base: str | None, count: int) -> list[str]:
    """Links that so many joints move, those usual for a tool first."""
    joints = list[str]()
    for link in robot.links:
        try:
            chain = Chain(robot, base, link)
        except CalibPinError:
            continue
        if len(chain.joints) == count:
            joints += [joint for joint in chain.joints if joint not in joints]
    return tips(robot, base, joints) if len(joints) == count else []


def joint_columns(
    robot: Robot, base: str | None, tip: str | None, columns: Sequence[Foreign]
) -> tuple[dict[str, Foreign], list[str]]:
    """The column of every joint, and the links that they may belong to.

    Args:
        robot: The robot.
        base: Link at which chains start; None for the root.
        tip: Link at which the chain ends, if it is known.
        columns: Those of a file.

    Returns:
        Columns by joint, empty where none are found, and the tips, likeliest first.
    """
    every = [name for name in robot.model.names if name != "universe"]
    named = joints_by_name(columns, every)
    if tip is not None:
        joints = Chain(robot, base, tip).joints
        if {*joints} <= {*named}:
            return {joint: named[joint] for joint in joints}, [tip]
        for family in numbered(columns):
            if len(family) == len(joints):
                return dict(zip(joints, family, strict=True)), [tip]
        return {}, [tip]
    if named:
        return named, tips(robot, base, list(named))
    for family in numbered(columns):
        links = serial_tips(robot, base, len(family))
        if links:
            joints = Chain(robot, base, links[0]).joints
            return dict(zip(joints, family, strict=True)), links
    return {}, []


def readings(
    setup: Setup,
    robot: Robot,
    joints: Mapping[str, Foreign],
    columns: Sequence[Foreign],
) -> Iterator[Look]:
    """Readings of a file that its names and numbers allow, likeliest first."""
    used = {one.name for one in joints.values()}
    found = measured([one for one in columns if one.name not in used])
    names = dict[str, Foreign]()
    for ours, choices in found.items():
        own = next((one for one in choices if one.name == ours), None)
        chosen = own or choices[0]
        if ours != "time" or chosen.largest < DATE:
            names[ours] = chosen
    orientations = [n for n in names if n[0] in "qr" or n in ("pitch", "yaw")]
    without = {n: one for n, one in names.items() if n not in orientations}
    ways = [names, without] if orientations and "x" in names else [names]
    angular = _angular(robot)
    free = [one for one in joints.values() if one.unit is None]
    turning = [o for j, o in joints.items() if o.unit is None and j in angular]
    degrees = max((one.largest for one in turning), default=0.0) > TURNED
    angles = ["deg"] if degrees else ["rad", "deg"]
    lengths = [one for n, one in without.items() if n in ("x", "y", "z", "distance")]
    unstated = [one for one in lengths if one.unit is None]
    scales = ["m", "mm"] if unstated else [""]
    for way, angle, length in product(ways, angles if free else [""], scales):
        stated, guessed, units = dict[str, str](), dict[str, str](), dict[str, str]()
        for ours, one in [*joints.items(), *way.items()]:
            unit = one.unit
            if unit is None and one in turning and angle == "deg":
                unit = units.setdefault(ours, "deg")
            if unit is None and one in unstated and length == "mm":
                unit = units.setdefault(ours, "mm")
            foreign = one.name != ours or (unit is not None and one.column.unit is None)
            if foreign or unit not in (None, one.column.unit):
                stated[ours] = one.stated(unit)
            if one.name != ours:
                guessed[ours] = one.name
        columns_of = {**stated, **setup.columns}
        yield Look(replace(setup, columns=columns_of), guessed=guessed, units=units)


def _angular(robot: Robot) -> set[str]:
    """Names of the joints that turn."""
    model = robot.model
    return {
        model.names[k]
        for k in range(1, model.njoints)
        if "P" not in model.joints[k].shortname().removeprefix("JointModel")
    }


def looked(
    look: Look, robot: Robot, files: Sequence[Path], *, station_per_file: bool = False
) -> Look:
    """A reading with the errors that it leaves the nominal robot."""
    setup = look.setup
    names = () if setup.tip is None else ("",)
    try:
        chains = Chains(robot, setup.base, setup.tip, setup.chains, names)
        data = read_measurements(
            list(files),
            chains,
            model=setup.model,
            columns=setup.columns,
            joints=setup.joints,
            station_per_file=station_per_file,
        )
        chains = chains.named(tuple(key.chain for key in data.keys))
        ready = prepared(chains, some_of(data)[0], setup)
    except CalibPinError as error:
        return replace(look, fault=error)
    residual = error_table(ready.problem, ready.theta)
    errors = {}
    for quantity in ready.problem.layout.quantities:
        sizes = quantity.errors(residual)
        if len(sizes):
            errors[quantity.name] = float(np.sqrt(np.mean(sizes**2)))
    first = next(iter(errors), "")
    moved = _scatter(ready.problem, pixels=first == "pixel")
    share = errors[first] / moved if first and moved > 0.0 else inf
    return replace(look, data=data, errors=errors, share=share)


def _scatter(problem: Problem, *, pixels: bool) -> float:
    """How far the tips of all chains moved about their means [m], or points [px]."""
    squares = []
    for block in problem.blocks:
        points = block.data.values
        if not pixels:
            points = block.part.error.chain.poses(block.data.q)[:, :3, 3]
        squares.append(np.sum((points - points.mean(0)) ** 2, axis=1))
    return float(np.sqrt(np.concatenate(squares).mean()))


def best(looks: Sequence[Look]) -> Look:
    """The reading that fits best; no orientation where none fits."""

    def order(look: Look) -> tuple[bool, float]:
        return look.errors.get("orientation", 0.0) > DROPPED, look.share

    whole = [look for look in looks if look.errors]
    return min(whole, key=order) if whole else looks[0]


def rivals(chosen: Look, looks: Sequence[Look]) -> list[Look]:
    """Readings with other units that fit nearly as well."""
    near = [look for look in looks if look.share < CLEAR * chosen.share]
    return [look for look in near if look.units != chosen.units]
