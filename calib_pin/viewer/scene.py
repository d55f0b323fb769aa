"""The scene of a robot, its measurements and a plan, as plain data.

All of it stands in one link: the base of the chain, or the root of the robot where
chains have several bases. A calibrated robot is drawn with the
joint origins of its corrected URDF and, where it has corrections of the joints, with
these turned as it says. What it corrects behind the tip moves no link: it shows in the
place of the tool only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.io.urdf_origins import edit_origins
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.observations import Observations
from calib_pin.parameterizations import NOTHING
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.report.breakdown import block_names
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.viewer.errors import StageErrors, base_poses
from calib_pin.viewer.shapes import Shape, box


class Skeleton:
    """Forward kinematics of a whole robot in one of its links.

    A joint that mimics another follows it, as commanded; one with several degrees of
    freedom, such as that of a floating base, stays at its neutral position.

    Args:
        robot: The robot; its model is not changed.
        base: Link in whose frame the others are.

    Attributes:
        links: Names of all L links.
        joints: Names of the K joints with a position of their own.
        revolute: True for those that turn, shape (K,).
        lower: Lower position limits, shape (K,) [rad, m].
        upper: Upper position limits, shape (K,) [rad, m]; half a turn or 1 m to either
            side where there is none.
    """

    def __init__(self, robot: Robot, base: str) -> None:
        """Find out which joints there are."""
        model = robot.model
        self._model = model
        self._data = model.createData()
        self.links = robot.links
        self._base = robot.links.index(base)
        self._frames = [model.getFrameId(k, pin.FrameType.BODY) for k in self.links]
        single = [j for j in range(1, model.njoints) if model.nvs[j] == 1]
        still = {*robot.mimics, *robot.refused}
        own = [joint for joint in single if model.names[joint] not in still]
        self.joints: tuple[str, ...] = tuple(str(model.names[j]) for j in own)
        # By joint: the place of the one whose position it takes, factor, and offset.
        self._driven = {joint: (k, 1.0, 0.0) for k, joint in enumerate(self.joints)}
        for name, mimic in robot.mimics.items():
            place = self.joints.index(mimic.leader)
            self._driven[name] = place, mimic.factor, mimic.offset
        kinds = [model.joints[j].shortname() for j in own]
        self.revolute = np.array(["JointModelP" not in kind for kind in kinds], bool)
        start = [model.idx_qs[j] for j in own]
        lower, upper = model.lowerPositionLimit[start], model.upperPositionLimit[start]
        continuous = np.array([model.nqs[j] == 2 for j in own], bool)
        limited = ~continuous & (upper > lower) & (np.abs(upper - lower) < 1e6)
        half = np.where(self.revolute, np.pi, 1.0)
        self.lower: Floats = np.where(limited, lower, -half)
        self.upper: Floats = np.where(limited, upper, half)

    @property
    def neutral(self) -> Floats:
        """Zero, or the limit next to it, of every joint, shape (K,) [rad, m]."""
        return np.asarray(np.clip(0.0, self.lower, self.upper))

    def positions(self, joints: Sequence[str], q: Floats) -> Floats:
        """Positions (n,) of joints, also of those that follow others, at q (K,)."""
        driven = (self._driven[joint] for joint in joints)
        return np.array([factor * q[k] + offset for k, factor, offset in driven])

    def placements(self, q: Floats) -> Floats:
        """Poses of all links in the base link at q (K,) [rad, m], shape (L, 4, 4)."""
        model, data = self._model, self._data
        full = pin.neutral(model)
        positions = self.positions(tuple(self._driven), q)
        for name, position in zip(self._driven, positions, strict=True):
            joint = model.getJointId(name)
            start = model.idx_qs[joint]
            if model.nqs[joint] == 2:  # A continuous joint has cosine and sine.
                full[start : start + 2] = np.cos(position), np.sin(position)
            else:
                full[start] = position
        pin.framesForwardKinematics(model, data, full)
        T = np.array([data.oMf[frame].homogeneous for frame in self._frames])
        return np.asarray(invert(T[self._base]) @ T)


STEPS = 20
"""Points of the tip's path from one configuration to the next."""

LONGEST = 5000
"""Points from which on a path has fewer between configurations."""

LEGS = 0.15
"""How far below what stands still a robot must reach to count as standing there [m]."""


@dataclass(frozen=True)
class Body:
    """One robot as it is drawn.

    Attributes:
        name: Its name: `robot`, or `nominal` and `corrected`.
        skeleton: Where its links are.
        model: Calibrated model that corrects the commanded joints; None where
            nothing does.
    """

    name: str
    skeleton: Skeleton
    model: CalibratedModel | None = None

    def placements(self, q: Floats, payload: str = "") -> Floats:
        """Poses of all links in the base link, shape (L, 4, 4).

        Args:
            q: Commanded positions of the skeleton's joints, shape (K,) [rad, m].
            payload: Name of what the robot carries; nothing, or the only payload
                there is, where it is empty.
        """
        moved = q.copy()
        own = {joint: k for k, joint in enumerate(self.skeleton.joints)}
        model = self.model
        chains = [] if model is None else [model.of(k) for k in model.measured_chains]
        for chain in chains:
            if chain.error.geometric:
                continue
            joints = chain.chain.joints
            commanded = self.skeleton.positions(joints, q)[None]
            (turned,) = _carrying(chain, payload).joint_positions(
                commanded, chain.theta
            )
            for joint, position in zip(joints, turned, strict=True):
                if joint in own:  # One that follows another follows it as it is.
                    moved[own[joint]] = position
        return self.skeleton.placements(moved)


@dataclass(frozen=True)
class Rows:
    """Measurements and their errors.

    Attributes:
        data: The N measurements.
        stages: Errors by stage, `before` and, of a calibration, `after`.
    """

    data: Observations
    stages: dict[str, StageErrors]

    @property
    def blocks(self) -> dict[str, NDArray[np.bool_]]:
        """Masks (N,) of the measurements of each block, by its name, after all."""
        every = {"all": np.ones(len(self.data), bool)}
        if len(self.data.blocks) == 1:
            return every
        return every | {
            name: self.data.block_of == k
            for k, name in enumerate(block_names(self.data.keys))
        }


@dataclass(frozen=True)
class Plan:
    """Configurations in their order.

    Attributes:
        q: Positions of the joints of all chains, shape (M, n) [rad, m].
        paths: The way of each tip in the base link, shape (P, 3) each [m].
    """

    q: Floats
    paths: Sequence[Floats] = ()

    def at(self, number: float) -> Floats:
        """Joint positions (n,) between configurations, numbered from 0 to M - 1."""
        first = min(int(number), len(self.q) - 1)
        last = min(first + 1, len(self.q) - 1)
        return np.asarray(
            self.q[first] + (number - first) * (self.q[last] - self.q[first])
        )


@dataclass(frozen=True)
class Scene:
    """All that is drawn.

    Attributes:
        title: Name of the robot.
        shapes: Shapes of the links of all bodies.
        bodies: The robot, or the nominal and the corrected one.
        chains: The chains that measurements and plan move, if there are any.
        rows: Measurements, if there are any.
        plan: Planned configurations, if there are any.
    """

    title: str
    shapes: tuple[Shape, ...]
    bodies: tuple[Body, ...]
    chains: Chains | None = None
    rows: Rows | None = None
    plan: Plan | None = None

    @cached_property
    def moved(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Joints of the chains with a position of their own, (m,), among the bodies'.

        The first are their columns in configurations of the chains, the second are
        their places among the joints of the bodies.
        """
        joints = () if self.chains is None else self.chains.joints
        own = self.bodies[0].skeleton.joints
        pairs = [(k, own.index(j)) for k, j in enumerate(joints) if j in own]
        columns, places = np.array(pairs, np.intp).reshape(-1, 2).T
        return columns, places

    @property
    def start(self) -> Floats:
        """Joint positions of the first measurement or plan, or neutral, shape (K,)."""
        q, (columns, places) = self.bodies[0].skeleton.neutral, self.moved
        if self.rows is not None:
            q[places] = self.rows.data.q[0, columns]
        elif self.plan is not None:
            q[places] = self.plan.q[0, columns]
        return q

    def corners(self, q: Floats) -> Floats:
        """Corners (S, 3) [m] of boxes around all shapes in the base link at q."""
        skeleton = self.bodies[0].skeleton
        T = dict(zip(skeleton.links, skeleton.placements(q), strict=True))
        return np.concatenate([_corners(shape, T[shape.link]) for shape in self.shapes])


def bodies_of(robot: Robot, base: str, model: CalibratedModel | None) -> list[Body]:
    """The robot by itself, or as it is nominally and as its calibration corrects it."""
    if model is None:
        return [Body("robot", Skeleton(robot, base))]
    corrected = edit_origins(robot.source, model.urdf_corrections(), robot.file)
    return [
        Body("nominal", Skeleton(robot, base)),
        Body("corrected", Skeleton(parse_robot(corrected, robot.file), base), model),
    ]


def drawn_link(chains: Chains) -> str:
    """The link in which everything is drawn: the base of the chains, or the root."""
    bases = {chains[name].base for name in chains.names if chains[name].joints}
    return bases.pop() if len(bases) == 1 else chains.robot.root


def tip_paths(
    chains: Chains, q: Floats, link: str, model: CalibratedModel | None = None
) -> list[Floats]:
    """The ways (P, 3) [m] of all tips in a link while all joints move evenly.

    The points of the configurations q (M, n) [rad, m] are among them.
    """
    between = max(1, min(STEPS, LONGEST // len(q)))
    numbers = np.arange((len(q) - 1) * between + 1) / between
    plan = Plan(q)
    dense = np.array([plan.at(number) for number in numbers])
    paths = []
    for name in chains.names:
        chain, own = chains[name], dense[:, chains.columns(name)]
        if not chain.joints:
            continue
        if model is None:
            T = chain.poses(own)
        else:
            calibrated = model.of(name)
            T = _carrying(calibrated, "").tip_poses(own, calibrated.theta)
        paths.append((base_poses(chains, name, link, dense) @ T)[:, :3, 3])
    return paths


def floor_height(scene: Scene) -> float:
    """Height of the ground under a robot in its base link [m].

    It lies under the links that stand still, or under the feet of a robot that reaches
    well below these.
    """
    skeleton = scene.bodies[0].skeleton
    neutral = skeleton.neutral
    # No joint stands at the same angle in both, nor a whole turn away.
    other = skeleton.lower + 0.37 * (skeleton.upper - skeleton.lower)
    ends = skeleton.placements(neutral), skeleton.placements(other)
    moves = np.abs(ends[0] - ends[1]).max(axis=(1, 2))
    fixed = {skeleton.links[k] for k in np.flatnonzero(moves < 1e-9)}
    lowest = float(scene.corners(neutral)[:, 2].min())
    standing = replace(scene, shapes=tuple(s for s in scene.shapes if s.link in fixed))
    if not standing.shapes:
        return lowest
    under = float(standing.corners(neutral)[:, 2].min())
    return under if lowest > under - LEGS else lowest


def _carrying(model: CalibratedChain, payload: str) -> ErrorModel:
    """The error model with a payload; of several, no name means no payload."""
    several = len(model.setup.payloads) > 1
    return model.error.carrying(payload or (NOTHING if several else ""))


def _corners(shape: Shape, T: Floats) -> Floats:
    vertices = shape.surface.vertices
    least, most = vertices.min(axis=0), vertices.max(axis=0)
    corners = box(most - least).vertices + 0.5 * (least + most)
    pose = T @ shape.placement
    return np.asarray(corners @ pose[:3, :3].T + pose[:3, 3])
