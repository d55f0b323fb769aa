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

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib_pin.errors import RobotError, enumerated
from calib_pin.io.urdf_bytes import (
    Document,
    Element,
    move_origins,
    parse_document,
    read_origin,
)
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats

TURNING = ("revolute", "continuous")

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
    document = parse_document(robot.source, robot.file)
    joints = {e.attributes["name"]: e for e in document.root.all("joint")}
    slides = _slides(document, joints)
    if not slides:
        return robot
    origins = (read_origin(document, joints[name]).translation for name in slides)
    names = enumerated(f"'{name}'" for name in slides)
    source = move_origins(document, _moved(document, slides))
    return replace(
        parse_robot(source, robot.file),
        remarks=(
            *robot.remarks,
            f"offsets of up to {max(map(np.linalg.norm, origins)):.3g} m along "
            "parallel axes cancel: straightened, by moving the frames of joints "
            f"{names} along their axes; the forward kinematics are the same, and the "
            "corrected URDF has these frames",
        ),
    )


def straight_source(source: bytes) -> bytes:
    """The bytes of a URDF after straightening, as far as it can be read."""
    try:
        return straightened(parse_robot(source, "")).source
    except RobotError:
        return source


def _slides(document: Document, joints: Mapping[str, Element]) -> dict[str, Floats]:
    """The slide of each joint that is to be moved, in its own frame, shape (3,) [m]."""
    axes: dict[str, Floats] = {}
    for name, joint in joints.items():
        if joint.attributes["type"] in TURNING:
            stated, axis = joint.child("axis"), np.array([1.0, 0.0, 0.0])
            if stated is not None and "xyz" in stated.attributes:
                axis = document.numbers("", stated, "xyz", 3)
            axes[name] = np.asarray(axis / np.linalg.norm(axis))
    places = {name: read_origin(document, joint) for name, joint in joints.items()}
    above = {joint.link("child"): name for name, joint in joints.items()}
    before: dict[str, str] = {}
    for name, axis in axes.items():
        parent = above.get(joints[name].link("parent"), "")
        if parent in axes:
            sine = np.cross(places[name].rotation @ axis, axes[parent])
            if np.linalg.norm(sine) < PARALLEL:
                before[name] = parent
    found: dict[str, Floats] = {}
    for first in dict.fromkeys(before.values()):
        if first not in before:
            found |= _group(first, before, axes, places)
    return found


def _group(
    first: str,
    before: Mapping[str, str],
    axes: Mapping[str, Floats],
    places: Mapping[str, pin.SE3],
) -> dict[str, Floats]:
    """Slides of joints on parallel axes, from the first on; none if all is well."""
    slides: dict[str, Floats] = {}
    pending, worst, way = [first], 0.0, 0.0
    while pending:
        name = pending.pop()
        axis, place = axes[name], places[name]
        worst = max(worst, abs(place.rotation.T @ place.translation @ axis))
        offset = place.translation - slides.get(before.get(name, ""), np.zeros(3))
        behind = [other for other, parent in before.items() if parent == name]
        if behind:
            slides[name] = -(place.rotation.T @ offset @ axis) * axis
            offset = offset + place.rotation @ slides[name]
        way += float(np.linalg.norm(offset))
        pending += behind
    return slides if worst > max(LEAST, TIMES * way) else {}


def _moved(
    document: Document, slides: Mapping[str, Floats]
) -> list[tuple[Element, pin.SE3]]:
    """Corrections of origins, each multiplied from the right."""
    moved: list[tuple[Element, pin.SE3]] = []
    joints, still = document.root.all("joint"), np.zeros(3)
    links = {
        joint.link("child"): slides[joint.attributes["name"]]
        for joint in joints
        if joint.attributes["name"] in slides
    }
    for joint in joints:
        old = read_origin(document, joint)
        own = slides.get(joint.attributes["name"], still)
        carried = links.get(joint.link("parent"), still)
        if own.any() or carried.any():
            shift = own - old.rotation.T @ carried
            moved.append((joint, pin.SE3(np.eye(3), shift)))
    for link in document.root.all("link"):
        slide = links.get(link.attributes["name"], still)
        for part in link.children:
            if part.tag not in ("visual", "collision", "inertial"):
                continue
            old = read_origin(document, part)
            stays = np.linalg.norm(old.translation - slide)
            if stays < np.linalg.norm(old.translation):
                shift = -old.rotation.T @ slide
                moved.append((part, pin.SE3(np.eye(3), shift)))
    return moved
