"""A URDF as a tree that knows its bytes, so that origins change and nothing else.

The round trip through an XML library changes lines that are not ours (2 to 23 lines
in each of 16 URDFs), so expat only says where the tags are, and the values of their
attributes are replaced in the bytes. Everything works on a UTF-8 copy, in which
expat's offsets hold for every encoding; the copy is encoded back at the end.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from calib_pin.errors import OutputError, RobotError, nearest
from calib_pin.kinematics.spatial import Floats
from calib_pin.units import as_number

_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
# Some generators put a blank line or a comment before the declaration.
_DECLARATION = re.compile(rb"(?>\s++|<!--.*?-->)*+(<\?xml\s.*?\?>)", re.DOTALL)
_ENCODING = re.compile(rb"""\sencoding\s*=\s*["']([\w.:-]+)["']""")
_ATTRIBUTE = re.compile(rb"""\s+([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")
_INDENT = re.compile(rb"(?:\r\n|\n|\r)[ \t]*\Z")

_DEEPEST = 4
"""Depth of the shape in the geometry in the collision of a link of the robot."""

ATTRIBUTES = 1000
"""Largest number in an element: the C++ reader compares each with all before it."""


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
    mark, codec = next(
        (known for known in _BYTE_ORDER_MARKS if source.startswith(known[0])),
        (b"", ""),
    )
    body = source[len(mark) :]
    if not re.match(rb"[\s\0]*<", body):
        found = source[:16].strip(b"\0 \t\r\n") or None
        reason = "the file is empty" if not body.strip(b"\0 \t\r\n") else "is not XML"
        raise RobotError(reason, file=file, value=found, allowed="XML text")
    codec = codec or _codec(body)
    data = plain = _decode(body, codec, file).encode()
    if stated := _DECLARATION.match(data):
        blank = re.sub(rb"[^\r\n]", b" ", stated[1])
        plain = data[: stated.start(1)] + blank + data[stated.end() :]
    return Document(file, data, plain, codec, mark, _scan(plain, file))


def _codec(body: bytes) -> str:
    """Encoding of a document without byte order mark."""
    if body[:2] in (b"<\0", b"\0<"):
        return "utf-16-le" if body[0] else "utf-16-be"
    declaration = _DECLARATION.match(body)
    declared = declaration and _ENCODING.search(declaration[1])
    return declared[1].decode() if declared else "utf-8"


def _decode(body: bytes, codec: str, file: str | None) -> str:
    """Text of the document, if encoding it again gives the same bytes."""
    line, about = None, f"is not written in its encoding, {codec}"
    try:
        text = body.decode(codec)
        # UTF-32, read as UTF-16, is full of NUL characters.
        if text.encode(codec) == body and "\0" not in text[:2]:
            return text
    except (UnicodeError, LookupError) as error:
        start = getattr(error, "start", 0)
        line = body.count(b"\n", 0, start) + 1
        if isinstance(error, UnicodeDecodeError):
            about = f"the byte 0x{body[start]:02x} is not {codec}"
    allowed = "UTF-8, or the encoding that the first line declares"
    raise RobotError(about, file=file, line=line, allowed=allowed)


def _scan(data: bytes, file: str | None) -> Element:
    """Run expat over a document in UTF-8."""
    parser = expat.ParserCreate("utf-8")
    path = [Element("", {}, 0, 0, "")]

    def refuse(reason: str, **about: Any) -> NoReturn:
        raise RobotError(reason, file=file, line=parser.CurrentLineNumber, **about)

    def doctype(*_: object) -> None:
        # Entities can fetch files and swell to gigabytes; no URDF needs them.
        refuse("a DOCTYPE with its entities is not accepted in a URDF")

    def start(tag: str, attributes: dict[str, str]) -> None:
        line, offset = parser.CurrentLineNumber, parser.CurrentByteIndex
        if (count := len(attributes)) > ATTRIBUTES:
            reason = f"<{tag}> has too many attributes"
            refuse(reason, value=count, allowed=f"at most {ATTRIBUTES}")
        if tag.startswith("xacro:"):
            reason = "is a xacro file; let its name end in .xacro, or expand it first"
            refuse(reason, value=f"<{tag}>")
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
