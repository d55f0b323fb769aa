"""Simple solids in place of links that nobody has drawn.

A link is the way between its own joint and the next ones. Robots are built along the
axes of their joints: the way leaves along one axis, goes across where both are closest,
and arrives along the other. Tubes along it and a cylinder about every axis look like
the robot; they get thinner towards the tips, as robots do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import (
    Color,
    Shape,
    Surface,
    ball,
    box,
    capsule,
    cylinder,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.tree import link_frame

JOINT: Color = (0.36, 0.40, 0.45)
"""Color of what stands for a joint; that of a link is left open."""

TIP, ROOT = 0.018, 0.020
"""Radius of a tube by the length of the longest limb, and what its root has more."""

THIN, THICK = 0.006, 0.09
"""Least and largest radius of a tube [m]."""

WIDE = 1.3
"""Radius of a joint by that of the tube at it."""

PARALLEL = 0.03
"""Squared sine up to which two axes count as parallel."""

FAR = 1.5
"""Distance by that of the joints at which axes are too far away to follow."""


def stand_ins(robot: Robot, link: str | None = None) -> list[Shape]:
    """Solids for a link, or for all links."""
    tree = _Tree(robot)
    links = robot.links if link is None else (link,)
    return [shape for name in links for shape in tree.shapes(name)]


class _Tree:
    """Links, their joints, and how thick what stands in for them is."""

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._model, self._root = model, robot.root
        self._frames = {name: link_frame(model, name) for name in robot.links}
        kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
        self._children: dict[int, list[int]] = {}
        for number, frame in enumerate(model.frames):
            if frame.type in kinds:
                self._children.setdefault(frame.parentFrame, []).append(number)
        of_joint = {model.frames[k].parentFrame: k for k in self._frames.values()}
        self._beyond: dict[int, float] = {}
        # The children of a link come behind it.
        for number in sorted(self._frames.values(), reverse=True):
            ways = [
                float(np.linalg.norm(self._placed(number, child)[:3, 3]))
                + self._beyond.get(of_joint.get(child, -1), 0.0)
                for child in self._children.get(number, ())
            ]
            self._beyond[number] = max(ways, default=0.0)
        self._reach = max(self._beyond.values(), default=0.0)

    def shapes(self, name: str) -> Iterator[Shape]:
        """The solids of a link."""
        number = self._frames[name]
        radius, own = self._radius(number), self._axis_of(number)
        children = self._children.get(number, ())
        if own is not None:
            yield _about(name, np.zeros(3), own, self._joint(number, radius), JOINT)
        elif name == self._root:
            foot = cylinder(1.6 * radius, 0.4 * radius)
            up = np.array([0.0, 0.0, 1.0])
            yield _about(name, np.array([0.0, 0.0, 0.2 * radius]), up, foot, JOINT)
        elif not children:
            yield Shape(name, np.eye(4), ball(0.6 * radius))
        for child in children:
            placed = self._placed(number, child)
            axis = self._axis(child)
            other = None if axis is None else placed[:3, :3] @ axis
            for start, end in pairwise(_way(placed[:3, 3], own, other)):
                length = float(np.linalg.norm(end - start))
                if length > 0.1 * radius:
                    # A round end would stick out of what the root stands on.
                    standing = own is None and name == self._root
                    tube = (cylinder if standing else capsule)(radius, length)
                    along = (end - start) / length
                    yield _about(name, 0.5 * (start + end), along, tube, None)

    def _radius(self, number: int) -> float:
        part = self._beyond[number] / self._reach if self._reach else 1.0
        return float(np.clip(self._reach * (TIP + ROOT * part), THIN, THICK))

    def _joint(self, number: int, radius: float) -> Surface:
        """A cylinder along z for a joint that turns, and a bar for one that slides."""
        wide = WIDE * radius
        kind = self._model.joints[self._model.frames[number].parentJoint].shortname()
        if kind.startswith("JointModelP"):
            return box(np.array([1.6 * wide, 1.6 * wide, 3.0 * wide]))
        return cylinder(wide, 2.0 * wide)

    def _placed(self, number: int, child: int) -> Floats:
        """Pose of a joint at zero in the link that carries it, shape (4, 4)."""
        model = self._model
        frame = model.frames[child]
        placement = frame.placement
        if frame.type == pin.FrameType.JOINT:
            placement = model.jointPlacements[frame.parentJoint]
        return np.asarray(model.frames[number].placement.actInv(placement).homogeneous)

    def _axis_of(self, number: int) -> Floats | None:
        """Axis of the joint that moves a link, in it; None for a fixed one."""
        frame = self._model.frames[number]
        axis = self._axis(frame.parentFrame)
        return None if axis is None else np.asarray(frame.placement.rotation.T @ axis)

    def _axis(self, frame: int) -> Floats | None:
        """Axis of a joint in its own frame, shape (3,); None of any but simple ones."""
        model = self._model
        joint = model.frames[frame].parentJoint
        if model.frames[frame].type != pin.FrameType.JOINT or model.nvs[joint] != 1:
            return None
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        J = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, -1)
        twist = J[:, model.idx_vs[joint]]
        return np.asarray(twist[3:] if twist[3:].any() else twist[:3])


def _way(end: Floats, own: Floats | None, other: Floats | None) -> Sequence[Floats]:
    """Corners of the way from the origin to the next joint, shape (3,) each [m].

    Args:
        end: Where the next joint is.
        own: Unit axis at the origin, if there is one.
        other: Unit axis of the next joint, if there is one.
    """
    start = np.zeros(3)
    if own is None or other is None:
        return start, end
    across = np.cross(own, other)
    square = float(across @ across)
    if square < PARALLEL:
        return start, end - (end @ own) * own, end
    leave, arrive = (
        float(np.cross(end, axis) @ across) / square for axis in (other, own)
    )
    if max(abs(leave), abs(arrive)) > FAR * float(np.linalg.norm(end)):
        return start, end
    return start, leave * own, end + arrive * other, end


def _about(
    link: str, center: Floats, axis: Floats, surface: Surface, color: Color | None
) -> Shape:
    """A surface whose z axis is turned to a unit axis of a link."""
    placement = np.eye(4)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis)
    placement[:3, :3], placement[:3, 3] = turn.toRotationMatrix(), center
    return Shape(link, placement, surface, color)
