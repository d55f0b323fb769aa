"""MuJoCo's description of the corrected robot: bodies, joints, limits, inertias.

Shapes are not written; MuJoCo compiles them from the corrected URDF itself.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.urdf_bytes import Document, Element, parse_document
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats

KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}

WORLD = "world"

LEAST_MASS, LEAST_INERTIA = 1e-3, 1e-6
"""Of a moving body whose URDF states none: MuJoCo refuses it without [kg, kg m^2]."""


def encode(exported: Exported, _: Path | None) -> Encoded:
    """The description.

    Raises:
        OptionError: If the robot has a joint of several degrees of freedom.
    """
    robot = exported.robot
    document = parse_document(robot.source, robot.file)
    below: dict[str, list[Element]] = {}
    for element in document.root.children:
        if element.tag == "joint":
            below.setdefault(_link(element, "parent"), []).append(element)
    links = {e.attributes["name"]: e for e in document.root.children if e.tag == "link"}
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
        stated = body is not world and _inertial(document, links[link], body)
        if moving and not stated:
            without.append(link)
            _write_inertial(body, LEAST_MASS, np.zeros(3), LEAST_INERTIA * np.eye(3))
        pending += [(body, _link(j, "child"), j) for j in below.get(link, [])]
    ElementTree.indent(root)
    data = ElementTree.tostring(root) + b"\n"
    exported.require_same(lambda q: _poses(data, exported.chain, q), "the MJCF")
    told = ", ".join(without)
    return Encoded(
        data,
        (f"the URDF states no mass of {told}: {LEAST_MASS:g} kg is written",)
        if without
        else (),
    )


def _link(joint: Element, end: str) -> str:
    element = joint.child(end)
    return "" if element is None else element.attributes["link"]


def _place(
    document: Document, body: ElementTree.Element, joint: Element, file: Path
) -> bool:
    """Put a body where its joint is; whether it moves."""
    name, kind = joint.attributes["name"], joint.attributes["type"]
    _write_pose(body, document.origin(joint))
    if kind == "fixed":
        return False
    if kind not in KINDS:
        raise OptionError(f"joint '{name}' is {kind}, which is not exported", file=file)
    stated = joint.child("axis")
    axis = np.array([1.0, 0.0, 0.0])
    if stated is not None and "xyz" in stated.attributes:
        axis = document.numbers(f"joint '{name}'", stated, "xyz", 3)
    element = ElementTree.SubElement(
        body, "joint", name=name, type=KINDS[kind], axis=_words(axis)
    )
    limit = joint.child("limit")
    if kind != "continuous" and limit is not None:
        ends = [float(limit.attributes.get(end, 0.0)) for end in ("lower", "upper")]
        if ends[0] < ends[1]:
            element.set("range", _words(ends))
    return True


def _inertial(document: Document, link: Element, body: ElementTree.Element) -> bool:
    """Write the inertia of a link, if its URDF states one that is more than zero."""
    stated = link.child("inertial")
    mass = None if stated is None else stated.child("mass")
    inertia = None if stated is None else stated.child("inertia")
    if stated is None or mass is None or inertia is None:
        return False
    owner = f"link '{link.attributes['name']}'"
    size = float(document.numbers(owner, mass, "value", 1)[0])
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (
        float(document.numbers(owner, inertia, key, 1)[0])
        if key in inertia.attributes
        else 0.0
        for key in keys
    )
    inertia_of = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not (size > 0.0 and np.linalg.eigvalsh(inertia_of).min() > 0.0):
        return False
    # An inertial has an origin like a joint.
    pose = document.origin(stated)
    _write_inertial(
        body, size, pose.translation, pose.rotation @ inertia_of @ pose.rotation.T
    )
    return True


def _write_inertial(
    body: ElementTree.Element, mass: float, com: Floats, full: Floats
) -> None:
    six = full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ElementTree.SubElement(
        body, "inertial", mass=repr(mass), pos=_words(com), fullinertia=_words(six)
    )


def _write_pose(body: ElementTree.Element, pose: pin.SE3) -> None:
    x, y, z, w = pin.Quaternion(pose.rotation).coeffs()
    body.set("pos", _words(pose.translation))
    body.set("quat", _words([w, x, y, z]))


def _words(numbers: Sequence[float] | Floats) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _poses(data: bytes, chain: Chain, q: Floats) -> Floats:
    """Poses of the tip in the base as Pinocchio reads the file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "robot.xml")
        file.write_bytes(data)
        model = pin.buildModelFromMJCF(str(file))
    locked = [j for j in range(1, model.njoints) if model.names[j] not in chain.joints]
    model = pin.buildReducedModel(model, locked, pin.neutral(model))
    # The world is the first of Pinocchio's frames.
    frames = [
        0 if name == WORLD and not model.existFrame(name) else model.getFrameId(name)
        for name in (chain.base, chain.tip)
    ]
    order = [chain.joints.index(model.names[j]) for j in range(1, model.njoints)]
    state, poses = model.createData(), np.empty((len(q), 4, 4))
    for row, positions in zip(poses, q[:, order], strict=True):
        pin.framesForwardKinematics(model, state, positions)
        base, tip = (state.oMf[frame] for frame in frames)
        row[:] = base.actInv(tip).homogeneous
    return poses


MJCF = Format("mjcf", ".xml", "MuJoCo's description of the robot", encode)
