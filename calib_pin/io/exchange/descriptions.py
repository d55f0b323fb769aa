"""The corrected robot in other languages: URDF, xacro's properties, and MuJoCo's."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import pinocchio as pin

import calib_pin.io.exchange.base as base
import calib_pin.io.urdf_tree as urdf_tree
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.exchange.places import camera_links
from calib_pin.io.urdf_tree import Document, parse_document

KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}

WORLD = "world"

MASS = 1e-3
"""Of a moving body whose URDF states none: MuJoCo refuses it without [kg]."""

LEAST = {"mass": repr(MASS), "pos": "0 0 0", "fullinertia": "1e-06 1e-06 1e-06 0 0 0"}
"""Its inertia [kg, m, kg m^2]."""


@partial(Format, "mjcf", ".xml", (*base.RIGID, *base.ROBOTS), "")
def mjcf(exported: Exported, _: Path | None) -> Encoded:
    """MuJoCo's description of the robot.

    Raises:
        OptionError: If the robot has a joint of several degrees of freedom.
    """
    robot = exported.robot
    document = parse_document(robot.source, robot.file)
    links, below = document.named("link"), dict[str, list[urdf_tree.Element]]()
    for element in document.root.all("joint"):
        below.setdefault(element.link("parent"), []).append(element)
    root, without = Element("mujoco", model=robot.name), []
    about = {"angle": "radian", "autolimits": "true", "balanceinertia": "true"}
    SubElement(root, "compiler", about)
    pending: list[tuple[Element, str, urdf_tree.Element | None]]
    pending = [(SubElement(root, "worldbody"), robot.root, None)]
    while pending:
        body, link, joint = pending.pop()
        stated = _inertia(document, links[link])
        if joint is not None or link != WORLD:  # Which MuJoCo has already.
            body = SubElement(body, "body", name=link)
        if joint is not None and (moves := _place(exported, document, joint, body)):
            SubElement(body, "joint", moves)
            without += [] if stated else [link]
            stated = stated or LEAST
        if stated and body.tag == "body":  # MuJoCo's world has no inertia.
            SubElement(body, "inertial", stated)
        pending += [(body, j.link("child"), j) for j in below.get(link, [])]
    if robot.mimics:
        equality = SubElement(root, "equality")
    for name, mimic in robot.mimics.items():
        numbers = base.words([mimic.offset, mimic.factor, 0.0, 0.0, 0.0])
        ends = {"joint1": name, "joint2": mimic.leader}
        SubElement(equality, "joint", ends, polycoef=numbers)
    indent(root)
    told = f"the URDF states no mass of {', '.join(without)}: {MASS:g} kg is written"
    return Encoded(tostring(root) + b"\n", (told,) if without else ())


def _place(
    exported: Exported, document: Document, joint: urdf_tree.Element, body: Element
) -> dict[str, str]:
    """Put a body where its joint is; how this moves it, if it does."""
    name, kind = joint.attributes["name"], joint.attributes["type"]
    pose, limit = document.origin(joint), joint.child("limit")
    x, y, z, w = pin.Quaternion(pose.rotation).coeffs()
    body.set("pos", base.words(pose.translation))
    body.set("quat", base.words([w, x, y, z]))
    if kind == "fixed":
        return {}
    if kind not in KINDS:
        raise exported.error(f"joint '{name}' is {kind}, which is not exported")
    moves = {
        "name": name,
        "type": KINDS[kind],
        "axis": base.words(document.axis(joint)),
    }
    if kind != "continuous" and limit is not None:
        ends = [float(limit.attributes.get(end, 0.0)) for end in ("lower", "upper")]
        moves |= {"range": base.words(ends)} if ends[0] < ends[1] else {}
    return moves


def _inertia(document: Document, link: urdf_tree.Element) -> dict[str, str]:
    """The inertia of a link, if its URDF states one that is more than zero."""
    for stated in link.all("inertial")[:1]:
        mass, inertia = stated.child("mass"), stated.child("inertia")
        if mass is None or inertia is None:
            break
        size, full = float(mass.attributes["value"]), np.zeros((3, 3))
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        six = [float(inertia.attributes.get(key, 0.0)) for key in keys]
        full[np.triu_indices(3)] = full.T[np.triu_indices(3)] = six
        if size > 0.0 and np.linalg.eigvalsh(full).min() > 0.0:
            pose = document.origin(stated)
            full = pose.rotation @ full @ pose.rotation.T
            six = full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            place = {"mass": repr(size), "pos": base.words(pose.translation)}
            return place | {"fullinertia": base.words(six)}
    return {}


@partial(Format, "urdf", ".urdf", (*base.RIGID, *base.ROBOTS, base.CAMERA_LINK), "")
def urdf(exported: Exported, _: Path | None) -> Encoded:
    """The corrected URDF, with its camera."""
    robot, (links, remarks) = exported.robot, camera_links(exported)
    document = parse_document(robot.source, robot.file)
    end = document.data.rfind(b"</")
    data = document.data[:end] + links.encode() + document.data[end:]
    return Encoded(document.mark + data.decode().encode(document.codec), remarks)


@partial(Format, "xacro", ".xacro", (*base.RIGID, *base.ROBOTS, base.CAMERA_LINK), "")
def xacro(exported: Exported, _: Path | None) -> Encoded:
    """Joint origins as properties, and the camera's links, to be included.

    Those of the chain, and those that the calibration moved. Properties have names that
    may stand in an expression, and no other joint's.
    """
    document = parse_document(exported.robot.source, exported.robot.file)
    changed = {} if exported.geometry is None else exported.geometry.urdf_corrections()
    properties, renamed = dict[str, str](), list[str]()
    for name, joint in document.named("joint").items():
        if name not in {*exported.chains.joints, *changed}:
            continue
        own = re.sub(r"\W|^(?=\d)", "_", name)
        while f"{own}_xyz" in properties:
            own += "_"
        if own != name:
            renamed.append(f"{own}_xyz, {own}_rpy are those of '{name}'")
        numbers = base.origin_of(document.origin(joint))
        properties[f"{own}_xyz"] = base.words(numbers[:3])
        properties[f"{own}_rpy"] = base.words(numbers[3:])
    about = escape(exported.robot.name).replace("--", "- -")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- joint origins of {about}, calibrated: "
        "include it, and take them as "
        '<origin xyz="${NAME_xyz}" rpy="${NAME_rpy}"/> -->',
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">',
    ]
    for name, text in properties.items():
        lines.append(f'  <xacro:property name={quoteattr(name)} value="{text}"/>')
    links, remarks = camera_links(exported)
    data = "\n".join([*lines, f"{links}</robot>", ""]).encode()
    return Encoded(data, (*renamed, *remarks))
