"""The corrected robot in other languages: MuJoCo's, and xacro's properties."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError
from calib_pin.io.exchange.base import (
    Encoded,
    Exported,
    Format,
    origin_of,
    require_read,
)
from calib_pin.io.urdf_tree import Document, Element, parse_document
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats

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
    exported.require_same(lambda q: _poses(data, exported.chain, q), "the MJCF")
    told = f"the URDF states no mass of {', '.join(without)}: {LEAST_MASS:g} kg is"
    return Encoded(data, (f"{told} written",) if without else ())


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


def _poses(data: bytes, chain: Chain, q: Floats) -> Floats:
    """Poses of the tip in the base as Pinocchio reads the file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "robot.xml")
        file.write_bytes(data)
        model = pin.buildModelFromMJCF(str(file))
    # The world is the first of Pinocchio's frames.
    ends = [
        0 if name == WORLD and not model.existFrame(name) else model.getFrameId(name)
        for name in (chain.base, chain.tip)
    ]
    state, poses, full = model.createData(), [], pin.neutral(model)
    for positions in q:
        for joint, position in zip(chain.joints, positions, strict=True):
            full[model.joints[model.getJointId(joint)].idx_q] = position
        pin.framesForwardKinematics(model, state, full)
        base, tip = (state.oMf[end] for end in ends)
        poses.append(base.actInv(tip).homogeneous)
    return np.array(poses)


NAMESPACE = "http://www.ros.org/wiki/xacro"


def encode_xacro(exported: Exported, _: Path | None) -> Encoded:
    """The overlay."""
    properties = {}
    for name, origin in corrected_origins(exported).items():
        numbers = list(map(repr, origin_of(origin)))
        own = re.sub(r"\W", "_", name)  # A name that may stand in an expression.
        properties[f"{own}_xyz"] = " ".join(numbers[:3])
        properties[f"{own}_rpy"] = " ".join(numbers[3:])
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- joint origins of {escape(exported.robot.name)}, calibrated: "
        "include it, and take them as "
        '<origin xyz="${NAME_xyz}" rpy="${NAME_rpy}"/> -->',
        f'<robot xmlns:xacro="{NAMESPACE}">',
    ]
    for name, text in properties.items():
        lines.append(f'  <xacro:property name={quoteattr(name)} value="{text}"/>')
    data = "\n".join([*lines, "</robot>", ""]).encode()
    found = {e.get("name"): e.get("value") for e in ElementTree.fromstring(data)}
    require_read(found, properties, "the origins")
    return Encoded(data)


def corrected_origins(exported: Exported) -> dict[str, pin.SE3]:
    """Origins of the joints in the corrected URDF that differ from the nominal one.

    All of the chain stand among them, so that an overlay is complete.
    """
    document = parse_document(exported.robot.source, exported.robot.file)
    changed = {} if exported.geometry is None else exported.geometry.urdf_corrections()
    wanted = {*exported.nominal.joints, *changed}
    named = document.named("joint").items()
    return {name: document.origin(joint) for name, joint in named if name in wanted}


MJCF = Format("mjcf", ".xml", "MuJoCo's description of the robot", encode_mjcf)
XACRO = Format(
    "xacro", ".xacro", "joint origins as properties, to be included", encode_xacro
)
