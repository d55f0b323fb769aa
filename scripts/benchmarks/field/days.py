"""Days in the field: which robot is measured by what, where, and how well."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from benchmarks.verdict.defects import narrow
from benchmarks.verdict.jobs import BOARD, PIXELS, Job, draw, log_uniform, stream
from benchmarks.verdict.truth import WORKSPACE, position_error
from calib_pin.estimation.nominal import unmeasured
from calib_pin.io.urdf import locate_robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements

JOBS = 100_000
"""Numbers of the jobs of a seed."""

ERRORS = (1e-4, 0.02)
"""Smallest and largest error of the nominal robot over the workspace, rms [m]."""

NOISE = (1e-5, 2e-4)
"""Smallest and largest standard deviation of lengths [m] and angles [rad]."""

ROWS = (20.0, 600.0)
"""Fewest and most measurements."""

MULTIPLE = 1.5
"""Fewest configurations, by those that determine everything."""

HALVES = (0.3, 1.0)
"""Smallest and largest half of the range of every joint in a region [rad]."""


MARKED = 3.0
"""Size of effects that somebody leaves out, by the expected one: they are to matter."""


class Robot(NamedTuple):
    """A robot, and its size.

    Attributes:
        name: Its name.
        base: Its first link; None for the root.
        tip: Its last link; None for the only one.
        scale: Its lengths, by those of the file.
        heavy: Whether its links have masses.
    """

    name: str
    base: str | None = None
    tip: str | None = None
    scale: float = 1.0
    heavy: bool = True


ROBOTS: Mapping[str, Robot] = {
    "bench": Robot("example:ur3_robot", "base_link", "tool0", 0.6),
    "xarm7": Robot("example:xarm7"),
    "pa10": Robot("pa10"),
    "ur10": Robot("example:ur10_robot", "base_link", "tool0"),
    "space6": Robot("space6", heavy=False),
    "giant": Robot("heavy6", scale=1.25),
}
"""Six robots, 0.4 to 4 m long."""

INSTRUMENTS = {
    "tracker": "position",
    "poses": "pose",
    "camera": "camera",
    "sockets": "fixed-point",
    "wire": "point-distance",
}
"""What measures, by the measurement model."""

TRUTHS: Mapping[str, tuple[str, ...]] = {
    "rigid": ("placement",),
    "geared": ("placement", "transmission"),
    "elastic": ("placement", "compliance"),
}
"""Errors that a robot has, and that its user estimates."""

LAYOUTS = ("random", "path", "random", "region")
"""Where it is measured: anywhere, from neighbor to neighbor, in a part of the space."""


class Day(NamedTuple):
    """A job, and what is peculiar to it.

    Attributes:
        job: The job.
        instrument: Name of the instrument.
        layout: Where it is measured.
        truth: Which errors the robot has.
        rows: Its measurements, without a mishap.
    """

    job: Job
    instrument: str
    layout: str
    truth: str
    rows: Measurements

    @property
    def label(self) -> str:
        """The day in a few words."""
        off = 1e3 * nominal_error(self.job)
        robot = Path(self.job.robot).stem.removeprefix("example:")
        return (
            f"{robot}, {self.truth}, {off:.2g} mm off, {self.instrument}, "
            f"{len(self.rows)} measurements, {self.layout}, noise {self.job.noise:.2g}"
            f"{', stated' if self.job.stated else ''}"
        )


def day(
    number: int,
    *,
    instruments: tuple[str, ...] = tuple(INSTRUMENTS),
    layouts: tuple[str, ...] = LAYOUTS,
    changes: Mapping[str, Any] | None = None,
    heavy: bool = False,
    least: int = 0,
) -> Day:
    """The day of a number.

    Args:
        number: Its number.
        instruments: Those that may measure.
        layouts: Where they may.
        changes: Keys of the setup, such as the errors that the robot has and its user
            estimates; default one of `TRUTHS`.
        heavy: Whether its links must have masses.
        least: Fewest configurations.
    """
    rng = stream(number, 5)
    known = [robot for robot in ROBOTS.values() if robot.heavy or not heavy]
    robot = known[int(rng.integers(len(known)))]
    instrument = instruments[int(rng.integers(len(instruments)))]
    layout = layouts[int(rng.integers(len(layouts)))]
    truth = list(TRUTHS)[int(rng.integers(2 + robot.heavy))]
    if changes is not None:
        truth = "+".join(changes.get("parameters", TRUTHS["rigid"])[1:]) or "rigid"
    model = INSTRUMENTS[instrument]
    noise, pixels, off, many = (
        float(log_uniform(rng, limits, 1)[0])
        for limits in (NOISE, PIXELS, ERRORS, ROWS)
    )
    job = draw(
        number,
        robot=located(robot),
        ends=(robot.base, robot.tip),
        model=model,
        multiple=MULTIPLE,
        least=max(round(many / (len(BOARD) if model == "camera" else 1)), least),
        size=1.0,
        noise=pixels if model == "camera" else noise,
        changes={"parameters": TRUTHS[truth]} if changes is None else changes,
    )
    stated = replace(job.setup, model=model, base=robot.base, tip=robot.tip)
    if changes is not None:
        names = job.problem.parameters.names
        effect = ["placement" not in name for name in names]
        job = replace(job, theta=np.where(effect, MARKED, 1.0) * job.theta)
    job = sized(replace(job, setup=stated), off)
    if model == "fixed-point":
        # Where the sockets are, the tool has to be.
        rows = job.measured(stream(number, 1))
        return Day(job, instrument, "random", truth, rows)
    q = _laid(job, layout, stream(number, 6))
    return Day(job, instrument, layout, truth, job.measured(stream(number, 1), q=q))


def sized(job: Job, off: float) -> Job:
    """The job of a robot whose tool is so far off over the workspace, rms [m]."""
    unit, theta = job.problem.parameters, job.theta
    # A joint neither rises under its load nor runs ahead.
    signed = [
        p.unit not in ("rad/Nm", "m/N") and "backlash" not in p.name for p in unit
    ]
    job = replace(job, theta=np.where(signed, theta, np.abs(theta)))
    return replace(job, theta=job.theta * off / nominal_error(job))


def nominal_error(job: Job) -> float:
    """How far the tool of the nominal robot is off over the workspace, rms [m]."""
    q = job.chain.random_configurations(WORKSPACE, stream(job.number, 98))
    return position_error(job, None, q)


@cache
def _folder() -> TemporaryDirectory[str]:
    """A folder for this process, which goes with it."""
    return TemporaryDirectory()


@cache
def located(robot: Robot) -> str:
    """The name of a robot, or the file of one whose lengths are others."""
    if robot.scale == 1.0:
        return robot.name

    def scaled(found: re.Match[str]) -> str:
        numbers = " ".join(repr(robot.scale * float(x)) for x in found[2].split())
        return f"{found[1]}{numbers}{found[3]}"

    text = locate_robot(robot.name).read_text(encoding="utf-8")
    text = re.sub(r"""(<origin[^>]*\bxyz=["'])([^"']*)(["'])""", scaled, text)
    path = Path(_folder().name) / f"{robot.name.removeprefix('example:')}_scaled.urdf"
    path.write_text(text, encoding="utf-8")
    return str(path)


def _laid(job: Job, layout: str, rng: np.random.Generator) -> Floats:
    """Configurations of a job at which its instrument sees everything, (count, n)."""
    while True:
        q = LAID[layout](job, rng, 2 * job.count)
        seen = np.ones(len(q), bool)
        if job.model == "camera":
            target = tuple(BOARD) * len(q)
            every = np.repeat(q, len(BOARD), axis=0)
            at = unmeasured(job.problem, job.problem.only.key, every, target)
            seen = job.problem.observable(job.theta, at).reshape(len(q), -1).all(axis=1)
        if seen.sum() >= job.count:
            return q[seen][: job.count]


def _anywhere(job: Job, rng: np.random.Generator, count: int) -> Floats:
    return job.chain.random_configurations(count, rng)


def _path(job: Job, rng: np.random.Generator, count: int) -> Floats:
    """Random configurations, each followed by the nearest of those that are left."""
    left = job.chain.random_configurations(count, rng)
    q = [left[0]]
    left = left[1:]
    while len(left):
        nearest = int(np.argmin(np.linalg.norm(left - q[-1], axis=1)))
        q.append(left[nearest])
        left = np.delete(left, nearest, axis=0)
    return np.array(q)


def _region(job: Job, rng: np.random.Generator, count: int) -> Floats:
    return narrow(job, rng, count, float(log_uniform(rng, HALVES, 1)[0]))


LAID: Mapping[str, Callable[[Job, np.random.Generator, int], Floats]] = {
    "random": _anywhere,
    "path": _path,
    "region": _region,
}
"""Configurations of a job by the layout, shape (count, n)."""
