"""The corrected robot and its frames in other languages.

Xacro's properties and MuJoCo's description hold the corrected robot; static transforms
and camera files say where base, tools, stations and cameras are.
"""

from __future__ import annotations

import re
import shlex
from functools import partial
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin
import yaml

import calib_pin.io.exchange.base as base
import calib_pin.io.urdf_tree as urdf_tree
from calib_pin.errors import enumerated
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.urdf_tree import Document, origin_of, unused, words
from calib_pin.measurement_models.declaration import QUATERNION
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.validation.result import REMEDY, frames_of

KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}

WORLD = "world"

MASS = 1e-3
"""Of a moving body whose URDF states none: MuJoCo refuses it without [kg]."""

LEAST = {"mass": repr(MASS), "pos": "0 0 0", "fullinertia": "1e-06 1e-06 1e-06 0 0 0"}
"""Its inertia, also that of a mass without one, such as a point [kg, m, kg m^2]."""

NAMES = {"base": ("measurement", "measured_frame"), "tool": ("tool", "measured_point")}
"""Names of the frames that have none of their own, by how they are called here."""

TURNS = ("rx", "ry", "rz")
"""Components of an orientation."""


class Place(NamedTuple):
    """A frame that stands still in a link.

    Attributes:
        parent: The link.
        child: Name of the frame, which no link and no other frame has.
        pose: Its pose in the link.
    """

    parent: str
    child: str
    pose: pin.SE3

    @property
    def numbers(self) -> dict[str, float]:
        """Position [m] and quaternion, each number by its name."""
        numbers = pin.SE3ToXYZQUAT(self.pose).tolist()
        return dict(zip((*"xyz", *QUATERNION), numbers, strict=True))


def places(
    exported: Exported, *, cameras: bool = False
) -> tuple[list[Place], tuple[str, ...]]:
    """The measurement frames in the base link, and the tools in the tip link.

    They belong to the corrected URDF; a frame that several blocks share is listed once.

    Args:
        exported: The calibration.
        cameras: Only the frames of cameras.

    Returns:
        The frames of which all is known, or of a point its position, and sentences
        about what is not known of them and of others.
    """
    frames, remarks = dict[tuple[str, ...], Place | None](), list[str]()
    result, model = exported.result, exported.result.described
    used = set(model.chains.robot.links)
    for term in model.terms.values():
        if exported.name not in (None, term.key.chain):
            continue
        chain, (station, tool) = term.error.chain, (f for f, _ in frames_of(term))
        start, tip = term.error.base.inverse(), model.of(term.key).tool
        seen = {
            "tool" if reference.mount == "hand" else "station": reference
            for reference in term.measurement.references
            if isinstance(reference, Camera)
        }
        for frame, link, pose in ((station, chain.base, start), (tool, chain.tip, tip)):
            key, camera = (*frame, link), seen.get(frame.kind)
            if key in frames or (cameras and camera is None):
                continue
            names = NAMES.get(frame.name, (f"{frame.name}_{frame.kind}",))
            if camera is not None:
                name = term.frames.reference(camera)
                names = (name, f"{name}_optical_frame")
            *plain, last = (re.sub(r"[./]", "_", name) for name in names)
            free = next((name for name in plain if name not in used), last)
            child, unknown = unused(free, used), result.unknown_of(*frame)
            where, frames[key] = f"of {link} -> {child}", Place(link, child, pose)
            if frame is tool and camera is None and unknown == TURNS:
                reason = "was not measured, only its position"
                remarks.append(f"the orientation {where} {reason}")
            elif unknown:
                remarks.append(f"{', '.join(unknown)} {where} unknown")
                frames[key] = None
    known = [place for place in frames.values() if place is not None]
    if len(known) < len(frames):
        remarks.append(REMEDY)
    return known, tuple(remarks)


def _corrected(exported: Exported) -> Document:
    return urdf_tree.parse_document(exported.robot.source, exported.robot.file)


@partial(Format, "mjcf", (*base.RIGID, *base.ROBOTS), "")
def mjcf(exported: Exported, _: Path | None) -> Encoded:
    """MuJoCo's description of the robot.

    Raises:
        OptionError: If the robot has a joint of several degrees of freedom.
    """
    robot, document = exported.robot, _corrected(exported)
    links, joints = document.named("link"), document.named("joint").values()
    root, without = Element("mujoco", model=robot.name), list[str]()
    settings = {"angle": "radian", "autolimits": "true", "balanceinertia": "true"}
    SubElement(root, "compiler", settings)
    pending: list[tuple[Element, str, Element | None]]
    pending = [(SubElement(root, "worldbody"), robot.root, None)]
    while pending:
        body, link, joint = pending.pop()
        inertia = inertia_of(document, links[link])
        if joint is not None or link != WORLD:  # Which MuJoCo has already.
            body = SubElement(body, "body", name=link)
        if joint is not None and (moves := _put(exported, document, joint, body)):
            SubElement(body, "joint", moves)
            without += [] if inertia else [link]
            inertia = inertia or LEAST
        if inertia and body.tag == "body":  # MuJoCo's world has no inertia.
            SubElement(body, "inertial", inertia)
        below = (j for j in joints if urdf_tree.link_of(j, "parent") == link)
        pending += [(body, urdf_tree.link_of(j, "child"), j) for j in below]
    equality = SubElement(root, "equality") if robot.mimics else root
    for name, mimic in robot.mimics.items():
        numbers = words([mimic.offset, mimic.factor, 0.0, 0.0, 0.0])
        ends = {"joint1": name, "joint2": mimic.leader}
        SubElement(equality, "joint", ends, polycoef=numbers)
    indent(root)
    remark = f"the URDF states no mass of {', '.join(without)}: {MASS:g} kg is written"
    return Encoded(tostring(root) + b"\n", (remark,) if without else ())


def _put(
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


def inertia_of(document: Document, link: Element) -> dict[str, str]:
    """The inertia of a link, if its URDF states a mass."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    size, full = 0.0 if mass is None else float(mass.attrib["value"]), np.zeros((3, 3))
    if not size > 0.0:
        return {}
    pose = document.origin(link.findall("inertial")[0])
    place = LEAST | {"mass": repr(size), "pos": words(pose.translation)}
    if inertia is None:
        return place
    # The upper triangle, row by row.
    numbers = [float(inertia.get(key, 0.0)) for key in urdf_tree.NUMBERS["inertia"]]
    full[np.triu_indices(3)] = full.T[np.triu_indices(3)] = numbers
    if not np.linalg.eigvalsh(full).min() > 0.0:
        return place
    full = pose.rotation @ full @ pose.rotation.T
    numbers = full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return place | {"fullinertia": words(numbers)}


@partial(Format, "xacro", (*base.RIGID, *base.ROBOTS), "")
def xacro(exported: Exported, _: Path | None) -> Encoded:
    """Joint origins as properties, to be included.

    Those of the chain, and those that the calibration moved. Properties have names that
    may stand in an expression, and no other joint's.
    """
    from xml.sax.saxutils import escape, quoteattr  # Loads what reads from the network.

    document = _corrected(exported)
    changed = {} if exported.geometry is None else exported.geometry.urdf_corrections()
    used, renamed = set[str](), list[str]()
    title = escape(exported.robot.name).replace("--", "- -")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- joint origins of {title}, calibrated: include it, and take them as "
        '<origin xyz="${NAME_xyz}" rpy="${NAME_rpy}"/> -->',
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">',
    ]
    for name, joint in document.named("joint").items():
        if name in {*exported.chains.joints, *changed}:
            stem = unused(re.sub(r"\W|^(?=\d)", "_", name), used)
            if stem != name:
                renamed.append(f"{stem}_xyz, {stem}_rpy are those of '{name}'")
            numbers = origin_of(document.origin(joint))
            for key, three in (("xyz", numbers[:3]), ("rpy", numbers[3:])):
                attributes = f'name={quoteattr(f"{stem}_{key}")} value="{words(three)}"'
                lines.append(f"  <xacro:property {attributes}/>")
    data = "\n".join([*lines, "</robot>", ""]).encode()
    return Encoded(data, tuple(renamed))


@partial(Format, "tf", (base.FRAMES, *base.ROBOTS), "")
def tf(exported: Exported, _: Path | None) -> Encoded:
    """Static transforms of base, tools, stations, camera.

    As ROS prints them, and the commands that publish them.

    Raises:
        OptionError: If nothing is known of any.
    """
    (frames, remarks), documents, commands = places(exported), [], []
    for place in frames:
        numbers = place.numbers
        turn = {key[1:]: numbers[key] for key in QUATERNION}
        pose = {"translation": {k: numbers[k] for k in "xyz"}, "rotation": turn}
        head = {"header": {"frame_id": place.parent}, "child_frame_id": place.child}
        documents.append(head | {"transform": pose})
        ends = {"frame-id": place.parent, "child-frame-id": place.child}
        options = {**{key: repr(number) for key, number in numbers.items()}, **ends}
        flags = " ".join(f"--{key} {shlex.quote(o)}" for key, o in options.items())
        commands.append(f"# ros2 run tf2_ros static_transform_publisher {flags}")
    if not documents:
        raise exported.error("; ".join(remarks))
    text = yaml.safe_dump({"transforms": documents}, sort_keys=False)
    lines = [*(f"# {remark}" for remark in remarks), *commands, text]
    return Encoded("\n".join(lines).encode(), remarks)


@partial(Format, "camera-info", (base.CAMERA, *base.ROBOTS), "")
def camera_info(exported: Exported, _: Path | None) -> Encoded:
    """The camera, as ROS loads it.

    With its place, as a comment.

    Raises:
        OptionError: If there is not one camera, or its intrinsics are not known.
    """
    cameras = exported.result.described.cameras
    if len(cameras) != 1:
        names = ", ".join(cameras) or "none"
        raise exported.error("one camera can be exported", names)
    ((name, camera),) = cameras.items()
    if unknown := [p for p in exported.result.unknown if p.startswith(f"{name}.")]:
        raise exported.error(f"{enumerated(unknown)} unknown; {REMEDY}")
    if camera.size is None:
        hint = "state 'size: [width, height]' [px] of 'camera', and calibrate again"
        raise exported.error(f"the size of the images is unknown; {hint}")
    (fx, fy), (cx, cy) = camera.focal, camera.center
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    matrices = {
        "camera_matrix": K,
        "distortion_coefficients": np.array([camera.distortion]),
        "rectification_matrix": np.eye(3),
        "projection_matrix": np.pad(K, ((0, 0), (0, 1))),
    }
    width, height = map(int, camera.size)
    document = {"image_width": width, "image_height": height, "camera_name": name}
    document |= {"distortion_model": "plumb_bob"}
    for key, matrix in matrices.items():
        (rows, cols), data = matrix.shape, matrix.ravel().tolist()
        document[key] = {"rows": rows, "cols": cols, "data": data}
    (placed, remarks), place_text = places(exported, cameras=True), ""
    for place in placed:
        numbers = [*place.numbers.values()]
        x, turn = words(numbers[:3]), words(numbers[3:])
        place_text = f" in {place.parent}: xyz {x}, quaternion x y z w {turn}"
    lines = [f"# optical frame{place_text or f': {remarks[0]}'}"]
    lines.append(yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
    return Encoded("\n".join(lines).encode(), remarks)
