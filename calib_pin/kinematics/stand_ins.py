"""Simple solids in place of links that nobody has drawn.

A tube from a link's own joint to each of the next ones, and a cylinder about the axis
of every joint.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import Color, Shape, Surface, ball, capsule, cylinder
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.tree import link_frame

JOINT: Color = (0.36, 0.40, 0.45)
"""Color of what stands for a joint; that of a link is left open."""

TUBE, WIDE = 0.03, 1.3
"""Radius of a tube by the length of the longest limb, and of a joint by that."""

THIN, THICK = 0.006, 0.09
"""Least and largest radius of a tube [m]."""


def stand_ins(robot: Robot, link: str | None = None) -> list[Shape]:
    """Solids for a link, or for all links."""
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    lengths = [float(np.linalg.norm(M.translation)) for M in model.jointPlacements]
    limbs = [sum(lengths[joint] for joint in above) for above in model.supports]
    radius = float(np.clip(TUBE * max(limbs), THIN, THICK))
    links = robot.links if link is None else (link,)
    return [shape for name in links for shape in _shapes(robot, data, name, radius)]


def _shapes(robot: Robot, data: pin.Data, name: str, radius: float) -> Iterator[Shape]:
    """The solids of a link, of a robot whose joints stand at zero."""
    model, number = robot.model, link_frame(robot.model, name)
    moved_by = model.frames[model.frames[number].parentFrame]
    pose, joint = data.oMf[number], moved_by.parentJoint
    if moved_by.type == pin.FrameType.JOINT and model.nvs[joint] == 1:
        J = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, -1)
        twist = J[:, model.idx_vs[joint]]
        axis = pose.rotation.T @ (twist[3:] if twist[3:].any() else twist[:3])
        solid = cylinder(WIDE * radius, 2.0 * WIDE * radius)
        yield _aligned(name, np.zeros(3), axis, solid, JOINT)
    elif name in robot.leaves:
        yield Shape(name, np.eye(4), ball(radius))
    kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    for child, frame in enumerate(model.frames):
        if frame.parentFrame == number and frame.type in kinds:
            end = pose.actInv(data.oMf[child]).translation
            length = float(np.linalg.norm(end))
            if length > 0.1 * radius:
                tube = capsule(radius, length)
                yield _aligned(name, 0.5 * end, end / length, tube, None)


def _aligned(
    link: str, center: Floats, axis: Floats, surface: Surface, color: Color | None
) -> Shape:
    """A surface whose z axis is turned to a unit axis of a link."""
    placement = np.eye(4)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis)
    placement[:3, :3], placement[:3, 3] = turn.toRotationMatrix(), center
    return Shape(link, placement, surface, color)
