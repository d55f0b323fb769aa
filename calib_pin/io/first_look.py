"""The likeliest reading of measurement files, by trying: what `init` writes down.

Every reading that names, units and links allow is tried on the robot: the nominal robot
is registered on the measurements, and the reading that leaves the smallest errors is
the one. A wrong unit or another link leaves errors a hundred times as large.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from math import inf
from pathlib import Path

import numpy as np

from calib_pin.errors import CalibPinError, InputError
from calib_pin.estimation.problem import Problem, distinct_values, error_table
from calib_pin.io.columns import ANGLE, LENGTH, counted
from calib_pin.io.foreign_headers import (
    GAUGED,
    VECTORS,
    Foreign,
    families,
    joints_by_name,
    measured,
    require_units,
    vectors,
    without_meaning,
)
from calib_pin.io.inferred_model import asked_models
from calib_pin.io.measured_columns import optional, reserved
from calib_pin.io.measurements import read_measurements
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import advice, drives_of
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.tree import turns
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.units import steps_of
from calib_pin.validation.evaluation import prepared
from calib_pin.validation.findings.case import some_of
from calib_pin.validation.findings.computed_values import COMPUTED, spread

USUAL = ("tool0", "tcp", "ee", "tip", "tool", "flange", "hand", "gripper")
"""Parts of the names of links at which a tool is usually mounted."""

TURNED = 2.2 * np.pi
"""Angles beyond this are degrees [rad]."""

DROPPED = 0.17
"""Orientation errors of the nominal robot from which an orientation is read wrongly, as
one of another convention [rad]."""

LENGTHS = {*VECTORS[0], "distance", *GAUGED}
"""Columns of lengths."""

SPATIAL = {*VECTORS[0], *VECTORS[1], *VECTORS[2], *VECTORS[3]}
"""Columns of positions and orientations."""

CLEAR = 0.5
"""Part of the errors of another reading that a less likely one must leave, at most."""

FITS = 0.2
"""Errors of the registered nominal robot, in parts of how far the tool moved, from
which a reading is none: a robot is off by a tenth at most, a wrong reading by all."""

FEWEST = 3
"""Joints that are found without their names."""

FEW = 10
"""Measurements for each joint and frame up to which they are few for six errors."""

ROUGH, SMALL = 0.01, 0.2
"""Part of its motion by which few nominal arms of a factory are off, and the scatter of
the points of a small arm, rms [m]."""

DATE = 1e11
"""Numbers from here on are dates with their digits in a row, and no seconds."""


@dataclass(frozen=True)
class Joints:
    """The columns of joints, and where on the robot they end.

    Attributes:
        columns: Column by joint.
        tips: Links that these joints move, and no others, likeliest first; empty where
            the measurements name their chains.
        order: How columns stand that are known to be theirs by their order alone.
    """

    columns: dict[str, Foreign]
    tips: Sequence[str] = ()
    order: str = ""


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
        joints: The columns of the joints.
        units: Column to unit, where nobody stated it.
        ignored: Names of columns without a meaning.
        next_share: The share in other units; infinite where there are none.
        position: Name of the column that is taken for x.
        remarks: Sentences about how the files were read.
        computed: Names of columns of x that the controller computed.
    """

    setup: Setup
    data: Observations | None = None
    errors: Mapping[str, float] = field(default_factory=dict)
    share: float = inf
    fault: CalibPinError | None = None
    joints: Joints = field(default_factory=lambda: Joints({}))
    units: Mapping[str, str] = field(default_factory=dict)
    ignored: Sequence[str] = ()
    next_share: float = inf
    position: str = ""
    remarks: Sequence[str] = ()
    computed: Sequence[str] = ()

    @property
    def fits(self) -> bool:
        """Whether the nominal robot moves as the measurements say."""
        return self.share < FITS

    @property
    def hand_set(self) -> str:
        """How it shows that zeros were set by hand, as a servo's; empty if nothing."""
        columns = self.joints.columns
        units = {j: self.units.get(j, of.unit or "") for j, of in columns.items()}
        if any(map(steps_of, units.values())):
            return "the joints are counted in steps of servos"
        degrees = [columns[j].column.numbers for j in units if units[j] == "deg"]
        if degrees and not np.nansum(np.array(degrees) % 1.0):
            return "the joints were read in whole degrees"
        few = self.data is not None and len(self.data) < FEW * (len(columns) + 2)
        size = next(iter(self.errors.values()), inf)
        if few and self.share > ROUGH and size < SMALL * self.share:
            return "few measurements of a small arm, which is off by 1 % of its motion"
        return ""


def likely_tip(links: Sequence[str], robot: Robot) -> list[str]:
    """Links ordered: those usual for a tool first, then leaves, as in the file."""

    def order(link: str) -> tuple[int, bool]:
        parts = re.split(r"[^a-z0-9]+", link.lower())
        ranks = (k for k, part in enumerate(USUAL) if part in parts)
        return next(ranks, len(USUAL)), link not in robot.leaves

    return sorted(links, key=order)


def chains_of(robot: Robot, base: str | None) -> dict[tuple[str, ...], list[str]]:
    """The links that drives move, by their joints, the likeliest tips first.

    Raises:
        InputError: If there is no such base.
    """
    found = dict[tuple[str, ...], list[str]]()
    for link in robot.links:
        try:
            chain = Chain(robot, base, link)
        except CalibPinError:
            if base is not None and base not in robot.links:
                raise
            continue
        if chain.joints:
            found.setdefault(tuple(drives_of(chain)), []).append(link)
    return {joints: likely_tip(links, robot) for joints, links in found.items()}


def joint_columns(
    robot: Robot, base: str | None, tip: str | None, columns: Sequence[Foreign]
) -> list[Joints]:
    """Columns that may be those of the joints, likeliest first; empty if none may.

    Args:
        robot: The robot.
        base: Link at which chains start; None for the root.
        tip: Link at which the chain ends, if it is known.
        columns: Those of a file.

    Raises:
        InputError: If there is no such base or tip, or a chain lacks columns for some
            of its joints.
        RobotError: If no chain can be used.
    """
    chains = chains_of(robot, base) if tip is None else {}
    if not chains:  # Of which the robot says why.
        tip = tip or likely_tip(robot.leaves, robot)[0]
        chains = {tuple(drives_of(Chain(robot, base, tip))): [tip]}
    every = [name for name in robot.model.names if name != "universe"]
    named = joints_by_name(columns, every)
    whole = [joints for joints in chains if {*joints} <= {*named}]
    longest = [one for one in whole if not any({*one} < {*other} for other in whole)]
    fullest = max(chains, key=lambda one: (len({*one} & {*named}), -len(one)))
    missing = [joint for joint in fullest if joint not in named]
    most = max(map(len, longest), default=0)
    if len(fullest) - len(missing) >= max(most + 1, FEWEST):
        end = chains[fullest][0]
        told = f"no column for {', '.join(missing)} of the chain to '{end}'"
        raise InputError(told + advice(Chain(robot, base, end), missing))
    if longest:
        # A file may hold those that follow, too.
        follow = {j: mimic.leader for j, mimic in robot.mimics.items() if j in named}
        return [
            Joints({j: named[j] for j in named if follow.get(j, j) in one}, chains[one])
            for one in longest
        ]
    found = []
    ordered = without_meaning(columns)
    for family in [*families(columns), ordered]:
        # Columns behind those of the longest chain are those of external axes.
        most = max((len(one) for one in chains if len(one) <= len(family)), default=0)
        if family is ordered and len(family) != most:
            break
        for one in chains:
            if len(one) == most >= FEWEST:
                own = dict(zip(one, family, strict=False))
                if all(_may_be(robot, *item) for item in own.items()):
                    found.append(Joints(own, chains[one], "as on the robot"))
    return found


def unlikely_joints(
    robot: Robot, base: str | None, likely: Sequence[Joints]
) -> Iterator[Joints]:
    """Other columns of joints, the likelier first, for files that fit in no usual way.

    Joints at the end of a chain that stand still may be in units of their own, such as
    a gripper in percent. Columns without names may be those of other joints: ROS writes
    joints by the alphabet.

    Args:
        robot: The robot.
        base: Link at which chains start; None for the root.
        likely: What fits in no way.
    """
    chains = chains_of(robot, base)
    for own in likely:
        moving = {joint for joint, one in own.columns.items() if one.moves}
        for one, links in chains.items():
            if own.tips and moving <= {*one} < own.columns.keys():
                yield Joints({joint: own.columns[joint] for joint in one}, links)
    for own in (own for own in likely if own.order):
        joints, columns = [*own.columns], own.columns.values()
        swapped = [
            own.columns | {a: own.columns[b], b: own.columns[a]}
            for a, b in combinations(joints, 2)
        ]
        for other in [dict(zip(sorted(joints), columns, strict=True)), *swapped]:
            yield replace(own, columns=other, order="other than on the robot")


def _may_be(robot: Robot, joint: str, one: Foreign) -> bool:
    """Whether a column's unit is one of a joint."""
    kind = ANGLE if turns(robot.model, joint) else LENGTH
    return one.unit is None or one.unit in kind.units


def named_chains(
    robot: Robot, base: str | None, names: Sequence[str], columns: Sequence[Foreign]
) -> tuple[Joints, dict[str, list[str]]]:
    """The columns of all joints, and the links that may be the tip of each chain.

    A name is that of a link, or a word in the names of links; of these the ones count
    that the most of the joints of the file move.
    """
    every = [name for name in robot.model.names if name != "universe"]
    joints, found = joints_by_name(columns, every), dict[str, list[str]]()
    chains = chains_of(robot, base)
    for name in names:
        words = {*re.split(r"[^a-z0-9]+", name.lower())}
        alike = dict[tuple[str, ...], list[str]]()
        for one, links in chains.items():
            same = [k for k in links if words <= {*re.split(r"[^a-z0-9]+", k.lower())}]
            if same and {*one} <= {*joints}:
                alike[one] = same
        most = max(map(len, alike), default=0)
        longest = [links for one, links in alike.items() if len(one) == most]
        # Of links that the same joints move, one is as good as another.
        alone = len(longest) == 1
        found[name] = longest[0][:1] if alone else [k for own in longest for k in own]
    return Joints(joints), found


def readings(
    setup: Setup,
    robot: Robot,
    found_joints: Joints,
    columns: Sequence[Foreign],
) -> Iterator[Look]:
    """Readings of a file that its names and numbers allow, likeliest first."""
    joints = found_joints.columns
    require_units(joints.values())
    if setup.tip is None and found_joints.tips:
        setup = replace(setup, tip=found_joints.tips[0])
    used = {one.name for one in joints.values()}
    by_name = {one.name: one for one in columns}
    rest = [one for one in columns if one.name not in used]
    names = dict[str, Foreign]()
    asked = asked_models(setup.model)
    gauges = frozenset[str]().union(*map(optional, asked))
    for ours, choices in measured(rest).items():
        if ours in GAUGED and ours not in gauges:
            continue
        own = next((one for one in choices if one.name == ours), None)
        chosen = own or choices[0]
        if ours != "time" or chosen.largest < DATE:
            names[ours] = chosen
    poses = vectors(rest)
    without = {n: one for n, one in names.items() if n not in SPATIAL}
    ways = [
        {**without, **position, **turned}
        for position, orientation in poses
        for turned in ((orientation, {}) if orientation else ({},))
    ] or [names]
    free = {joint: one for joint, one in joints.items() if one.unit is None}
    turning = {joint for joint in free if turns(robot.model, joint)}
    # A joint that stands still, as a gripper in percent, tells no unit.
    far = {j for j in turning if free[j].moves and free[j].largest > TURNED}
    angles = [turning, far] if far else [far, turning]
    numbers = [np.zeros(0), *(free[joint].column.numbers for joint in turning)]
    steps = counted(np.concatenate(numbers))
    angles = [turning] if steps else angles
    none = set[str]()
    slides = [none, free.keys() - turning]
    for way, degrees, millimeters, length in product(
        ways, _distinct(angles), _distinct(slides), ["m", "mm"]
    ):
        lengths = [one for n, one in way.items() if n in LENGTHS]
        unstated = [one for one in lengths if one.unit is None]
        if length == "mm" and not unstated:
            continue
        stated, units = dict[str, str](), dict[str, str]()
        for ours, one in [*joints.items(), *way.items()]:
            unit = one.unit
            if ours in degrees:
                unit = units.setdefault(ours, steps or "deg")
            if ours in millimeters or (one in unstated and length == "mm"):
                unit = units.setdefault(ours, "mm")
            foreign = one.name != ours or (unit is not None and one.column.unit is None)
            if foreign or unit not in (None, one.column.unit):
                stated[ours] = one.stated(unit)
        for ours, unit in units.items():
            # The scatter of numbers is in their unit.
            sigma = by_name.get(f"sigma_{ours}")
            if sigma is not None and sigma.unit is None and ours in way:
                stated[sigma.name] = sigma.stated(unit)
        columns_of = {**stated, **setup.columns}
        read = replace(setup, columns=columns_of)
        if "x" in way and read.model is None and not SPATIAL & {*way} - {*VECTORS[0]}:
            read = replace(read, model="position")  # Whatever else is in the file.
        meant = {*used, *(one.name for one in way.values()), *reserved()}
        ignored = tuple(one.name for one in columns if one.name not in meant)
        x = way["x"].name if "x" in way else ""
        yield Look(read, joints=found_joints, units=units, ignored=ignored, position=x)


def _distinct(sets: Sequence[Set[str]]) -> list[Set[str]]:
    return [one for k, one in enumerate(sets) if one not in sets[:k]]


def looked(
    look: Look, robot: Robot, files: Sequence[Path], *, station_per_file: bool = False
) -> Look:
    """A reading with the errors that it leaves the nominal robot."""
    setup, remarks = look.setup, list[str]()
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
            notice=remarks.append,
        )
        chains = chains.named(tuple(key.chain for key in data.keys))
        ready = prepared(chains, some_of(data)[0], setup)
        known = distinct_values(ready.problem)
        parameters = ready.problem.parameters
        unknown = int(np.sum(parameters.free & parameters.nuisance))
        if known <= unknown:
            count = f"{len(data)} measurement" + "s" * (len(data) > 1)
            reason = (
                f"{count} ({known} numbers) are too few: where instrument and tool are "
                f"takes {unknown} already"
            )
            raise InputError(reason, file=files[0])
    except CalibPinError as error:
        return replace(look, fault=error)
    residual = error_table(ready.problem, ready.theta)
    errors = {}
    for quantity in ready.problem.layout.quantities:
        sizes = quantity.errors(residual)
        if len(sizes):
            errors[quantity.name] = float(np.sqrt(np.mean(sizes**2)))
    first = next(iter(errors), "")
    moved = _moved(ready.problem)
    share = errors[first] / moved if first and moved > 0.0 else inf
    return replace(look, data=data, errors=errors, share=share, remarks=remarks)


def _moved(problem: Problem) -> float:
    """How far measured points moved about their means, or else the tips [m, px].

    Where both tell no length, as on a positioner whose tool may sit anywhere, errors in
    another unit are the same part of what was measured in it.
    """
    return spread(
        [
            block.data.values[:, :3]
            if block.data.model in ("position", "pose", "camera")
            else block.term.error.chain.poses(block.data.q)[:, :3, 3]
            for block in problem.blocks
        ]
    )


def best(looks: Sequence[Look]) -> Look:
    """The likeliest of the readings that fit best; no orientation where none fits.

    Args:
        looks: Readings, the likeliest first.

    Raises:
        InputError: If the nominal robot fits to a file as no instrument sees one.
    """
    whole = [look for look in looks if look.errors]
    if not whole:
        return looks[0]
    computed = {look.position for look in whole if look.share <= COMPUTED} - {""}
    seen = [look for look in whole if look.position not in computed]
    if not seen:
        first = whole[0]
        size = 1e3 * next(iter(first.errors.values()))
        raise InputError(
            f"the positions fit to the nominal robot to {size:.2g} mm, which no "
            "instrument does: they are computed from the joints by the controller, and "
            "no measurement"
        )
    whole = seen
    turned = [k for k in whole if k.errors.get("orientation", 0.0) <= DROPPED] or whole
    least = min(look.share for look in turned)
    chosen = next(look for look in turned if CLEAR * look.share <= least)
    others = (
        look.share
        for look in whole
        if look.joints is chosen.joints and look.units != chosen.units
    )
    return replace(
        chosen, next_share=min(others, default=inf), computed=sorted(computed)
    )
