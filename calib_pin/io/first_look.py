"""The likeliest reading of measurement files, by trying: what `init` writes down.

Names, numbers and units allow several readings of each column. All of their
combinations, the likeliest first, are tried on the robot: the nominal robot is
registered on the measurements, and the combination that leaves the smallest errors is
the one. A wrong unit or another link leaves errors a hundred times as large.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

import calib_pin.io.foreign_headers as headers
import calib_pin.io.measured_columns as measured_columns
from calib_pin.errors import CalibPinError, InputError, OptionError, enumerated
from calib_pin.estimation.evidence import Finding, rms
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import distinct_values
from calib_pin.io.columns import ANGLE, LENGTH, TURNED, closest, counted, split_header
from calib_pin.io.foreign_headers import Foreign
from calib_pin.io.measured_columns import POSITION, measured
from calib_pin.io.measurement_errors import SETS
from calib_pin.io.measurements import read_measurements
from calib_pin.io.setup import setup_document, yaml_text
from calib_pin.io.table import read_table
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import advice, drives_of
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.tree import turns
from calib_pin.measurement_models import declared
from calib_pin.observations import Booleans, Observations
from calib_pin.parameterizations.placement import HAND_SET
from calib_pin.setup import STATED, WORLD, CameraSetup, ChainSetup, Setup
from calib_pin.units import steps_of
from calib_pin.validation.evaluation import error_sizes, registered_robot
from calib_pin.validation.findings.case import Case, QuickFit, subset
from calib_pin.validation.findings.facts import computed_values, require_motion, spread
from calib_pin.validation.findings.readings import orientations
from calib_pin.validation.findings.sentences import lines_of, shown, written
from calib_pin.validation.model_errors import Registered

TOUCHES = ("fixed-point", "plane-contact", "sphere-contact")
DISTANCES = ("plane-distance", "point-distance", "relative-distance")

AT_REST = 0.05
"""Scatter of a nominal robot's ball in its sockets, in parts of how far it moved, below
which it was in sockets."""

USUAL = ("tool0", "tcp", "ee", "tip", "tool", "flange", "hand", "gripper")
"""Parts of the names of links at which a tool is usually mounted."""

DROPPED = 0.17
"""Orientation errors of the nominal robot from which an orientation is read wrongly, as
one of another convention [rad]."""

CLEAR = 0.5
"""Part of the errors of another reading that a less likely one must leave, at most."""

FITS = 0.2
"""Errors of the registered nominal robot, in parts of how far the tool moved, from
which a reading is none: a robot is off by a tenth at most, a wrong reading by all."""

FAR, FEW = 5.0, 0.1
"""Errors of lost targets in the median of all, and which part of all may be such."""

APART = ("station", "tool", "target")
"""Columns that one of a few names may be."""

FEWEST = 3
"""Joints that are found without their names."""


WIDTH = 88
"""Longest line of a comment."""

EXTERNAL = """\
# The instrument may stand anywhere, and the target may sit anywhere on the tool: both
#   are estimated. State them if you know them.
frames:
  base: {estimate: true}
  tool: {estimate: true}"""
INTERNAL = """\
# Tool and instrument are estimated; the base link is the frame of reference. State
#   'frames', 'targets' or 'planes' that you know."""
"""Lines on what is estimated of frames, by where the instrument stands."""

Choose = Callable[[str, Sequence[str], str], str]
"""The choice of a user: of a question, the choices, and the option that says it."""

Try = Callable[["Look"], "Look"]
"""A reading with the errors that it leaves, see `with_errors`."""


@dataclass(frozen=True)
class Look:
    """A reading of measurement files, or as much of it as is known.

    Attributes:
        setup: The setup that reads them so.
        joints: The columns of the joints, by joint.
        tips: Links that these joints move, and no others, likeliest first; empty where
            the measurements name their chains.
        order: How columns stand that are known to be theirs by their order alone.
        chains: The chains that the measurements name.
        data: The measurements; None where they cannot be read or the robot cannot be
            located on them.
        errors: Root mean square errors of the registered nominal robot, by quantity
            [SI units]; empty then.
        share: The first of them as a part of how far the tool moved, or the points
            moved in an image: a wrong unit can make both of them small.
        fault: Why not; None where they can.
        units: Column to unit, where nobody stated it.
        position: Name of the column that is taken for x.
        remarks: Sentences about how the files were read.
        exact: The finding that the nominal robot fits as no instrument sees it; None
            where it does not.
        computed: Names of columns of x that the controller computed.
    """

    setup: Setup
    joints: Mapping[str, Foreign]
    tips: Sequence[str] = ()
    order: str = ""
    chains: Chains | None = None
    data: Observations | None = None
    errors: Mapping[str, float] = field(default_factory=dict)
    share: float = inf
    fault: CalibPinError | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    position: str = ""
    remarks: Sequence[str] = ()
    exact: Finding | None = None
    computed: Sequence[str] = ()

    @property
    def fits(self) -> bool:
        """Whether the nominal robot moves as the measurements say."""
        return self.share < FITS

    @property
    def hand_set(self) -> str:
        """How it shows that zeros were set by hand, as a servo's; empty if nothing."""
        units = {j: self.units.get(j, of.unit or "") for j, of in self.joints.items()}
        if any(map(steps_of, units.values())):
            return "the joints are counted in steps of servos"
        degrees = [self.joints[j].column.numbers for j in units if units[j] == "deg"]
        whole = bool(degrees) and not np.nansum(np.array(degrees) % 1.0)
        return "the joints were read in whole degrees" * whole


def first_look(
    robot: Robot, files: Sequence[Path], setup: Setup, choose: Choose, apart: bool
) -> Look:
    """The reading of measurement files that fits the nominal robot best.

    Args:
        robot: The robot.
        files: The files; the first shows the columns.
        setup: What is known: base, tip (of chains that the files name, NAME=LINK,...),
            model, board and camera.
        choose: Called where only a user can tell readings apart.
        apart: Whether each file is a station.

    Raises:
        CalibPinError: If the files cannot be read in any way, numbers do not tell their
            units, or all positions were computed by the controller.
    """
    table = read_table(files[0]).whole(robot.model.names)
    columns = headers.with_turns(headers.foreign(table.columns))
    look_at = partial(with_errors, robot=robot, files=files, apart=apart)
    looks, reading = list[Look](), None
    for joints in _joints(robot, _with_camera(setup, columns), columns, choose):
        likely = [k for look in joints for k in readings(look, robot, columns)]
        tries = list[Look]()
        for inverted in (False, True):
            if not inverted or not best(tries).fits:
                way = (k for k in likely if k.setup.reading.inverted is inverted)
                tries += map(look_at, way)
        tries = _in_conventions(tries, look_at)
        better = best(tries)
        # Joints are exchanged where that fits, not where nothing does.
        if reading is None or better.fits or better.share < reading.share == inf:
            looks, reading = tries, better
        if reading.fits:
            break
    assert reading is not None
    question, models = "of which kind is the distance", list[str]()
    if reading.setup.model in DISTANCES and reading.fault is None:
        models = _answers("model", looks, reading)
    elif reading.setup.model in TOUCHES and not setup.model:
        question = "no position or distance is found: "
        question += "did the tool rest in sockets or touch planes or spheres"
        models = [*TOUCHES] if reading.share >= AT_REST else []
    if len(models) > 1:
        setup = replace(setup, model=choose(question, models, "--model"))
        return first_look(robot, files, setup, choose, apart)
    if reading.fault is not None:
        raise reading.fault
    looks = [look for look in looks if look.setup.model == reading.setup.model]
    looks = [look for look in looks if look.position not in reading.computed]
    same = [look for look in looks if look.joints is reading.joints]
    next_share = min((k.share for k in same if k.units != reading.units), default=inf)
    if CLEAR * next_share <= reading.share < inf:
        plain = [k for k in same if not k.units and CLEAR * k.share <= reading.share]
        if reading.fits or not plain:
            reason = "the robot fits about as well with other units; state them in the "
            raise InputError(f"{reason}header, such as 'x [mm]', or in 'columns'")
        # It is something else that does not fit, and plain headers are in m and rad.
        reading = plain[0]
    ends = _answers("tip", looks, reading)
    if len(ends) > 1 and reading.share < inf:
        tip = choose("which link was measured", ends, "--tip")
        reading = best([look for look in looks if look.setup.tip == tip])
    hints = *_thousands(reading, columns), *_named_apart(reading, columns, look_at)
    reading = replace(reading, remarks=[*reading.remarks, *hints])
    if reading.hand_set:
        prior = {"*.joint-offset.q": round(HAND_SET, 3)}
        setup = replace(reading.setup, parameters=("joint-offset",), prior=prior)
        return replace(reading, setup=setup)
    return reading


def _used_names(look: Look) -> set[str]:
    """Names of columns that a reading takes, or that have a meaning in every file."""
    columns = {split_header(text)[0] for text in look.setup.columns.values()}
    joints = {foreign.name for foreign in look.joints.values()}
    return columns | joints | measured_columns.reserved()


def _thousands(look: Look, columns: Sequence[Foreign]) -> Iterator[str]:
    """Errors of whole numbers with a mark between their thousands, as they are read."""
    used = _used_names(look)
    for column in (k for k in columns if k.name in used and k.numeric):
        size = abs(column.numbers)
        whole = size % 1.0 == 0.0
        parts, small = size[~whole], size[whole]
        # Numbers of so many digits in all have fewer decimals where they are larger.
        thousands = (parts >= 1.0) & (parts < 1e3) & (parts.round(3) == parts)
        long = parts[parts.round(2) != parts]
        many = len(small) >= FEW * len(size) and 2 * len(long) > len(parts)
        if many and thousands.all() and 100.0 <= small.max(initial=0.0) < 1e3:
            first = float(column.numbers[np.argmin(whole)])
            text = f"'{column.name}' has whole numbers and {first:.3f} among them: "
            yield f"{text}if it is {1e3 * first:.0f}, write no mark between thousands"


def _named_apart(look: Look, columns: Sequence[Foreign], look_at: Try) -> Iterator[str]:
    """Columns of a few names that nobody reads, and what these may tell apart."""
    setup, used = look.setup, _used_names(look)
    free = [key for key in APART if key not in setup.columns]
    for foreign in (k for k in columns if k.name not in used and not k.column.numeric):
        count = len(foreign.column.texts().distinct)
        if not 1 < count <= len(foreign.column.numbers) / headers.SHARED:
            continue
        errors = dict[str, float]()
        for key in free:
            named = {**setup.columns, key: foreign.column.header}
            trial = replace(look, setup=replace(setup, columns=named))
            errors[key] = _fit_rms(look_at(trial))
        now, least = _fit_rms(look), min(errors.values(), default=inf)
        text = f"'{foreign.name}' has {count} names that repeat: "
        if least < CLEAR * now < inf:
            close = [key for key in free if CLEAR * errors[key] <= least]
            text += f"named {' or '.join(close)} in 'columns' it leaves "
            yield f"{text}{100.0 * least / now:.2g} % of the errors of a fit"
        elif not look.fits:
            yield f"{text}does it tell {', '.join(free)} apart? name it in 'columns'"


def _fit_rms(look: Look) -> float:
    """Errors that a fit of the robot leaves [standard deviations]; infinite of none."""
    if look.data is None or look.chains is None:
        return inf
    try:
        rows, _ = subset(look.data)
        fit = QuickFit.of(make_problem(look.chains, rows, look.setup))
    except (CalibPinError, np.linalg.LinAlgError):
        return inf
    return fit.rms if fit.redundant else inf


def _answers(key: str, looks: Sequence[Look], reading: Look) -> list[str]:
    """Values of a key in the setups of readings that fit about as well as the best."""
    close = [look for look in looks if CLEAR * look.share <= reading.share]
    return [*dict.fromkeys(getattr(k.setup, key) or "" for k in [reading, *close])]


def _with_camera(setup: Setup, columns: Sequence[Foreign]) -> Setup:
    """The setup with a camera to start from, where columns are those of a camera.

    Raises:
        OptionError: If nothing says which board it saw.
    """
    choices = headers.measured(columns)
    # Of u, v and w others write the orientation.
    pixels = {"u", "v"} <= choices.keys() and all(one.words != "w" for one in columns)
    if not pixels or setup.model not in (None, "camera"):
        return setup
    if setup.board is None:
        reason = "state the board that the camera saw (--board, or --setup of detect)"
        raise OptionError(reason, allowed="charuco:7x5:0.03:0.022, lengths in m")
    # The image is larger than where corners were seen, by how much nobody knows.
    width, height = (100.0 * -(-choices[axis][0].largest // 100.0) for axis in "uv")
    center = ((width - 1.0) / 2.0, (height - 1.0) / 2.0)
    camera = CameraSetup("hand", (width, width), center, estimate=True)
    return replace(setup, model="camera", camera=setup.camera or camera)


def _joints(
    robot: Robot, setup: Setup, columns: Sequence[Foreign], choose: Choose
) -> Iterator[Sequence[Look]]:
    """Columns that may be those of the joints, likeliest first, and chains they name.

    Raises:
        InputError: If nothing may, there is no such base or tip, or a chain lacks
            columns for some of its joints.
        RobotError: If no chain can be used.
    """
    joint_names = [name for name in robot.model.names if name != "universe"]
    by_name = headers.joints_by_name(columns, joint_names)
    named = headers.measured(columns).get("chain")
    if named is None or (setup.tip is not None and "=" not in setup.tip):
        looks = _one_chain_looks(robot, setup, columns, by_name)
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
        looks = [Look(setup, by_name)] if by_name else []
    if not looks:
        reason = "joint positions are needed (the controller's pose hides the branch), "
        reason += "and no columns are found for them; state 'columns' in a setup file"
        numbered = (one for one in columns if headers.NUMBERED.match(one.words))
        for one in [one for one in numbered if not one.column.numeric][:1]:
            reason += f"; '{one.name}' has no numbers, but '{one.column.text(0)}'"
        raise InputError(f"{reason} (joints: {enumerated(joint_names)})")
    yield looks
    # Joints at the end of a chain that stand still may be in units of their own, such
    # as a gripper in percent.
    for look in (look for look in looks if look.tips):
        moving = {joint for joint, column in look.joints.items() if column.moves}
        for chain, links in chains_of(robot, setup.base).items():
            if moving <= {*chain} < look.joints.keys():
                few = {joint: look.joints[joint] for joint in chain}
                yield [replace(look, joints=few, tips=links)]
    # Columns without names may be those of other joints: ROS writes by the alphabet.
    for look in (look for look in looks if look.order):
        joints = dict(zip(sorted(look.joints), look.joints.values(), strict=True))
        yield [replace(look, joints=joints, order="by the alphabet")]


def _name_parts(link: str) -> list[str]:
    return re.split(r"[^a-z0-9]+", link.lower())


def _links_called(
    name: str, chains: Mapping[tuple[str, ...], Sequence[str]], joints: Set[str]
) -> list[str]:
    """The links that may be the tip of a chain, whose name their names contain.

    Of these the ones count that the most of the joints of the file move.
    """
    # Of links that the same joints move, one is as good as another.
    called = {
        chain: link
        for chain, links in chains.items()
        for link in reversed(links)
        if joints >= {*chain} and {*_name_parts(name)} <= {*_name_parts(link)}
    }
    most = max(map(len, called), default=0)
    return [link for chain, link in called.items() if len(chain) == most]


def chains_of(
    robot: Robot, base: str | None, tip: str | None = None
) -> dict[tuple[str, ...], list[str]]:
    """The links that drives move, by their joints, the likeliest tips first.

    Those usual for a tool come first, then leaves.

    Raises:
        InputError: If there is no such base or tip.
        RobotError: If no chain can be used.
    """

    def order(link: str) -> tuple[int, bool]:
        ranks = (k for k, part in enumerate(USUAL) if part in _name_parts(link))
        return next(ranks, len(USUAL)), link not in robot.leaves

    chains = dict[tuple[str, ...], list[str]]()
    for link in robot.links if tip is None else ():
        with suppress(CalibPinError):
            drives = drives_of(Chain(robot, base, link))
            chains.setdefault(tuple(drives), []).append(link)
    chains.pop((), None)
    if not chains:  # Of which the robot says why.
        tip = tip or min(robot.leaves, key=order)
        chains[tuple(drives_of(Chain(robot, base, tip)))] = [tip]
    return {joints: sorted(links, key=order) for joints, links in chains.items()}


def _one_chain_looks(
    robot: Robot, setup: Setup, columns: Sequence[Foreign], named: dict[str, Foreign]
) -> list[Look]:
    """Columns that may be those of the joints of a chain, likeliest first.

    Args:
        robot: The robot.
        setup: Base and tip of the chain, as far as they are known.
        columns: Those of a file.
        named: Those that are called like joints of the robot, by joint.
    """
    chains = chains_of(robot, setup.base, setup.tip)
    whole = [{*chain} for chain in chains if named.keys() >= {*chain}]
    fullest = max(chains, key=lambda chain: (len({*chain} & named.keys()), -len(chain)))
    missing = [joint for joint in fullest if joint not in named]
    if len(fullest) - len(missing) >= max([FEWEST, *(len(c) + 1 for c in whole)]):
        end = chains[fullest][0]
        reason = f"no column for {', '.join(missing)} of the chain to '{end}'"
        used = {column.name for column in named.values()} | measured_columns.reserved()
        free = {column.name for column in columns} - used
        hints = filter(None, (closest(joint, free) for joint in missing))
        hint = next(hints, advice(Chain(robot, setup.base, end), missing))
        raise InputError(reason + hint)
    if whole:
        # A file may hold those that follow, too.
        follow = {j: mimic.leader for j, mimic in robot.mimics.items()}
        return [
            Look(setup, {j: named[j] for j in named if follow.get(j, j) in chain}, tips)
            for chain, tips in chains.items()
            if {*chain} in whole and not any({*chain} < other for other in whole)
        ]
    meant = [k for choices in headers.measured(columns).values() for k in choices]
    looks, ordered = [], [k for k in columns if k.numeric and k not in meant]
    for family in [*headers.families(columns), ordered]:
        # Columns behind those of the longest chain are those of external axes.
        most = max((n for n in map(len, chains) if n <= len(family)), default=0)
        if family is ordered and len(family) != most:
            break
        for chain in (chain for chain in chains if len(chain) == most >= FEWEST):
            joints = dict(zip(chain, family, strict=False))
            kinds = {j: ANGLE if turns(robot.model, j) else LENGTH for j in joints}
            if all(not k.unit or k.unit in kinds[j].units for j, k in joints.items()):
                looks.append(Look(setup, joints, chains[chain], "as on the robot"))
    return looks


def readings(look: Look, robot: Robot, columns: Sequence[Foreign]) -> Iterator[Look]:
    """Readings of a file that its names and numbers allow, likeliest first."""
    joints, setup = look.joints, look.setup
    headers.require_units(joints.values())
    setup = replace(setup, tip=setup.tip or next(iter(look.tips), None))
    used = {one.name for one in joints.values()}
    rest = [one for one in columns if one.name not in used]
    others = {*POSITION, *measured_columns.ORIENTED, *measured_columns.optional()}
    for name in measured_columns.asked_models(setup.model):
        others -= measured_columns.optional(name).keys()
    names = {
        ours: one
        for ours, (one, *_) in headers.measured(rest).items()
        # Other words divide a file in other ways.
        if ours != "set" or one.name == "set" or {*one.column.words} <= {*SETS}
        if ours not in others
    }
    inverted = replace(setup.reading, inverted=True)
    setups = [setup, replace(setup, reading=inverted)]
    if (camera := setup.camera) is not None:
        mounts = (replace(camera, mount=mount) for mount in ("hand", "world"))
        setups = [replace(setup, camera=camera) for camera in mounts]
    for spatial, start in product(headers.vectors(rest) or [{}], setups):
        oriented = bool({*spatial} - {*POSITION})
        if start.reading.inverted and not oriented:
            continue
        models: Sequence[str | None] = [setup.model]
        if setup.model is None and spatial:  # Whatever else is in the file.
            models = [None if oriented else "position"]
        elif setup.model is None:
            models = DISTANCES if "distance" in names else TOUCHES[:1]
        by_name = {**names, **spatial}
        # The scatter of numbers is in their unit.
        sigmas = {f"sigma_{ours}" for ours, one in by_name.items() if one.unit is None}
        by_name |= {k.name: k for k in rest if k.name in sigmas and k.unit is None}
        for units, model in product(_units(robot, joints, by_name), models):
            theirs = {
                ours: text
                for ours, one in {**joints, **by_name}.items()
                for text in [one.setup_name(units.get(ours, one.unit))]
                if one.name != ours or text not in (ours, one.column.header)
            }
            position = spatial["x"].name if spatial else ""
            candidate = replace(start, model=model, columns=theirs)
            yield replace(look, setup=candidate, units=units, position=position)


def _units(
    robot: Robot, joints: Mapping[str, Foreign], by_name: Mapping[str, Foreign]
) -> list[dict[str, str]]:
    """Units of columns that state none, where they may be in others than rad and m."""
    free = {joint: one for joint, one in joints.items() if one.unit is None}
    turning = {joint: one for joint, one in free.items() if turns(robot.model, joint)}
    steps = counted(np.concatenate([[], *(k.column.numbers for k in turning.values())]))
    every = dict.fromkeys(turning, steps or "deg")
    # A joint that stands still, as a gripper in percent, tells no unit.
    far = {j: "deg" for j, one in turning.items() if one.moves and one.largest > TURNED}
    slides = dict.fromkeys(free.keys() - turning.keys(), "mm")
    kinds = {f"{p}{n}": k for n, k in measured().items() for p in ("", "sigma_")}
    plain = [n for n, one in by_name.items() if one.unit is None and n in kinds]
    angles = {name: by_name[name] for name in plain if kinds[name].si == ANGLE.si}
    lengths = [name for name in plain if kinds[name].si == LENGTH.si]
    degrees = any(one.largest > TURNED for one in angles.values())
    oriented = dict.fromkeys(angles if degrees else (), "deg")
    turned = [every] if steps else [every, far] if far else [far, every]
    metric = [oriented, oriented | dict.fromkeys(lengths, "mm")]
    options = [{**a, **b, **c} for a, b, c in product(turned, [{}, slides], metric)]
    return [units for k, units in enumerate(options) if units not in options[:k]]


def with_errors(look: Look, robot: Robot, files: Sequence[Path], apart: bool) -> Look:
    """A reading with the errors that it leaves the nominal robot."""
    setup, remarks = look.setup, list[str]()
    try:
        names = () if setup.tip is None else ("",)
        chains = Chains(robot, setup.base, setup.tip, setup.chains, names)
        data = read_measurements(
            list(files),
            chains,
            model=setup.model,
            columns=setup.columns,
            reading=setup.reading,
            station_per_file=apart,
            notice=remarks.append,
        )
        chains = chains.named(tuple(key.chain for key in data.keys))
        require_motion(data)
        rows, rank = subset(data)
        ready = registered_robot(chains, rows, setup)
        known, parameters = distinct_values(ready.problem), ready.problem.parameters
        unknown = int(np.sum(parameters.free & parameters.nuisance))
        if known <= unknown:
            reason = f"{known} numbers are too few for {unknown} of instrument and tool"
            raise InputError(reason, file=files[0])
        errors, share = _errors(ready)
        case = Case(data, QuickFit(ready.problem, ready.theta), rank, ready.theta)
        exact = next(computed_values(case), None)
        if share >= FITS and (far := _far_off(ready, len(rows))).any():
            # Of lost targets that nothing else marks a few are enough to hide a fit.
            errors, share = _errors(registered_robot(chains, rows.rows(~far), setup))
            first = rows.source(int(np.argmax(far)))
            text = f"{np.count_nonzero(far)} of {len(rows)} measurements"
            remarks.append(f"far off all others: {text}, the first is {first}")
    except CalibPinError as error:
        return replace(look, fault=error, data=None)
    look = replace(look, chains=chains, data=data, errors=errors, share=share)
    return replace(look, exact=exact, remarks=remarks)


def _in_conventions(looks: Sequence[Look], look_at: Try) -> list[Look]:
    """The same readings, orientations in the convention that fits best.

    Of each position the one with the units that fit: with others no convention does.
    """
    turned = [look for look in looks if "orientation" in look.errors]
    turned.sort(key=lambda look: look.share, reverse=True)
    likely = {look.position: look for look in turned}  # The last counts.
    return [
        _in_convention(look, look_at) if likely.get(look.position) is look else look
        for look in looks
    ]


def _in_convention(look: Look, look_at: Try) -> Look:
    """A reading with its orientations in the convention that fits best.

    The one that columns are called by comes first. What the orientation was taken for
    is a remark, with the conventions that fit about as well.
    """
    assert look.data is not None and look.chains is not None
    ways = {block.orientation for block in look.data.blocks} - {""}
    if len(ways) != 1:
        return look
    (way,), setup, tries = ways, look.setup, [look]
    case = Case.of_none(look.chains, look.data, setup)
    for candidate in orientations(case, 1.0 / CLEAR):
        if (held := candidate.reading.orientation) is not None:
            reading = replace(setup.reading, orientation=held)
            tries.append(look_at(replace(look, setup=replace(setup, reading=reading))))
    least = min(k.errors.get("orientation", inf) for k in tries)
    if least > DROPPED:
        return look
    close = [k for k in tries if CLEAR * k.errors.get("orientation", inf) <= least]
    theirs = [setup.columns.get(name, name) for name in STATED[way]]
    called = all(n in text.lower() for n, text in zip(STATED[way], theirs, strict=True))
    if called and len(close) == 1 and close[0] is look:
        return look
    texts = list[str]()
    for k in close:
        held = k.setup.reading.orientation
        text = written({"columns": way, **(lines_of(held) if held else {})})
        texts.append(f"'{text}' ({shown(k.errors['orientation'], 'rad')})")
    remark = f"the orientation in {', '.join(theirs)} is taken for {texts[0]}"
    if texts[1:]:
        remark += f"; others fit about as well: {enumerated(texts[1:])}"
    return replace(close[0], remarks=[*close[0].remarks, remark])


def _far_off(ready: Registered, count: int) -> Booleans:
    """Which of so many errors are far off all others; none where these are many."""
    sizes = error_sizes(ready.problem, ready.theta)[0][2]
    far: Booleans = sizes > FAR * np.median(sizes)
    few = len(far) == count and far.mean() <= FEW
    return far if few else np.zeros(count, bool)


def _errors(ready: Registered) -> tuple[dict[str, float], float]:
    """Root mean square errors by quantity, and the first in parts of the motion."""
    errors = {n: rms(of) for n, _, of in error_sizes(ready.problem, ready.theta)}
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
    return errors, share


def best(looks: Sequence[Look]) -> Look:
    """The likeliest of the readings that fit best; no orientation where none fits.

    Args:
        looks: Readings, the likeliest first.

    Raises:
        InputError: If the nominal robot fits to a file as no instrument sees one.
    """
    whole = [look for look in looks if look.errors]
    exact = {k.position: k.exact for k in whole if k.exact is not None and k.position}
    others = any(k.fits for k in whole if k.position not in exact)
    # Where the steps of joints make it likely only, there must be others to take.
    computed = {n for n, of in exact.items() if others or of.severity == "error"}
    seen = [look for look in whole if look.position not in computed]
    if computed and not seen:
        raise InputError(exact[whole[0].position].message)
    turned = [k for k in seen if k.errors.get("orientation", 0.0) <= DROPPED] or seen
    least = min((look.share for look in turned), default=inf)
    # Where none is read, the one with the most small units fails for no unit.
    read = (k for k in turned if CLEAR * k.share <= least)
    chosen = next(read, max(looks, key=lambda look: len(look.units)))
    remarks = [*chosen.remarks]
    if chosen.exact is not None:
        remarks.append(chosen.exact.message)
    close = [k for k in seen if k.position not in ("", chosen.position)]
    close = [k for k in close if chosen.fits and CLEAR * k.share <= chosen.share]
    if close:
        other = min(close, key=lambda look: look.share)
        size = shown(next(iter(other.errors.values())), "m")
        text = f"the position is that of '{chosen.position}', and "
        remarks.append(f"{text}'{other.position}' fits to {size}: correct 'columns'?")
    return replace(chosen, remarks=remarks, computed=sorted(computed))


def draft(robot: Robot, look: Look, command: str) -> str:
    """The setup file that a reading of measurements leads to.

    Args:
        robot: The robot.
        look: The reading.
        command: The command line that it comes from.
    """
    assert look.data is not None
    document = {**setup_document(look.setup), "model": "+".join(look.data.models)}
    parts = ["\n".join(map(_comment, _head(robot, look, command)))]
    for key, comment in _comments(look).items():
        if key in document:
            parts.append(f"{_comment(comment)}\n{_lines(key, document[key], look)}")
    parts.append(INTERNAL)
    if any(declared(name).external for name in look.data.models):
        parts[-1] = EXTERNAL
    quantity = next(iter(look.errors))
    unit, usual = ("px", "0.3") if quantity == "pixel" else ("m", "1.0e-4")
    parts[-1] += f"\n# State the noise of the instrument if you know it [{unit}]:"
    parts[-1] += f"\n# noise: {{{quantity}: {usual}}}\n"
    return "\n\n".join(parts)


def _comments(look: Look) -> dict[str, str]:
    """Comments of keys, in the order of the file."""
    assert look.data is not None
    blocks, why = look.data.blocks, look.hand_set
    others = enumerated(link for link in look.tips if link != look.setup.tip)
    helps = "; ".join(declared(name).help for name in look.data.models)
    camera = " Corners of images are better than poses computed from them ('detect')."
    gauge = " In 'dial' pushed in is positive, in 'deviation' it is negative."
    gauged = any(declared(b.model).contact and b.values.shape[1] for b in blocks)
    families = f"The zeros of the joints alone: {why}. Others: placement."
    usual = "Six errors at every joint. Others: joint-offset, transmission, compliance."
    return {
        "base": "The chain starts here.",
        "tip": "The link that carries the tool."
        + f" The same joints move {others}." * bool(others),
        "chains": "The links that the names in the column 'chain' stand for.",
        "model": f"Measured: {helps}."
        + camera * ("pose" in look.data.models)
        + gauge * gauged,
        "parameters": families if why else usual,
        "prior": "Zeros that were set by hand are off by about 5 degrees [rad].",
        "columns": "Our names of columns, and those of the file with their units.",
        "reading": "How the poses are to be read so that they fit the robot.",
        "board": "The board; its points are known.",
        "camera": "A first guess; camera-info also needs 'size: [width, height]'.",
        "distances": "Known distances [m]: they give the robot its size.",
    }


def _head(robot: Robot, look: Look, command: str) -> Iterator[str]:
    """Comments on the whole, and on how well the nominal robot fits."""
    yield f"Setup file of calib-pin, drafted by: {command}"
    units = {"orientation": "rad", "pixel": "px"}
    fits = (f"{shown(k, units.get(n, 'm'), 3)} ({n})" for n, k in look.errors.items())
    text = f"{len(look.data or ())} measurements of {robot.name}. The nominal robot "
    text += f"fits to {', '.join(fits)} rms with this setup"
    text += f": {100 * look.share:.2g} % of its motion" * (look.share < inf) + "."
    if not look.fits:
        text += " That is NO fit: a column has another meaning, or these are not "
        text += "measurements of this robot. Correct what is wrong below."
    yield text
    if look.computed:
        names = enumerated(look.computed)
        yield f"The controller computed {names} from the joints: others are taken."


def _lines(key: str, value: Any, look: Look) -> str:
    """A key as it stands in the file, columns each on a line of its own."""
    if key != "columns":
        return yaml_text({key: value})
    lines = [f"# Joints are known by the order alone, {look.order}."] * bool(look.order)
    lines.append("columns:")
    for ours, theirs in value.items():
        comment = "  # (unit by its numbers)" * (ours in look.units)
        lines.append(f"  {yaml_text({ours: theirs})}{comment}")
    return "\n".join(lines)


def _comment(text: str) -> str:
    """A comment, of a long text in several lines."""
    line, more = f"# {text}", "#   "
    return textwrap.fill(line, WIDTH, subsequent_indent=more, break_long_words=False)
