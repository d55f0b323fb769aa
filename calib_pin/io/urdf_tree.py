"""The tree of links and joints in a URDF: its bytes, checked, and built by Pinocchio.

The round trip through an XML library changes lines that are not ours (2 to 23 lines
in each of 16 URDFs), so expat says where the tags are, and the values of their
attributes are replaced in the bytes.
"""

from __future__ import annotations

import codecs
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from typing import IO, Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from calib_pin.errors import OutputError, RobotError, enumerated, nearest
from calib_pin.kinematics.joint_space import Mimic
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.units import as_number

# Some generators put a blank line or a comment before the declaration.
_DECLARATION = re.compile(rb"(?>\s++|<!--.*?-->)*+(<\?xml\s.*?\?>)", re.DOTALL)
_ATTRIBUTE = re.compile(rb"""(\s+([^\s=]+)\s*=\s*(["']))(.*?)(\3)""", re.DOTALL)
_START = re.compile(rb"<[^\s/>]+(?:%s)*" % _ATTRIBUTE.pattern, re.DOTALL)
_INDENT = re.compile(rb"(?:\r\n|\n|\r)[ \t]*\Z")

ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")
"""Numbers of an origin as URDFs have them [m, rad]."""


def origin_of(pose: pin.SE3) -> list[float]:
    """The numbers of a pose, see `ORIGIN`."""
    # scipy's conversion loses 2e-7 near pitch = 90 deg, this one 2e-15.
    return [*pose.translation.tolist(), *pin.rpy.matrixToRpy(pose.rotation).tolist()]


def placed(origin: Sequence[float]) -> pin.SE3:
    """The pose of the numbers of an origin, see `ORIGIN`."""
    numbers = np.array(origin, float)
    return pin.SE3(pin.rpy.rpyToMatrix(numbers[3:]), numbers[:3])


def words(numbers: Iterable[float]) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(number)) for number in numbers)


def unused(name: str, used: set[str]) -> str:
    """A name that nothing else has, longer if need be; taken from now."""
    while name in used:
        name += "_"
    used.add(name)
    return name


@dataclass(frozen=True)
class Document:
    """A well-formed XML document.

    Attributes:
        file: Name of the source, for messages.
        data: The document in UTF-8.
        plain: The same with blanks in place of the mark at its start and of the XML
            declaration, which speaks of the encoding of the file and may be where XML
            does not allow it.
        root: The outermost element; tags have the namespace prefix as written.
        places: Of each element the line of its start tag, counted from 1, and its
            offset in the data.
    """

    file: str | None
    data: bytes
    plain: bytes
    root: Element
    places: Mapping[Element, tuple[int, int]]

    def named(self, tag: str) -> dict[str, Element]:
        """The links or joints of the robot by name, in the order of the file."""
        return {e.get("name", ""): e for e in self.root.findall(tag)}

    def owner(self, element: Element) -> str:
        """The link or joint in which an element is, as messages name it."""
        top = next(e for e in self.root if element in e.iter())
        return f"{top.tag} '{top.get('name', '')}'"

    def error(self, element: Element, reason: str, **about: Any) -> RobotError:
        """An error that points at an element, and is about a `value` in it."""
        line = self.places[element][0]
        return RobotError(reason, file=self.file, line=line, **about)

    def require(
        self, holds: object, element: Element, reason: str, **about: Any
    ) -> None:
        """Raise an error that points at an element if something does not hold."""
        if not holds:
            raise self.error(element, reason, **about)

    def numbers(self, element: Element, attribute: str, count: int) -> Floats:
        """Read an attribute that must hold `count` finite numbers, shape (count,)."""
        text = element.get(attribute, "")
        parts = text.split() if count > 1 else [text]
        numbers = np.array([as_number(part) for part in parts], float)
        if len(parts) != count or not np.isfinite(numbers).all():
            allowed = f"{count} finite numbers" if count > 1 else "a finite number"
            place = f"{attribute} in the <{element.tag}> of {self.owner(element)}"
            reason = f"{place} cannot be read"
            raise self.error(element, reason, value=text, allowed=allowed)
        return numbers

    def axis(self, joint: Element) -> Floats:
        """Axis of a joint in its own frame as it is written, shape (3,), not zero."""
        element = joint.find("axis")
        if element is None:
            return np.array([1.0, 0.0, 0.0])
        if not (axis := self.numbers(element, "xyz", 3)).any():
            raise self.error(element, f"the axis of {self.owner(joint)} is zero")
        return axis

    def origin(self, element: Element) -> pin.SE3:
        """Placement of a joint, a shape or a mass, as its `<origin>` states it."""
        origin = element.find("origin")
        placement = pin.SE3.Identity()
        if origin is None:
            return placement
        if "xyz" in origin.attrib:
            placement.translation = self.numbers(origin, "xyz", 3)
        if "quat_xyzw" in origin.attrib:
            reason = f"the origin of {self.owner(element)} has a quaternion"
            raise self.error(origin, reason, allowed="rpy, the angles of URDF 1.0")
        if "rpy" in origin.attrib:
            placement.rotation = pin.rpy.rpyToMatrix(self.numbers(origin, "rpy", 3))
        return placement


def link_of(joint: Element, role: str) -> str:
    """Name of the link that a joint has as its `parent` or `child`."""
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


def parse_document(
    source: bytes, file: str | None = None, comments: bool = False
) -> Document:
    """Parse XML as far as a URDF, or an SRDF, needs it.

    Args:
        source: The bytes.
        file: Name of the source, for messages.
        comments: Whether the tree has comments, for who writes it.

    Raises:
        RobotError: If the bytes are not well-formed XML in UTF-8, declare a DOCTYPE or
            entities, or are an unexpanded xacro file.
    """
    try:
        source.decode()
    except UnicodeDecodeError as error:
        line = source.count(b"\n", 0, error.start) + 1
        raise RobotError("is not text in UTF-8", file=file, line=line) from None
    mark = codecs.BOM_UTF8
    plain = re.sub(b"^" + mark, b" " * len(mark), source)
    if match := _DECLARATION.match(plain):
        blank = re.sub(rb"[^\r\n]", b" ", match[1])
        plain = plain[: match.start(1)] + blank + plain[match.end() :]
    parser = expat.ParserCreate("utf-8")
    builder = TreeBuilder(insert_comments=comments)
    places = dict[Element, tuple[int, int]]()

    def doctype(*_: object) -> None:
        # Entities can fetch files and swell to gigabytes; no URDF needs them.
        reason = "a DOCTYPE with its entities is not accepted in a URDF"
        raise RobotError(reason, file=file, line=parser.CurrentLineNumber)

    def start(tag: str, attributes: dict[str, str]) -> None:
        line, offset = parser.CurrentLineNumber, parser.CurrentByteIndex
        if tag.startswith("xacro:"):
            reason = "is a xacro file; let its name end in .xacro, or expand it first"
            raise RobotError(reason, file=file, line=line, value=f"<{tag}>")
        places[builder.start(tag, attributes)] = line, offset

    parser.buffer_text, parser.StartDoctypeDeclHandler = True, doctype
    parser.StartElementHandler, parser.EndElementHandler = start, builder.end
    parser.CharacterDataHandler, parser.CommentHandler = builder.data, builder.comment
    try:
        parser.Parse(plain, True)
    except expat.ExpatError as error:
        reason = f"is not well-formed XML: {expat.ErrorString(error.code)}"
        raise RobotError(reason, file=file, line=error.lineno) from error
    return Document(file, source, plain, builder.close(), places)


def edit_origins(
    source: bytes, corrections: Mapping[str, pin.SE3], file: str | None = None
) -> bytes:
    """Change joint origins, `origin <- origin * correction`, and nothing else.

    Only the values of `xyz` and `rpy` change, with all digits; a number that stays the
    same keeps its text. An attribute or an `<origin>` that is missing is added if it is
    needed.

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
    moves = [(joints[name], move) for name, move in corrections.items()]
    return move_origins(document, moves)


def move_origins(document: Document, moves: Iterable[tuple[Element, pin.SE3]]) -> bytes:
    """The bytes of a URDF with other origins of joints, shapes or masses.

    Args:
        document: The URDF.
        moves: Elements with an origin, each with what it is multiplied by.

    Raises:
        OutputError: If a move is not finite.
    """
    edits, data = (_edited(document, *moved) for moved in moves), document.data
    for start, end, text in sorted(edits, reverse=True):
        data = data[:start] + text + data[end:]
    return data


def _edited(
    document: Document, element: Element, move: pin.SE3
) -> tuple[int, int, bytes]:
    """From where to where the start tag of an origin is, and the moved one."""
    origin, old = element.find("origin"), document.origin(element)
    new, data, texts = old * move, document.data, dict[bytes, bytes]()
    if not np.isfinite(new.homogeneous).all():
        reason = f"the correction of {document.owner(element)} is not finite"
        raise OutputError(reason)
    written = {} if origin is None else origin.attrib
    if not np.array_equal(new.translation, old.translation):
        texts[b"xyz"] = _text(new.translation, written.get("xyz", ""))
    if not np.array_equal(new.rotation, old.rotation):
        texts[b"rpy"] = _text(np.array(origin_of(new)[3:]), written.get("rpy", ""))
    tag, behind = b"<origin", b""
    if origin is not None:
        start = document.places[origin][1]
        tag = _START.match(data, start)[0]  # type: ignore[index]
        end = start + len(tag)
    else:  # It goes before the first child, indented like it.
        start = end = document.places[element[0]][1]
        indent = _INDENT.search(data, document.places[element][1], end)
        behind = b"/>" + (indent[0] if indent else b"")
    changed = bool(texts)
    tag = _ATTRIBUTE.sub(lambda m: m[1] + texts.pop(m[2], m[4]) + m[5], tag)
    tag += b"".join(b' %s="%s"' % added for added in texts.items())
    return start, end, tag + behind if changed else data[start:end]


def _text(values: Floats, old: str) -> bytes:
    """Numbers with all their digits, in their old words where they are the same."""
    written = old.split() or ["nan"] * len(values)
    pairs = zip(written, values, strict=True)
    # Not -0.0.
    return " ".join(w if float(w) == v else words([v + 0.0]) for w, v in pairs).encode()


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
    few, reason = len(links) <= LINKS, f"the robot has {len(links)} links"
    document.require(few, root, reason, allowed=f"at most {LINKS}")
    for element in (*links.values(), *joints.values()):
        _check(document, element)
    parents: dict[str, str] = {}
    for name, joint in joints.items():
        child = link_of(joint, "child")
        reason = f"link '{child}' is the child of two joints, '{parents.get(child)}'"
        document.require(child not in parents, joint, f"{reason} and '{name}'")
        parents[child] = name
    model = _build_model(document, {**links, **joints})
    frames = {f.name for f in model.frames if f.type == pin.FrameType.BODY}
    if lost := [link for link in links if link not in frames]:
        names = enumerated(f"'{link}'" for link in lost)
        reason = f"nothing joins {names} to the root: a URDF is one tree, without loops"
        carrier = joints.get(parents.get(lost[0], ""), links[lost[0]])
        raise document.error(carrier, reason)
    inner = {link_of(joint, "parent") for joint in joints.values()}
    fixed = {name for name, joint in joints.items() if joint.get("type") == "fixed"}
    mimics, refused = _mimics(joints)
    return Robot(
        name=root.attrib["name"],
        file=file,
        source=source,
        model=model,
        root=next(link for link in links if link not in parents),
        links=tuple(links),
        leaves=tuple(link for link in links if link not in inner),
        fixed_parents={link: name for link, name in parents.items() if name in fixed},
        refused=refused,
        mimics=mimics,
    )


def _check(document: Document, element: Element) -> None:
    """Refuse a link or joint with numbers that are none, or which no robot has."""
    kind, name = element.get("type", ""), element.get("name", "")
    owner = f"{element.tag} '{name}'"
    document.require(name, element, f"a {element.tag} has no name")
    for part in element.iter():
        for key, count in NUMBERS.get(part.tag, {}).items():
            if key in part.attrib:
                numbers = document.numbers(part, key, count)
                near = key != "xyz" or np.abs(numbers).max() <= FARTHEST
                reason = f"the {part.tag} of {owner} is too far away"
                document.require(near, part, reason, value=part.get(key))
    if element.tag == "joint":
        document.origin(element)
        reason = "a joint cannot be called 'universe', Pinocchio's name of the world"
        document.require(name != "universe" or kind == "fixed", element, reason)
        if kind in (*_SINGLE, "planar"):
            document.axis(element)
    for inertial in element.findall("inertial")[:1]:
        mass = inertial.find("mass")
        if mass is None or "value" not in mass.attrib:
            reason = f"the <inertial> of {owner} has no mass value"
            raise document.error(inertial, reason)
        usual = 0.0 <= document.numbers(mass, "value", 1)[0] <= HEAVIEST
        about = {"value": mass.get("value"), "allowed": f"0 to {HEAVIEST:g} kg"}
        document.require(usual, mass, f"no link has the mass of {owner}", **about)


def _mimics(joints: Mapping[str, Element]) -> tuple[dict[str, Mimic], dict[str, str]]:
    """Joints that follow another, and the reasons why a chain cannot contain others.

    Returns:
        Mimic joints, each with the driven joint at the end of those that it follows,
        and phrases for "joint x is ..., which a chain cannot contain".
    """
    direct, mimics, refused = dict[str, Mimic](), dict[str, Mimic](), dict[str, str]()
    single = {k for k, joint in joints.items() if joint.get("type") in _SINGLE}
    for name, joint in joints.items():
        kind, element = joint.attrib["type"], joint.find("mimic")
        if kind in ("floating", "planar"):
            refused[name] = f"a {kind} joint"
        elif element is not None and name in single:
            about = {"multiplier": "1", "offset": "0", **element.attrib}
            factor, offset = float(about["multiplier"]), float(about["offset"])
            direct[name] = Mimic(about.get("joint", ""), factor, offset)
    for name, mimic in direct.items():
        path = {name}
        while (leader := mimic.leader) in direct and leader not in path:
            path.add(leader)
            above = direct[leader]
            offset = mimic.factor * above.offset + mimic.offset
            mimic = Mimic(above.leader, mimic.factor * above.factor, offset)
        if leader in single - path:
            mimics[name] = mimic
        else:
            leader = direct[name].leader
            refused[name] = f"a mimic joint without a driven leader ('{leader}')"
    return mimics, refused


def _build_model(document: Document, known: Mapping[str, Element]) -> pin.Model:
    """The model; `known` are links and joints that Pinocchio may complain of."""
    # To XML a tab or line break in numbers is a space; urdfdom chokes on it.
    text = re.sub(r"[\t\r\n]", " ", document.plain.decode())
    with tempfile.TemporaryFile() as printed:
        try:
            with _stderr_to(printed):
                model = pin.buildModelFromXML(text)
        except Exception as failure:  # Whatever C++ throws.
            printed.seek(0)
            output = printed.read().decode(errors="replace")
            errors = re.search(r"Error:\s+(.*?)\.?\s\s", output, re.DOTALL)
            message = errors[1] if errors else str(failure)
            # What it names last is what is wrong.
            named = [n for n in re.findall(r"[\['](.*?)[\]']", message) if n in known]
            culprit = known[named[-1]] if named else document.root
            reason = f"Pinocchio cannot read it: {message}"
            raise document.error(culprit, reason) from failure
    reason = f"the robot has {model.nv} degrees of freedom"
    few, allowed = model.nv <= FREEDOM, f"at most {FREEDOM}"
    document.require(few, document.root, reason, allowed=allowed)
    return model


@contextmanager
def _stderr_to(file: IO[bytes]) -> Iterator[None]:
    """Collect what C++ prints to file descriptor 2, past `sys.stderr`."""
    with ExitStack() as stack:
        with suppress(OSError):  # It is closed, so nothing is printed.
            saved = os.dup(2)
            stack.callback(os.close, saved)
            stack.callback(os.dup2, saved, 2)
            os.dup2(file.fileno(), 2)
        yield
