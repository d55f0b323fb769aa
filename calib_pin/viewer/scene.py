"""The scene of a robot, its measurements and a plan, as plain data.

All of it stands in the base link of the chain. A calibrated robot is drawn with the
joint origins of its corrected URDF and, where it has corrections of the joints, with
these turned as it says. What it corrects behind the tip moves no link: it shows in the
place of the tool only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.io.urdf_bytes import edit_origins
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain, Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.parameterizations import NOTHING
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.viewer.errors import StageErrors
from calib_pin.viewer.shapes import Shape, box
from calib_pin.viewer.skeleton import Skeleton

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
        name: What it is called: `robot`, or `nominal` and `corrected`.
        skeleton: Where its links are.
        model: What moves its joints away from where they are commanded; None where
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
        if self.model is None or self.model.error.geometric:
            return self.skeleton.placements(q)
        error, theta = _carrying(self.model, payload), self.model.theta
        joints = self.skeleton.joints
        places = [joints.index(name) for name in self.model.chain.joints]
        moved = q.copy()
        moved[places] = error.joint_positions(q[None, places], theta)[0]
        return self.skeleton.placements(moved)


@dataclass(frozen=True)
class Rows:
    """Measurements and their errors.

    Attributes:
        data: The N rows.
        stages: Errors by stage, `before` and, of a calibration, `after`.
    """

    data: Measurements
    stages: dict[str, StageErrors]


@dataclass(frozen=True)
class Plan:
    """Configurations in their order.

    Attributes:
        q: Positions of the chain's joints, shape (M, n) [rad, m].
        path: The way of the tip in the base link, shape (P, 3) [m].
    """

    q: Floats
    path: Floats

    def at(self, number: float) -> Floats:
        """Joint positions on the way from one configuration to the next, shape (n,).

        Args:
            number: From 0 for the first to M - 1 for the last.
        """
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
        shapes: What the links look like, of all bodies.
        bodies: The robot, or the nominal and the corrected one.
        chain: The chain that rows and plan move, if there is one.
        rows: Measurements, if there are any.
        plan: Planned configurations, if there are any.
    """

    title: str
    shapes: tuple[Shape, ...]
    bodies: tuple[Body, ...]
    chain: Chain | None = None
    rows: Rows | None = None
    plan: Plan | None = None

    @property
    def places(self) -> NDArray[np.intp]:
        """Positions of the chain's joints among those of the bodies, shape (n,)."""
        joints = () if self.chain is None else self.chain.joints
        return np.array(
            [self.bodies[0].skeleton.joints.index(k) for k in joints], np.intp
        )

    @property
    def start(self) -> Floats:
        """Joint positions of the first row, or of the plan, or neutral, shape (K,)."""
        q = self.bodies[0].skeleton.neutral
        if self.rows is not None:
            q[self.places] = self.rows.data.q[0]
        elif self.plan is not None:
            q[self.places] = self.plan.q[0]
        return q

    def corners(self, q: Floats) -> Floats:
        """Corners of boxes around all shapes in the base link, shape (S, 3) [m].

        Args:
            q: Joint positions, shape (K,) [rad, m].
        """
        skeleton = self.bodies[0].skeleton
        T = dict(zip(skeleton.links, skeleton.placements(q), strict=True))
        return np.concatenate([_corners(shape, T[shape.link]) for shape in self.shapes])


def bodies_of(robot: Robot, base: str, model: CalibratedModel | None) -> list[Body]:
    """The robot by itself, or as it is nominally and as it is corrected.

    Args:
        robot: The robot as it was read.
        base: Link in whose frame it is drawn.
        model: Its calibration, if there is one.
    """
    if model is None:
        return [Body("robot", Skeleton(robot, base))]
    corrected = edit_origins(robot.source, model.urdf_corrections(), robot.file)
    return [
        Body("nominal", Skeleton(robot, base)),
        Body("corrected", Skeleton(parse_robot(corrected, robot.file), base), model),
    ]


def tip_path(subject: Chain | CalibratedModel, q: Floats) -> Floats:
    """The way of the tip in the base link while all joints move evenly.

    Args:
        subject: The chain, or the calibrated robot, whose tip it is.
        q: Positions of the chain's joints, shape (M, n) [rad, m].

    Returns:
        Points, shape (P, 3) [m]; those of the configurations are among them.
    """
    between = max(1, min(STEPS, LONGEST // len(q)))
    numbers = np.arange((len(q) - 1) * between + 1) / between
    plan = Plan(q, np.zeros((0, 3)))
    dense = np.array([plan.at(number) for number in numbers])
    if isinstance(subject, Chain):
        return np.asarray(subject.poses(dense)[:, :3, 3])
    error = _carrying(subject, "")
    return error.tip_poses(dense, subject.theta)[:, :3, 3]


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


def _carrying(model: CalibratedModel, payload: str) -> ErrorModel:
    """The error model with a payload; of several, no name means no payload."""
    several = len(model.setup.payloads) > 1
    return model.error.carrying(payload or (NOTHING if several else ""))


def _corners(shape: Shape, T: Floats) -> Floats:
    vertices = shape.surface.vertices
    least, most = vertices.min(axis=0), vertices.max(axis=0)
    corners = box(most - least).vertices + 0.5 * (least + most)
    pose = T @ shape.placement
    return np.asarray(corners @ pose[:3, :3].T + pose[:3, 3])
