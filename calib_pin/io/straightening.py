"""Chains whose offsets along their axes are absurd, and cancel.

Nobody can tell where on its axis the frame of a joint stands, and between axes that are
nearly parallel vendors who fit all DH parameters have ended with 300 m in one joint and
-300 m in the next: the robot is right, its frames are somewhere. Errors of their
placements would then be levers of that length.

A joint's frame may slide along its own axis without changing the robot, if what hangs
on it goes the other way: a translation along an axis commutes with the rotation about
it. Those that are far off are put at the foot of the perpendicular from the frame
before them; the next one takes what remains. Links without a joint, as the tip, stay
where they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

import calib_pin.io.urdf_tree as urdf_tree
from calib_pin.errors import RobotError, enumerated
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats

TURNING = ("revolute", "continuous")

INSIDE = ("visual", "collision", "inertial")
"""Elements of a link that have an origin."""

LEAST, TIMES = 1.0, 3.0
"""Least slide that is made [m], and times the way from joint to joint that must remain
without them."""


def straightened(robot: Robot) -> Robot:
    """The same robot without offsets along axes that are absurd and cancel.

    Args:
        robot: The robot.

    Returns:
        The robot itself if it has none; else with the frames of some links moved along
        their axes, which its last remark tells. Shapes and masses stay with their link,
        where they are nearer to it so.

    Raises:
        RobotError: If the forward kinematics would not be the same.
    """
    offsets = (placement.translation for placement in robot.model.jointPlacements)
    if max(map(np.linalg.norm, offsets)) < LEAST:
        return robot
    document = urdf_tree.parse_document(robot.source, robot.file)
    joints, slides = document.named("joint"), _slides(document)
    if not slides:
        return robot
    origins = (document.origin(joints[name]).translation for name in slides)
    remark = (
        f"offsets of up to {max(map(np.linalg.norm, origins)):.3g} m along axes "
        "cancel: straightened, by moving the frames of joints "
        f"{enumerated(map(repr, slides))} along their axes; the forward kinematics are "
        "the same, and the corrected URDF has these frames"
    )
    found = urdf_tree.parse_robot(
        urdf_tree.move_origins(document, _moved(document, slides)), robot.file
    )
    return replace(found, remarks=(*robot.remarks, remark))


def straight_source(source: bytes) -> bytes:
    """The bytes of a URDF after straightening, as far as it can be read."""
    try:
        return straightened(urdf_tree.parse_robot(source, "")).source
    except RobotError:
        return source


def _slides(document: urdf_tree.Document) -> dict[str, Floats]:
    """The slide of each joint that is to be moved, in its own frame, shape (3,) [m].

    Those joints move that must, for the sum of the squares of all offsets to be least.
    """
    # What is mounted on a link stays where it is, however far its frame goes.
    every = document.named("joint")
    parents = {joint.link("parent") for joint in every.values()}
    joints = {
        name: joint
        for name, joint in every.items()
        if joint.attributes["type"] != "fixed" or joint.link("child") in parents
    }
    turning = {
        name: joint
        for name, joint in joints.items()
        if joint.attributes["type"] in TURNING and joint.link("child") in parents
    }
    axes = {name: document.axis(joint) for name, joint in turning.items()}
    axes = {name: np.asarray(a / np.linalg.norm(a)) for name, a in axes.items()}
    column = {name: k for k, name in enumerate(turning)}
    above = {joint.link("child"): name for name, joint in turning.items()}
    offsets, A = np.zeros((len(joints), 3)), np.zeros((len(joints), 3, len(turning)))
    for k, (name, joint) in enumerate(joints.items()):
        place, parent = document.origin(joint), above.get(joint.link("parent"))
        offsets[k] = place.translation
        if name in turning:
            A[k, :, column[name]] = place.rotation @ axes[name]
        if parent is not None:
            A[k, :, column[parent]] -= axes[parent]
    slides = np.linalg.lstsq(A.reshape(-1, len(turning)), -offsets.reshape(-1))[0]
    ways = [np.linalg.norm(o, axis=1).sum() for o in (offsets, offsets + A @ slides)]
    if ways[0] <= TIMES * ways[1]:
        return {}
    found = dict[str, Floats]()

    def slide(name: str | None) -> Floats:
        """To the foot of the perpendicular from the frame before, if at all."""
        if name is None or abs(slides[column[name]]) <= LEAST:
            return np.zeros(3)
        if name not in found:
            joint, place = turning[name], document.origin(turning[name])
            offset = place.translation - slide(above.get(joint.link("parent")))
            axis = place.rotation @ axes[name]
            found[name] = np.asarray(-(offset @ axis) * axes[name])
        return found[name]

    return {name: slide(name) for name in turning if slide(name).any()}


def _moved(
    document: urdf_tree.Document, slides: Mapping[str, Floats]
) -> Iterator[tuple[urdf_tree.Element, pin.SE3]]:
    """Corrections of origins, each multiplied from the right."""
    joints, still = document.named("joint"), np.zeros(3)
    links = {joints[name].link("child"): slide for name, slide in slides.items()}
    for name, joint in joints.items():
        carried = links.get(joint.link("parent"), still)
        turned = document.origin(joint).rotation.T @ carried
        yield joint, pin.SE3(np.eye(3), slides.get(name, still) - turned)
    for name, slide in links.items():
        link = document.named("link")[name]
        for part in (part for kind in INSIDE for part in link.all(kind)):
            old = document.origin(part)
            if np.linalg.norm(old.translation - slide) < np.linalg.norm(
                old.translation
            ):
                yield part, pin.SE3(np.eye(3), -old.rotation.T @ slide)
