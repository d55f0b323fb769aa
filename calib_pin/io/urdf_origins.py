"""Origins in a URDF: read, and changed in its bytes without touching the rest."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin

from calib_pin.errors import OutputError, RobotError, nearest
from calib_pin.io.urdf_bytes import Document, Element, parse_document
from calib_pin.kinematics.spatial import Floats

_INDENT = re.compile(rb"(?:\r\n|\n|\r)[ \t]*\Z")


def edit_origins(
    source: bytes, corrections: Mapping[str, pin.SE3], file: str | None = None
) -> bytes:
    """Change joint origins, `origin <- origin * correction`, and nothing else.

    Only the values of `xyz` and `rpy` (or `quat_xyzw`, from URDF 1.1 on) change, with
    all digits; a number that stays the same keeps its text. An attribute or an
    `<origin>` that is missing is added if it is needed.

    Args:
        source: The bytes of a URDF.
        corrections: Correction of each joint by name, multiplied from the right.
        file: Name of the URDF, for messages.

    Returns:
        The bytes of the corrected URDF.

    Raises:
        RobotError: If the URDF cannot be read or has no such joint.
        OutputError: If a correction is not finite.

    Examples:
        >>> urdf = b'<robot><joint name="j"><origin xyz="1 0 .5"/></joint></robot>'
        >>> shift = pin.SE3(np.eye(3), np.array([0.25, 0.0, 0.0]))
        >>> edit_origins(urdf, {"j": shift}).decode()
        '<robot><joint name="j"><origin xyz="1.25 0 .5"/></joint></robot>'
    """
    document = parse_document(source, file)
    joints = {
        element.attributes.get("name", ""): element
        for element in document.root.children
        if element.tag == "joint"
    }
    for name in corrections:
        if name not in joints:
            hint = nearest(name, joints)
            raise RobotError(f"the robot has no joint '{name}'{hint}", file=file)
    named = corrections.items()
    return move_origins(document, [(joints[name], move) for name, move in named])


def move_origins(document: Document, moves: Iterable[tuple[Element, pin.SE3]]) -> bytes:
    """The bytes of a URDF with other origins of joints, shapes or masses.

    Args:
        document: The URDF.
        moves: Elements with an origin, each with what it is multiplied by.

    Raises:
        OutputError: If a move is not finite.
    """
    edits = []
    for element, move in moves:
        edits += _edits(document, element, move)
    data = document.data
    for start, end, text in sorted(edits, reverse=True):
        data = data[:start] + text + data[end:]
    return document.encode(data)


def read_origin(document: Document, joint: Element) -> pin.SE3:
    """Nominal placement in the parent link's frame, as the `<origin>` states it."""
    owner = f"joint '{joint.attributes.get('name', '')}'"
    origin = joint.child("origin")
    placement = pin.SE3.Identity()
    if origin is None:
        return placement
    if "xyz" in origin.attributes:
        placement.translation = document.numbers(owner, origin, "xyz", 3)
    if _uses_quaternion(document, origin):
        quaternion = document.numbers(owner, origin, "quat_xyzw", 4)
        if not quaternion.any():
            raise document.error(origin, f"quat_xyzw of {owner} is zero")
        placement.rotation = pin.Quaternion(quaternion).normalized().matrix()
    elif "rpy" in origin.attributes:
        rpy = document.numbers(owner, origin, "rpy", 3)
        placement.rotation = pin.rpy.rpyToMatrix(rpy)
    return placement


def _uses_quaternion(document: Document, origin: Element | None) -> bool:
    """Whether urdfdom takes the rotation from `quat_xyzw`: from URDF 1.1 on."""
    version = document.root.attributes.get("version", "1.0")
    return origin is not None and "quat_xyzw" in origin.attributes and version != "1.0"


def _edits(
    document: Document, joint: Element, correction: pin.SE3
) -> list[tuple[int, int, bytes]]:
    """Replacements (from, to, new bytes) that put a correction into a joint."""
    origin = joint.child("origin")
    old = read_origin(document, joint)
    new = old * correction
    if not np.isfinite(new.homogeneous).all():
        name = joint.attributes.get("name", "")
        raise OutputError(f"the correction of joint '{name}' is not finite")
    changed: dict[str, Floats] = {}
    if not np.array_equal(new.translation, old.translation):
        changed["xyz"] = new.translation
    if not np.array_equal(new.rotation, old.rotation):
        if _uses_quaternion(document, origin):
            changed["quat_xyzw"] = pin.Quaternion(new.rotation).coeffs()
        else:
            # scipy's conversion loses 2e-7 near pitch = 90 deg, this one 2e-15.
            changed["rpy"] = pin.rpy.matrixToRpy(new.rotation)
    if not changed:
        return []
    if origin is None:
        return [_new_origin(document, joint, changed)]
    places, end = document.values(origin)
    edits = []
    for attribute, values in changed.items():
        if attribute in places:
            text = _text(values, origin.attributes[attribute])
            edits.append((*places[attribute], text.encode()))
    added = _attributes(
        {key: values for key, values in changed.items() if key not in places}
    )
    return [*edits, (end, end, added)] if added else edits


def _new_origin(
    document: Document, joint: Element, values: Mapping[str, Floats]
) -> tuple[int, int, bytes]:
    """Insertion of an `<origin>` before a joint's first child, indented like it."""
    if not joint.children:
        raise document.error(joint, "the joint names no parent link")
    place = joint.children[0].start
    indent = _INDENT.search(document.data, joint.start, place)
    tag = b"<origin" + _attributes(values) + b"/>"
    return place, place, tag + (indent[0] if indent else b"")


def _attributes(values: Mapping[str, Floats]) -> bytes:
    texts = [f' {key}="{_text(numbers, "")}"' for key, numbers in values.items()]
    return "".join(texts).encode()


def _text(values: Floats, old: str) -> str:
    """Numbers with all their digits, in their old words where they are the same."""
    words = old.split()
    if len(words) != len(values):
        words = ["nan"] * len(values)
    # Adding zero turns -0.0 into 0.0.
    return " ".join(
        word if float(word) == value else repr(float(value) + 0.0)
        for word, value in zip(words, values, strict=True)
    )
