"""The tree of links and joints in a URDF: checked, then built by Pinocchio."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import pinocchio as pin

from calib_pin.errors import enumerated, nearest
from calib_pin.io.urdf_bytes import Document, Element, parse_document
from calib_pin.kinematics.joint_space import Mimic
from calib_pin.kinematics.robot import Robot

_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_SINGLE = ("revolute", "continuous", "prismatic")
_WITH_AXIS = (*_SINGLE, "planar")

JOINTS = 10_000
"""Largest number in a robot: Pinocchio compares each name with all before it."""

DEEPEST = 1000
"""Most links from the root on; Pinocchio crashes at some thousands."""

FREEDOM = 200
"""Most degrees of freedom: Pinocchio's memory grows with their cube, to 0.6 GB here."""

NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}
"""Count of the numbers in attributes, by element: what holds others, Pinocchio drops,
often without a word."""

FARTHEST = 1e6
"""Largest coordinate of an origin [m]; a world may be larger than its robot."""

HEAVIEST = 1e6
"""Largest mass of a link [kg]."""


def parse_robot(source: bytes, file: str) -> Robot:
    """Check a URDF and build the robot.

    Args:
        source: The bytes of the URDF.
        file: Name of the source, for messages.

    Returns:
        The robot.

    Raises:
        RobotError: If the URDF cannot be used.

    Examples:
        >>> parse_robot(b'<robot name="r"><link name="a"/></robot>', "r.urdf").leaves
        ('a',)
    """
    document = parse_document(source, file)
    root = document.root
    if root.tag != "robot":
        reason = f"the outermost element is <{root.tag}>"
        raise document.error(root, reason, allowed="<robot>")
    name = _attribute(document, root, "name")
    links, joints = _named(document, "link"), _named(document, "joint")
    if not links:
        raise document.error(root, "the robot has no links")
    if len(joints) > JOINTS:
        reason = "the robot has too many joints"
        allowed = f"at most {JOINTS}"
        raise document.error(root, reason, value=len(joints), allowed=allowed)
    for joint in joints.values():
        _check_joint(document, joint, links)
    for link in links.values():
        _check_link(document, link)
    parents = _parents(document, links, joints)
    inner = {joint.link("parent") for joint in joints.values()}
    mimics, refused = _mimics(joints)
    return Robot(
        name=name,
        file=file,
        source=source,
        model=_build_model(document, links, joints),
        root=next(link for link in links if link not in parents),
        links=tuple(links),
        leaves=tuple(link for link in links if link not in inner),
        fixed_parents={
            child: joint
            for child, joint in parents.items()
            if joints[joint].attributes["type"] == "fixed"
        },
        refused=refused,
        mimics=mimics,
    )


def _attribute(document: Document, element: Element, key: str) -> str:
    value = element.attributes.get(key, "")
    if not value:
        raise document.error(element, f"<{element.tag}> has no {key}")
    return value


def _named(document: Document, tag: str) -> dict[str, Element]:
    """All links or all joints by name, each with one of its own."""
    result = document.named(tag)
    for element in document.root.all(tag):
        name = _attribute(document, element, "name")
        if result[name] is not element:
            reason = f"{tag} '{name}' is here for the second time"
            line = f"the first is in line {element.line}"
            raise document.error(result[name], f"{reason}, {line}")
    return result


def _check_joint(
    document: Document, joint: Element, links: Mapping[str, Element]
) -> None:
    name, kind = joint.attributes["name"], _attribute(document, joint, "type")
    if kind not in _TYPES:
        reason = f"{joint.owner} has the unknown type '{kind}'{nearest(kind, _TYPES)}"
        raise document.error(joint, reason, allowed=", ".join(_TYPES))
    if name == "universe" and kind != "fixed":
        reason = "a joint cannot be called 'universe', Pinocchio's name for the world"
        raise document.error(joint, reason)
    for role in ("parent", "child"):
        if (link := joint.link(role)) not in links:
            reason = f"the {role} link '{link}' of {joint.owner} does not exist"
            raise document.error(joint, reason + nearest(link, links))
    document.origin(joint)
    if kind in _WITH_AXIS:
        document.axis(joint)
    _check_numbers(document, joint)


def _check_link(document: Document, link: Element) -> None:
    _check_numbers(document, link)
    for inertial in link.all("inertial")[:1]:
        mass = inertial.child("mass")
        if mass is None or "value" not in mass.attributes:
            reason = f"the <inertial> of {link.owner} has no mass value"
            raise document.error(inertial, reason)
        if not 0.0 <= document.numbers(mass, "value", 1)[0] <= HEAVIEST:
            value, allowed = mass.attributes["value"], f"0 to {HEAVIEST:g} kg"
            reason = f"no link has the mass of {link.owner}"
            raise document.error(mass, reason, value=value, allowed=allowed)


def _check_numbers(document: Document, element: Element) -> None:
    """Refuse attributes below a link or joint that do not hold their numbers."""
    for child in element.children:
        for key, count in NUMBERS.get(child.tag, {}).items():
            if key in child.attributes:
                numbers = document.numbers(child, key, count)
                if key == "xyz" and np.abs(numbers).max() > FARTHEST:
                    reason = f"the {child.tag} of {child.owner} is too far away"
                    value = child.attributes[key]
                    raise document.error(child, reason, value=value, allowed="xyz in m")
        _check_numbers(document, child)


def _parents(
    document: Document, links: Mapping[str, Element], joints: Mapping[str, Element]
) -> dict[str, str]:
    """Name of the joint that carries each link but the root, if it is one tree."""
    parents: dict[str, str] = {}
    below: dict[str, list[str]] = {}
    for name, joint in joints.items():
        child = joint.link("child")
        if child in parents:
            reason = f"link '{child}' is the child of two joints"
            raise document.error(joint, f"{reason}, '{parents[child]}' and '{name}'")
        parents[child] = name
        below.setdefault(joint.link("parent"), []).append(child)
    level = [link for link in links if link not in parents][:1]
    carried = set(level)
    for _ in range(DEEPEST):
        level = [child for link in level for child in below.get(link, ())]
        carried.update(level)
    if level:
        reason = f"link '{level[0]}' is too far from the root"
        allowed = f"at most {DEEPEST} links one after the other"
        raise document.error(links[level[0]], reason, allowed=allowed)
    if lost := [link for link in links if link not in carried]:
        names = enumerated(f"'{link}'" for link in lost)
        reason = f"nothing joins {names} to the root: a URDF is one tree, without loops"
        first = joints[parents[lost[0]]] if lost[0] in parents else links[lost[0]]
        raise document.error(first, reason)
    return parents


def _mimics(
    joints: Mapping[str, Element],
) -> tuple[dict[str, Mimic], dict[str, str]]:
    """Joints that follow another, and the reasons why a chain cannot contain others.

    Returns:
        Mimic joints, each with the driven joint at the end of those that it follows,
        and phrases for "joint x is ..., which a chain cannot contain".
    """
    stated: dict[str, Mimic] = {}
    refused: dict[str, str] = {}
    for name, joint in joints.items():
        kind, element = joint.attributes["type"], joint.child("mimic")
        if kind in ("floating", "planar"):
            refused[name] = f"a {kind} joint"
        elif element is not None and kind in _SINGLE:
            about = {"multiplier": "1", "offset": "0", **element.attributes}
            factor, offset = float(about["multiplier"]), float(about["offset"])
            stated[name] = Mimic(about.get("joint", ""), factor, offset)
    mimics: dict[str, Mimic] = {}
    for name, mimic in stated.items():
        path = {name}
        while mimic.leader in stated and mimic.leader not in path:
            path.add(mimic.leader)
            above = stated[mimic.leader]
            offset = mimic.factor * above.offset + mimic.offset
            mimic = Mimic(above.leader, mimic.factor * above.factor, offset)
        driven = None if mimic.leader in path else joints.get(mimic.leader)
        if driven is not None and driven.attributes["type"] in _SINGLE:
            mimics[name] = mimic
        else:
            leader = stated[name].leader
            refused[name] = f"a mimic joint without a driven leader ('{leader}')"
    return mimics, refused


def _build_model(
    document: Document, links: Mapping[str, Element], joints: Mapping[str, Element]
) -> pin.Model:
    try:
        with captured_stderr() as printed:
            # To XML a tab or line break in numbers is a space; urdfdom chokes on it.
            text = re.sub(r"[\t\r\n]", " ", document.plain.decode())
            model = pin.buildModelFromXML(text)
    except Exception as failure:  # Whatever C++ throws.
        errors = re.search(r"Error:\s+(.*?)\s+at line", printed[0], re.DOTALL)
        reason = f"Pinocchio cannot read it: {errors[1] if errors else failure}"
        named = re.findall(r"[Jj]oint \[(.+?)\]", printed[0])
        culprit = next((joints[name] for name in named if name in joints), None)
        raise document.error(culprit or document.root, reason) from failure
    if model.nv > FREEDOM:
        reason = f"the robot has {model.nv} degrees of freedom"
        raise document.error(document.root, reason, allowed=f"at most {FREEDOM}")
    frames = {(f.name, f.type == pin.FrameType.BODY) for f in model.frames}
    for elements in (links, joints):
        for name, element in elements.items():
            if (name, elements is links) not in frames:
                reason = f"Pinocchio does not take over {element.tag} '{name}'"
                raise document.error(element, reason)
    return model


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """Collect what C++ prints to file descriptor 2, past `sys.stderr`."""
    printed: list[str] = []
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:  # It is closed, so nothing is printed.
        yield [""]
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield printed
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            file.seek(0)
            printed.append(file.read().decode(errors="replace"))
