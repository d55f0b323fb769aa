"""The tree of links and joints in a URDF: its bytes, checked, and built by Pinocchio.

The round trip through an XML library changes lines that are not ours (2 to 23 lines
in each of 16 URDFs), so expat only says where the tags are, and the values of their
attributes are replaced in the bytes. Everything works on a UTF-8 copy, in which
expat's offsets hold for every encoding; the copy is encoded back at the end.
"""

from __future__ import annotations

import codecs
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from calib_pin.errors import OutputError, RobotError, enumerated, nearest
from calib_pin.kinematics.joint_space import Mimic
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.units import as_number

_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
# Some generators put a blank line or a comment before the declaration.
_DECLARATION = re.compile(rb"(?>\s++|<!--.*?-->)*+(<\?xml\s.*?\?>)", re.DOTALL)
_ENCODING = re.compile(rb"""\sencoding\s*=\s*["']([\w.:-]+)["']""")
_ATTRIBUTE = re.compile(rb"""\s+([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")
_INDENT = re.compile(rb"(?:\r\n|\n|\r)[ \t]*\Z")

_DEEPEST = 4
"""Depth of the shape in the geometry in the collision of a link of the robot."""


@dataclass(frozen=True)
class Element:
    """An XML element near the root.

    Attributes:
        tag: Its name, with the namespace prefix as written.
        attributes: Its attributes, references and escapes resolved.
        line: Line of its start tag, counted from 1.
        start: Offset of its start tag in the document's data.
        owner: The element below the root in which it is, as messages name it.
        children: Elements directly inside, down to those of a geometry.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    start: int
    owner: str
    children: list[Element] = field(default_factory=list)

    def child(self, tag: str) -> Element | None:
        """The first child of that name, the one that URDF readers take."""
        return next(iter(self.all(tag)), None)

    def link(self, role: str) -> str:
        """Name of the link that a joint has as its `parent` or `child`."""
        element = self.child(role)
        return "" if element is None else element.attributes.get("link", "")

    def all(self, tag: str) -> list[Element]:
        """The children of that name."""
        return [child for child in self.children if child.tag == tag]


@dataclass(frozen=True)
class Document:
    """A well-formed XML document.

    Attributes:
        file: Name of the source, for messages.
        data: The document in UTF-8 without byte order mark.
        plain: The same with blanks in place of the XML declaration, which speaks of
            the encoding of the file and may be where XML does not allow it.
        codec: Python's name of the encoding in the file.
        mark: Byte order mark at the start of the file, often empty.
        root: The outermost element.
    """

    file: str | None
    data: bytes
    plain: bytes
    codec: str
    mark: bytes
    root: Element

    def named(self, tag: str) -> dict[str, Element]:
        """The links or joints of the robot by name, in the order of the file."""
        return {e.attributes.get("name", ""): e for e in self.root.all(tag)}

    def error(self, element: Element, reason: str, **about: Any) -> RobotError:
        """An error that points at an element, and is about a `value` in it."""
        return RobotError(reason, file=self.file, line=element.line, **about)

    def values(self, element: Element) -> tuple[dict[str, tuple[int, int]], int]:
        """Offsets of the attribute values as written, and the end of the last one."""
        places = {}
        end = element.start + 1 + len(element.tag.encode())
        while match := _ATTRIBUTE.match(self.data, end):
            places[match[1].decode()] = (match.start(2) + 1, match.end(2) - 1)
            end = match.end()
        return places, end

    def numbers(self, element: Element, attribute: str, count: int) -> Floats:
        """Read an attribute that must hold `count` finite numbers, shape (count,)."""
        text = element.attributes.get(attribute, "")
        words = text.split() if count > 1 else [text]
        numbers = np.array([as_number(word) for word in words], float)
        if len(words) != count or not np.isfinite(numbers).all():
            allowed = f"{count} finite numbers" if count > 1 else "a finite number"
            place = f"{attribute} in the <{element.tag}> of {element.owner}"
            reason = f"{place} cannot be read"
            raise self.error(element, reason, value=text, allowed=allowed)
        return numbers

    def axis(self, joint: Element) -> Floats:
        """Axis of a joint in its own frame as it is written, shape (3,), not zero."""
        stated = joint.child("axis")
        if stated is None:
            return np.array([1.0, 0.0, 0.0])
        axis = self.numbers(stated, "xyz", 3)
        if not axis.any():
            raise self.error(stated, f"the axis of {joint.owner} is zero")
        return axis

    def origin(self, element: Element) -> pin.SE3:
        """Placement of a joint, a shape or a mass, as its `<origin>` states it."""
        origin = element.child("origin")
        placement = pin.SE3.Identity()
        if origin is None:
            return placement
        if "xyz" in origin.attributes:
            placement.translation = self.numbers(origin, "xyz", 3)
        if self.turn(origin) == "quat_xyzw":
            quaternion = self.numbers(origin, "quat_xyzw", 4)
            if not quaternion.any():
                raise self.error(origin, f"quat_xyzw of {element.owner} is zero")
            placement.rotation = pin.Quaternion(quaternion).normalized().matrix()
        elif "rpy" in origin.attributes:
            placement.rotation = pin.rpy.rpyToMatrix(self.numbers(origin, "rpy", 3))
        return placement

    def turn(self, origin: Element | None) -> str:
        """Attribute from which urdfdom takes the rotation; quaternions from 1.1 on."""
        stated = origin is not None and "quat_xyzw" in origin.attributes
        later = self.root.attributes.get("version", "1.0") != "1.0"
        return "quat_xyzw" if stated and later else "rpy"


def parse_document(source: bytes, file: str | None = None) -> Document:
    """Parse XML as far as a URDF needs it.

    Raises:
        RobotError: If the bytes are not well-formed XML in a known encoding, declare
            a DOCTYPE or entities, or are an unexpanded xacro file.
    """
    mark = next((m for m in _BYTE_ORDER_MARKS if source.startswith(m)), b"")
    body = source[len(mark) :]
    if not re.match(rb"[\s\0]*<", body):
        found = body[:16] if body.strip(b"\0 \t\r\n") else None
        reason = "the file is empty" if found is None else "is not XML"
        raise RobotError(reason, file=file, value=found, allowed="a URDF, as text")
    declaration = _DECLARATION.match(body)
    declared = declaration and _ENCODING.search(declaration[1])
    codec = declared[1].decode() if declared else "utf-8"
    if body[:2] in (b"<\0", b"\0<"):
        codec = "utf-16-le" if body[0] else "utf-16-be"
    codec = _BYTE_ORDER_MARKS.get(mark, codec)
    data = plain = _decode(body, codec, file).encode()
    if stated := _DECLARATION.match(data):
        blank = re.sub(rb"[^\r\n]", b" ", stated[1])
        plain = data[: stated.start(1)] + blank + data[stated.end() :]
    return Document(file, data, plain, codec, mark, _scan(plain, file))


def _decode(body: bytes, codec: str, file: str | None) -> str:
    """Text of the document, if encoding it again gives the same bytes."""
    line, reason = None, f"is not written in its encoding, {codec}"
    try:
        text = body.decode(codec)
        # UTF-32, read as UTF-16, is full of NUL characters.
        if text.encode(codec) == body and "\0" not in text[:2]:
            return text
    except UnicodeDecodeError as error:
        line = body.count(b"\n", 0, error.start) + 1
        reason = f"the byte 0x{body[error.start]:02x} is not {codec}"
    except (UnicodeError, LookupError):
        line = 1
    allowed = "UTF-8, or the encoding that the first line declares"
    raise RobotError(reason, file=file, line=line, allowed=allowed)


def _scan(data: bytes, file: str | None) -> Element:
    """Run expat over a document in UTF-8."""
    parser = expat.ParserCreate("utf-8")
    path = [Element("", {}, 0, 0, "")]

    def doctype(*_: object) -> None:
        # Entities can fetch files and swell to gigabytes; no URDF needs them.
        reason = "a DOCTYPE with its entities is not accepted in a URDF"
        raise RobotError(reason, file=file, line=parser.CurrentLineNumber)

    def start(tag: str, attributes: dict[str, str]) -> None:
        line, offset = parser.CurrentLineNumber, parser.CurrentByteIndex
        if tag.startswith("xacro:"):
            reason = "is a xacro file; let its name end in .xacro, or expand it first"
            raise RobotError(reason, file=file, line=line, value=f"<{tag}>")
        owner = path[-1].owner
        if len(path) == 2:
            owner = f"{tag} '{attributes.get('name', '')}'"
        element = Element(tag, attributes, line, offset, owner)
        if len(path) <= 1 + _DEEPEST:
            path[-1].children.append(element)
        path.append(element)

    def end(_: str) -> None:
        path.pop()

    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = f"is not well-formed XML: {expat.ErrorString(error.code)}"
        raise RobotError(reason, file=file, line=error.lineno) from error
    return path[0].children[0]


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
    joints = document.named("joint")
    if unknown := next((name for name in corrections if name not in joints), None):
        reason = f"the robot has no joint '{unknown}'{nearest(unknown, joints)}"
        raise RobotError(reason, file=file)
    return move_origins(
        document, [(joints[k], move) for k, move in corrections.items()]
    )


def move_origins(document: Document, moves: Iterable[tuple[Element, pin.SE3]]) -> bytes:
    """The bytes of a URDF with other origins of joints, shapes or masses.

    Args:
        document: The URDF.
        moves: Elements with an origin, each with what it is multiplied by.

    Raises:
        OutputError: If a move is not finite.
    """
    edits = [edit for moved in moves for edit in _edits(document, *moved)]
    data = document.data
    for start, end, text in sorted(edits, reverse=True):
        data = data[:start] + text + data[end:]
    return document.mark + data.decode().encode(document.codec)


def _edits(
    document: Document, element: Element, move: pin.SE3
) -> list[tuple[int, int, bytes]]:
    """Replacements (from, to, new bytes) that put a move into an origin."""
    origin, old = element.child("origin"), document.origin(element)
    new = old * move
    if not np.isfinite(new.homogeneous).all():
        raise OutputError(f"the correction of {element.owner} is not finite")
    key, changed = document.turn(origin), dict[str, Floats]()
    if not np.array_equal(new.translation, old.translation):
        changed["xyz"] = new.translation
    if not np.array_equal(new.rotation, old.rotation):
        # scipy's conversion loses 2e-7 near pitch = 90 deg, this one 2e-15.
        rpy = pin.rpy.matrixToRpy(new.rotation)
        changed[key] = rpy if key == "rpy" else pin.Quaternion(new.rotation).coeffs()
    if not changed:
        return []
    places, end = ({}, 0) if origin is None else document.values(origin)
    written = {} if origin is None else origin.attributes
    edits, added = [], b""
    for key, values in changed.items():
        text = _text(values, written.get(key, "")).encode()
        if key in places:
            edits.append((*places[key], text))
        else:
            added += b' %s="%s"' % (key.encode(), text)
    if origin is None:  # It goes before the first child, indented like it.
        end = element.children[0].start
        indent = _INDENT.search(document.data, element.start, end)
        added = b"<origin" + added + b"/>" + (indent[0] if indent else b"")
    return [*edits, (end, end, added)]


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


_SINGLE = ("revolute", "continuous", "prismatic")

LINKS = 1000
"""Most links of a robot: Pinocchio crashes where some thousands follow each other."""

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
    root, links, joints = document.root, document.named("link"), document.named("joint")
    if root.tag != "robot":
        reason = f"the outermost element is <{root.tag}>"
        raise document.error(root, reason, allowed="<robot>")
    if len(links) > LINKS:
        reason, allowed = "the robot has too many links", f"at most {LINKS}"
        raise document.error(root, reason, value=len(links), allowed=allowed)
    parents: dict[str, str] = {}
    for element in (*links.values(), *joints.values()):
        if not element.attributes.get("name"):
            raise document.error(element, f"a {element.tag} has no name")
        _check(document, element)
    for name, joint in joints.items():
        kind, child = joint.attributes.get("type", ""), joint.link("child")
        if name == "universe" and kind != "fixed":
            reason = (
                "a joint cannot be called 'universe', Pinocchio's name of the world"
            )
            raise document.error(joint, reason)
        if kind in (*_SINGLE, "planar"):
            document.axis(joint)
        if other := parents.get(child):
            reason = (
                f"link '{child}' is the child of two joints, '{other}' and '{name}'"
            )
            raise document.error(joint, reason)
        parents[child] = name
    model = _build_model(document, links, joints)
    frames = {f.name for f in model.frames if f.type == pin.FrameType.BODY}
    if lost := [link for link in links if link not in frames]:
        names = enumerated(f"'{link}'" for link in lost)
        reason = f"nothing joins {names} to the root: a URDF is one tree, without loops"
        carrier = joints.get(parents.get(lost[0], ""), links[lost[0]])
        raise document.error(carrier, reason)
    inner = {joint.link("parent") for joint in joints.values()}
    fixed = {k for k, joint in joints.items() if joint.attributes["type"] == "fixed"}
    mimics, refused = _mimics(joints)
    return Robot(
        name=root.attributes["name"],
        file=file,
        source=source,
        model=model,
        root=next(link for link in links if link not in parents),
        links=tuple(links),
        leaves=tuple(link for link in links if link not in inner),
        fixed_parents={k: joint for k, joint in parents.items() if joint in fixed},
        refused=refused,
        mimics=mimics,
    )


def _check(document: Document, element: Element) -> None:
    """Refuse numbers in a link or joint that are none, or which no robot has."""
    for child in element.children:
        for key, count in NUMBERS.get(child.tag, {}).items():
            if key in child.attributes:
                numbers = document.numbers(child, key, count)
                if key == "xyz" and np.abs(numbers).max() > FARTHEST:
                    reason = f"the {child.tag} of {child.owner} is too far away"
                    value = child.attributes[key]
                    raise document.error(child, reason, value=value, allowed="xyz in m")
        _check(document, child)
    if element.tag == "joint":
        document.origin(element)
    for inertial in element.all("inertial")[:1]:
        mass = inertial.child("mass") or inertial
        if "value" not in mass.attributes:
            reason = f"the <inertial> of {element.owner} has no mass value"
            raise document.error(inertial, reason)
        if not 0.0 <= document.numbers(mass, "value", 1)[0] <= HEAVIEST:
            value, allowed = mass.attributes["value"], f"0 to {HEAVIEST:g} kg"
            reason = f"no link has the mass of {element.owner}"
            raise document.error(mass, reason, value=value, allowed=allowed)


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
    # To XML a tab or line break in numbers is a space; urdfdom chokes on it.
    text = re.sub(r"[\t\r\n]", " ", document.plain.decode())
    printed = list[str]()
    try:
        with _captured_stderr(printed):
            model = pin.buildModelFromXML(text)
    except Exception as failure:  # Whatever C++ throws.
        errors = re.search(r"Error:\s+(.*?)\.?\s\s", "".join(printed), re.DOTALL)
        said = errors[1] if errors else str(failure)
        # What it names last is what is wrong.
        known, named = {**links, **joints}, re.findall(r"[\['](.*?)[\]']", said)
        culprit = next((known[n] for n in named[::-1] if n in known), document.root)
        raise document.error(culprit, f"Pinocchio cannot read it: {said}") from failure
    if model.nv > FREEDOM:
        reason = f"the robot has {model.nv} degrees of freedom"
        raise document.error(document.root, reason, allowed=f"at most {FREEDOM}")
    return model


@contextmanager
def _captured_stderr(printed: list[str]) -> Iterator[None]:
    """Collect what C++ prints to file descriptor 2, past `sys.stderr`."""
    with tempfile.TemporaryFile() as file, ExitStack() as stack:
        with suppress(OSError):  # It is closed, so nothing is printed.
            saved = os.dup(2)
            stack.callback(os.close, saved)
            stack.callback(os.dup2, saved, 2)
            os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            file.seek(0)
            printed.append(file.read().decode(errors="replace"))
