"""How a file could be read otherwise: joints, lines, axes, units, targets, robot.

Each kind is a generator of alternatives, which are tried by `alternatives`; of two
columns for the same joints it is known what the other one says, and both are fitted.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, permutations, product
from typing import Any, Literal

import numpy as np

from calib_pin.errors import CalibPinError, RobotError, enumerated
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import error_table
from calib_pin.estimation.terms import FRAME, Term
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats, from_quaternion, to_quaternion
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.camera_start import pose_of_points
from calib_pin.measurement_models.orientations import numbers_of, quaternions
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.measurement_models.readings import (
    SHIFTS,
    from_below,
    in_files,
    measured_lengths,
    place_of,
    places_of,
    postures,
    with_positions,
    with_values,
)
from calib_pin.measurement_models.references import Plane
from calib_pin.observations import (
    FRAMES,
    BlockKey,
    Booleans,
    Frame,
    Indices,
    Labels,
    Measurements,
    Observations,
    apart,
)
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import (
    AXES,
    HELD,
    TAGS,
    ConvertedSetup,
    FrameSetup,
    JointMap,
    OrientationSetup,
    ReadingSetup,
)
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.alternatives import (
    FITTED,
    NEIGHBORS,
    Alternative,
    Explanation,
    JointReading,
)
from calib_pin.validation.findings.case import (
    ABSURD,
    COMPARED,
    Case,
    QuickFit,
    held_as,
    located,
    unlikely,
)
from calib_pin.validation.findings.sentences import lines_of, shown, written

TURNS, GEARS = (90.0, -90.0, 180.0), (2.0, 0.5)
"""Offsets between the zeros of a controller and of a URDF [deg], and gears of which the
motion of a joint is often told before or behind."""

ROWS, SEEDS = 60, 8
"""Measurements of a block by which conventions are compared, and those with whose
rotation all others are."""

LIKELY = 0.3
"""Part of the disagreement as it is read that a convention may leave."""

MOST = 3
"""Conventions, and sets of columns, that are tried with the robot."""

DEGREE = np.pi / 180.0

REACH = {"rad": 2.0 * np.pi, "m": 10.0}
"""Largest positions that joints have, by their unit."""

FEWEST, TARGETS, GROUPS = 3, 20, 5
"""Fewest measurements of a target that contradict together, or points of a board, and
most targets and groups of them that are tried; each has a frame of its own to fit."""

MOUNTS: dict[Literal["hand", "world"], str] = {
    "hand": "moves with the tool",
    "world": "stands still",
}
"""Where a camera may be."""

ABSORBED = 4.0
"""Factor by which six numbers of a frame make errors of a robot smaller: they are half
as large on six joints, and less than a third on three."""

PIXEL = ("u", "v")
"""Column and row of a point in an image."""

SQUARE, FLAT = 1e-3, 2e-3
"""Cosine of axes that are at right angles, and distance from a plane of points in it
[m], of robots that look the same in a mirror but for their errors."""

FARTHEST = 10
"""Most lines by which joint positions may stand elsewhere."""

SEVERAL, NEAREST = 2, 3
"""Lines of a configuration from which these may stand elsewhere together, and how many
of them."""

SHIFTED = {"shift": "line", "shift_configurations": "configuration"}
"""Words of what joint positions are shifted by, by the keys of a reading."""

SIDE, APART = 6, 4.0
"""Fewest measurements on each side of a lost line, and factor by which these err less
than if they were on the other side, in the geometric mean."""

STRETCH = 0.1
"""Part of all measurements from which some in a row were measured otherwise."""

FACTORS = {
    1e-3: "mm read as m",
    1e-2: "cm read as m",
    0.0254: "inches read as m",
    0.3048: "feet read as m",
    0.9144: "yards read as m",
    1e3: "m read as mm",
    10.0: "cm read as mm",
    25.4: "inches read as mm",
    1.0 / 25.4: "mm read as inches",
    1.0 / 0.0254: "m read as inches",
    1.0 / 0.3048: "m read as feet",
    0.1: "mm read as cm",
    100.0: "m read as cm",
    0.5: "counted there and back",
    2.0: "halves of what they should be",
}
"""Mistakes of a unit by the factor that undoes them."""


def joint_columns(case: Case) -> Iterator[Alternative]:
    """Joints reversed, offset, exchanged, in degrees, geared, coupled: likely first."""
    joints, of_base = case.data.joints, turned_by_base(case)
    count = len(joints)
    turning = [j for j, joint in enumerate(joints) if case.unit(joint) == "rad"]
    for j in range(count):
        yield _joint("joint-reversed", joints, j, "is reversed", {j: -1.0})
    for j, turn in product(turning, TURNS):
        # The frame of the base, which is another explanation, tells some of them.
        if joints[j] != of_base:
            yield offset_by(joints, j, turn * DEGREE)
    for order in _orders(count):
        moved = [f"'{joints[k]}'" for k, other in enumerate(order) if k != other]
        words = f"the columns of joints {', '.join(moved[:-1])} and {moved[-1]} are "
        read = JointReading(np.eye(count)[list(order)], np.zeros(count))
        subject = "order of the joint columns"
        yield Alternative("joints-exchanged", f"{words}exchanged", subject, joints=read)
    yield from _units_of_joints(case)
    for j, factor in product(range(count), GEARS):
        yield geared(joints, j, factor)
    # Robots couple a joint to those before it.
    for (other, j), factor in product(combinations(turning, 2), (1.0, -1.0)):
        yield coupled(joints, j, other, factor)


def _units_of_joints(case: Case) -> Iterator[Alternative]:
    """Joints in deg or mm that were read as rad or m, or the other way round.

    Each alone, or all at once that can be: smaller angles would be next to none in
    degrees, where any wrong joint looks better, and larger ones turns in radians.
    """
    largest = np.abs(case.data.q).max(axis=0)
    for si, reach in REACH.items():
        unit, factor = DISPLAY[si]
        members = np.array([case.unit(joint) == si for joint in case.data.joints])
        small = (largest > 0.0) & (factor * largest < reach)
        for times, possible, words in (
            (1.0 / factor, largest > reach, f"are in {unit}"),
            (factor, small, f"are in {si}, and were read as {unit}"),
        ):
            columns = np.flatnonzero(members & possible).tolist()
            names = tuple(case.data.joints[j] for j in columns)
            for group in dict.fromkeys([*((name,) for name in names), names]):
                read = ReadingSetup(converted=(ConvertedSetup(times, joints=group),))
                text = f"the positions of {enumerated(group)} {words}"
                if group:
                    yield Alternative("joint-degrees", text, f"unit in {si}", read)


def offset_by(
    joints: Sequence[str], joint: int, offset: float, turns: bool = True
) -> Alternative:
    """A joint whose zero is elsewhere, by its position among all [rad, m]."""
    words = f"is offset by {shown(offset, 'rad' if turns else 'm', 4)}"
    return _joint("joint-offset", joints, joint, words, {}, offset)


def geared(joints: Sequence[str], joint: int, factor: float) -> Alternative:
    """A joint that moves some times as far as its column says."""
    words = f"moves {factor:.5g} times as far as read"
    fault = _joint("joint-gear", joints, joint, words, {joint: factor})
    return replace(fault, joint="")


def coupled(
    joints: Sequence[str], joint: int, other: int, factor: float, by: str = ""
) -> Alternative:
    """A joint whose column counts from another one, with words of how much."""
    words = f"is coupled to '{joints[other]}'{by}"
    return _joint("joint-coupled", joints, joint, words, {other: factor})


def _joint(
    code: str,
    joints: Sequence[str],
    joint: int,
    words: str,
    factors: Mapping[int, float],
    offset: float = 0.0,
) -> Alternative:
    """A joint, by its place, that is read with some factors of the columns."""
    name, reading = joints[joint], JointReading.plain(len(joints))
    reading.offsets[joint] = offset
    for column, factor in factors.items():
        reading.factors[joint, column] = factor
    words, subject = f"joint '{name}' {words}", f"{code} {name}"
    fault = Alternative(code, words, subject, joints=reading, joint=name)
    return replace(fault, figure="by-joint")


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Other orders of so many columns: two exchanged, three shifted round, reversed."""
    plain = tuple(range(count))
    for first, second in combinations(plain, 2):
        swap = {first: second, second: first}
        yield tuple(swap.get(k, k) for k in plain)
    for k in plain[:-2]:
        for order in ((k + 1, k + 2, k), (k + 2, k, k + 1)):
            yield (*plain[:k], *order, *plain[k + 3 :])
    if count > 3:
        yield plain[::-1]


def line_order(case: Case) -> Iterator[Alternative]:
    """Explanations by the order of the joint positions, the likeliest kinds first."""
    files = in_files(case.data)
    count = sum(int(postures(case.data.q[rows])[-1]) + 1 for rows in files)
    for lines in range(1, min(FARTHEST, max(map(len, files)) // 2) + 1):
        yield _shifted(lines)
        yield _shifted(-lines)
    if SEVERAL * count < len(case.data):
        for k in range(1, min(NEAREST, count // 2) + 1):
            yield _shifted(k, "shift_configurations")
            yield _shifted(-k, "shift_configurations")
    words, subject = "the joint positions stand in reversed order", "order of the lines"
    yield Alternative("lines-reversed", words, subject, ReadingSetup(reversed=True))


def _shifted(number: int, key: str = "shift", place: str = "") -> Alternative:
    """Joint positions so many lines, or configurations, below or above their own."""
    where, far = "below" if number > 0 else "above", abs(number)
    words = f"from line {place} on " if place else ""
    words += f"the joint positions stand {far} {SHIFTED[key]}{'s' * (far > 1)} {where} "
    words += "their measurement"
    shift: dict[str, Any] = {key: number, "shift_from": (place,) if place else ()}
    reading = ReadingSetup(**shift)
    fault = Alternative("lines-shifted", words, "order of the lines", reading)
    return replace(fault, figure="over-order" if place else "")


def lost_line(case: Case) -> Explanation | None:
    """Joint positions that stand elsewhere from some line on, where one was lost.

    Or those of all lines, where a fit has set aside the one line of every image that is
    wrong then; of all of them there are other explanations, too.
    """
    aside = case.fitted is not None and np.sum(case.data.weight == 0.0) >= SIDE
    if not (case.doubtful or aside):
        return None
    data = case.data
    # Some of the measurements may tell of some blocks alone.
    robots = [case.fit] if case.fit.problem.terms.keys() >= {*data.keys} else []
    third = np.argsort(data.in_order) * 3 // len(data)
    if case.doubtful:
        robots += _nominal_fit(case, data, third == 0)
    of_each = len(data) // data.configurations
    shifts = [("shift", k) for k in dict.fromkeys((1, 2, of_each))]
    shifts += [("shift_configurations", 1)] * (of_each >= SEVERAL)
    signed = ((key, sign * far) for (key, far), sign in product(shifts, (1, -1)))
    last = third == 2
    trials = (_shifted_from(case, *by, robots, last) for by in signed)
    # What leaves most of the errors is another fault.
    clear = (e for explanations in trials for e in explanations if e.part < FITTED)
    return min(clear, key=lambda explanation: explanation.after, default=None)


def _shifted_from(
    case: Case, key: str, shift: int, robots: Sequence[QuickFit], last: Booleans
) -> Iterator[Explanation]:
    """The likeliest line of each file from which on positions are shifted, if any is.

    By the robot that was fitted, which may have set aside what is behind that line, and
    by the nominal one where the first or the last third of the measurements has it.

    Args:
        case: The case.
        key: The key of the reading that shifts them.
        shift: By how much.
        robots: Robots that stand where the lines before may have them.
        last: The last third of the measurements, shape (N,).
    """
    data, quantity = case.data, case.fit.quantity
    has = [quantity in declared(block.model).quantities for block in data.blocks]
    measured, unit = np.array(has)[data.block_of], expected_size(quantity.unit)
    source = from_below(data, shift, SHIFTS[key])
    shifted = with_positions(data, data.q[source])
    more = _nominal_fit(case, shifted, last & (source >= 0)) if case.doubtful else ()
    for robot in (*robots, *more):
        here, other = (_errors_of(robot, read) for read in (data, shifted))
        other[source < 0] = np.nan
        for rows in in_files(data):
            number = SHIFTS[key](data.q[rows])
            behind = np.searchsorted(number, number + max(-shift, 0))
            first = _first_shifted(here[rows], other[rows], behind)
            if first < 0 or (first == 0 and case.doubtful):
                continue
            errors, later = here.copy(), rows[behind[first] :]
            errors[rows[first:]] = np.nan
            errors[later] = other[later]
            sizes = (np.sqrt(np.nanmean(e[measured] ** 2)) for e in (here, errors))
            before, after = (float(unit * size) for size in sizes)
            whole = first == 0 and len(rows) == len(data)
            place = "" if whole else place_of(data, int(rows[first]))
            fault = (_shifted(shift, key, place),)
            yield Explanation(fault, before, after, robot.robot, judged="error")


def _nominal_fit(case: Case, data: Observations, part: Booleans) -> Iterator[QuickFit]:
    """The nominal robot where a part of the measurements has it, if it can be there."""
    setup = replace(case.setup, parameters=(), learned=None, fixed=(), bounds={})
    data = data.weighted(part.astype(float))
    try:
        problem = make_problem(case.chains, data, replace(setup, prior={}))
        problem = located(problem, thorough=True)
    except (CalibPinError, np.linalg.LinAlgError):
        return  # A point is behind the camera, say.
    yield QuickFit(problem, np.zeros(len(problem.parameters)), robot=False)


def _errors_of(fit: QuickFit, data: Observations) -> Floats:
    """Errors of the first quantity of each measurement, in expected sizes, (N,)."""
    problem = replace(fit.problem, data=data, expected=None)
    table, errors = error_table(problem, fit.theta), np.full(len(data), np.nan)
    for quantity in reversed(problem.layout.quantities):
        sizes = np.linalg.norm(table[:, quantity.columns], axis=1)
        sizes /= expected_size(quantity.unit)
        errors = np.where(np.isnan(sizes), errors, sizes)
    return np.asarray(np.minimum(errors, ABSURD))


def _first_shifted(here: Floats, other: Floats, behind: Indices) -> int:
    """The line from which on positions are shifted, -1 for none.

    What is before it, if anything, and what is behind it must fit far better so.

    Args:
        here: Errors as the lines are, in expected sizes, shape (n,).
        other: Errors if they are shifted, NaN of those that then have none, shape (n,).
        behind: The first line that has positions if those from a line on are shifted,
            shape (n,).
    """
    # A calibrated robot leaves less, and no less counts.
    old, new = (np.log(np.maximum(errors, 1.0)) for errors in (here, other))
    usual = float(np.nanmedian(np.fmin(old, new)))
    old, new = (np.nan_to_num(log, nan=usual) for log in (old, new))
    lines = np.arange(len(here))
    of_old, of_new = (np.append(0.0, np.cumsum(log)) for log in (old, new))
    # A line without positions costs as much as others do.
    cost = of_old[lines] - of_new[behind] + usual * (behind - lines)
    first = int(np.argmin(cost))
    sides = (new - old)[:first], (old - new)[behind[first] :]
    moved = [side[side != 0.0] for side in sides[first == 0 :]]
    clear = all(len(m) >= SIDE and m.mean() > np.log(APART) for m in moved)
    return first if clear else -1


def units(case: Case) -> Iterator[Alternative]:
    """Other units of all measured lengths."""
    blocks = [b for b in case.data.blocks if not declared(b.model).contact]
    filed = any(case.data.files.distinct)
    if any(measured_lengths(block).any() for block in blocks):
        for factor, mistake in FACTORS.items():
            words = f"the measured lengths are {mistake}"
            fault = Alternative("unit", words, "unit of lengths", gross=True)
            # Arrays are multiplied more easily than read otherwise.
            advice = "" if filed else f"multiply values by {factor:g}"
            yield replace(fault, reading=ReadingSetup(scale=factor), advice=advice)


def axes(case: Case) -> Iterator[Alternative]:
    """Other axes of positions, as far as measurements can tell them apart.

    Where nothing else shows how the measurement frame is turned, every frame is right
    but a left-handed one.
    """
    blocks = [b for b in case.data.blocks if (*declared(b.model).columns,)[:3] == AXES]
    terms, free = case.fit.problem.terms, case.fit.problem.parameters.free
    turned = any(
        declared(b.model).oriented
        or (b.key in terms and not free[terms[b.key].index[:FRAME]].all())
        for b in blocks
    )
    # Every left-handed frame is the one with all axes negated, turned.
    mirrored = ("-x", "-y", "-z") if turned else ("x", "y", "-z")
    if flipped := [] if turned or not blocks else mirrored_joints(case):
        # A point of the tool that is known beside the plane of the arm tells the sides.
        ends = [t.index[len(t.error.screws) - FRAME :] for t in terms.values()]
        ambiguous = all(free[index].any() for index in ends)
        yield _mirrored(case.data.joints, flipped, ambiguous)
        if ambiguous:
            return
    negated = [*product(*((axis, f"-{axis}") for axis in AXES))]
    orders = [order for axes in negated for order in permutations(axes)]
    for order in orders if turned else [mirrored] * bool(blocks):
        reading, subject = ReadingSetup(axes=order), "axes of positions"
        words = f"the columns x, y and z hold {', '.join(order)}"
        code = "axes-negated" if order in negated else "axes-exchanged"
        if order == mirrored:
            code, words = "left-handed-frame", "the frame of x, y and z is left-handed "
            words += "(two are exchanged, or one is negated)"
        if order != AXES:
            yield Alternative(code, words, subject, reading, gross=True)


def mirrored_joints(case: Case) -> list[int]:
    """Joints that turn the other way in the mirror image of the robot.

    Arms of which every axis lies in one plane, or is normal to it, look the same on
    both sides: where the tool is not known either, positions do not tell a left-handed
    frame from a controller that counts these joints the other way. Of other robots, and
    of several chains, none.
    """
    chain, *others = {t.error.chain for t in case.fit.problem.terms.values()}
    if others:
        return []
    frames, turning = chain.joint_frames(), chain.revolute
    # The axes, be it of turns or of slides.
    axes = np.einsum("nij,nj->ni", frames[:, :3, :3], chain.axes)
    turns = axes[turning]
    for normal in [*turns, *np.cross(turns[:-1], turns[1:])]:
        if (size := np.linalg.norm(normal)) < SQUARE:
            continue
        along = np.abs(axes @ normal / size)
        inside, across = along < SQUARE, along > 1.0 - SQUARE
        heights = frames[turning & inside, :3, 3] @ normal / size
        if (inside | across).all() and len(heights) and np.ptp(heights) < FLAT:
            flipped = np.flatnonzero(np.where(turning, inside, across)).tolist()
            return [case.data.joints.index(chain.joints[j]) for j in flipped]
    return []


def _mirrored(
    joints: Sequence[str], flipped: Sequence[int], ambiguous: bool
) -> Alternative:
    """Joints that are reversed, which a left-handed frame may look like."""
    signs = np.ones(len(joints))
    signs[flipped] = -1.0
    read = JointReading(np.diag(signs), np.zeros(len(joints)))
    names = enumerated([f"'{joints[j]}'" for j in flipped])
    words = f"joint{'s' * (len(flipped) > 1)} {names} "
    words += f"{'are' if len(flipped) > 1 else 'is'} reversed"
    fault = Alternative("joint-reversed", words, "axes of positions", joints=read)
    if not ambiguous:
        return fault
    words += ", or the frame of x, y and z is left-handed, which looks the same"
    advice = "if it is the frame, state in the setup file: reading: {axes: [x, y, -z]}"
    return replace(fault, words=words, gross=True, advice=advice)


def orientations(case: Case, likely: float = LIKELY) -> Iterator[Alternative]:
    """The conventions with which orientations agree best, and inverted poses.

    Whatever the convention, with the right one `R = R_base R_tip R_tool` holds for all
    measurements, where positions tell the base frame. So each convention is tried by
    how well the rotations `R_tip^T R_base^T R` agree, which needs no fit. Angles beyond
    those that a rotation has were lost in reading; of the rotations that they may have
    been, the nearest to the others is taken.

    Args:
        case: The measurements and the robot.
        likely: Part of the disagreement as it is read that a convention may leave.
    """
    blocks = [b for b in case.data.blocks if declared(b.model).oriented]
    if not blocks:
        return
    words = "the poses are those of the measurement frame in the tool"
    inverted = ReadingSetup(inverted=True)
    yield Alternative("pose-inverted", words, "pose of what", inverted, gross=True)
    try:
        terms = _located_terms(case, blocks)
    except (CalibPinError, np.linalg.LinAlgError):
        return
    sampled = [block.sample(ROWS) for block in blocks]
    columns = {block.orientation or "quaternion" for block in blocks}
    trials = [
        (reading, {b.key: _agreement(terms[b.key], reading, b) for b in sampled})
        for reading in (OrientationSetup(), *_conventions(columns))
    ]
    angles = [max(apart for apart, _ in agreed.values()) for _, agreed in trials]
    for k in 1 + np.argsort(angles[1:], kind="stable")[:MOST]:
        reading, agreed = trials[k]
        if angles[k] < likely * angles[0]:
            tools = {key: (terms[key], tool) for key, (_, tool) in agreed.items()}
            words = f"orientations are written otherwise ({written(lines_of(reading))})"
            fault = Alternative("orientation-convention", words, "orientations")
            setup = ReadingSetup(orientation=reading)
            change = partial(_nearest, reading=reading, tools=tools)
            yield replace(fault, reading=setup, change=change, gross=True)


def _conventions(columns: Iterable[str]) -> Iterator[OrientationSetup]:
    """All that the columns of an orientation may hold, by the ways of the files."""
    yield OrientationSetup(inverse=True)
    for way in columns:
        angles = way != "quaternion"
        for factor in (DEGREE, 1.0 / DEGREE) if angles else ():
            yield OrientationSetup(way, factor=factor)
        for hold in HELD:
            same = hold == way or (way, hold) == ("roll-pitch-yaw", "extrinsic-xyz")
            if not same and (hold != "wxyz") == angles:
                yield OrientationSetup(way, hold)
                yield OrientationSetup(way, hold, inverse=True)


def _located_terms(case: Case, blocks: Sequence[Measurements]) -> dict[BlockKey, Term]:
    """The terms of blocks where positions alone find the robot."""
    sampled = [replace(b.sample(ROWS), model="position", sigma=None) for b in blocks]
    data = Observations.of(*(replace(b, values=b.values[:, :3]) for b in sampled))
    setup = replace(case.setup, parameters=(), learned=None, fixed=(), bounds={})
    problem = make_problem(case.chains, data, replace(setup, prior={}))
    problem, solution = register(problem, np.zeros(len(problem.parameters)))
    terms = problem.rebased(solution.x)[0].terms
    return {b.key: terms[b.key._replace(model="position")] for b in blocks}


def _tools(
    term: Term, reading: OrientationSetup, block: Measurements
) -> tuple[Floats, Floats]:
    """Quaternions that orientations may be, and the tool's with each, (A, N, 4)."""
    columns = block.orientation or "quaternion"
    values = numbers_of(block.values[:, 3:], columns, turns=reading.factor != 1.0)
    rotations = np.stack([quaternions(numbers, columns, reading) for numbers in values])
    tip = term.error.chain.poses(block.q[:, term.columns])[:, :3, :3]
    to_tip = np.swapaxes(term.error.base.rotation @ tip, 1, 2)
    return rotations, to_quaternion(to_tip @ from_quaternion(rotations))


def _agreement(
    term: Term, reading: OrientationSetup, block: Measurements
) -> tuple[float, Floats]:
    """Typical disagreement about the tool [rad], and what most agree on."""
    _, tools = _tools(term, reading, block)
    seeds = tools[:, :: max(1, tools.shape[1] // SEEDS)].reshape(-1, 4)
    nearest = np.abs(np.einsum("sk,ank->san", seeds, tools)).max(axis=1)
    typical = np.median(nearest, axis=1)
    best = int(np.argmax(typical))
    return 2.0 * float(np.arccos(min(typical[best], 1.0))), seeds[best]


def _nearest(
    data: Observations,
    reading: OrientationSetup,
    tools: Mapping[BlockKey, tuple[Term, Floats]],
) -> Observations:
    """Measurements as the reader of files would have read them."""

    def change(block: Measurements, _: object) -> Floats:
        if block.key not in tools:
            return block.values
        term, tool = tools[block.key]
        rotations, of_tool = _tools(term, reading, block)
        near = np.abs(of_tool @ tool).argmax(axis=0)
        return np.hstack([block.values[:, :3], rotations[near, np.arange(len(block))]])

    return with_values(data, change)


def targets(case: Case) -> Iterator[Alternative]:
    """Each of several targets left out; single outliers are found by the fit."""
    data, target = case.data, case.data.target
    counts = np.bincount(target.codes, minlength=len(target.names))
    if len(data) > NEIGHBORS or not 1 < np.count_nonzero(counts) <= TARGETS:
        return
    enough = (counts >= FEWEST) & (counts < len(data) / 2)
    for code in np.flatnonzero(enough).tolist():
        rows = np.flatnonzero(target.codes == code).tolist()
        words = f"the measurements of target '{target.names[code]}' contradict all "
        reading = ReadingSetup(without=places_of(data, rows))
        fault = Alternative("target", f"{words}others", "target", reading)
        yield replace(fault, figure="over-order")


def standing(case: Case) -> Iterator[Alternative]:
    """A stretch of the files in which the reading of a joint stands still, left out."""
    data = case.data
    for joint, rows in still_stretches(data):
        few = len(np.unique(data.groups()[rows])) < FEWEST
        if few or not STRETCH * len(data) <= len(rows) < len(data) / 2:
            continue
        words = f"the reading of joint '{joint}' does not change in "
        reading = ReadingSetup(without=places_of(data, rows.tolist()))
        words += f"{len(rows)} measurements from line {reading.without[0]} on"
        fault = Alternative("stuck-encoder", words, "stretch", reading, gross=True)
        yield replace(fault, figure="over-order")


def still_stretches(data: Observations) -> Iterator[tuple[str, Indices]]:
    """Each joint, and the longest stretch of the files in which it is read as still."""
    order = data.in_order
    for joint, q in zip(data.joints, data.q[order].T, strict=True):
        run = np.cumsum(np.diff(q, prepend=q[:1]) != 0.0)
        yield joint, order[run == np.argmax(np.bincount(run))]


def target_names(case: Case) -> Iterator[Alternative]:
    """Corners that are counted otherwise, and two of few targets that are exchanged."""
    names, board = case.data.target.distinct, case.setup.board
    if board is not None and board.type in TAGS:
        yield from _corners_of_tags(names)
    if board is not None and board.type in ("chessboard", "circles"):
        yield from _half_turned(case, np.array([p.xyz for p in board.points.values()]))
    if board is not None and "0" not in names and all(map(str.isdigit, names)):
        words = "the numbers of the targets begin with 1, and those of the board with 0"
        change = partial(_renamed, names={name: str(int(name) - 1) for name in names})
        fault = Alternative("targets-exchanged", words, "target", change=change)
        yield replace(fault, gross=True, advice="subtract 1 from each of them")
    for first, second in combinations(names, 2) if len(names) <= TARGETS else ():
        words = f"the targets '{first}' and '{second}' have the name of each other"
        change = partial(_renamed, names={first: second, second: first})
        fault = Alternative("targets-exchanged", words, "target", change=change)
        yield replace(fault, advice="exchange the two names", figure="over-order")


def _corners_of_tags(names: Iterable[str]) -> Iterator[Alternative]:
    """Corners of tags from another one on, or counterclockwise, as detectors count."""
    tags = {name.rpartition("/")[0] for name in names}
    words = "the corners of the tags are not counted clockwise from the upper left one"
    for start, step in [*product(range(4), (1, -1))][1:]:
        order = [(start + step * corner) % 4 for corner in range(4)]
        pairs = product(tags, enumerate(order))
        renamed = {f"{tag}/{k}": f"{tag}/{corner}" for tag, (k, corner) in pairs}
        change = partial(_renamed, names=renamed)
        fault = Alternative("targets-exchanged", words, "target", change=change)
        yield replace(fault, advice="name them so")


def _half_turned(case: Case, board: Floats) -> Iterator[Alternative]:
    """Points of a board, (J, 3), that some images count from its other end."""
    data, last = case.data, len(board) - 1
    corners = {str(k): str(last - k) for k in range(len(board))}
    known = corners.keys() >= {*data.target.distinct}
    if len(data.blocks) != 1 or len(data) > NEIGHBORS or not known:
        return

    def upright(data: Observations) -> Observations:
        (block,), turned = data.blocks, _turned_images(case, data, board)
        pairs = zip(block.target, turned.tolist(), strict=True)
        names = [corners[name] if other else name for name, other in pairs]
        return Observations((replace(block, target=Labels.of(names)),))

    rows = np.flatnonzero(_turned_images(case, data, board))
    first = np.sort(rows[np.unique(data.groups()[rows], return_index=True)[1]]).tolist()
    words = f"the board looks the same turned by half a turn, as {len(first)} of "
    words += f"{data.configurations} images show it"
    where = enumerated(places_of(data, first))
    advice = f"count the corners of the images at lines {where} from the other end, or "
    advice += "take a board that looks different turned"
    if first:
        fault = Alternative("targets-exchanged", words, "target", change=upright)
        yield replace(fault, gross=True, advice=advice)


def _turned_images(case: Case, data: Observations, board: Floats) -> Booleans:
    """The rows of images of a board, (J, 3), that the robot says are turned, (N,).

    Between two images camera and board turn by the angle of the robot, wherever both
    are fixed. Which images belong together is the first eigenvector of how much better
    these angles agree (Singer, "Angular synchronization", 2011).
    """
    (block,), images, term = data.blocks, data.groups(), case.fit.problem.only
    rays = Camera.from_setup(case.setup).rays(block.values)
    points = board[np.array([*map(int, block.target)])]
    seen = {g: images == g for g in np.unique(images).tolist()}
    poses = {g: pose_of_points(points[k], rays[k]) for g, k in seen.items()}
    rotations = {g: T[:3, :3] for g, T in poses.items() if T is not None}
    if len(rotations) < FEWEST:
        return np.zeros(len(data), bool)
    q = np.array([block.q[seen[g]][0, term.columns] for g in rotations])
    robot = term.error.chain.poses(q)[:, :3, :3].reshape(-1, 9)
    R = np.array([*rotations.values()])
    of_board, turned = R.reshape(-1, 9), (R * [-1.0, -1.0, 1.0]).reshape(-1, 9)
    pairs = (robot, robot), (of_board, of_board), (turned, of_board)
    cosines = [np.clip((one @ two.T - 1.0) / 2.0, -1.0, 1.0) for one, two in pairs]
    by_robot, plain, other = map(np.arccos, cosines)
    agree = np.abs(other - by_robot) - np.abs(plain - by_robot)
    along = np.linalg.eigh(agree)[1][:, -1]
    few = np.array([*rotations])[along * along.sum() < 0.0]
    return np.asarray(np.isin(images, few))


def _renamed(data: Observations, names: Mapping[str, str]) -> Observations:
    """Measurements whose targets have other names."""

    def renamed(name: str) -> str:
        return names.get(name, name)

    blocks = (replace(b, target=b.target.map(renamed)) for b in data.blocks)
    return Observations(tuple(blocks))


def target_frames(case: Case) -> Iterator[Alternative]:
    """Groups of targets each of which has a frame of its own: boards at places, say."""
    for group in _groups(case.data):
        names = Counter(group.values())
        # Of fewer points a frame of their own is none: they are known elsewhere.
        if not 1 < len(names) <= GROUPS or min(names.values()) < FEWEST:
            continue
        words = f"the targets {enumerated([f'{name}/..' for name in names])} do not "
        words += "fit together, and each fits alone"
        for frame in FRAMES:
            fault = Alternative("target-frames", words, "frames of targets")
            change = partial(_split, group=group, frame=frame)
            advice = f"give each a {frame} of its own (a column '{frame}')"
            yield replace(fault, change=change, advice=advice, absorbs=ABSORBED)


def _groups(data: Observations) -> Iterator[dict[str, str]]:
    """Groups of targets by the first part of their names, and of those seen together.

    By name of the target.
    """
    from scipy.sparse import coo_array  # Slow to import.
    from scipy.sparse.csgraph import connected_components

    names, target = data.target.distinct, data.target
    if all("/" in name for name in names):
        yield {name: name.rpartition("/")[0] for name in names}
    pairs, count = (target.codes, data.groups() + len(target.names)), len(target.names)
    size = (count + data.configurations,) * 2
    graph = coo_array((np.ones(len(data)), pairs), shape=size)
    label = dict(zip(target.names, connected_components(graph)[1][:count], strict=True))
    first = {label[name]: name for name in reversed(names)}
    yield {name: first[label[name]] for name in names}


def _split(data: Observations, group: Mapping[str, str], frame: Frame) -> Observations:
    """Measurements whose groups of targets have a station, or a tool, of their own."""
    return apart(data, frame, data.target.map(group.__getitem__))[0]


def instruments(case: Case) -> Iterator[Alternative]:
    """Explanations by what is known of an instrument, and by how its images stand."""
    yield from (f for key, f in held_numbers(case).items() if key != Plane.kind)
    if (camera := case.setup.camera) is not None:
        (mount,) = MOUNTS.keys() - {camera.mount}
        yield Alternative(
            "camera-mount",
            f"the camera {MOUNTS[mount]}, and is not one that {MOUNTS[camera.mount]}",
            "the chain",
            setup={"camera": replace(camera, mount=mount)},
            lines={"camera": {"mount": mount}},
        )
        words, advice = "u and v are exchanged", "exchange the names of these columns"
        fault = Alternative("image-axes", words, "the camera", change=_transposed)
        yield replace(fault, advice=advice)
        if camera.size is not None:
            words = "v counts from the lower edge of the image, and not from the upper"
            advice = f"take {camera.size[1] - 1:g} - v"
            change = partial(_upside_down, last=camera.size[1] - 1.0)
            yield replace(fault, words=words, advice=advice, change=change)


def held_numbers(case: Case) -> dict[str, Alternative]:
    """Alternatives of what is held of instruments, by its names, see `held_as`."""
    faults, groups = dict[str, Alternative](), defaultdict[str, list[Any]](list)
    for reference in case.fit.problem.references.values():
        groups[held_as(reference)].append(reference)
    if (camera := case.setup.camera) is not None and Camera.kind in groups:
        faults[Camera.kind] = Alternative(
            "camera-intrinsics",
            "the camera has other focal lengths or another center than stated",
            "the camera",
            setup={"camera": replace(camera, estimate=True)},
            lines={"camera": {"estimate": True}},
        )
    for key, references in groups.items():
        if key in ("", Camera.kind):
            continue
        section = references[0].section
        words, free = "planes do not stand where they are held", "estimate"
        if key != Plane.kind:
            words = f"the {key} of the {section} is not the one that is held"
            free = f"estimate_{key}"
        changed: dict[str, Any] = {free: True}
        entries = {r.name: replace(r.stated(), **changed) for r in references}
        setup = {section: {**getattr(case.setup, section), **entries}}
        lines = {section: {name: changed for name in entries}}
        faults[key] = Alternative("held-number", words, key, setup=setup, lines=lines)
    return faults


def robots(case: Case) -> Iterator[Alternative]:
    """Explanations by what was measured: the robot, its links, the tool."""
    for code, end in (("tool-frame", "tool"), ("base-frame", "base")):
        if getattr(case.setup, f"{end}_frame").estimate is False:
            words = f"the frame of the {end} is not the stated one"
            fault = Alternative(code, words, f"{end} frame", absorbs=ABSORBED)
            # Half a turn away the stated one is no start.
            setup = {f"{end}_frame": FrameSetup(estimate=True)}
            lines = {"frames": {end: {"estimate": True}}}
            yield replace(fault, setup=setup, lines=lines)
    if case.chains.names == ("",):
        yield from _ends(case.chains[""], case)
    robot = case.chains.robot
    for other in case.others():
        file = other.robot.file
        words = f"the robot is '{file}', not '{robot.file}'"
        advice = f"use '{file}' in place of '{robot.file}'"
        yield Alternative("robot", words, "the chain", chains=other, advice=advice)


def _transposed(data: Observations) -> Observations:
    """Measurements with the rows and columns of their images exchanged."""
    return _with_pixels(data, lambda values: values[:, ::-1])


def _upside_down(data: Observations, last: float) -> Observations:
    """Measurements with the rows of their images counted from the last one."""
    return _with_pixels(data, lambda values: [0.0, last] + values * [1.0, -1.0])


def _with_pixels(
    data: Observations, change: Callable[[Floats], Floats]
) -> Observations:
    """Measurements with other pixels."""

    def changed(block: Measurements, _: Booleans) -> Floats:
        image = declared(block.model).components == PIXEL
        return change(block.values) if image else block.values

    return with_values(data, changed)


def turned_by_base(case: Case) -> str:
    """The joint whose offset is a turn of a base that is known; empty for none."""
    chain = case.chains[case.chains.names[0]]
    known = case.setup.base_frame.estimate is False and len(case.chains.names) == 1
    return chain.joints[0] if known and chain.revolute[0] else ""


def _ends(chain: Chain, case: Case) -> Iterator[Alternative]:
    """Other links of the chain as its tip or its base."""
    known = {*case.data.joints, *(joint for joint, _ in case.data.conditions.spare)}
    touching = any(declared(model).contact for model in case.data.models)
    links, free = (chain.base, chain.tip), case.fit.problem.parameters.names
    ends = ("base", "base-link", "base.frame.x"), ("tip", "tip-link", "tool.frame.x")
    for k, (end, code, frame) in enumerate(ends):
        seen: list[tuple[object, ...]] = []
        for link in (links[k], *chain.robot.links):
            try:
                other = Chain(chain.robot, *(*links[:k], link, *links[k + 1 :]))
            except RobotError:
                continue
            # A frame that is estimated absorbs where on its body a link is.
            place = (other.ends[k].homogeneous.round(9) + 0.0).tobytes()
            body = other.joints, frame in free or place
            # A shorter chain touches one point the better the less it moves.
            moves = len(other.joints) >= (len(chain.joints) if touching else 1)
            if moves and {*other.joints} <= known and body not in seen:
                seen.append(body)
                if link != links[k]:
                    words = f"the {end} link is '{link}', not '{links[k]}'"
                    fault = Alternative(code, words, "the chain", lines={end: link})
                    yield replace(fault, chains=Chains.of(other))


def joint_sets(case: Case) -> Explanation | None:
    """Other columns of the joints, commanded or measured ones, that fit better."""
    setup, sample = replace(case.setup, learned=None), case.fit.problem.data
    near, explanations = defaultdict[str, list[str]](list), list[Explanation]()
    joint_maps = {given.joint: given for given in setup.joints.values()}
    if any(given.coupled for given in joint_maps.values()):
        return None  # Their own columns are coupled to those that were read.
    for joint, column in sample.conditions.spare:
        if joint in sample.joints:
            near[joint].append(column)
    for k in range(min(max(map(len, near.values()), default=0), MOST)):
        columns = {j: near[j][k] for j in sample.joints if k < len(near[j])}
        maps = {column: joint_maps.get(j, JointMap(j)) for j, column in columns.items()}
        try:
            samples = [sample, _with_columns(sample, columns)]
            problems = [make_problem(case.chains, data, setup) for data in samples]
            fit, other = (QuickFit.of(problem, COMPARED) for problem in problems)
        except CalibPinError:
            continue  # No robot is there.
        ratio = fit.dof * float(np.log(fit.rms / other.rms))
        if not (fit.redundant and ratio > unlikely()):
            continue
        names = [*columns.values()]
        ends = " to ".join(f"'{n}'" for n in dict.fromkeys((names[0], names[-1])))
        better = Alternative(
            "joint-columns",
            f"the joint positions stand in {ends} as well, which fit better",
            "columns of the joints",
            lines={"joints": {column: lines_of(j) for column, j in maps.items()}},
            figure="by-joint",
            numbers={"columns": ", ".join(names)},
        )
        explanations.append(Explanation((better,), fit.errors, other.errors))
    # What one column lags behind another is no lag of its joint.
    return min(explanations, key=lambda explanation: explanation.after, default=None)


def _with_columns(data: Observations, columns: Mapping[str, str]) -> Observations:
    """Measurements with the joint positions that other columns have.

    Raises:
        CalibPinError: If those of the starts of relative measurements are not known.
    """
    blocks = []
    for block in data.blocks:
        if block.start.size:
            raise CalibPinError("where these columns started is not known")
        q = block.q.copy()
        for joint, column in columns.items():
            q[:, data.joints.index(joint)] = block.conditions.spare[joint, column]
        blocks.append(replace(block, q=q))
    return Observations(tuple(blocks))


FAMILIES = (
    joint_columns,
    line_order,
    standing,
    orientations,
    axes,
    units,
    instruments,
    robots,
    targets,
    target_names,
)
"""Explanations of errors that no robot explains."""
