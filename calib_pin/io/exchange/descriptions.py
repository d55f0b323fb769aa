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
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.exchange.places import camera_links
from calib_pin.io.urdf_tree import Document, link_of, origin_of, parse_document, words

KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}

WORLD = "world"

MASS = 1e-3
"""Of a moving body whose URDF states none: MuJoCo refuses it without [kg]."""

LEAST = {"mass": repr(MASS), "pos": "0 0 0", "fullinertia": "1e-06 1e-06 1e-06 0 0 0"}
"""Its inertia [kg, m, kg m^2]."""

SIX = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""The upper triangle of an inertia, row by row."""


def _corrected(exported: Exported) -> Document:
    return parse_document(exported.robot.source, exported.robot.file)


@partial(Format, "mjcf", ".xml", (*base.RIGID, *base.ROBOTS), "")
def mjcf(exported: Exported, _: Path | None) -> Encoded:
    """MuJoCo's description of the robot.

    Raises:
        OptionError: If the robot has a joint of several degrees of freedom.
    """
    robot, document = exported.robot, _corrected(exported)
    links, joints = document.named("link"), document.named("joint").values()
    root, without = Element("mujoco", model=robot.name), list[str]()
    about = {"angle": "radian", "autolimits": "true", "balanceinertia": "true"}
    SubElement(root, "compiler", about)
    pending: list[tuple[Element, str, Element | None]]
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
        below = (j for j in joints if link_of(j, "parent") == link)
        pending += [(body, link_of(j, "child"), j) for j in below]
    equality = SubElement(root, "equality") if robot.mimics else root
    for name, mimic in robot.mimics.items():
        numbers = words([mimic.offset, mimic.factor, 0.0, 0.0, 0.0])
        ends = {"joint1": name, "joint2": mimic.leader}
        SubElement(equality, "joint", ends, polycoef=numbers)
    indent(root)
    told = f"the URDF states no mass of {', '.join(without)}: {MASS:g} kg is written"
    return Encoded(tostring(root) + b"\n", (told,) if without else ())


def _place(
    exported: Exported, document: Document, joint: Element, body: Element
) -> dict[str, str]:
    """Put a body where its joint is; how this moves it, if it does."""
    name, kind = joint.attrib["name"], joint.attrib["type"]
    pose, limit = document.origin(joint), joint.find("limit")
    x, y, z, w = pin.Quaternion(pose.rotation).coeffs()
    body.attrib |= {"pos": words(pose.translation), "quat": words([w, x, y, z])}
    if kind == "fixed":
        return {}
    if kind not in KINDS:
        raise exported.error(f"joint '{name}' is {kind}, which is not exported")
    axis = words(document.axis(joint))
    moves = {"name": name, "type": KINDS[kind], "axis": axis}
    if kind != "continuous" and limit is not None:
        ends = [float(limit.get(end, 0.0)) for end in ("lower", "upper")]
        moves |= {"range": words(ends)} if ends[0] < ends[1] else {}
    return moves


def _inertia(document: Document, link: Element) -> dict[str, str]:
    """The inertia of a link, if its URDF states one that is more than zero."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    if mass is None or inertia is None:
        return {}
    size, full = float(mass.attrib["value"]), np.zeros((3, 3))
    numbers = [float(inertia.get(key, 0.0)) for key in SIX]
    full[np.triu_indices(3)] = full.T[np.triu_indices(3)] = numbers
    if not (size > 0.0 and np.linalg.eigvalsh(full).min() > 0.0):
        return {}
    pose = document.origin(link.findall("inertial")[0])
    full = pose.rotation @ full @ pose.rotation.T
    numbers = full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    place = {"mass": repr(size), "pos": words(pose.translation)}
    return place | {"fullinertia": words(numbers)}


@partial(Format, "urdf", ".urdf", (*base.RIGID, *base.ROBOTS, base.CAMERA_LINK), "")
def urdf(exported: Exported, _: Path | None) -> Encoded:
    """The corrected URDF, with its camera."""
    document, (links, remarks) = _corrected(exported), camera_links(exported)
    before, end, after = document.data.rpartition(b"</")
    return Encoded(document.encoded(before + links.encode() + end + after), remarks)


@partial(Format, "xacro", ".xacro", (*base.RIGID, *base.ROBOTS, base.CAMERA_LINK), "")
def xacro(exported: Exported, _: Path | None) -> Encoded:
    """Joint origins as properties, and the camera's links, to be included.

    Those of the chain, and those that the calibration moved. Properties have names that
    may stand in an expression, and no other joint's.
    """
    document, (links, remarks) = _corrected(exported), camera_links(exported)
    changed = {} if exported.geometry is None else exported.geometry.urdf_corrections()
    owners, about = dict[str, str](), escape(exported.robot.name).replace("--", "- -")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- joint origins of {about}, calibrated: "
        "include it, and take them as "
        '<origin xyz="${NAME_xyz}" rpy="${NAME_rpy}"/> -->',
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">',
    ]
    for name, joint in document.named("joint").items():
        if name in {*exported.chains.joints, *changed}:
            own = re.sub(r"\W|^(?=\d)", "_", name)
            while own in owners:
                own += "_"
            owners[own] = name
            numbers = origin_of(document.origin(joint))
            for key, three in (("xyz", numbers[:3]), ("rpy", numbers[3:])):
                about = f'name={quoteattr(f"{own}_{key}")} value="{words(three)}"'
                lines.append(f"  <xacro:property {about}/>")
    renamed = [
        f"{own}_xyz, {own}_rpy are those of '{name}'"
        for own, name in owners.items()
        if own != name
    ]
    data = "\n".join([*lines, f"{links}</robot>", ""]).encode()
    return Encoded(data, (*renamed, *remarks))
