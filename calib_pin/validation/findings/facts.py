"""Facts that measurements show by themselves, whatever is wrong with them besides.

Copies, few or equal configurations, joints that stand still or were read turns away,
values that nobody measured or that have few digits, gauges that count the other way.
Each is a function that yields its findings, and stands in the list at the end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, product

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import ADDING, Finding
from calib_pin.estimation.problem import (
    EXACT,
    Problem,
    current_units,
    distinct_values,
    error_table,
    measured_count,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.measurement_models.orientations import numbers_of
from calib_pin.measurement_models.readings import places_of
from calib_pin.observations import Indices, Observations
from calib_pin.observations.labels import Booleans, numbered
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import AnchorSetup, ReadingSetup, Setup
from calib_pin.validation.findings.alternatives import (
    Alternative,
    Explanation,
    setup_lines,
)
from calib_pin.validation.findings.case import CHANCE, SOME, Case
from calib_pin.validation.findings.readings import offset_by
from calib_pin.validation.findings.sentences import (
    finding,
    lines_of,
    listed,
    named,
    shown,
)

MORE = f"measure configurations that differ more: {ADDING}"
_too_similar = partial(finding, remedy=MORE, residuals="by-joint")
"""Makes a finding of configurations that are too much alike."""

REPEATED, SHARE = 3.0, 0.5
"""Measurements of a thing at a configuration, in the mean, from which they are many,
and part of all that is one configuration's from which it is told."""

NARROW, SMALL, WIDE = 0.1, 0.25, 0.4
"""Parts of the range of a joint below which there is a warning, and a remark, and a
warning where far more errors are expected elsewhere."""

ELSEWHERE = 3.0
"""Expected errors over the workspace, by those where it was measured, from which the
configurations are too much alike.

Random ones have 1.0 to 1.6, those of narrow ranges and paths that cost more than twice
the noise 3.5 and more.
"""

SMOOTH = 0.05
"""Squared steps between neighbors of a path, by those of random configurations."""

FEWEST = 8
"""Configurations below which frames alone may explain positions, and fewer than which
are never too much alike: more is wrong with them."""

ALONE, FEW = 0.03, 2
"""Motion along a direction, by that along the largest, that counts as independent, and
so many that do not tell the errors of a robot.

Three of six joints that repeat the others have told them to 0.06 mm.
"""

TURN = 2.0 * np.pi
"""Range of a revolute joint that counts; turns beyond it show the same again [rad]."""

LIMITS = 1e-3
"""By how much limits may be exceeded, which are rounded [rad]."""

VALUES = 20
"""Least number of different values from which a step is no chance."""

COARSE, MOST = 0.5, 2.0
"""Parts of the remaining errors that steps make, from which they are told, and beyond
which values cannot have been rounded: the errors would be larger, but for what was set
aside. Joints are often commanded to round numbers."""

DIGITS = (2, 3, 4)
"""Digits with which a sheet may show numbers of any size."""

ROUNDED = 1.0 / np.sqrt(12.0)
"""Standard deviation of what rounding adds, in steps."""

ANGLES = ("rotation-vector", "roll-pitch-yaw")
"""Ways to state orientations whose numbers can be had from quaternions."""

STEPS = {"m": (1.0, 0.0254), "rad": (1.0, np.pi / 180.0), "px": (1.0,), "": (1.0,)}
"""Units in which a file may count decimal steps, by the one of the values."""

COMPUTED, COARSE_JOINTS = 3e-6, 1e-3
"""Errors of the nominal robot, in parts of how far the tool moved, below which it has
computed them: a micrometer in a meter is what six digits leave, and the best tracker
sees ten times that on a robot without errors. And those that steps of joints make."""

FINE, TIMES = 1e-4, 1.2
"""Steps of written values, or of the tool by those of joints, up to which errors of so
many times what rounding makes are those of a controller that rounds: no robot is as
near to its URDF [m]. Steps of joints that move it farther make it likely."""

STOOD, MOVED = 5e-4, 20.0
"""Difference of joint positions that are those of one configuration [rad, m], and
scatter there, in expected sizes of an error, that no robot has."""

NEAR = 0.5
"""By how much the factor of readings that count the other way, -1, may be missed:
half-way to those that say nothing."""


def require_motion(data: Observations) -> None:
    """Refuse joint positions that stay where they are while measurements do not.

    Whatever wrote them did not follow the robot: they are those of one configuration,
    or of two.

    Args:
        data: The measurements.

    Raises:
        InputError: If the measurements of a thing at a configuration differ by more
            than any robot errs.
    """
    q = data.q
    if len(q) < FEWEST or any(block.start.size for block in data.blocks):
        return
    first = _coincide(q, q[0])
    second = _coincide(q, q[np.argmin(first)])
    if not (first | second).all():
        return
    for block, rows in zip(data.blocks, data.slices, strict=True):
        quantity = declared(block.model).quantities[0]
        thing, squares = 2 * block.target.codes + first[rows], 0.0
        for value in block.values[:, quantity.columns].T:
            mean = np.bincount(thing, value) / np.maximum(np.bincount(thing), 1)
            squares += float(np.sum((value - mean[thing]) ** 2))
        scatter = float(np.sqrt(squares / max(len(block), 1)))
        if scatter > MOVED * expected_size(quantity.unit):
            text = "the joint positions of all measurements are those of "
            text += "one configuration" if first.all() else "two configurations"
            text += f", while their {quantity.name} values scatter by "
            text += f"{shown(scatter, quantity.unit, 3)}: what wrote the joints did "
            raise block.error(0, f"{text}not follow the robot")


def _coincide(q: Floats, posture: Floats) -> Booleans:
    """Whether joints stand as in one configuration, (N, n) and (n,) -> (N,)."""
    pairs = zip(q.T, posture.tolist(), strict=True)
    # Joint by joint: the rows of a million are short.
    near = [np.abs(joint - at) < STOOD for joint, at in pairs]
    return np.asarray(np.logical_and.reduce(near))


def require_distances(data: Observations, setup: Setup) -> None:
    """Refuse distances that no wire and no beam has: a tenth of them below zero.

    Fewer are outliers. Where a bias is estimated, any distance may be read.

    Args:
        data: The measurements.
        setup: The setup, which may state by how much wires read too much.

    Raises:
        InputError: If there are such distances.
    """
    for block in data.blocks:
        model, names = declared(block.model), block.target.names
        if [*model.columns] != ["distance"]:
            continue
        anchors = [setup.anchors.get(name, AnchorSetup()) for name in names]
        limits = np.array([-np.inf if a.estimate_bias else a.bias for a in anchors])
        below = block.values[:, 0] < limits[block.target.codes]
        if below.mean() <= SOME:
            continue
        text = f"{np.sum(below)} of {len(block)} distances are negative: the "
        if below.all():
            remedy = "instrument counts the other way; state in the setup file: "
            remedy += "reading: {scale: -1}"
        else:
            remedy = "instrument was not zero where the distance is; add to all of "
            remedy += "them what it read there too little"
            if block.model == "point-distance":
                remedy += ", or state in the setup file: anchors: {NAME: "
                remedy += "{estimate_bias: true}}"
        raise block.error(int(np.argmax(below)), text + remedy, column="distance")


def constant_orientation(case: Case) -> Iterator[Finding]:
    """Orientations that are the same at all configurations, and were not measured."""
    blocks = [b for b in case.data.blocks if declared(b.model).oriented]
    if case.data.configurations < FEWEST or not blocks:
        return
    if not any(np.ptp(block.values[:, 3:], axis=0).any() for block in blocks):
        text = "the measured orientation is the same at all configurations: no "
        text += "instrument has measured it"
        numbers = {"configurations": case.data.configurations}
        remedy = "take the positions alone: --model position"
        yield finding("constant-orientation", text, numbers, remedy, error=True)


def constant_positions(case: Case) -> Iterator[Finding]:
    """Coordinates that stand still, or repeat another one, where no robot has such.

    One stands still where a tool touches a sheet, all where it turns about its point.
    """
    blocks = [b for b in case.data.blocks if b.model in ("position", "pose")]
    if not case.doubtful or case.data.configurations < FEWEST or not blocks:
        return
    columns = np.concatenate([block.values[:, :3] for block in blocks]).T
    still = [name for name, x in zip("xyz", columns, strict=True) if not np.ptp(x)]
    pairs = combinations(range(3), 2)
    equal = ["xyz"[i] + "xyz"[j] for i, j in pairs if (columns[i] == columns[j]).all()]
    if len(still) > 1:
        text = f"the measured {enumerated(still)} never changed while the joints moved"
    elif equal:
        text = f"{enumerated(list(equal[0]))} are equal in every measurement"
    else:
        return
    text += ": no instrument has measured this"
    remedy = "name the columns that one has measured: 'columns' in the setup file"
    numbers = {"configurations": case.data.configurations}
    yield finding("constant-positions", text, numbers, remedy, error=True)


def gauge_readings(case: Case) -> Explanation | None:
    """Places whose contacts fit far better with readings of the opposite sign.

    A dial gauge is positive where it is pushed in, a deviation is positive away from
    the surface, and planes have normals that point to either side.
    """
    if not case.informed:
        return None
    # A place that is wrong as a whole has been set aside.
    data, things = case.fit.problem.data, case.fit.problem.data.things
    share = np.bincount(things, data.weight > 0.0) / np.bincount(things).clip(1)
    data = data.weighted(np.where(share[things] < 0.5, 1.0, data.weight))
    problem = replace(case.fit.problem, data=data)
    fit, touched = replace(case.fit, problem=problem), {}
    for _, block, _, values in problem.blocks:
        model = declared(block.model)
        if not model.contact or not block.values.any():
            continue
        for name, axis in product(block.target.distinct, model.components):
            column = np.zeros(problem.layout.row.shape)
            along = np.array(model.components) == axis
            entries = block.target.where(name)[:, None] & along
            column[values] = np.where(entries, -block.values, 0.0).ravel()
            words = name or model.naming.noun, axis * (len(model.components) > 1)
            touched[" ".join(words).strip()] = column / problem.sigma
    if not touched:
        return None
    score = fit.score(np.column_stack([*touched.values()]))
    factors = dict(zip(touched, 1.0 + score.values, strict=True))
    wrong = [n for n, factor in factors.items() if abs(factor + 1.0) < NEAR]
    if score.chance > CHANCE or not wrong:
        return None
    all_wrong = len(wrong) == len(factors)
    best = np.mean([factors[name] for name in wrong])
    text = f"the gauge readings at {enumerated(wrong)} have the opposite sign, for "
    advice = "state these planes with normals that point the other way, or exchange "
    advice += "'deviation' and 'dial' in the names of their columns"
    opposite = Alternative(
        "gauge-sign",
        f"{text}they fit best times {best:.2g}",
        "gauges",
        ReadingSetup(opposite=all_wrong),
        advice="" if all_wrong else advice,
        numbers={"left": score.remaining, "chance": score.chance, **factors},
    )
    after = fit.errors * float(np.sqrt(score.remaining))
    return Explanation((opposite,), fit.errors, after, judged="error")


def computed_values(case: Case) -> Iterator[Finding]:
    """Positions that fit to the nominal robot as those of no instrument can."""
    problem = case.fit.problem
    blocks = [b for b in problem.data.blocks if b.model in ("position", "pose")]
    if not blocks or problem.data.configurations < FEWEST:
        return
    errors = error_table(problem, case.nominal)
    # Beside those of another model they have its name too, and rows of nan.
    at = (q for q in problem.layout.quantities if q.name.startswith("position"))
    sizes = {float(np.sqrt(np.nanmean(q.errors(errors) ** 2))): q for q in at}
    rms = min(sizes)
    moved = spread([block.values[:, :3] for block in blocks])
    step = max(coarse_step(b.values[:, :3].ravel(), "m") for b in blocks)
    step = step if step <= FINE else 0.0
    small = rms < COARSE_JOINTS * moved
    by_joints = _joint_step(case, sizes[rms])[2] if small else 0.0
    whole = TIMES * ROUNDED * np.sqrt(3.0)
    fine = np.hypot(step, by_joints if by_joints <= FINE else 0.0)
    sure = rms < max(COMPUTED * moved, whole * fine)
    if sure or rms < whole * np.hypot(step, by_joints):
        text = f"the positions fit to the nominal robot to {shown(rms, 'm')}, which "
        if sure:
            text += "no instrument does: they were computed from the joints by the "
            text += "controller"
        else:
            text += "the steps of the joint positions make alone: it may be that they "
            text += "were computed from the joints by the controller"
        remedy = "take the columns that an instrument measured; 'calib-pin init' finds "
        numbers = {"rms": rms, "moved": moved}
        yield finding("computed-values", text, numbers, f"{remedy}them", error=sure)


def spread(blocks: Sequence[Floats]) -> float:
    """Root mean square distance of points from the mean of their block.

    Args:
        blocks: Points, each of shape (N, k).
    """
    away = np.concatenate([np.sum((p - p.mean(0)) ** 2, axis=1) for p in blocks])
    return float(np.sqrt(away.mean()))


def copies(case: Case) -> Iterator[Finding]:
    """Measurements that are equal to another one to the last digit."""
    data, rows = case.data, _repeated_rows(case.data)
    if not rows or _by_chance(case, len(rows)):
        return
    text = f"{len(rows)} of {len(data)} measurements are copies of others to the last "
    text += f"digit, which count twice: {named(data, rows)}"
    numbers = {"copies": len(rows), "all": len(data)}
    lines = {"reading": lines_of(ReadingSetup(without=places_of(data, rows)))}
    yield finding("copied-measurements", text, numbers, lines=lines)


def repetitions(case: Case) -> Iterator[Finding]:
    """Few configurations, or most measurements at one of them."""
    data, problem = case.data, case.fit.problem
    labels = _thing_labels(data)
    counts, configurations = np.bincount(labels), data.configurations
    free = int(problem.parameters.free.sum())
    many = len(data) >= REPEATED * len(counts)
    if many and distinct_values(problem) < 2 * free:
        text = f"{len(data)} measurements are at only {configurations} distinct "
        text += f"configurations: repetitions tell the noise, not the {free} unknowns"
        numbers = {"configurations": configurations, "unknowns": free}
        numbers |= {"measurements": len(data)}
        remedy = "measure other configurations instead of repeating these"
        yield finding("few-configurations", text, numbers, remedy)
    elif (most := int(counts.max())) > max(SHARE * len(data), REPEATED):
        row = int(np.argmax(counts[labels] == most))
        text = f"{most} of {len(data)} measurements are at one configuration "
        text += f"({named(data, [row])})"
        numbers = {"there": most, "all": len(data)}
        remedy = "measure other configurations as well"
        yield finding("one-configuration", text, numbers, remedy)


def _repeated_rows(data: Observations) -> list[int]:
    """Measurements that repeat all numbers of one before them in the files."""
    place, label, repeated = np.argsort(data.in_order), _thing_labels(data), list[int]()
    several = np.bincount(label)[label] > 1
    for block, rows in zip(data.blocks, data.slices, strict=True):
        if not block.values.shape[1]:
            continue  # Of contacts the joint positions are what is measured.
        candidates = rows.start + np.flatnonzero(several[rows])
        candidates = candidates[np.argsort(place[candidates])]
        local = candidates - rows.start
        start = block.start if block.start.size else block.q[:, :0]
        table = np.column_stack([label[candidates], block.values[local], start[local]])
        first = np.unique(table, axis=0, return_index=True)[1]
        repeated += np.delete(candidates, first).tolist()
    return sorted(repeated, key=place.__getitem__)


def _by_chance(case: Case, pairs: int) -> bool:
    """Whether noise may repeat the digits of so many measurements.

    Two values of normal noise fall on one step of their grid with the probability
    `step / (2 sqrt(pi) sigma)` where the step is small.
    """
    sigma = case.fit.rms * float(np.median(case.fit.problem.given_sigma))
    # A robot that is not as its model leaves more in a fit than an instrument scatters.
    noise = case.fitted.noise[:1] if case.fitted is not None else ()
    sigma = min([sigma, *(part.pure for part in noise if part.pure)])
    if not np.isfinite(sigma) or case.fit.rms < EXACT:
        return True  # Exact measurements repeat themselves.
    values = [b.values[:, :3] for b in case.data.blocks if b.values.shape[1]]
    steps = [coarse_step(v.ravel(), case.fit.quantity.unit) for v in values]
    once = [step / (2.0 * np.sqrt(np.pi) * sigma) for step in steps]
    chance = max(x ** v.shape[1] for x, v in zip(once, values, strict=True))
    return bool(chance * (len(case.data) - case.data.configurations + pairs) > CHANCE)


def _thing_labels(data: Observations) -> Indices:
    """Label of the measurements of one thing at one configuration, shape (N,)."""
    labels = data.groups() * (data.things.max() + 1) + data.things
    return numbered(labels)[1]


def still_joints(problem: Problem) -> tuple[str, ...]:
    """Names of the joints of the chains that no measurement moves."""
    moved, mimics = set[str](), problem.chains.mimics
    for _, data, _, _ in problem.blocks:
        moved |= {data.joints[k] for k in np.flatnonzero(np.ptp(data.q, axis=0))}
    # One that others follow moves with them, be it in a chain or not.
    moved |= {mimics[joint].leader for joint in moved & mimics.keys()}
    return tuple(joint for joint in problem.chains.joints if joint not in moved)


def unmoved_joints(case: Case) -> Iterator[Finding]:
    """The joints of which nothing can be said; of a single chain this is a fault."""
    chains = case.fit.problem.chains
    still = [n for n in still_joints(case.fit.problem) if n not in chains.robot.mimics]
    # Nobody asks measurements for errors that are not fitted.
    if still and case.fitted is not None:
        text = "no measurement moves some joints, and errors that only their motion "
        text += f"shows stay at nominal: {enumerated(still)}"
        numbers, several = {"joints": ", ".join(still)}, len(chains.names) > 1
        yield _too_similar("unmoved-joints", text, numbers, info=several)


def hidden_joints(case: Case) -> Iterator[Finding]:
    """Joints whose turns move what is measured by less than its noise shows.

    Of a target on the axis of the last joint, points beside it are not known.
    """
    if case.fitted is None:
        return
    problem, still = case.fit.problem, still_joints(case.fit.problem)
    # What an error of the expected size does, if nothing else were unknown; of errors
    # that are left a fit may take any size for noise.
    units = current_units(problem)[problem.layout.component]
    shown_by = np.linalg.norm(units[:, None] * case.fit.by_joints, axis=0)
    sizes = np.array([expected_size(case.unit(j)) for j in problem.data.joints])
    little = (shown_by * sizes < 1.0) & (shown_by < ALONE * shown_by.max(initial=0.0))
    names = np.array(problem.data.joints)[little].tolist()
    hidden = [joint for joint in names if joint not in still]
    if hidden:
        text = f"turns of {enumerated(hidden)} move nothing that is measured: the "
        text += "figures are those of the measured point, not of points beside it"
        remedy = "mount the target 5 cm beside the axis, or measure orientations, too"
        numbers = {"joints": ", ".join(hidden)}
        yield finding("hidden-joints", text, numbers, remedy)


def design(case: Case) -> Iterator[Finding]:
    """Joints that are hardly moved, and joints that only move together."""
    if case.fitted is None or not len(case.data):
        return
    chains, q, count = case.chains, case.data.q, case.data.configurations
    span, room = np.ptp(q, axis=0), chains.upper - chains.lower
    room = np.where(chains.revolute, np.minimum(room, TURN), room)
    moved = np.array([j not in chains.mimics for j in chains.joints]) & (span > 0.0)
    part = np.divide(span, room, out=np.ones(len(span)), where=room > 0.0)
    elsewhere = _errors_elsewhere(case) if count > FEWEST else ""
    if elsewhere and _smooth(q[case.data.in_order][:, moved]):
        text = f"all configurations lie on one path, and {elsewhere}"
        yield _too_similar("one-path", text, {})
        elsewhere = ""
    limit, within = WIDE if elsewhere else SMALL, np.minimum(part, 1.0)
    by_chance = moved.sum() * (count - (count - 1) * within) * within ** (count - 1)
    few = np.flatnonzero(moved & (part < limit) & (by_chance < CHANCE))
    worst = few[np.argsort(part[few])].tolist()
    if worst:
        ranges = []
        for j in worst:
            unit = case.unit(chains.joints[j])
            low, high = (shown(end, unit, 3) for end in (q[:, j].min(), q[:, j].max()))
            ranges.append(f"{chains.joints[j]} from {low.split()[0]} to {high}")
        text = f"the measurements move {listed(ranges)}, less than "
        text += f"{100 * limit:.0f} % of the range; "
        text += elsewhere or "elsewhere the accuracy is uncertain"
        narrow = elsewhere or part[worst[0]] < NARROW
        numbers = {chains.joints[j]: part[j] for j in worst}
        yield _too_similar("small-range", text, numbers, info=not narrow)
    several = int(moved.sum())
    if several < 2 or len(q) <= several:
        return
    squares = np.linalg.eigvalsh(np.corrcoef(q[:, moved].T))
    directions = int((squares > ALONE**2 * squares[-1]).sum())
    # So many configurations move in one direction less at most.
    if directions < min(several, count - 1):
        text = f"the {several} joints that move do so in few independent directions"
        text += f" ({directions}); errors that cancel along them show elsewhere"
        numbers = {"directions": directions, "joints": several}
        yield _too_similar("joints-move-together", text, numbers, info=directions > FEW)


def _errors_elsewhere(case: Case) -> str:
    """Expected errors elsewhere in words, if they are far above those of the design."""
    pairs = [(a.workspace, a.measured) for a in case.accuracies.values()]
    sizes = [[x.calibrated.position for x in pair if x] for pair in pairs]
    ratios = [(s[0] / max(s[1], 1e-300), s[0]) for s in sizes if len(s) == 2]
    times, size = max(ratios, default=(0.0, 0.0))
    if times <= ELSEWHERE:
        return ""
    text = f"over the workspace errors of {shown(size, 'm')} are expected, {times:.2g}"
    return f"{text} times those where it was measured"


def _smooth(q: Floats) -> bool:
    """Whether configurations, repeated or not, follow one another closely."""
    changed = np.any(np.diff(q, axis=0) != 0.0, axis=1)
    q = q[np.append(True, changed)]
    steps = np.mean(np.diff(q, axis=0) ** 2, axis=0)
    return float(np.mean(steps / (2.0 * q.var(axis=0)))) < SMOOTH


def joint_turns(case: Case) -> Iterator[Finding]:
    """Joints all of whose positions are within the limits some turns on.

    A turn changes no placement, and a fit is as good with it. It shows where the
    position itself counts: in limits, in commands that are computed from the robot.
    """
    chains, data = case.chains, case.data
    for k, joint in enumerate(chains.joints):
        if case.unit(joint) != "rad" or joint not in data.joints:
            continue
        j, lower, upper = data.joints.index(joint), chains.lower[k], chains.upper[k]
        least, most = data.q[:, j].min(), data.q[:, j].max()
        first = np.ceil((lower - LIMITS - least) / TURN)
        last = np.floor((upper + LIMITS - most) / TURN)
        # The fewest turns that bring all of them between the limits, if any do.
        turns = int(max(first, min(0, last)))
        if not first <= turns <= last or turns == 0:
            continue
        lines = setup_lines(case, (offset_by(data.joints, j, TURN * turns),))
        words = "on" if turns > 0 else "back"
        words = f"a turn {words}" if abs(turns) == 1 else f"{abs(turns)} turns {words}"
        text = f"joint '{joint}' was read at up to {np.degrees(max(most, -least)):.0f} "
        text += f"deg, beyond its limits; {words} all of its positions are within them"
        numbers = {"joint": joint, "turns": turns}
        yield finding("joint-turns", text, numbers, lines=lines, info=True)


def coarse_values(case: Case) -> Iterator[Finding]:
    """Steps of measured values, and of joint positions, that show in the errors."""
    fit, problem = case.fit, case.fit.problem
    used = np.sqrt(max(fit.dof, 1) / max(measured_count(problem), 1))
    for k, quantity in enumerate(problem.layout.quantities):
        table = fit.table[:, quantity.columns]
        table = table[np.isfinite(table)]
        # Both are sizes of all components, as errors are shown.
        whole = float(np.sqrt(quantity.dimension))
        rms = whole * float(np.sqrt(np.mean(table**2))) / used if len(table) else 0.0
        step, unit = _step_of(case, quantity), quantity.unit
        steps = [(f"measured {quantity.name}s", step, unit, step)]
        steps += [] if k else [("joint positions", *_joint_step(case, quantity))]
        for words, step, unit, errors in steps:
            noise = whole * ROUNDED * errors
            if noise > 0.0 and COARSE * rms <= noise <= MOST * rms:
                parts = [shown(x, quantity.unit) for x in (noise, rms)]
                text = f"the {words} are written in steps of {shown(step, unit, 3)}, "
                text += f"which makes {parts[0]} of the {parts[1]} of {quantity.name} "
                text += "errors that are left"
                numbers = {"step": step, "noise": noise, "left": rms}
                yield finding(
                    "coarse-steps", text, numbers, "write them with more digits"
                )


def _step_of(case: Case, quantity: Quantity) -> float:
    """The step of the values of a quantity, the same in all files; zero for none."""
    steps = []
    for block in case.fit.problem.data.blocks:
        model = declared(block.model)
        if quantity not in model.quantities or not block.values.shape[1]:
            continue
        tables = [block.values[:, quantity.columns]]
        if model.oriented and quantity.unit == "rad":
            tables = [numbers_of(block.values[:, 3:], way)[0] for way in ANGLES]
        steps.append(max(coarse_step(way.ravel(), quantity.unit) for way in tables))
    return min(steps, default=0.0)


def _joint_step(case: Case, quantity: Quantity) -> tuple[float, str, float]:
    """The step of joint positions, and the errors of a quantity that a whole one makes.

    Zero where none turns in steps.
    """
    problem, data = case.fit.problem, case.fit.problem.data
    units = [case.unit(joint) for joint in data.joints]
    pairs = zip(data.q.T, units, strict=True)
    steps = np.array([coarse_step(column, unit) for column, unit in pairs])
    step = float(steps.max(where=np.array(units) == "rad", initial=0.0))
    of_quantity = np.array([c.quantity == quantity for c in problem.layout.components])
    rows = of_quantity[problem.layout.component]
    rows &= data.weight[problem.layout.row] > 0.0
    if step == 0.0 or not rows.any():
        return 0.0, "rad", 0.0
    moved = case.fit.by_joints[rows] * problem.sigma[rows, None] * steps
    # A fit follows what has leverage, such as grazing beams.
    free = 1.0 - np.sum(case.fit.unexplained[0][: len(rows)][rows] ** 2, axis=1)
    squares = np.sum(free[:, None] * moved**2) / max(free.sum(), 1e-300)
    return step, "rad", float(np.sqrt(squares))


def coarse_step(values: Floats, unit: str) -> float:
    """The largest step of 1, 2 or 5 times a power of ten that all values are on.

    Where all are written with as many digits, as `1.54E+03`, each has a step of its
    own, and theirs is the root mean square. Zero where there is none, or too few values
    differ to tell.

    Args:
        values: Values, shape (N,) [unit].
        unit: SI unit of the values.
    """
    of_each = product(STEPS[unit], range(0, -7, -1), (5.0, 2.0, 1.0))
    steps = -np.sort([-a * 10.0**power * factor for factor, power, a in of_each])
    for sample in (values[:: max(1, len(values) // 50)], values):
        parts = sample / steps[:, None]
        steps = steps[np.all(np.abs(parts - np.round(parts)) < 1e-6, axis=1)]
    common = steps[:1] if len(np.unique(values)) >= VALUES else steps[:0]
    for scale, digits in product(STEPS[unit], DIGITS if len(common) else ()):
        powers = np.floor(np.log10(np.maximum(np.abs(values / scale), 1e-12)))
        last_digit = scale * 10.0 ** (powers + 1.0 - digits)
        if np.all(np.abs(values / last_digit - np.round(values / last_digit)) < 1e-6):
            common = np.append(common, np.sqrt(np.mean(last_digit**2)))
    return float(common.max(initial=0.0))


KINDS = (
    computed_values,
    copies,
    repetitions,
    unmoved_joints,
    design,
    joint_turns,
    coarse_values,
)
"""Facts that are told of every case, whatever else is wrong."""
