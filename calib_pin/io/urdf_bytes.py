"""A URDF as a tree that knows its bytes, so that origins change and nothing else.

The round trip through an XML library changes lines that are not ours (2 to 23 lines
in each of 16 URDFs), so expat only says where the tags are, and the values of their
attributes are replaced in the bytes. Everything works on a UTF-8 copy, in which
expat's offsets hold for every encoding; the copy is encoded back at the end.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.parsers import expat

import numpy as np

from calib_pin.errors import RobotError
from calib_pin.kinematics.spatial import Floats
from calib_pin.units import as_number

_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_DECLARED = re.compile(rb"""<\?xml[^>]*?\sencoding\s*=\s*["']([\w.:-]+)["']""")
_DECLARATION = re.compile(rb"<\?xml\s.*?\?>", re.DOTALL)
_BEFORE = re.compile(rb"(?>\s++|<!--.*?-->)*+", re.DOTALL)
_ATTRIBUTE = re.compile(rb"""\s+([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")

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
        children: Elements directly inside, down to those of a geometry.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    start: int
    children: list[Element]

    def child(self, tag: str) -> Element | None:
        """The first child of that name, the one that URDF readers take."""
        return next((child for child in self.children if child.tag == tag), None)


@dataclass(frozen=True)
class Document:
    """A well-formed XML document.

    Attributes:
        file: Name of the source, for messages.
        data: The document in UTF-8 without byte order mark.
        codec: Python's name of the encoding in the file.
        mark: Byte order mark at the start of the file, often empty.
        root: The outermost element.
    """

    file: str | None
    data: bytes
    codec: str
    mark: bytes
    root: Element

    @property
    def plain(self) -> bytes:
        """The data with blanks for the XML declaration, which may stand too late.

        It speaks of the encoding of the file, and some generators put a blank line or a
        comment before it.
        """
        return _undeclared(self.data)

    def encode(self, data: bytes) -> bytes:
        """Bytes of a file with this document's encoding."""
        return self.mark + data.decode().encode(self.codec)

    def error(
        self,
        element: Element,
        reason: str,
        *,
        value: object = None,
        allowed: str | None = None,
    ) -> RobotError:
        """An error that points at an element."""
        line = element.line
        return RobotError(
            reason, file=self.file, line=line, value=value, allowed=allowed
        )

    def values(self, element: Element) -> tuple[dict[str, tuple[int, int]], int]:
        """Offsets of the attribute values as written, and the end of the last one."""
        places = {}
        end = element.start + 1 + len(element.tag.encode())
        while match := _ATTRIBUTE.match(self.data, end):
            places[match[1].decode()] = (match.start(2) + 1, match.end(2) - 1)
            end = match.end()
        return places, end

    def numbers(
        self, owner: str, element: Element, attribute: str, count: int
    ) -> Floats:
        """Read an attribute that must hold `count` finite numbers, shape (count,)."""
        text = element.attributes[attribute]
        place = f"{attribute} in the <{element.tag}> of {owner}"
        words = text.split() if count > 1 else [text]
        numbers = np.array([as_number(word) for word in words], float)
        if len(words) != count or not np.isfinite(numbers).all():
            allowed = f"{count} finite numbers" if count > 1 else "a finite number"
            reason = f"{place} cannot be read"
            raise self.error(element, reason, value=text, allowed=allowed)
        start, end = self.values(element)[0][attribute]
        # To XML a tab or line break here is a space; urdfdom chokes on it.
        if re.search(rb"[\t\r\n]", self.data[start:end]):
            reason = f"{place} has a tab or line break between its numbers"
            raise self.error(element, reason, allowed="spaces")
        return numbers


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
    codec = codec or _codec(body)
    if not body.strip(b"\0 \t\r\n"):
        raise RobotError("the file is empty", file=file)
    if not re.match(rb"[\s\0]*<", body):
        raise RobotError(
            "is not XML", file=file, value=source[:16], allowed="a URDF, as text"
        )
    data = _decode(body, codec, file).encode()
    return Document(file, data, codec, mark, _scan(data, file))


def _codec(body: bytes) -> str:
    """Encoding of a document without byte order mark."""
    if body[:2] in (b"<\0", b"\0<"):
        return "utf-16-le" if body[0] else "utf-16-be"
    declared = _DECLARED.match(body, _declaration(body))
    return declared[1].decode() if declared else "utf-8"


def _declaration(data: bytes) -> int:
    """Offset of the XML declaration, if there is one, behind blanks and comments."""
    before = _BEFORE.match(data)
    return before.end() if before else 0


def _undeclared(data: bytes) -> bytes:
    """A document with blanks for its XML declaration."""
    if not (found := _DECLARATION.match(data, _declaration(data))):
        return data
    blank = re.sub(rb"[^\r\n]", b" ", found[0])
    return data[: found.start()] + blank + data[found.end() :]


def _decode(body: bytes, codec: str, file: str | None) -> str:
    """Text of the document, if encoding it again gives the same bytes."""
    reason, line = f"is not written in its encoding, {codec}", None
    try:
        text = body.decode(codec)
        # UTF-32, read as UTF-16, is full of NUL characters.
        if text.encode(codec) == body and "\0" not in text[:2]:
            return text
    except UnicodeDecodeError as error:
        line = body.count(b"\n", 0, error.start) + 1
        reason = f"the byte 0x{body[error.start]:02x} is not {codec}"
    except UnicodeError:
        pass
    except LookupError:
        line, reason = 1, f"the encoding '{codec}' is unknown"
    allowed = "UTF-8, or the encoding that the first line declares"
    raise RobotError(reason, file=file, line=line, allowed=allowed)


def _scan(data: bytes, file: str | None) -> Element:
    """Run expat over a document in UTF-8."""
    parser = expat.ParserCreate("utf-8")
    path: list[Element] = []
    top: list[Element] = []

    def refuse_doctype(*_: object) -> None:
        # Entities can fetch files and swell to gigabytes; no URDF needs them.
        raise RobotError(
            "a DOCTYPE with its entities is not accepted in a URDF",
            file=file,
            line=parser.CurrentLineNumber,
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        line, offset = parser.CurrentLineNumber, parser.CurrentByteIndex
        if len(attributes) > ATTRIBUTES:
            raise RobotError(
                f"<{tag}> has too many attributes",
                file=file,
                line=line,
                value=len(attributes),
                allowed=f"at most {ATTRIBUTES}",
            )
        element = Element(tag, attributes, line, offset, [])
        # Elsewhere, as in the text of a plugin, a dollar may mean something else.
        in_joint = tag == "joint" or (len(path) == 2 and path[1].tag == "joint")
        texts = attributes.values() if in_joint else ()
        macros = [text for text in texts if "${" in text or "$(" in text]
        if tag.startswith("xacro:") or macros:
            reason = "is a xacro file; let its name end in .xacro, or expand it first"
            value = macros[0] if macros else f"<{tag}>"
            raise RobotError(reason, file=file, line=line, value=value)
        if len(path) <= _DEEPEST:
            (path[-1].children if path else top).append(element)
        path.append(element)

    def end(_: str) -> None:
        path.pop()

    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(_undeclared(data), True)
    except expat.ExpatError as error:
        reason = f"is not well-formed XML: {expat.ErrorString(error.code)}"
        raise RobotError(reason, file=file, line=error.lineno) from error
    return top[0]
