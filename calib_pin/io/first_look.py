"""The likeliest reading of measurement files, by trying: what `init` writes down.

Names, numbers and units allow several readings of each column. All of their
combinations, the likeliest first, are tried on the robot: the nominal robot is
registered on the measurements, and the combination that leaves the smallest errors is
the one. A wrong unit or another link leaves errors a hundred times as large.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

import calib_pin.io.foreign_headers as headers
from calib_pin.errors import CalibPinError, InputError, OptionError, enumerated
from calib_pin.estimation.problem import distinct_values, error_table
from calib_pin.io.columns import ANGLE, LENGTH, counted
from calib_pin.io.foreign_headers import GAUGED, VECTORS, Foreign
from calib_pin.io.measured_columns import asked_models, optional, reserved
from calib_pin.io.measurements import read_measurements
from calib_pin.io.table import read_table
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import advice, drives_of
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.tree import turns
from calib_pin.observations import Observations
from calib_pin.parameterizations.placement import HAND_SET
from calib_pin.setup import WORLD, CameraSetup, ChainSetup, Setup
from calib_pin.units import steps_of
from calib_pin.validation.evaluation import prepared
from calib_pin.validation.findings.case import some_of
from calib_pin.validation.findings.computed_values import COMPUTED, spread

TOUCHES = ("fixed-point", "plane-contact", "sphere-contact")
DISTANCES = ("plane-distance", "point-distance", "relative-distance")

AT_REST = 0.05
"""Scatter of a nominal robot's ball in its sockets, in parts of how far it moved, below
which it was in sockets."""

USUAL = ("tool0", "tcp", "ee", "tip", "tool", "flange", "hand", "gripper")
"""Parts of the names of links at which a tool is usually mounted."""

TURNED = 2.2 * np.pi
"""Angles beyond this are degrees [rad]."""

DROPPED = 0.17
"""Orientation errors of the nominal robot from which an orientation is read wrongly, as
one of another convention [rad]."""

LENGTHS = {*VECTORS[0], "distance", *GAUGED}
"""Columns of lengths."""

SPATIAL = {name for vector in VECTORS[:4] for name in vector}
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

Choose = Callable[[str, Sequence[str], str], str]
"""The choice of a user: of a question, the choices, and the option that says it."""


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


def first_look(
    robot: Robot,
    files: Sequence[Path],
    setup: Setup,
    choose: Choose,
    station_per_file: bool = False,
) -> Look:
    """The reading of measurement files that fits the nominal robot best.

    Args:
        robot: The robot.
        files: The files; the first shows the columns.
        setup: What is known: base, tip (of chains that the files name, NAME=LINK,...),
            model, board and camera.
        choose: Called where only a user can tell readings apart.
        station_per_file: Whether each file is a station.

    Raises:
        CalibPinError: If the files cannot be read in any way, numbers do not tell their
            units, or all positions were computed by the controller.
    """
    columns = headers.foreign(read_table(files[0]).whole(robot.model.names).columns)
    start, joints = _ends(robot, setup, columns, choose)
    start = _with_camera(start, columns)

    def tried(joints: Sequence[Joints]) -> list[Look]:
        ways = (way for own in joints for way in readings(start, robot, own, columns))
        return [looked(way, robot, files, station_per_file) for way in ways]

    looks = tried(joints)
    found = best(looks)
    others = unlikely_joints(robot, start.base, joints)
    while not found.fits and (other := next(others, None)) is not None:
        if (better := best(tries := tried([other]))).share < found.share:
            looks, found = tries, better
    question, models = "of which kind is the distance", _answers("model", looks, found)
    if found.setup.model in TOUCHES:
        question = "did the tool rest in sockets or touch planes or spheres"
        models = [] if found.share < AT_REST or start.model else [*TOUCHES]
    if len(models) > 1 and models[0] in (*TOUCHES, *DISTANCES):
        setup = replace(setup, model=choose(question, models, "--model"))
        return first_look(robot, files, setup, choose, station_per_file)
    if found.fault is not None:
        raise found.fault
    looks = [
        look
        for look in looks
        if look.setup.model == found.setup.model and look.position not in found.computed
    ]
    same = [look for look in looks if look.joints is found.joints]
    next_share = min((k.share for k in same if k.units != found.units), default=inf)
    if CLEAR * next_share <= found.share < inf:
        raise InputError(
            "the robot fits about as well with other units; state the units in the "
            "header, such as 'x [mm]', or in 'columns' of a setup file"
        )
    ends = _answers("tip", looks, found)
    if len(ends) > 1 and found.share < inf:
        tip = choose("which link was measured", ends, "--tip")
        found = best([look for look in looks if look.setup.tip == tip])
    if found.hand_set:
        prior = {"*.joint-offset.q": round(HAND_SET, 3)}
        setup = replace(found.setup, parameters=("joint-offset",), prior=prior)
        found = replace(found, setup=setup)
    return replace(found, next_share=next_share)


def _answers(key: str, looks: Sequence[Look], found: Look) -> list[str]:
    """Values of a key in the setups of readings that fit about as well as the best."""
    close = [look for look in looks if CLEAR * look.share <= found.share]
    return [*dict.fromkeys(getattr(k.setup, key) or "" for k in [found, *close])]


def _ends(
    robot: Robot, setup: Setup, columns: Sequence[Foreign], choose: Choose
) -> tuple[Setup, list[Joints]]:
    """The setup with the chains that a column names, and what may be the joints."""
    every = [name for name in robot.model.names if name != "universe"]
    by_name = headers.joints_by_name(columns, every)
    named = headers.measured(columns).get("chain")
    if named is None or (setup.tip is not None and "=" not in setup.tip):
        joints = joint_columns(robot, setup, columns, by_name)
    else:
        tips = dict(word.partition("=")[::2] for word in (setup.tip or "").split(","))
        names = named[0].column.texts().map(str.strip).distinct
        chains = dict[str, ChainSetup]()
        for name in (k for k in names if k not in ("", WORLD, *robot.links)):
            links = _links_called(name, chains_of(robot, setup.base), by_name.keys())
            asked = f"which link is the tip of chain '{name}'"
            option = f"--tip {name}=LINK"
            tip = tips.get(name) or choose(asked, links or robot.links, option)
            chains[name] = ChainSetup(tip=tip)
        setup = replace(setup, tip=None, chains=chains)
        joints = [Joints(by_name)] if by_name else []
    if not joints:
        raise InputError(
            "joint positions are needed (a pose of the controller hides the branch and "
            "the errors of the robot), and no columns are found for them; map them "
            f"with 'columns' in a setup file (joints: {enumerated(every)})"
        )
    return setup, joints


def _parts(link: str) -> list[str]:
    return re.split(r"[^a-z0-9]+", link.lower())


def _links_called(
    name: str, chains: Mapping[tuple[str, ...], Sequence[str]], joints: Set[str]
) -> list[str]:
    """The links that may be the tip of a chain, whose name their names contain.

    Of these the ones count that the most of the joints of the file move.
    """
    called = {
        one: [link for link in links if {*_parts(name)} <= {*_parts(link)}]
        for one, links in chains.items()
        if joints >= {*one}
    }
    most = max((len(one) for one, links in called.items() if links), default=0)
    found = [links for one, links in called.items() if links and len(one) == most]
    # Of links that the same joints move, one is as good as another.
    return found[0][:1] if len(found) == 1 else [k for links in found for k in links]


def _with_camera(setup: Setup, columns: Sequence[Foreign]) -> Setup:
    """The setup with a camera to start from, where columns are those of a camera.

    Raises:
        OptionError: If nothing says which board it saw.
    """
    found = headers.measured(columns)
    if not {"u", "v"} <= found.keys() or setup.model not in (None, "camera"):
        return setup
    if setup.board is None:
        raise OptionError(
            "the points that the camera saw must be known: state --board, or --setup, "
            "the file of detect's --setup-output",
            allowed="such as charuco:7x5:0.03:0.022, lengths in m",
        )
    # The image is larger than where corners were seen, by how much nobody knows.
    width, height = (100.0 * -(-found[axis][0].largest // 100.0) for axis in "uv")
    center = ((width - 1.0) / 2.0, (height - 1.0) / 2.0)
    camera = setup.camera or CameraSetup(
        mount="hand", focal=(width, width), center=center, estimate=True
    )
    return replace(setup, model="camera", camera=camera)


def likely_tip(links: Sequence[str], robot: Robot) -> list[str]:
    """Links ordered: those usual for a tool first, then leaves, as in the file."""

    def order(link: str) -> tuple[int, bool]:
        ranks = (k for k, part in enumerate(USUAL) if part in _parts(link))
        return next(ranks, len(USUAL)), link not in robot.leaves

    return sorted(links, key=order)


def chains_of(
    robot: Robot, base: str | None, tip: str | None = None
) -> dict[tuple[str, ...], list[str]]:
    """The links that drives move, by their joints, the likeliest tips first.

    Raises:
        InputError: If there is no such base or tip.
        RobotError: If no chain can be used.
    """
    found = dict[tuple[str, ...], list[str]]()
    for link in robot.links if tip is None else ():
        with suppress(CalibPinError):
            chain = Chain(robot, base, link)
            if chain.joints:
                found.setdefault(tuple(drives_of(chain)), []).append(link)
    if not found:  # Of which the robot says why.
        tip = tip or likely_tip(robot.leaves, robot)[0]
        found[tuple(drives_of(Chain(robot, base, tip)))] = [tip]
    return {joints: likely_tip(links, robot) for joints, links in found.items()}


def joint_columns(
    robot: Robot, setup: Setup, columns: Sequence[Foreign], named: dict[str, Foreign]
) -> list[Joints]:
    """Columns that may be those of the joints, likeliest first; empty if none may.

    Args:
        robot: The robot.
        setup: Base and tip of the chain, as far as they are known.
        columns: Those of a file.
        named: Those that are called like joints of the robot, by joint.

    Raises:
        InputError: If there is no such base or tip, or a chain lacks columns for some
            of its joints.
        RobotError: If no chain can be used.
    """
    chains = chains_of(robot, setup.base, setup.tip)
    whole = [one for one in chains if named.keys() >= {*one}]
    fullest = max(chains, key=lambda one: (len({*one} & named.keys()), -len(one)))
    missing = [joint for joint in fullest if joint not in named]
    most = max(map(len, whole), default=0)
    if len(fullest) - len(missing) >= max(most + 1, FEWEST):
        end = chains[fullest][0]
        told = f"no column for {', '.join(missing)} of the chain to '{end}'"
        raise InputError(told + advice(Chain(robot, setup.base, end), missing))
    if whole:
        # A file may hold those that follow, too.
        follow = {j: mimic.leader for j, mimic in robot.mimics.items()}
        return [
            Joints({j: named[j] for j in named if follow.get(j, j) in one}, chains[one])
            for one in whole
            if not any({*one} < {*other} for other in whole)
        ]
    found, ordered = [], headers.without_meaning(columns)
    for family in [*headers.families(columns), ordered]:
        # Columns behind those of the longest chain are those of external axes.
        most = max((len(one) for one in chains if len(one) <= len(family)), default=0)
        if family is ordered and len(family) != most:
            break
        for one in (one for one in chains if len(one) == most >= FEWEST):
            own = dict(zip(one, family, strict=False))
            kinds = (ANGLE if turns(robot.model, joint) else LENGTH for joint in one)
            units = (column.unit for column in own.values())
            if all(
                u is None or u in k.units for k, u in zip(kinds, units, strict=True)
            ):
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
    for own in (own for own in likely if own.tips):
        moving = {joint for joint, one in own.columns.items() if one.moves}
        for one, links in chains_of(robot, base).items():
            if moving <= {*one} < own.columns.keys():
                yield Joints({joint: own.columns[joint] for joint in one}, links)
    for own in (own for own in likely if own.order):
        columns = own.columns
        others = [dict(zip(sorted(columns), columns.values(), strict=True))]
        for a, b in combinations(columns, 2):
            others.append(columns | {a: columns[b], b: columns[a]})
        for other in others:
            yield replace(own, columns=other, order="other than on the robot")


def readings(
    setup: Setup, robot: Robot, own: Joints, columns: Sequence[Foreign]
) -> Iterator[Look]:
    """Readings of a file that its names and numbers allow, likeliest first."""
    joints, by_name = own.columns, {one.name: one for one in columns}
    headers.require_units(joints.values())
    if own.tips:
        setup = replace(setup, tip=setup.tip or own.tips[0])
    used = {one.name for one in joints.values()}
    rest = [one for one in columns if one.name not in used]
    gauges = frozenset[str]().union(*map(optional, asked_models(setup.model)))
    names = {
        ours: one
        for ours, (one, *_) in headers.measured(rest).items()
        if ours not in SPATIAL and (ours not in GAUGED or ours in gauges)
        if ours != "time" or one.largest < DATE
    }
    ways = [
        {**names, **position, **turned}
        for position, orientation in headers.vectors(rest) or [({}, {})]
        for turned in _distinct([orientation, {}])
    ]
    mounts = [setup]
    if (camera := setup.camera) is not None:
        cameras = (replace(camera, mount=mount) for mount in ("hand", "world"))
        mounts = [replace(setup, camera=camera) for camera in cameras]
    for way, mount in product(ways, mounts):
        models: Sequence[str | None] = [setup.model]
        if setup.model is None and "x" in way:  # Whatever else is in the file.
            models = [None if SPATIAL & {*way} - {*VECTORS[0]} else "position"]
        elif setup.model is None:
            models = DISTANCES if "distance" in way else TOUCHES[:1]
        for units, model in product(_units(robot, joints, way), models):
            stated = dict[str, str]()
            for ours, one in [*joints.items(), *way.items()]:
                told = one.stated(units.get(ours, one.unit))
                if one.name != ours or told not in (ours, one.column.header):
                    stated[ours] = told
            for ours in (ours for ours in units if ours in way):
                # The scatter of numbers is in their unit.
                sigma = by_name.get(f"sigma_{ours}")
                if sigma is not None and sigma.unit is None:
                    stated[sigma.name] = sigma.stated(units[ours])
            meant = {*used, *(one.name for one in way.values()), *reserved()}
            yield Look(
                replace(mount, model=model, columns=stated),
                joints=own,
                units=units,
                ignored=tuple(one.name for one in columns if one.name not in meant),
                position=way["x"].name if "x" in way else "",
            )


def _units(
    robot: Robot, joints: Mapping[str, Foreign], way: Mapping[str, Foreign]
) -> list[dict[str, str]]:
    """Units of columns that state none, where they may be in others than rad and m."""
    free = {joint: one for joint, one in joints.items() if one.unit is None}
    turning = {joint: one for joint, one in free.items() if turns(robot.model, joint)}
    numbers = [np.zeros(0), *(one.column.numbers for one in turning.values())]
    steps = counted(np.concatenate(numbers))
    every = dict.fromkeys(turning, steps or "deg")
    # A joint that stands still, as a gripper in percent, tells no unit.
    far = {j: "deg" for j, one in turning.items() if one.moves and one.largest > TURNED}
    slides = dict.fromkeys((joint for joint in free if joint not in turning), "mm")
    lengths = [ours for ours in way if ours in LENGTHS and way[ours].unit is None]
    ways = (
        [every] if steps else [every, far] if far else [far, every],
        [{}, slides],
        [{}, dict.fromkeys(lengths, "mm")],
    )
    return [{**a, **b, **c} for a, b, c in product(*map(_distinct, ways))]


def _distinct(ways: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [one for k, one in enumerate(ways) if one not in ways[:k]]


def looked(
    look: Look, robot: Robot, files: Sequence[Path], station_per_file: bool = False
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
            station_per_file=station_per_file,
            notice=remarks.append,
        )
        chains = chains.named(tuple(key.chain for key in data.keys))
        ready = prepared(chains, some_of(data)[0], setup)
        known = distinct_values(ready.problem)
        parameters = ready.problem.parameters
        unknown = int(np.sum(parameters.free & parameters.nuisance))
        if known <= unknown:
            reason = (
                f"{len(data)} measurement{'s' * (len(data) > 1)} ({known} numbers) "
            )
            reason += (
                f"are too few: where instrument and tool are takes {unknown} already"
            )
            raise InputError(reason, file=files[0])
    except CalibPinError as error:
        return replace(look, fault=error)
    residual = error_table(ready.problem, ready.theta)
    sizes = {q.name: q.errors(residual) for q in ready.problem.layout.quantities}
    errors = {n: float(np.sqrt(np.mean(of**2))) for n, of in sizes.items() if len(of)}
    # How far measured points moved about their means, or else the tips: where both
    # tell no length, as on a positioner whose tool may sit anywhere, errors in another
    # unit are the same part of what was measured in it.
    moved = spread(
        [
            block.data.values[:, :3]
            if block.data.model in ("position", "pose", "camera")
            else block.term.error.chain.poses(block.data.q)[:, :3, 3]
            for block in ready.problem.blocks
        ]
    )
    share = next(iter(errors.values())) / moved if errors and moved > 0.0 else inf
    return replace(look, data=data, errors=errors, share=share, remarks=remarks)


def best(looks: Sequence[Look]) -> Look:
    """The likeliest of the readings that fit best; no orientation where none fits.

    Args:
        looks: Readings, the likeliest first.

    Raises:
        InputError: If the nominal robot fits to a file as no instrument sees one.
    """
    whole = [look for look in looks if look.errors]
    computed = {look.position for look in whole if look.share <= COMPUTED} - {""}
    seen = [look for look in whole if look.position not in computed]
    if computed and not seen:
        size = 1e3 * next(iter(whole[0].errors.values()))
        raise InputError(
            f"the positions fit to the nominal robot to {size:.2g} mm, which no "
            "instrument does: they are computed from the joints by the controller, and "
            "no measurement"
        )
    turned = [k for k in seen if k.errors.get("orientation", 0.0) <= DROPPED] or seen
    least = min((look.share for look in turned), default=inf)
    chosen = (look for look in turned if CLEAR * look.share <= least)
    return replace(next(chosen, looks[0]), computed=sorted(computed))
