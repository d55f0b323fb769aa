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
from calib_pin.io.urdf_tree import (
    Document,
    Element,
    move_origins,
    parse_document,
    parse_robot,
)
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
    document = parse_document(robot.source, robot.file)
    joints, slides = document.named("joint"), _slides(document)
    if not slides:
        return robot
    origins = (document.origin(joints[name]).translation for name in slides)
    names = enumerated(f"'{name}'" for name in slides)
    source = move_origins(document, _moved(document, slides))
    remark = (
        f"offsets of up to {max(map(np.linalg.norm, origins)):.3g} m along parallel "
        "axes cancel: straightened, by moving the frames of joints "
        f"{names} along their axes; the forward kinematics are the same, and the "
        "corrected URDF has these frames"
    )
    found = parse_robot(source, robot.file)
    return replace(found, remarks=(*robot.remarks, remark))


def straight_source(source: bytes) -> bytes:
    """The bytes of a URDF after straightening, as far as it can be read."""
    try:
        return straightened(parse_robot(source, "")).source
    except RobotError:
        return source


def _slides(document: Document) -> dict[str, Floats]:
    """The slide of each joint that is to be moved, in its own frame, shape (3,) [m]."""
    joints, axes = document.named("joint"), dict[str, Floats]()
    for name, joint in joints.items():
        if joint.attributes["type"] in TURNING:
            axis = document.axis(joint)
            axes[name] = np.asarray(axis / np.linalg.norm(axis))
    places = {name: document.origin(joints[name]) for name in axes}
    above = {joint.link("child"): name for name, joint in joints.items()}
    behind: dict[str, list[str]] = {}
    for name, axis in axes.items():
        parent = above.get(joints[name].link("parent"), "")
        if parent in axes:
            sine = np.cross(places[name].rotation @ axis, axes[parent])
            if np.linalg.norm(sine) < PARALLEL:
                behind.setdefault(parent, []).append(name)
    found: dict[str, Floats] = {}
    for first in behind.keys() - {name for names in behind.values() for name in names}:
        found |= _group(first, behind, axes, places)
    return {name: found[name] for name in joints if name in found}


def _group(
    first: str,
    behind: Mapping[str, list[str]],
    axes: Mapping[str, Floats],
    places: Mapping[str, pin.SE3],
) -> dict[str, Floats]:
    """Slides of joints on parallel axes, from the first on; none if all is well."""
    slides: dict[str, Floats] = {}
    pending, worst, way = [(first, np.zeros(3))], 0.0, 0.0
    while pending:
        name, carried = pending.pop()
        axis, place = axes[name], places[name]
        worst = max(worst, abs(place.rotation.T @ place.translation @ axis))
        offset = place.translation - carried
        if name in behind:
            slides[name] = -(place.rotation.T @ offset @ axis) * axis
            offset = offset + place.rotation @ slides[name]
            pending += [(other, slides[name]) for other in behind[name]]
        way += float(np.linalg.norm(offset))
    return slides if worst > max(LEAST, TIMES * way) else {}


def _moved(
    document: Document, slides: Mapping[str, Floats]
) -> list[tuple[Element, pin.SE3]]:
    """Corrections of origins, each multiplied from the right."""
    moved: list[tuple[Element, Floats]] = []
    joints, still = document.named("joint"), np.zeros(3)
    links = {joints[name].link("child"): slide for name, slide in slides.items()}
    for name, joint in joints.items():
        own, carried = slides.get(name, still), links.get(joint.link("parent"), still)
        moved.append((joint, own - document.origin(joint).rotation.T @ carried))
    for name, link in document.named("link").items():
        slide = links.get(name, still)
        for part in (p for kind in INSIDE for p in link.all(kind)):
            old = document.origin(part)
            stays = np.linalg.norm(old.translation - slide)
            if stays < np.linalg.norm(old.translation):
                moved.append((part, -old.rotation.T @ slide))
    return [(element, pin.SE3(np.eye(3), shift)) for element, shift in moved]
