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
from calib_pin.io.urdf_bytes import Document, Element, parse_document
from calib_pin.io.urdf_origins import move_origins, read_origin
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

EXACT = 1e-9
"""Largest difference of forward kinematics that is rounding [m, rad]."""


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
    joints = {e.attributes["name"]: e for e in document.root.children if _moves(e)}
    slides = _slides(document, joints)
    if not slides:
        return robot
    source = move_origins(document, _moved(document, slides))
    links = {_link(joints[name], "child"): slide for name, slide in slides.items()}
    names = enumerated(f"'{name}'" for name in slides)
    result = replace(
        parse_robot(source, robot.file),
        remarks=(
            *robot.remarks,
            f"offsets of up to {_longest(document, joints, slides):.3g} m along "
            "parallel axes cancel: straightened, by moving the frames of joints "
            f"{names} along their axes; the forward kinematics are the same, and the "
            "corrected URDF has these frames",
        ),
    )
    _require_same(robot, result, links)
    return result


def straight_source(source: bytes) -> bytes:
    """The bytes of a URDF after straightening, as far as it can be read."""
    try:
        return straightened(parse_robot(source, "")).source
    except RobotError:
        return source


def _moves(element: Element) -> bool:
    return element.tag == "joint"


def _link(joint: Element, end: str) -> str:
    element = joint.child(end)
    return "" if element is None else element.attributes.get("link", "")


def _axis(document: Document, joint: Element) -> Floats | None:
    """Axis of a joint that turns, in its frame, shape (3,)."""
    if joint.attributes["type"] not in TURNING:
        return None
    stated, axis = joint.child("axis"), np.array([1.0, 0.0, 0.0])
    if stated is not None and "xyz" in stated.attributes:
        axis = document.numbers("", stated, "xyz", 3)
    return np.asarray(axis / np.linalg.norm(axis))


def _slides(document: Document, joints: Mapping[str, Element]) -> dict[str, Floats]:
    """The slide of each joint that is to be moved, in its own frame, shape (3,) [m]."""
    axes = {name: _axis(document, joint) for name, joint in joints.items()}
    places = {name: read_origin(document, joint) for name, joint in joints.items()}
    above = {_link(joint, "child"): name for name, joint in joints.items()}
    before: dict[str, str] = {}
    for name, joint in joints.items():
        parent = above.get(_link(joint, "parent"), "")
        own, other = axes[name], axes.get(parent)
        if own is None or other is None:
            continue
        if np.linalg.norm(np.cross(places[name].rotation @ own, other)) < PARALLEL:
            before[name] = parent
    found: dict[str, Floats] = {}
    for first in dict.fromkeys(before.values()):
        if first not in before:
            found |= _group(first, before, axes, places)
    return found


def _group(
    first: str,
    before: Mapping[str, str],
    axes: Mapping[str, Floats | None],
    places: Mapping[str, pin.SE3],
) -> dict[str, Floats]:
    """Slides of joints on parallel axes, from the first on; none if all is well."""
    slides: dict[str, Floats] = {}
    pending, worst, way = [first], 0.0, 0.0
    while pending:
        name = pending.pop()
        axis, place = axes[name], places[name]
        assert axis is not None
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
    joints = [e for e in document.root.children if _moves(e)]
    links = {
        _link(joint, "child"): slides[joint.attributes["name"]]
        for joint in joints
        if joint.attributes["name"] in slides
    }
    for joint in joints:
        old = read_origin(document, joint)
        own = slides.get(joint.attributes["name"], np.zeros(3))
        carried = links.get(_link(joint, "parent"), np.zeros(3))
        if own.any() or carried.any():
            shift = own - old.rotation.T @ carried
            moved.append((joint, pin.SE3(np.eye(3), shift)))
    for link in document.root.children:
        if link.tag != "link" or link.attributes["name"] not in links:
            continue
        slide = links[link.attributes["name"]]
        for part in link.children:
            if part.tag not in ("visual", "collision", "inertial"):
                continue
            old = read_origin(document, part)
            stays = old.translation - slide
            if np.linalg.norm(stays) < np.linalg.norm(old.translation):
                shift = -old.rotation.T @ slide
                moved.append((part, pin.SE3(np.eye(3), shift)))
    return moved


def _longest(
    document: Document, joints: Mapping[str, Element], slides: Mapping[str, Floats]
) -> float:
    """Longest offset of a joint that is moved [m]."""
    offsets = (read_origin(document, joints[name]).translation for name in slides)
    return float(max(map(np.linalg.norm, offsets)))


def _require_same(before: Robot, after: Robot, links: Mapping[str, Floats]) -> None:
    """Compare the poses of all links of two robots.

    Raises:
        RobotError: If they differ, but for links that were moved.
    """
    rng, poses = np.random.default_rng(0), []
    steps = rng.uniform(-2.0, 2.0, (5, before.model.nv))
    for robot, slides in ((before, links), (after, {})):
        model, data = robot.model, robot.model.createData()
        frames = [model.getFrameId(link, pin.FrameType.BODY) for link in robot.links]
        for step in steps:
            q = pin.integrate(model, pin.neutral(model), step)
            pin.framesForwardKinematics(model, data, q)
            for link, frame in zip(robot.links, frames, strict=True):
                shift = pin.SE3(np.eye(3), slides.get(link, np.zeros(3)))
                poses.append((data.oMf[frame] * shift).homogeneous)
    first, second = np.split(np.array(poses), 2)
    difference = float(np.abs(first - second).max())
    if not difference < EXACT:
        raise RobotError(
            "offsets along parallel axes are absurd, and without them the robot would "
            f"differ by {difference:.2g} m",
            file=before.file,
        )
