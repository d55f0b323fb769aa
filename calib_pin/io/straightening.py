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
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

import calib_pin.io.urdf_tree as urdf_tree
from calib_pin.errors import enumerated
from calib_pin.io.urdf_tree import Document, link_of
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
        RobotError: If the robot with the moved frames cannot be used.
    """
    offsets = (placement.translation for placement in robot.model.jointPlacements)
    if max(map(np.linalg.norm, offsets)) < LEAST:
        return robot
    document = urdf_tree.parse_document(robot.source, robot.file)
    joints, slides = document.named("joint"), _slides(document)
    if not slides:
        return robot
    origins = (document.origin(joints[name]).translation for name in slides)
    far, moved = max(map(np.linalg.norm, origins)), enumerated(map(repr, slides))
    remark = f"offsets of up to {far:.3g} m along axes cancel: joints {moved} "
    remark += "are moved along them, in the corrected URDF as well"
    source = urdf_tree.move_origins(document, _corrections(document, slides))
    straight = urdf_tree.parse_robot(source, robot.file)
    return replace(straight, remarks=(*robot.remarks, remark))


def _slides(document: Document) -> dict[str, Floats]:
    """The slide of each joint that is to be moved, in its own frame, shape (3,) [m].

    None, unless the way from joint to joint is much shorter with them.
    """
    joints, slides = document.named("joint"), dict[str, Floats]()
    places = {name: document.origin(joint) for name, joint in joints.items()}
    # What is mounted on a link stays where it is, however far its frame goes.
    parents = {link_of(joint, "parent") for joint in joints.values()}
    inner = [name for name, j in joints.items() if link_of(j, "child") in parents]
    turning = [name for name in inner if joints[name].get("type") in TURNING]
    above = {link_of(joints[name], "child"): name for name in turning}

    def offset(name: str) -> Floats:
        """From the frame before, where that stands after its own slide."""
        carrier = above.get(link_of(joints[name], "parent"))
        carried = 0.0 if carrier is None else slide(carrier)
        return np.asarray(places[name].translation - carried)

    def slide(name: str) -> Floats:
        """To the foot of the perpendicular from the frame before, if that is far."""
        if name not in slides:
            axis = document.axis(joints[name])
            axis = axis / np.linalg.norm(axis)
            way = offset(name) @ (places[name].rotation @ axis)
            slides[name] = np.asarray(-way * axis if abs(way) > LEAST else 0.0 * axis)
        return slides[name]

    before = after = 0.0
    for name, joint in joints.items():
        if name in inner or joint.get("type") != "fixed":
            moved = places[name].rotation @ slide(name) if name in turning else 0.0
            before += float(np.linalg.norm(places[name].translation))
            after += float(np.linalg.norm(offset(name) + moved))
    cancel = before > TIMES * after
    return {name: slides[name] for name in turning if cancel and slides[name].any()}


def _corrections(
    document: Document, slides: Mapping[str, Floats]
) -> Iterator[tuple[Element, pin.SE3]]:
    """Corrections of origins, each multiplied from the right."""
    joints, links, still = document.named("joint"), document.named("link"), np.zeros(3)
    moved = {link_of(joints[name], "child"): slide for name, slide in slides.items()}
    for name, joint in joints.items():
        carried = moved.get(link_of(joint, "parent"), still)
        turned = document.origin(joint).rotation.T @ carried
        yield joint, pin.SE3(np.eye(3), slides.get(name, still) - turned)
    for name, slide in moved.items():
        for part in (e for e in links[name] if e.tag in INSIDE):
            old = document.origin(part)
            near = np.linalg.norm(old.translation - slide)
            if near < np.linalg.norm(old.translation):
                yield part, pin.SE3(np.eye(3), -old.rotation.T @ slide)
