"""Jobs with one defect each, as users have them without knowing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.verdict.jobs import MODELS, Job, draw, log_uniform, stream
from calib_pin.kinematics.spatial import Floats, se3_exp
from calib_pin.observations import Measurements
from calib_pin.setup import DistanceSetup, PointSetup, Setup

ROWS = 60
"""Measurements where the issue names a number."""

GROSS = (5e-3, 1.0)
"""Smallest and largest gross error [m]; a pixel counts as one millimeter."""

PIXELS_PER_METER = 1e3

LEVER = 0.5
"""How far a joint moves the tool of a contact that was read wrong [m/rad]."""

SIX_JOINTS = ("space6", "example:ur10_robot")

NARROW = 0.2
"""Half the range of every joint where all configurations are close together [rad]."""


@dataclass(frozen=True)
class Case:
    """The input of `calibrate`.

    Attributes:
        job: The job.
        rows: Its measurements.
        setup: The user's setup.
        validation: Further measurements to check with.
        like: New configurations like those that were measured, shape (N, n); None
            where they fill the workspace.
    """

    job: Job
    rows: Measurements
    setup: Setup
    validation: Measurements | None = None
    like: Floats | None = None


def spoil(
    rows: Measurements, index: NDArray[Any], size: Floats, rng: np.random.Generator
) -> Measurements:
    """Measurements with gross errors.

    Args:
        rows: The measurements, of one model.
        index: Indices of the spoiled measurements, shape (K,).
        size: Size of each error [m], shape (K,).
        rng: Random generator of their directions.
    """
    values, q = rows.values.copy(), rows.q.copy()
    if rows.model == "fixed-point":
        # Contacts have no values: the robot stood somewhere else.
        turned = rng.normal(size=(len(index), q.shape[1]))
        turned /= np.linalg.norm(turned, axis=1)[:, None]
        q[index] += turned * size[:, None] / LEVER
        return replace(rows, q=q)
    width = 3 if rows.model == "pose" else values.shape[1]
    factor = PIXELS_PER_METER if rows.model == "camera" else 1.0
    off = rng.normal(size=(len(index), width))
    off *= factor * (size / np.linalg.norm(off, axis=1))[:, None]
    values[index, :width] += off
    return replace(rows, values=values)


def narrow(job: Job, rng: np.random.Generator, count: int, half: float) -> Floats:
    """Configurations around one in the middle of the joint ranges, shape (count, n)."""
    chain = job.chain
    middle, quarter = (chain.lower + chain.upper) / 2, (chain.upper - chain.lower) / 4
    center = middle + quarter * rng.uniform(-1.0, 1.0, len(middle))
    q = center + half * rng.uniform(-1.0, 1.0, (count, len(middle)))
    return np.clip(q, chain.lower, chain.upper)


def path(job: Job, rng: np.random.Generator, count: int) -> Floats:
    """Configurations along one smooth path, shape (count, n)."""
    chain, t = job.chain, np.linspace(0.0, 1.0, count)[:, None]
    middle, half = (chain.lower + chain.upper) / 2, (chain.upper - chain.lower) / 2
    n = len(middle)
    wave = np.zeros((count, n))
    for turns in (0.5, 1.0):
        phase = rng.uniform(0.0, 2.0 * np.pi, n)
        wave += 0.3 * np.sin(2.0 * np.pi * turns * t + phase)
    return np.asarray(middle + half * wave)


def stuck(job: Job, rng: np.random.Generator, count: int, joint: int) -> Floats:
    """Configurations with a joint that never moves, shape (count, n)."""
    q = job.chain.random_configurations(count, rng)
    q[:, joint] = q[0, joint]
    return q


def exchanged(rows: Measurements, first: int, second: int) -> Measurements:
    """Measurements of which two have each other's configuration."""
    q = rows.q.copy()
    q[[first, second]] = q[[second, first]]
    return replace(rows, q=q)


def _among(number: int, names: tuple[str, ...]) -> str:
    return names[int(stream(number, 2).integers(len(names)))]


def _one_stated(number: int) -> Case:
    """One measurement of 60 spoiled by 20 mm, stated standard deviation 0.1 mm."""
    job = draw(number, model=_among(number, ("position", "pose")), multiple=1, least=60)
    rng = stream(number, 1)
    rows = job.measured(rng)
    size = (len(rows), 3 if job.model == "position" else 6)
    rows = replace(rows, sigma=np.full(size, 1e-4))
    rows = spoil(rows, rng.integers(len(rows), size=1), np.array([0.02]), rng)
    return Case(job, rows, job.setup)


def _one_bad(number: int) -> Case:
    """One measurement of 60 or more spoiled by 5, 20 or 60 mm."""
    job, rng = draw(number, multiple=2, least=ROWS), stream(number, 1)
    rows = job.measured(rng)
    size = rng.choice([0.005, 0.02, 0.06], size=1)
    return Case(job, spoil(rows, rng.integers(len(rows), size=1), size, rng), job.setup)


def _gross(number: int) -> Case:
    """Gross errors of 5 mm to 1 m in 5 to 40 % of the measurements."""
    job, rng = draw(number, multiple=4), stream(number, 1)
    rows = job.measured(rng)
    count = round(len(rows) * rng.uniform(0.05, 0.4))
    index = rng.permutation(len(rows))[:count]
    size = log_uniform(rng, GROSS, count)
    return Case(job, spoil(rows, index, size, rng), job.setup)


def _exchanged(number: int) -> Case:
    """Two measurements with each other's configuration."""
    job, rng = draw(number, multiple=3), stream(number, 1)
    rows = job.measured(rng)
    first, second = rng.permutation(len(rows))[:2].tolist()
    return Case(job, exchanged(rows, first, second), job.setup)


def _moved(number: int) -> Case:
    """The instrument has moved between training and validation."""
    job = draw(number, model=_among(number, ("position", "pose")), multiple=4)
    rng = stream(number, 1)
    term = job.problem.only
    shift = np.concatenate([rng.normal(size=3), 0.3 * rng.normal(size=3)])
    base = se3_exp(shift) @ term.error.base.homogeneous
    error = term.error.with_frames(pin.SE3(base), term.error.tool)
    terms = {term.key: replace(term, error=error)}
    moved = replace(job, problem=replace(job.problem, terms=terms))
    return Case(job, job.measured(rng), job.setup, moved.measured(rng, 30))


def _scaled(number: int) -> Case:
    """All measured lengths 1 to 5 % too large."""
    names = ("position", "pose", "point-distance", "relative-distance")
    job = draw(number, model=_among(number, names), multiple=4)
    rng = stream(number, 1)
    rows, factor = job.measured(rng), rng.uniform(1.01, 1.05)
    values = rows.values.copy()
    values[:, :3] *= factor
    return Case(job, replace(rows, values=values), job.setup)


def _socket(number: int) -> Case:
    """A socket distance of 60 for 50 mm."""
    job, rng = draw(number, model="fixed-point", multiple=4), stream(number, 1)
    wrong = tuple(replace(d, value=1.2 * d.value) for d in job.setup.distances)
    return Case(job, job.measured(rng), replace(job.setup, distances=wrong))


def _board(number: int) -> Case:
    """A board of 35 for 30 mm squares."""
    job, rng = draw(number, model="camera", multiple=4), stream(number, 1)
    targets = {}
    for name, point in job.setup.targets.items():
        assert point.xyz is not None
        x, y, z = (35.0 / 30.0 * value for value in point.xyz)
        targets[name] = PointSetup((x, y, z))
    return Case(job, job.measured(rng), replace(job.setup, targets=targets))


def _repeated(number: int) -> Case:
    """Five configurations, each measured 30 times."""
    # Five poses are as many values as a robot with six joints has unknowns.
    job = draw(number, model="pose", robot=_among(number, SIX_JOINTS))
    rng = stream(number, 1)
    q = job.chain.random_configurations(5, rng)
    return Case(job, job.measured(rng, q=q, repeats=30), job.setup)


def _ruler(number: int) -> Case:
    """A known distance that is 4 % off what is measured."""
    job, rng = draw(number, model="fixed-point", multiple=4), stream(number, 1)
    first, *others = job.setup.distances
    wrong = DistanceSetup(first.between, 1.04 * first.value, first.sigma)
    return Case(job, job.measured(rng), replace(job.setup, distances=(wrong, *others)))


def _narrow(number: int) -> Case:
    """All configurations within 0.2 rad of one."""
    names = ("position", "pose", "point-distance")
    job = draw(number, model=_among(number, names), multiple=3, least=ROWS)
    rng = stream(number, 1)
    q = narrow(job, rng, job.count + 100, NARROW)
    rows = job.measured(rng, q=q[: job.count])
    return Case(job, rows, job.setup, like=q[job.count :])


def _path(number: int) -> Case:
    """All configurations along one smooth path."""
    names = ("position", "pose", "point-distance")
    job = draw(number, model=_among(number, names), multiple=3, least=2 * ROWS)
    rng = stream(number, 1)
    q = path(job, rng, 2 * job.count)
    return Case(job, job.measured(rng, q=q[::2]), job.setup, like=q[1::2])


def _stuck_joint(number: int) -> Case:
    """The elbow, or another inner joint, never moved."""
    names = ("position", "pose", "point-distance")
    job = draw(number, model=_among(number, names), multiple=3, least=ROWS)
    rng = stream(number, 1)
    joint = int(rng.integers(1, len(job.chain.joints) - 1))
    q = stuck(job, rng, job.count + 100, joint)
    rows = job.measured(rng, q=q[: job.count])
    return Case(job, rows, job.setup, like=q[job.count :])


def _encoder(number: int) -> Case:
    """An encoder shows the same for the last third, although its joint moves."""
    models = tuple(name for name in MODELS if name not in ("relative-distance",))
    job = draw(number, model=_among(number, models), multiple=4)
    rng = stream(number, 1)
    rows = job.measured(rng)
    q = rows.q.copy()
    joint = int(rng.integers(q.shape[1]))
    begin = 2 * len(q) // 3
    q[begin:, joint] = q[begin, joint]
    return Case(job, replace(rows, q=q), job.setup)


def _copy(number: int) -> Case:
    """A copy of the training file as validation, one measurement in ten spoiled."""
    job, rng = draw(number, multiple=1.2), stream(number, 1)
    rows = job.measured(rng)
    index = rng.permutation(len(rows))[: max(1, len(rows) // 10)]
    rows = spoil(rows, index, np.full(len(index), 0.01), rng)
    return Case(job, rows, job.setup, rows)


DEFECTS: Mapping[str, Callable[[int], Case]] = {
    "one of 60, 20 mm, stated": _one_stated,
    "one of 60": _one_bad,
    "gross errors": _gross,
    "two measurements exchanged": _exchanged,
    "instrument moved": _moved,
    "lengths 1-5 % too large": _scaled,
    "socket distance": _socket,
    "board": _board,
    "five configurations": _repeated,
    "ruler distance": _ruler,
    "narrow": _narrow,
    "path": _path,
    "stuck joint": _stuck_joint,
    "stuck encoder": _encoder,
    "copy as validation": _copy,
}
"""How each defect is made, by job number."""
