"""The corrected robot in other languages: MuJoCo's, and xacro's properties."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError
from calib_pin.io.exchange.base import (
    CAMERA_LINK,
    RIGID,
    ROBOTS,
    Encoded,
    Exported,
    Format,
    origin_of,
    require_read,
)
from calib_pin.io.exchange.places import camera_links
from calib_pin.io.urdf_tree import Document, Element, parse_document
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, invert, se3_exp

KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}

WORLD = "world"

LEAST_MASS, LEAST_INERTIA = 1e-3, 1e-6
"""Of a moving body whose URDF states none: MuJoCo refuses it without [kg, kg m^2]."""


def encode_mjcf(exported: Exported, _: Path | None) -> Encoded:
    """The description.

    Raises:
        OptionError: If the robot has a joint of several degrees of freedom.
    """
    robot = exported.robot
    document = parse_document(robot.source, robot.file)
    links, below = document.named("link"), dict[str, list[Element]]()
    for element in document.root.all("joint"):
        below.setdefault(element.link("parent"), []).append(element)
    root = ElementTree.Element("mujoco", model=robot.name)
    ElementTree.SubElement(
        root, "compiler", angle="radian", autolimits="true", balanceinertia="true"
    )
    world = ElementTree.SubElement(root, "worldbody")
    pending: list[tuple[ElementTree.Element, str, Element | None]] = [
        (world, robot.root, None)
    ]
    without = []
    _couple(root, exported)
    while pending:
        parent, link, joint = pending.pop()
        body, moving = parent, False
        if joint is not None or link != WORLD:  # Which MuJoCo has already.
            body = ElementTree.SubElement(parent, "body", name=link)
            moving = joint is not None and _place(document, body, joint, exported.file)
            if not _inertial(document, links[link], body) and moving:
                without.append(link)
                least = LEAST_INERTIA * np.eye(3)
                _write_inertial(body, LEAST_MASS, np.zeros(3), least)
        pending += [(body, j.link("child"), j) for j in below.get(link, [])]
    ElementTree.indent(root)
    data = ElementTree.tostring(root) + b"\n"
    read = partial(_poses, ElementTree.fromstring(data))
    exported.require_same(read, "the MJCF")
    told = f"the URDF states no mass of {', '.join(without)}: {LEAST_MASS:g} kg is"
    return Encoded(data, (f"{told} written",) if without else (), read)


def _couple(root: ElementTree.Element, exported: Exported) -> None:
    """Let mimic joints follow their leaders."""
    if exported.robot.mimics:
        equality = ElementTree.SubElement(root, "equality")
    for name, mimic in exported.robot.mimics.items():
        numbers = _words([mimic.offset, mimic.factor, 0.0, 0.0, 0.0])
        ends = {"joint1": name, "joint2": mimic.leader}
        ElementTree.SubElement(equality, "joint", ends, polycoef=numbers)


def _place(
    document: Document, body: ElementTree.Element, joint: Element, file: Path
) -> bool:
    """Put a body where its joint is; whether it moves."""
    name, kind = joint.attributes["name"], joint.attributes["type"]
    pose = document.origin(joint)
    x, y, z, w = pin.Quaternion(pose.rotation).coeffs()
    body.set("pos", _words(pose.translation))
    body.set("quat", _words([w, x, y, z]))
    if kind == "fixed":
        return False
    if kind not in KINDS:
        raise OptionError(f"joint '{name}' is {kind}, which is not exported", file=file)
    element = ElementTree.SubElement(
        body, "joint", name=name, type=KINDS[kind], axis=_words(document.axis(joint))
    )
    limit = joint.child("limit")
    if kind != "continuous" and limit is not None:
        ends = [float(limit.attributes.get(end, 0.0)) for end in ("lower", "upper")]
        if ends[0] < ends[1]:
            element.set("range", _words(ends))
    return True


def _inertial(document: Document, link: Element, body: ElementTree.Element) -> bool:
    """Write the inertia of a link, if its URDF states one that is more than zero."""
    for stated in link.all("inertial")[:1]:
        mass, inertia = stated.child("mass"), stated.child("inertia")
        if mass is None or inertia is None:
            return False
        size, full = float(mass.attributes["value"]), np.zeros((3, 3))
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        six = [float(inertia.attributes.get(key, 0.0)) for key in keys]
        full[np.triu_indices(3)] = full.T[np.triu_indices(3)] = six
        if size > 0.0 and np.linalg.eigvalsh(full).min() > 0.0:
            pose = document.origin(stated)
            turned = pose.rotation @ full @ pose.rotation.T
            _write_inertial(body, size, pose.translation, turned)
            return True
    return False


def _write_inertial(
    body: ElementTree.Element, mass: float, com: Floats, full: Floats
) -> None:
    six = full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ElementTree.SubElement(
        body, "inertial", mass=repr(mass), pos=_words(com), fullinertia=_words(six)
    )


def _words(numbers: Sequence[float] | Floats) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _poses(root: ElementTree.Element, chain: Chain, q: Floats) -> Floats:
    """Poses of the tip in the base by the file, where mimic joints follow."""
    at = dict(zip(chain.joints, q.T, strict=True))
    for name, mimic in chain.mimics.items():  # These follow by the file alone.
        position = at.pop(name)
        if mimic.factor:
            at.setdefault(mimic.leader, (position - mimic.offset) / mimic.factor)
    for coupling in root.iterfind("equality/joint"):
        offset, factor, *_ = _numbers(coupling, "polycoef")
        leader = at.get(coupling.get("joint2", ""), np.zeros(len(q)))
        at[coupling.get("joint1", "")] = offset + factor * leader
    bodies = {body.get("name", ""): body for body in root.iter("body")}
    above = {child: b for b in bodies.values() for child in b.findall("body")}
    ends = []
    for link in (chain.base, chain.tip):
        T, body = np.eye(4), bodies.get(link)
        while body is not None:
            w, *xyz = _numbers(body, "quat") or [1.0, 0.0, 0.0, 0.0]
            pose = pin.SE3(pin.Quaternion(np.array([*xyz, w])), np.zeros(3))
            pose.translation = np.array(_numbers(body, "pos") or [0.0, 0.0, 0.0])
            for joint in body.findall("joint"):
                axis = np.array(_numbers(joint, "axis"))
                axis, none = axis / np.linalg.norm(axis), np.zeros(3)
                hinge = joint.get("type") == "hinge"
                motion = np.concatenate([none, axis] if hinge else [axis, none])
                position = at.get(joint.get("name", ""), np.zeros(len(q)))
                T = se3_exp(np.outer(position, motion)) @ T
            T, body = pose.homogeneous @ T, above.get(body)
        ends.append(T)
    return np.asarray(invert(ends[0]) @ ends[1])


def _numbers(element: ElementTree.Element, key: str) -> list[float]:
    return [float(word) for word in element.get(key, "").split()]


def encode_description(exported: Exported, _: Path | None) -> Encoded:
    """The corrected URDF itself, with links of the cameras that were located."""
    robot, (links, remarks) = exported.robot, camera_links(exported)
    document = parse_document(robot.source, robot.file)
    end = document.data.rfind(b"</")
    data = document.data[:end] + links.encode() + document.data[end:]
    data = document.mark + data.decode().encode(document.codec)
    names = [len(parse_document(d).named("link")) for d in (robot.source, data)]
    require_read(names[1] - names[0], links.count("<link "), "the cameras")
    return Encoded(data, remarks, exported.corrected_poses)


NAMESPACE = "http://www.ros.org/wiki/xacro"


def encode_xacro(exported: Exported, _: Path | None) -> Encoded:
    """The overlay."""
    properties, renamed = dict[str, str](), list[str]()
    for name, origin in corrected_origins(exported).items():
        numbers = list(map(repr, origin_of(origin)))
        # A name that may stand in an expression, and no other joint's.
        own = re.sub(r"\W|^(?=\d)", "_", name)
        while f"{own}_xyz" in properties:
            own += "_"
        if own != name:
            renamed.append(f"{own}_xyz, {own}_rpy are those of '{name}'")
        properties[f"{own}_xyz"] = " ".join(numbers[:3])
        properties[f"{own}_rpy"] = " ".join(numbers[3:])
    about = escape(exported.robot.name).replace("--", "- -")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- joint origins of {about}, calibrated: "
        "include it, and take them as "
        '<origin xyz="${NAME_xyz}" rpy="${NAME_rpy}"/> -->',
        f'<robot xmlns:xacro="{NAMESPACE}">',
    ]
    for name, text in properties.items():
        lines.append(f'  <xacro:property name={quoteattr(name)} value="{text}"/>')
    links, remarks = camera_links(exported)
    data = "\n".join([*lines, f"{links}</robot>", ""]).encode()
    stated = ElementTree.fromstring(data).iterfind(f"{{{NAMESPACE}}}property")
    found = {e.get("name"): e.get("value") for e in stated}
    require_read(found, properties, "the origins")
    return Encoded(data, (*renamed, *remarks), exported.corrected_poses)


def corrected_origins(exported: Exported) -> dict[str, pin.SE3]:
    """Origins of the joints in the corrected URDF that differ from the nominal one.

    All of the chain stand among them, so that an overlay is complete.
    """
    document = parse_document(exported.robot.source, exported.robot.file)
    changed = {} if exported.geometry is None else exported.geometry.urdf_corrections()
    wanted = {*exported.chains.joints, *changed}
    named = document.named("joint").items()
    return {name: document.origin(joint) for name, joint in named if name in wanted}


HELD = (*RIGID, *ROBOTS)
"""Held by a description of the whole robot."""

SEEN = (*HELD, CAMERA_LINK)
"""The same with its cameras."""

URDF = Format(
    "urdf",
    ".urdf",
    "the corrected URDF, with its camera",
    encode_description,
    holds=SEEN,
)
MJCF = Format(
    "mjcf", ".xml", "MuJoCo's description of the robot", encode_mjcf, holds=HELD
)
XACRO = Format(
    "xacro",
    ".xacro",
    "joint origins as properties, and the camera's links, to be included",
    encode_xacro,
    holds=SEEN,
)
