"""What goes wrong in the field, one thing a day.

Most are the defects that `scripts/benchmark findings` grades by size, here in one usual
size; the others are those that only whole days have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.field.days import INSTRUMENTS, sized
from benchmarks.findings.defect import Input, given, told
from benchmarks.findings.running import DEFECTS
from benchmarks.verdict.defects import narrow, spoil, stuck
from benchmarks.verdict.jobs import BOARD, Job
from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements

GRADED = {defect.name: defect for defect in DEFECTS}
"""Defects of the other benchmark by their names."""

ALL = tuple(INSTRUMENTS)
"""All instruments."""

FREE = ("tracker", "poses", "wire")
"""Instruments that measure anywhere, once at each configuration."""

PLACES = ("tracker", "poses")
"""Instruments that measure positions."""

RATIO = 80.0
"""Turns of a motor per turn of its joint."""

Spoil = Callable[[Job, Measurements, np.random.Generator], Input]
Columns = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Changed(Input):
    """An input of several true robots, any of which is right to find.

    Attributes:
        robots: Each, and what the joint columns hold by its joint positions.
    """

    robots: tuple[tuple[Job, Columns], ...] = ()


@dataclass(frozen=True)
class Mishap:
    """Something that goes wrong.

    Attributes:
        instruments: Those it can happen with.
        codes: Codes of findings that name it; `refused` where the reader may.
        spoil: Input with the mishap, by a job, its clean measurements and a generator.
        words: Words of a sentence, any of which names it as well.
        also: Codes of other findings that are true then as well.
        layouts: Where it is measured; default any.
        changes: Keys of the setup of the true robot and of the clean twin.
        hidden: Whether it spoils the check alone, and so costs in any case.
        least: Fewest configurations.
    """

    instruments: tuple[str, ...]
    codes: tuple[str, ...]
    spoil: Spoil
    words: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    layouts: tuple[str, ...] = ("random", "path", "random", "region")
    changes: Mapping[str, Any] | None = field(default=None)
    hidden: bool = False
    least: int = 0


def _graded(name: str, size: Any, instruments: tuple[str, ...], **more: Any) -> Mishap:
    """A defect of the other benchmark, in a size that a generator may draw."""
    defect = GRADED[name]

    def spoiled(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
        drawn = size(job, rng) if callable(size) else size
        return defect.spoil(job, rows, rng, drawn)

    also = (*defect.also, *more.pop("also", ()))
    hidden = defect.cost is not None
    return Mishap(instruments, defect.codes, spoiled, also=also, hidden=hidden, **more)


def _says(*words: str) -> Callable[[Finding], bool]:
    """Whether a finding says one of some words."""
    return lambda finding: any(told(word)(finding) for word in words)


def _inner(job: Job, rng: np.random.Generator) -> int:
    """A joint whose zero neither base nor tool can absorb."""
    return int(rng.integers(1, len(job.chain.joints) - 2))


def _neighbors(job: Job, rng: np.random.Generator) -> tuple[int, ...]:
    """The order of columns of which two neighbors are exchanged."""
    order, first = list(range(len(job.chain.joints))), _inner(job, rng)
    order[first : first + 2] = order[first + 1], order[first]
    return tuple(order)


def _some_row(rows: Measurements, rng: np.random.Generator) -> int:
    """A row in the middle third, at which something changes."""
    return int(rng.integers(len(rows) // 3, 2 * len(rows) // 3))


def _rehomed(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """A joint was homed anew, half a degree from before."""
    first, joint, q = _some_row(rows, rng), _inner(job, rng), rows.q.copy()
    off = np.zeros(q.shape[1])
    off[joint] = np.radians(0.5)
    q[first:] += off
    files = {"measured.csv": replace(rows, q=q)}
    right, later = told(rows.joints[joint]), (job, lambda q: q + off)
    return Changed(files, job.setup, right=right, robots=(later,))


def _two_robots(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """From a row on it is another robot of the same type."""
    first = _some_row(rows, rng)
    part = job.problem.parameters
    robotic = part.free & ~part.nuisance
    drawn = np.where(robotic, part.scales * rng.normal(size=len(part)), 0.0)
    other = sized(replace(job, theta=drawn), 3e-3)
    later = other.measured(rng, q=rows.q[first:])
    both = np.concatenate([rows.values[:first], later.values])
    files = {"measured.csv": replace(rows, values=both)}
    return Changed(files, job.setup, robots=((other, lambda q: q),))


def _in_motion(together: bool) -> Spoil:
    """Read before the end of a motion: the joints are not yet where they were sent."""

    def spoiled(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
        size = np.radians(np.exp(rng.uniform(np.log(0.2), np.log(6.0))))
        q = rows.q
        ways = np.diff(q, axis=0, prepend=q[:1])
        if together:
            longest = np.abs(ways).max(axis=1, keepdims=True)
            left = ways * np.minimum(size / np.maximum(longest, size / 10.0), 1.0)
        else:
            left = np.clip(ways, -size, size)
        seen = job.measured(rng, q=q - left)
        return given(job, replace(seen, q=q))

    return spoiled


def _percent(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """Joint positions in percent of their range, -100 to 100."""
    low, high = job.chain.lower, job.chain.upper

    def columns(q: Floats) -> Floats:
        return np.asarray(200.0 * (q - low) / (high - low) - 100.0)

    right = _says("percent", "%", "range", "gear")
    spoiled = given(job, replace(rows, q=columns(rows.q)), right)
    return replace(spoiled, columns=columns)


def _one_column(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """One of x, y and z is in inches."""
    values = rows.values.copy()
    values[:, int(rng.integers(3))] /= 0.0254
    return given(job, replace(rows, values=values))


def _image_before(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """The joints of every image are those of the image before."""
    many = len(BOARD)
    kept = rows.rows(np.arange(many, len(rows)))
    right = _says("image", "line")
    return given(job, replace(kept, q=rows.q[:-many]), right)


def _targets(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """Two targets have each other's name."""
    first, second = sorted(set(rows.target))[:2]
    names = {first: second, second: first}
    target = tuple(names.get(name, name) for name in rows.target)
    return given(job, replace(rows, target=target), told(first, second))


def _mount(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """A camera that stands still is said to be in the hand, or the other way round."""
    assert job.setup.camera is not None
    mount = "hand" if job.setup.camera.mount == "world" else "world"
    camera = replace(job.setup.camera, mount=mount)
    setup = replace(job.setup, camera=camera)
    return replace(given(job, rows, _says("mount")), setup=setup)


def _lens(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """Focal lengths and center are those of an image of another size."""
    assert job.setup.camera is not None
    factor = rng.choice([0.5, 0.75, 1.25, 2.0])
    focal, center = (
        tuple(factor * number for number in numbers)
        for numbers in (job.setup.camera.focal, job.setup.camera.center)
    )
    camera = replace(job.setup.camera, focal=focal, center=center, estimate=False)
    setup = replace(job.setup, camera=camera)
    return replace(given(job, rows, _says("focal")), setup=setup)


def _bias(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """Readings of a wire are too long, and nobody says so."""
    setup = replace(job.setup, anchors={})
    return replace(given(job, rows, _says("bias")), setup=setup)


def _transposed(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """The column of a corner stands where its row should."""
    wrong = replace(rows, values=rows.values[:, ::-1])
    return given(job, wrong, _says("exchanged"))


def _computed(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """The controller's own tool point, in hundredths of a millimeter."""
    values = rows.values.copy()
    values[:, :3] = job.chain.poses(rows.q)[:, :3, 3].round(5)
    return given(job, replace(rows, values=values[:, :3]))


def _lost(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """Zeros, or the same number, where the tracker has lost its target."""
    values = rows.values.copy()
    index = rng.permutation(len(rows))[: max(2, len(rows) // 12)]
    values[index, :3] = rng.choice([0.0, -1.0, -9.99])
    right = _says("excluded", "no reading", "the same")
    return given(job, replace(rows, values=values), right)


def _no_orientation(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """Orientations that nobody measured, and that are written as zero."""
    values = rows.values.copy()
    values[:, 3:] = [0.0, 0.0, 0.0, 1.0]
    return given(job, replace(rows, values=values), _says("orientation"))


def _stuck_encoder(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """An encoder shows the same for the last third, although its joint moves."""
    q, joint, first = rows.q.copy(), _inner(job, rng), 2 * len(rows) // 3
    q[first:, joint] = q[first, joint]
    return given(job, replace(rows, q=q), told(rows.joints[joint]))


def _modeled(*names: str) -> Spoil:
    """Measurements of a robot of which no more than this is estimated."""

    def spoiled(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
        setup = replace(job.setup, parameters=names, gear_ratios={})
        unknown = replace(rows.conditions, direction=np.zeros((0, 0), np.int8))
        rows = replace(rows, conditions=replace(unknown, source=""))
        return replace(given(job, rows), setup=setup)

    return spoiled


def _wrong_tip(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """The link before the last one is said to be the tip."""
    model = job.chain.robot.model
    before = model.getJointId(job.chain.joints[-2])
    link = next(
        frame.name
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint == before
    )
    right = _says("tip link", "'tip'")
    return replace(given(job, rows, right), setup=replace(job.setup, tip=link))


def _stuck(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """A joint that never moved."""
    joint = _inner(job, rng)
    q = stuck(job, rng, len(rows), joint)
    return given(job, job.measured(rng, q=q), told(rows.joints[joint]))


def _elsewhere(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """Measured in one region, and checked in another."""
    here, there = (narrow(job, rng, n, 0.4) for n in (len(rows), 30))
    clean = given(job, job.measured(rng, q=here))
    return replace(clean, validation={"there.csv": job.measured(rng, q=there)})


def _moved_twice(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """The instrument was bumped twice."""
    first, second = sorted(rng.choice(np.arange(3, len(rows) - 3), 2, replace=False))
    values = rows.values.copy()
    for row in (first, second):
        values[row:, :3] += 3e-3 * rng.normal(size=3)
    return given(job, replace(rows, values=values))


def _outliers(job: Job, rows: Measurements, rng: np.random.Generator) -> Input:
    """One measurement in twelve is wrong by centimeters."""
    index = rng.permutation(len(rows))[: max(1, len(rows) // 12)]
    size = np.exp(rng.uniform(np.log(0.01), np.log(0.2), len(index)))
    return given(job, spoil(rows, index, size, rng))


def _effect(name: str, **keys: Any) -> dict[str, Any]:
    return {"parameters": ("placement", name), **keys}


INCH, Y_FIRST = 0.0254, ("y", "x", "z")

STATED = ("frames that the setup states",)
CORRECTIONS = ("large-correction", "implausible-correction")

UNCLEAR = ("noise",)
"""Of what no parameter describes: it is left open whether sigma is wrong."""

NONE = "none"
"""A day on which nothing goes wrong."""

MISHAPS: Mapping[str, Mishap] = {
    NONE: Mishap(ALL, (), lambda job, rows, rng: given(job, rows)),
    # What the joint columns hold.
    "joint reversed": _graded("reversed", _inner, ALL),
    "joint zero": _graded("offset", 20.0, ALL),
    "joints exchanged": _graded("exchanged", _neighbors, ALL),
    "joint coupled": _graded("coupled", 1.0, FREE),
    "joint gear": _graded("geared", 0.01, ALL, also=("scale",)),
    "joint in degrees": _graded("degrees", lambda job, rng: (_inner(job, rng),), FREE),
    "percent": Mishap(
        FREE, ("joint-gear", "joint-unit", "joint-degrees", "refused"), _percent
    ),
    "commanded joints": _graded("joint-sets", 2e-3, (*PLACES, "camera")),
    "stuck encoder": Mishap(
        ("tracker", "poses", "wire", "camera"),
        ("stuck-encoder", "joint-frozen", "frozen-joint", "refused"),
        _stuck_encoder,
        also=("outliers",),
    ),
    # When they were read.
    "shifted": _graded("shifted", 1, FREE),
    "image shift": Mishap(("camera",), ("lines-shifted", "refused"), _image_before),
    "reversed order": _graded("backwards", lambda job, rng: job.count, FREE),
    "lag": _graded("lag", 0.02, FREE),
    "in motion together": Mishap(FREE, ("lag",), _in_motion(True), least=40),
    "in motion alone": Mishap(FREE, ("lag", "backlash"), _in_motion(False), least=40),
    "lost motion": Mishap(
        FREE,
        ("backlash",),
        _modeled("placement"),
        words=("backlash", "lost motion", "hysteresis"),
        also=UNCLEAR,
        changes=_effect("hysteresis"),
        least=60,
    ),
    # What was measured.
    "left-handed": _graded("left-handed", Y_FIRST, PLACES),
    "axes": _graded("turned-axes", ("y", "z", "x"), ("poses",)),
    "inches": _graded("unit", INCH, FREE),
    "inches in one column": Mishap(
        PLACES, ("unit", "unit-of-column", "unit-of-some", "refused"), _one_column
    ),
    "feet in some rows": _graded("unit-of-some", 0.05, FREE),
    "lengths": _graded("scale", 1.01, FREE),
    "coarse steps": _graded("steps", 1e-3, FREE),
    "quaternion": _graded("quaternion", ((3, 0, 1, 2), 1.0), ("poses",)),
    "inverted pose": _graded("inverted", None, ("poses",)),
    "no orientation": Mishap(
        ("poses",), ("constant-orientation", "refused"), _no_orientation
    ),
    "controller's values": Mishap(
        ("tracker",), ("computed-values", "refused"), _computed
    ),
    "lost target": Mishap(PLACES, ("outliers", "sentinel", "refused"), _lost),
    "outliers": Mishap(ALL, ("outliers",), _outliers),
    "target": _graded("target", 5e-3, ("camera", "wire")),
    "targets exchanged": Mishap(
        ("camera", "sockets", "wire"),
        ("targets-exchanged", "target", "refused"),
        _targets,
    ),
    "ruler": _graded("ruler", 0.04, ("sockets",)),
    "copies": _graded("copies", lambda job, rng: max(3, job.count // 10), FREE),
    "lines exchanged": _graded("lines-exchanged", 2, FREE, also=("outliers",)),
    "stated noise": _graded("sigma", 0.1, FREE),
    # What changed on the way.
    "instrument moved": _graded("moved", 5e-3, PLACES),
    "moved twice": Mishap(PLACES, ("instrument-moved",), _moved_twice),
    "moved before the check": _graded("other-station", 5e-3, PLACES),
    "tool remounted": _graded("remounted", 2e-3, PLACES),
    "rehomed": Mishap(FREE, ("joint-rehomed",), _rehomed),
    "two robots": Mishap(
        FREE,
        ("outlying-stretch",),
        _two_robots,
        words=("two robots", "another robot", "robot changed"),
    ),
    "instrument drift": _graded("drift", 1e-3, PLACES),
    "robot drift": _graded("robot-drift", 1e-3, FREE),
    # What the robot is, and what is estimated.
    "elasticity left out": Mishap(
        ALL,
        ("model-lacks",),
        _modeled("placement"),
        words=("compliance", "elastic"),
        changes=_effect("compliance"),
    ),
    "gears left out": Mishap(
        ALL,
        ("model-lacks", "gear-ripple"),
        _modeled("placement"),
        words=("transmission",),
        changes=_effect("transmission"),
    ),
    "gear ripple": Mishap(
        FREE,
        ("gear-ripple",),
        _modeled("placement"),
        words=("ripple",),
        also=UNCLEAR,
        changes=_effect("motor-ripple", gear_ratios={"*": RATIO}),
        least=60,
    ),
    "offsets alone": Mishap(
        ALL,
        ("model-lacks",),
        _modeled("joint-offset"),
        words=("placement", "geometry"),
        changes={"parameters": ("placement",)},
    ),
    "wrong tip": Mishap(ALL, ("tip-link", "refused"), _wrong_tip),
    # An origin beside a stated frame takes over its error, and its remedy names both.
    "wrong tool": _graded("other-tool", 0.02, PLACES, words=STATED, also=CORRECTIONS),
    "wrong base": _graded("other-base", 0.02, PLACES, words=STATED, also=CORRECTIONS),
    "wrong mount": Mishap(
        ("camera",), ("camera-mount", "mount", "refused"), _mount, words=("mount",)
    ),
    "wrong lens": Mishap(("camera",), ("camera-intrinsics", "refused"), _lens),
    "bias": Mishap(("wire",), ("held-number", "refused"), _bias),
    "rows for columns": Mishap(("camera",), ("image-axes", "refused"), _transposed),
    # Where it was measured.
    "stuck joint": Mishap(
        FREE,
        ("unmoved-joints", "unmoved-joint"),
        _stuck,
        also=("joints-move-together",),
        layouts=("random",),
    ),
    "narrow region": _graded("narrow", 0.3, FREE, layouts=("random",)),
    "another region": Mishap(
        FREE, ("small-range",), _elsewhere, layouts=("random",), least=30
    ),
    "few configurations": _graded("repeats-only", 6, PLACES, layouts=("random",)),
}
"""All mishaps by name."""
