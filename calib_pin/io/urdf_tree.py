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
from calib_pin.io.urdf_origins import read_origin
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

_NUMBERS = {
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
        raise document.error(
            root, f"the outermost element is <{root.tag}>", allowed="<robot>"
        )
    name = _attribute(document, root, "name", "the robot")
    links = _named(document, "link")
    joints = _named(document, "joint")
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
    parents = _parents(document, joints)
    root_link = _root(document, links, joints, parents)
    inner = {_end(joint, "parent") for joint in joints.values()}
    fixed = {
        child: joint
        for child, joint in parents.items()
        if joints[joint].attributes["type"] == "fixed"
    }
    mimics = _mimics(document, joints)
    return Robot(
        name=name,
        file=file,
        source=source,
        model=_build_model(document, links, joints),
        root=root_link,
        links=tuple(links),
        leaves=tuple(link for link in links if link not in inner),
        fixed_parents=fixed,
        refused=_refused(joints, mimics),
        mimics=mimics,
    )


def _attribute(document: Document, element: Element, key: str, owner: str) -> str:
    value = element.attributes.get(key, "")
    if not value:
        raise document.error(element, f"{owner} has no {key}")
    return value


def _named(document: Document, tag: str) -> dict[str, Element]:
    """All links or all joints by name, in the order of the file."""
    result: dict[str, Element] = {}
    for element in document.root.children:
        if element.tag != tag:
            continue
        name = _attribute(document, element, "name", f"a {tag}")
        if name in result:
            reason = f"{tag} '{name}' is here for the second time"
            line = result[name].line
            raise document.error(element, f"{reason}, the first is in line {line}")
        result[name] = element
    return result


def _end(joint: Element, role: str) -> str:
    """Name of a joint's parent or child link."""
    element = joint.child(role)
    return "" if element is None else element.attributes.get("link", "")


def _check_joint(
    document: Document, joint: Element, links: Mapping[str, Element]
) -> None:
    name = joint.attributes["name"]
    owner = f"joint '{name}'"
    kind = _attribute(document, joint, "type", owner)
    if kind not in _TYPES:
        reason = f"{owner} has the unknown type '{kind}'{nearest(kind, _TYPES)}"
        raise document.error(joint, reason, allowed=", ".join(_TYPES))
    if name == "universe" and kind != "fixed":
        reason = "a joint cannot be called 'universe', Pinocchio's name for the world"
        raise document.error(joint, reason)
    for role in ("parent", "child"):
        link = _end(joint, role)
        if not link:
            raise document.error(joint, f"{owner} names no {role} link")
        if link not in links:
            reason = f"the {role} link '{link}' of {owner} does not exist"
            raise document.error(joint, reason + nearest(link, links))
    read_origin(document, joint)
    axis = joint.child("axis")
    if axis is not None and kind in _WITH_AXIS:
        _attribute(document, axis, "xyz", f"the <axis> of {owner}")
        if not document.numbers(owner, axis, "xyz", 3).any():
            raise document.error(axis, f"the axis of {owner} is zero")
    _check_numbers(document, owner, joint)


def _check_link(document: Document, link: Element) -> None:
    owner = f"link '{link.attributes['name']}'"
    _check_numbers(document, owner, link)
    inertial = link.child("inertial")
    if inertial is None:
        return
    mass = inertial.child("mass")
    if mass is None or "value" not in mass.attributes:
        raise document.error(inertial, f"the <inertial> of {owner} has no mass value")
    if not 0.0 <= document.numbers(owner, mass, "value", 1)[0] <= HEAVIEST:
        value, allowed = mass.attributes["value"], f"0 to {HEAVIEST:g} kg"
        reason = f"no link has the mass of {owner}"
        raise document.error(mass, reason, value=value, allowed=allowed)


def _check_numbers(document: Document, owner: str, element: Element) -> None:
    """Refuse attributes below a link or joint that do not hold their numbers."""
    for child in element.children:
        for key, count in _NUMBERS.get(child.tag, {}).items():
            if key in child.attributes:
                numbers = document.numbers(owner, child, key, count)
                if key == "xyz" and np.abs(numbers).max() > FARTHEST:
                    reason = f"the {child.tag} of {owner} is too far away"
                    value = child.attributes[key]
                    raise document.error(child, reason, value=value, allowed="xyz in m")
        _check_numbers(document, owner, child)


def _parents(document: Document, joints: Mapping[str, Element]) -> dict[str, str]:
    """The joint that carries each link but the root."""
    result: dict[str, str] = {}
    for name, joint in joints.items():
        child = _end(joint, "child")
        if child in result:
            reason = f"link '{child}' is the child of two joints"
            raise document.error(joint, f"{reason}, '{result[child]}' and '{name}'")
        result[child] = name
    return result


def _root(
    document: Document,
    links: Mapping[str, Element],
    joints: Mapping[str, Element],
    parents: Mapping[str, str],
) -> str:
    """Name of the root link, after a check that the links form one tree."""
    deep: dict[str, int] = {}
    for link in links:
        branch = dict.fromkeys([link])
        while link in parents and link not in deep:
            link = _end(joints[parents[link]], "parent")
            if link in branch:
                loop = [*branch, link]
                words = " > ".join(reversed(loop[loop.index(link) :]))
                reason = f"the links {words} form a loop, and a URDF is a tree"
                raise document.error(joints[parents[link]], reason)
            branch[link] = None
        above = deep.get(link, 0)
        deep |= {name: above + k for k, name in enumerate(reversed(branch))}
        if above + len(branch) > DEEPEST:
            reason = f"link '{next(iter(branch))}' is too far from the root"
            allowed = f"at most {DEEPEST} links one after the other"
            raise document.error(links[next(iter(branch))], reason, allowed=allowed)
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        names = enumerated(f"'{link}'" for link in roots)
        reason = f"the links {names} all have no parent joint, and a URDF has one root"
        raise document.error(links[roots[1]], reason)
    return roots[0]


def _mimics(document: Document, joints: Mapping[str, Element]) -> dict[str, Mimic]:
    """Mimic joints, each with the driven joint at the end of those that it follows."""
    stated: dict[str, Mimic] = {}
    for name, joint in joints.items():
        element = joint.child("mimic")
        if element is not None and joint.attributes["type"] in _SINGLE:
            factor, offset = (
                float(document.numbers(f"joint '{name}'", element, key, 1)[0])
                if key in element.attributes
                else usual
                for key, usual in (("multiplier", 1.0), ("offset", 0.0))
            )
            stated[name] = Mimic(element.attributes.get("joint", ""), factor, offset)
    driven: dict[str, Mimic] = {}
    for name in stated:
        path: dict[str, None] = {}
        while name in stated and name not in driven and name not in path:
            path[name] = None
            name = stated[name].leader
        for name in reversed(path):
            mimic = stated[name]
            if above := driven.get(mimic.leader):
                offset = mimic.factor * above.offset + mimic.offset
                mimic = Mimic(above.leader, mimic.factor * above.factor, offset)
            driven[name] = mimic
    result = {}
    for name, mimic in driven.items():
        leader = None if mimic.leader in stated else joints.get(mimic.leader)
        if leader is not None and leader.attributes["type"] in _SINGLE:
            result[name] = mimic
    return result


def _refused(
    joints: Mapping[str, Element], mimics: Mapping[str, Mimic]
) -> dict[str, str]:
    """Reasons, for the sentence "joint x is ..., which a chain cannot contain"."""
    result = {}
    for name, joint in joints.items():
        kind, mimic = joint.attributes["type"], joint.child("mimic")
        if kind in ("floating", "planar"):
            result[name] = f"a {kind} joint"
        elif kind in _SINGLE and mimic is not None and name not in mimics:
            leader = mimic.attributes.get("joint", "")
            result[name] = f"a mimic joint without a driven leader ('{leader}')"
    return result


def _build_model(
    document: Document, links: Mapping[str, Element], joints: Mapping[str, Element]
) -> pin.Model:
    try:
        with captured_stderr() as printed:
            model = pin.buildModelFromXML(document.plain.decode())
    except Exception as failure:  # Whatever C++ throws.
        errors = re.search(r"Error:\s+(.*?)\s+at line", printed[0], re.DOTALL)
        reason = f"Pinocchio cannot read it: {errors[1] if errors else failure}"
        named = re.findall(r"[Jj]oint \[(.+?)\]", printed[0])
        culprit = next((joints[name] for name in named if name in joints), None)
        raise document.error(culprit or document.root, reason) from failure
    if model.nv > FREEDOM:
        reason = f"the robot has {model.nv} degrees of freedom"
        raise document.error(document.root, reason, allowed=f"at most {FREEDOM}")
    for name, link in links.items():
        if not model.existFrame(name, pin.FrameType.BODY):
            raise document.error(link, f"Pinocchio does not take over link '{name}'")
    for name, joint in joints.items():
        fixed = joint.attributes["type"] == "fixed"
        if not fixed and not model.existJointName(name):
            raise document.error(joint, f"Pinocchio does not take over joint '{name}'")
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
