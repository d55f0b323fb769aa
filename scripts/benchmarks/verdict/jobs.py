"""Simulated jobs: a robot with known errors, an instrument, and the user's setup.

A job is made from its number alone, so that each can be run again by itself. The true
frames and instruments are not those that the user states: he states what he can know.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import (
    analyze_structure,
    brought_to_contact,
    unmeasured,
)
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    Triple,
)

SEED = 16
"""Seed of all jobs, beside their numbers."""

ROBOTS: Mapping[str, tuple[str | None, str | None]] = {
    "space6": (None, None),
    "space7": (None, None),
    "pa10": (None, None),
    "example:ur10_robot": ("base_link", "tool0"),
    "example:panda": (None, "panda_link8"),
    "example:tiago_no_hand": (None, "arm_7_link"),
}
"""Robots by base and tip: six and seven joints, and a lift with seven joints."""

SIZES = (0.3, 3.0)
"""Smallest and largest standard deviation of true errors [mm, mrad]."""

OFFSETS = (0.01, 0.03)
"""Smallest and largest joint offset that a fifth of the robots have [rad]."""

NOISE = (2e-5, 5e-4)
"""Smallest and largest standard deviation of lengths [m] and angles [rad]."""

PIXELS = (0.1, 1.0)
"""The same of an image [px]."""

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
BOARD = {
    "a": (0.05, 0.08, 0.12),
    "b": (-0.06, 0.03, 0.1),
    "c": (0.02, -0.07, 0.15),
    "d": (0.1, 0.1, -0.05),
}
"""Points that a camera looks at, in the tool frame [m]."""


@dataclass(frozen=True)
class Equipment:
    """An instrument.

    Attributes:
        truth: Its true placement and properties.
        stated: The user's setup of it.
    """

    truth: Setup
    stated: Setup


@dataclass(frozen=True)
class Job:
    """A robot to be calibrated.

    Attributes:
        number: Number of the job.
        robot: Name of the robot.
        chain: Its nominal chain.
        problem: The true instrument about the nominal robot.
        theta: True parameter values, shape (P,).
        setup: The user's setup.
        minimal: Fewest configurations that determine everything.
        count: Configurations to measure.
        stated: Whether the measurements state their standard deviations.
    """

    number: int
    robot: str
    chain: calib_pin.Chain
    problem: Problem
    theta: Floats
    setup: Setup
    minimal: int
    count: int
    stated: bool

    @property
    def model(self) -> str:
        """Name of the measurement model."""
        return self.problem.only.key.model

    @property
    def noise(self) -> float:
        """True standard deviation of lengths [m], or of an image [px]."""
        return next(iter(self.problem.setup.noise.values()))

    @property
    def label(self) -> str:
        """The job in a few words."""
        name = self.robot.removeprefix("example:")
        shown = f"{name} {self.model} {self.count} configurations"
        return f"{shown}, noise {self.noise:.2g}{', stated' if self.stated else ''}"

    def measured(
        self,
        rng: np.random.Generator,
        count: int | None = None,
        q: Floats | None = None,
        repeats: int = 1,
    ) -> Measurements:
        """Measurements of the true robot at random configurations, or at given ones."""
        count = count or self.count
        target: tuple[str, ...] = ()
        if self.model == "camera":
            # An image shows the whole board.
            q = self.chain.random_configurations(count, rng) if q is None else q
            q, target = np.repeat(q, len(BOARD), axis=0), tuple(BOARD) * len(q)
        rows = calib_pin.simulate(
            self.problem,
            self.theta,
            rng,
            q=q,
            target=target,
            count=count if q is None else None,
            repeats=repeats,
        ).only
        return rows if self.stated else replace(rows, sigma=None)


def stream(number: int, purpose: int = 0) -> np.random.Generator:
    """Random generator of a job; other purposes do not disturb each other."""
    return np.random.default_rng([SEED, number, purpose])


def log_uniform(
    rng: np.random.Generator, limits: tuple[float, float], count: int
) -> Floats:
    """Sizes between limits, any order of magnitude as likely as another."""
    low, high = np.log(limits)
    return np.exp(rng.uniform(float(low), float(high), count))


def draw(
    number: int,
    *,
    robot: str | None = None,
    model: str | None = None,
    multiple: float | None = None,
    perfect: bool = False,
    stated: bool | None = None,
    least: int = 0,
    size: float | None = None,
    noise: float | None = None,
    ends: tuple[str | None, str | None] | None = None,
    changes: Mapping[str, Any] = {},
) -> Job:
    """The job of a number.

    Args:
        number: Its number; robots, models and multiples of the minimal number of
            configurations take turns.
        robot: Robot instead of the one whose turn it is.
        model: Measurement model instead of the one whose turn it is.
        multiple: Number of configurations by the minimal one, instead.
        perfect: Whether the robot has no errors.
        stated: Whether rows state their standard deviation, instead of every other.
        least: Fewest configurations.
        size: Standard deviation of the true errors in the scales of their parameters,
            instead.
        noise: Standard deviation of what is measured, instead [m, rad, px].
        ends: Base and tip of a robot that is none of these.
        changes: Keys of the setup that differ, of the true robot and the user's alike,
            such as the parameters.
    """
    rng = stream(number)
    names, models = tuple(ROBOTS), tuple(MODELS)
    # Shuffled, so that a part of the jobs is a mix of all.
    cycle = len(names) * len(models) * 5
    turn = int(np.random.default_rng(SEED).permutation(cycle)[number % cycle])
    robot = robot or names[turn % len(names)]
    model = model or models[turn // len(names) % len(models)]
    turns = 1.0 + turn // (len(names) * len(models))
    drawn_size, length, pixel = (
        float(log_uniform(rng, limits, 1)[0]) for limits in (SIZES, NOISE, PIXELS)
    )
    offset, every_other = rng.uniform() < 0.2, bool(rng.uniform() < 0.5)
    chain = _chain(robot, ends or ROBOTS[robot])
    equipment = MODELS[model](chain, rng)
    keys: tuple[str, ...] = ("position", "orientation", "distance", "contact")
    if model == "camera":
        keys, length = ("pixel",), pixel
    sigmas = dict.fromkeys(keys, length if noise is None else noise)
    truth = replace(equipment.truth, noise=sigmas, **changes)
    problem = nominal_problem(chain, model, truth)
    parameters = problem.parameters
    sizes = 1e-3 * drawn_size if size is None else size * parameters.scales
    robotic = parameters.free & ~parameters.nuisance & (not perfect)
    theta = np.where(robotic, sizes * rng.normal(size=len(parameters)), 0.0)
    if offset and size is None and not perfect:
        theta[_offset(problem, rng)] += rng.choice([-1, 1]) * rng.uniform(*OFFSETS)
    minimal = _minimal(problem, rng)
    return Job(
        number=number,
        robot=robot,
        chain=chain,
        problem=problem,
        theta=theta,
        setup=replace(equipment.stated, **changes),
        minimal=minimal,
        count=max(
            math.ceil((turns if multiple is None else multiple) * minimal), least
        ),
        stated=every_other if stated is None else stated,
    )


@cache
def _chain(robot: str, ends: tuple[str | None, str | None]) -> calib_pin.Chain:
    base, tip = ends
    return calib_pin.load_chain(robot, base=base, tip=tip)


def _offset(problem: Problem, rng: np.random.Generator) -> int:
    """Position of the offset of a random revolute joint."""
    chain = problem.only.error.chain
    joint = int(rng.choice(np.flatnonzero(chain.revolute)))
    axis = "xyz"[int(np.argmax(np.abs(chain.axes[joint])))]
    name = f"{chain.joints[joint]}.placement.r{axis}"
    return problem.parameters.names.index(name)


def _minimal(problem: Problem, rng: np.random.Generator) -> int:
    """Fewest configurations that can determine everything."""
    found, _ = analyze_structure(problem, np.zeros(len(problem.parameters)), rng)
    # Of a board there is at most its pose to be seen.
    part = problem.only
    values = 6 if part.key.model == "camera" else part.components
    return -(-found.rank // values)


def _tools(chain: calib_pin.Chain, rng: np.random.Generator, count: int) -> Floats:
    """True tool poses in the middle half of the joint ranges, shape (count, 4, 4)."""
    middle, half = (chain.lower + chain.upper) / 2, (chain.upper - chain.lower) / 4
    q = middle + half * rng.uniform(-1.0, 1.0, (count, len(middle)))
    return np.asarray(chain.poses(q) @ frame_pose(TOOL).homogeneous)


def _reach(chain: calib_pin.Chain) -> float:
    q = chain.random_configurations(200, np.random.default_rng(0))
    return float(np.linalg.norm(chain.poses(q)[:, :3, 3], axis=1).max())


def _triple(values: Floats) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _tracker(chain: calib_pin.Chain, rng: np.random.Generator) -> Equipment:
    return Equipment(Setup(base_frame=BASE, tool_frame=TOOL), Setup())


def _ranger(chain: calib_pin.Chain, rng: np.random.Generator) -> Equipment:
    # Each plane is hit at a right angle, 2 m in front, from one configuration.
    planes = {
        name: (T[:3, 2], -float(T[:3, 2] @ T[:3, 3]) - 2.0)
        for name, T in zip(
            ("floor", "wall", "door"), _tools(chain, rng, 3), strict=True
        )
    }
    stated = {
        name: PlaneSetup(
            _triple(normal + 2e-3 * rng.normal(size=3)), offset + 3e-3 * rng.normal()
        )
        for name, (normal, offset) in planes.items()
    }
    truth = {name: PlaneSetup(_triple(n), f) for name, (n, f) in planes.items()}
    guess = FrameSetup((0.053, 0.078, 0.12), (0.21, -0.3, 0.1))
    return Equipment(
        Setup(planes=truth, tool_frame=TOOL), Setup(planes=stated, tool_frame=guess)
    )


def _sockets(chain: calib_pin.Chain, rng: np.random.Generator) -> Equipment:
    apart = 0.05 * _reach(chain)
    sockets: dict[str, PointSetup] = {}
    for name, along in zip(("left", "right", "top"), apart * np.eye(3), strict=True):
        while True:
            (T,) = _tools(chain, rng, 1)
            pair = {
                f"{name}/{k}": PointSetup(_triple(T[:3, 3] + k * along)) for k in (0, 1)
            }
            if _touched(chain, pair, rng):
                break
        sockets |= pair
    distances = tuple(
        DistanceSetup((f"{name}/0", f"{name}/1"), apart, 2e-5)
        for name in ("left", "right", "top")
    )
    return Equipment(
        Setup(sockets=sockets, tool_frame=TOOL), Setup(distances=distances)
    )


def _touched(
    chain: calib_pin.Chain,
    sockets: Mapping[str, PointSetup],
    rng: np.random.Generator,
) -> bool:
    """Whether the tool gets into each of some sockets from one start in ten."""
    setup = Setup(sockets=sockets, tool_frame=TOOL)
    problem = nominal_problem(chain, "fixed-point", setup)
    starts = 40
    names = tuple(sockets) * starts
    q = chain.random_configurations(len(names), rng)
    theta = np.zeros(len(problem.parameters))
    at = unmeasured(problem, problem.only.key, q, names)
    _, there = brought_to_contact(problem, theta, at)
    return bool((there.reshape(starts, -1).mean(axis=0) > 0.1).all())


def _camera(chain: calib_pin.Chain, rng: np.random.Generator) -> Equipment:
    board = {name: PointSetup(xyz) for name, xyz in BOARD.items()}
    far = FrameSetup((0.1, -0.2, 2.5 * _reach(chain)), (0.3, -0.2, 0.4), estimate=True)
    camera = CameraSetup("world", (900.0, 910.0), (640.0, 500.0), estimate=True)
    nominal = CameraSetup("world", (905.0, 905.0), (638.0, 503.0), estimate=True)
    return Equipment(
        Setup(targets=board, camera=camera, base_frame=far, tool_frame=TOOL),
        Setup(targets=board, camera=nominal),
    )


def _wires(chain: calib_pin.Chain, rng: np.random.Generator) -> Equipment:
    reach, out = _reach(chain), np.eye(3)
    truth, stated = {}, {}
    for name, direction in zip(("wire 1", "wire 2", "wire 3"), out, strict=True):
        xyz = 1.2 * reach * direction + 0.1 * rng.normal(size=3)
        truth[name] = AnchorSetup(_triple(xyz), 0.01, estimate_bias=True)
        guess = xyz + 0.02 * rng.normal(size=3)
        stated[name] = AnchorSetup(_triple(guess), estimate_bias=True)
    return Equipment(Setup(anchors=truth, tool_frame=TOOL), Setup(anchors=stated))


def _relative(chain: calib_pin.Chain, rng: np.random.Generator) -> Equipment:
    return Equipment(Setup(tool_frame=TOOL), Setup())


MODELS: Mapping[str, Callable[[calib_pin.Chain, np.random.Generator], Equipment]] = {
    "position": _tracker,
    "pose": _tracker,
    "plane-distance": _ranger,
    "fixed-point": _sockets,
    "camera": _camera,
    "point-distance": _wires,
    "relative-distance": _relative,
}
"""Equipment of every measurement model."""
