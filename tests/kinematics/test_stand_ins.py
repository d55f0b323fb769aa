"""Simple solids between the joints look like the robot that they stand in for."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.shapes import Shape
from calib_pin.kinematics.skeleton import Skeleton, corners
from calib_pin.kinematics.stand_ins import JOINT, stand_ins


def spread(shape: Shape) -> np.ndarray:
    """Vertices of a shape in its link."""
    R, p = shape.placement[:3, :3], shape.placement[:3, 3]
    return np.asarray(shape.surface.vertices @ R.T + p)


@pytest.mark.parametrize("name", ["space7", "heavy6"])
def test_every_joint_is_drawn_and_all_hangs_together(name: str) -> None:
    robot = load_robot(name)
    skeleton = Skeleton(robot, robot.root)
    shapes = stand_ins(robot)
    joints = [shape for shape in shapes if shape.color == JOINT]
    assert {s.link for s in joints} >= {
        robot.model.frames[k].name
        for k in range(robot.model.nframes)
        if robot.model.frames[k].name in robot.links
        and robot.model.frames[robot.model.frames[k].parentFrame].name
        in skeleton.joints
    }
    T = dict(zip(skeleton.links, skeleton.placements(skeleton.neutral), strict=True))
    clouds = [
        spread(shape) @ T[shape.link][:3, :3].T + T[shape.link][:3, 3]
        for shape in shapes
    ]
    # From any part the others are reached over parts that touch.
    boxes = [(cloud.min(axis=0), cloud.max(axis=0)) for cloud in clouds]
    low, high = (np.array(ends) for ends in zip(*boxes, strict=True))
    meet = (low[:, None] <= high[None] + 1e-9).all(axis=2)
    meet = (meet & meet.T).astype(float)
    assert (np.linalg.matrix_power(meet, len(boxes)) > 0.0).all()


def test_a_link_is_as_long_as_its_way_to_the_next_joint() -> None:
    robot = load_robot("example:ur10_robot")
    (joint, tube) = stand_ins(robot, "upper_arm_link")
    assert joint.color == JOINT
    radius = float(np.ptp(tube.surface.vertices[:, 0])) / 2.0
    way = np.ptp(tube.surface.vertices, axis=0)[2] - 2.0 * radius
    # 0.612 m along the arm, 0.1719 m back along the axis of the elbow.
    assert way == pytest.approx(np.hypot(0.612, 0.1719), rel=0.02)
    axis = joint.placement[:3, 2]
    assert np.abs(axis) == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
    skeleton = Skeleton(robot, robot.root)
    size = np.ptp(corners(skeleton, stand_ins(robot), skeleton.neutral), axis=0).max()
    assert 1.1 < size < 1.8
