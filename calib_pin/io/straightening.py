"""Chains whose offsets along parallel axes are absurd, and cancel.

Between axes that are nearly parallel nobody can tell where the offset along them is,
and vendors who fit all DH parameters have ended with 300 m in one joint and -300 m in
the next: the robot is right, its frames are somewhere. Errors of their placements would
then be levers of that length.

A joint's frame may slide along its own axis without changing the robot, if what hangs
on it goes the other way: a translation along an axis commutes with the rotation about
it. All but the last of such joints are put at the foot of the perpendicular from the
frame before them; the last one takes what remains. Links without a joint, as the tip,
stay where they are.
"""

from __future__ import annotations

from collections import defaultdict
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

PARALLEL = 0.05
"""Largest angle between axes that are nearly parallel [rad]; factories are off by 0.002
and designers by more than this."""

LEAST = 1.0
"""Least offset that is absurd [m], where it is also `TIMES` the way from joint to joint
that remains without it."""

TIMES = 2.0


def straightened(robot: Robot) -> Robot:
    """The same robot without offsets along parallel axes that are absurd and cancel.

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
        f"offsets of up to {max(map(np.linalg.norm, origins)):.3g} m along parallel "
        "axes cancel: straightened, by moving the frames of joints "
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
    """The slide of each joint that is to be moved, in its own frame, shape (3,) [m]."""
    every = document.named("joint").items()
    joints = {name: j for name, j in every if j.attributes["type"] in TURNING}
    places = {name: document.origin(joint) for name, joint in joints.items()}
    axes = {name: document.axis(joint) for name, joint in joints.items()}
    axes = {name: np.asarray(a / np.linalg.norm(a)) for name, a in axes.items()}
    above = {joint.link("child"): name for name, joint in joints.items()}
    behind = defaultdict[str, list[str]](list)
    for name, joint in joints.items():
        if parent := above.get(joint.link("parent")):
            sine = np.cross(places[name].rotation @ axes[name], axes[parent])
            if np.linalg.norm(sine) < PARALLEL:
                behind[parent].append(name)
    found = dict[str, Floats]()
    for first in behind.keys() - {name for names in behind.values() for name in names}:
        # From the first joint on parallel axes on, with how far its frame has moved.
        slides, pending, worst, way = {}, [(first, np.zeros(3))], 0.0, 0.0
        while pending:
            name, carried = pending.pop()
            axis = places[name].rotation @ axes[name]
            worst = max(worst, abs(places[name].translation @ axis))
            offset = places[name].translation - carried
            if name in behind:
                slides[name] = -(offset @ axis) * axes[name]
                offset = offset - (offset @ axis) * axis
                pending += [(other, slides[name]) for other in behind[name]]
            way += float(np.linalg.norm(offset))
        found |= slides if worst > max(LEAST, TIMES * way) else {}
    return {name: found[name] for name in joints if name in found}


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
