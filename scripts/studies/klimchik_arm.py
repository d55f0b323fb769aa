"""The robot of the study of partial pose measurements: its true errors, its tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Labels, Measurements
from calib_pin.parameterizations.base import COMPONENTS
from calib_pin.setup import FrameSetup, Payload, PointSetup, Region, Setup
from studies.klimchik_model import HEAVY, POINTS, robot

COMPLIANCE = (3e-6, 3e-7, 5e-7, 3e-6, 3.5e-6, 2.5e-6)
"""True compliance of every joint [rad/Nm]."""

TRACKER = FrameSetup(xyz=(3.5, -2.5, 1.2), rpy=(0.02, -0.03, 2.0))
"""True placement of the robot base in the tracker."""

TOOL = FrameSetup(xyz=(0.002, -0.003, 0.251), rpy=(4e-3, -3e-3, 5e-3))
"""True placement of the tool frame in the flange."""

REACH = Region(box=((0.8, -2.5, 0.4), (3.2, 2.5, 3.2)))
"""Positions of the flange in the measurements, in front of the robot [m]."""

WORKPIECE = Region(box=((1.5, -0.4, 0.6), (2.2, 0.4, 1.2)))
"""Positions of the flange at the test poses [m]."""

DRAWS = 2000
"""Configurations that are tried at once."""

TILT = np.cos(np.radians(60.0))
"""Cosine of the largest angle between the tool at the test poses and straight down."""


@dataclass(frozen=True)
class Settings:
    """The simulation and the search; lengths in m, angles in rad.

    Attributes:
        count: Configurations that are measured.
        repeats: Readings of every point there, averaged.
        noise: Standard deviation of a reading of a coordinate.
        length: Largest error of a placement.
        angle: The same of angles.
        mass: Payload [kg].
        com: Its center of mass in the flange.
        unseen: Number of validation configurations.
        rounds: Limit on the rounds of alternating least squares.
        near: Difference to the joint solution, in sizes of errors, that ends them.
        tests: Number of test poses for the plan.
        candidates: Number of candidates of the plan.
        starts: Random sets from which the search descends as well.
    """

    count: int = 24
    repeats: int = 10
    noise: float = 0.03e-3
    length: float = 1e-3
    angle: float = 1e-3
    mass: float = 250.0
    com: tuple[float, float, float] = (0.1, 0.0, 0.3)
    unseen: int = 200
    rounds: int = 200
    near: float = 1e-6
    tests: int = 20
    candidates: int = 500
    starts: int = 4

    @property
    def load(self) -> Payload:
        """The payload."""
        return Payload(self.mass, self.com)


def truth(
    rng: np.random.Generator, length: float, angle: float, load: Payload | None = None
) -> tuple[Problem, Floats]:
    """The true robot: a problem without measurements, and values, shape (P,).

    Args:
        rng: Random generator.
        length: Largest error of a placement [m].
        angle: The same of angles [rad].
        load: The payload of a robot with joint compliance; None for a stiff one.
    """
    setup = Setup(
        parameters=("placement",) if load is None else ("placement", "compliance"),
        base_frame=TRACKER,
        tool_frame=TOOL,
        targets={name: PointSetup(xyz, False) for name, xyz in POINTS.items()},
        payloads={} if load is None else {HEAVY: load},
    )
    problem = nominal_problem(robot(), "position", setup)
    errors = {}
    for joint, compliance in zip(robot().joints, COMPLIANCE, strict=True):
        for component in COMPONENTS:
            largest = angle if component.startswith("r") else length
            name = f"{joint}.placement.{component}"
            errors[name] = rng.uniform(-largest, largest)
        if load is not None:
            errors[f"{joint}.compliance.k"] = compliance
    return problem, problem.parameters.vector(errors)


def configurations(count: int, rng: np.random.Generator) -> Floats:
    """Random configurations with the flange in front of the robot, shape (count, 6)."""
    return _drawn(count, REACH, -1.0, rng)


def task_poses(count: int, rng: np.random.Generator) -> Floats:
    """Random configurations with the tool over a workpiece, shape (count, 6)."""
    return _drawn(count, WORKPIECE, TILT, rng)


def _drawn(count: int, region: Region, down: float, rng: np.random.Generator) -> Floats:
    """Random configurations with the flange in a region, shape (count, 6).

    Args:
        count: How many.
        region: The region.
        down: Least cosine of the angle between the flange and straight down.
        rng: Random generator.
    """
    found = np.empty((0, len(robot().joints)))
    while len(found) < count:
        q = robot().random_configurations(DRAWS, rng)
        T = robot().poses(q)
        within = region.contains(T[:, :3, 3]) & (-T[:, 2, 2] >= down)
        found = np.concatenate([found, q[within]])
    return found[:count]


def measure(
    problem: Problem,
    theta: Floats,
    q: Floats,
    rng: np.random.Generator,
    *,
    loads: Sequence[str] = (),
    noise: float = 0.0,
    repeats: int = 1,
) -> Measurements:
    """Measure all reference points of the true robot at some configurations.

    Args:
        problem: The true robot.
        theta: Its parameter values, shape (P,).
        q: Configurations, shape (K, 6) [rad].
        rng: Random generator.
        loads: Its loads, one after the other; empty for a stiff robot.
        noise: Standard deviation of a reading of a coordinate [m].
        repeats: Readings, which are averaged.
    """
    states = tuple(loads) or ("",)
    count = len(q) * len(states)
    return calib_pin.simulate(
        problem,
        theta,
        rng,
        q=np.repeat(q, len(states) * len(POINTS), axis=0),
        target=tuple(POINTS) * count,
        conditions=Conditions(
            Labels.of(tuple(load for load in states for _ in POINTS) * len(q))
        ),
        noise=noise / np.sqrt(repeats),
    ).only
