"""SVG as a page wants it: part of its text, in its colors, with ids of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree import ElementTree

SVG = "http://www.w3.org/2000/svg"

ROUNDED = re.compile(r"-?\d+\.\d{3,}")
"""Coordinates with more than two decimals of a point."""

REFERENCE = re.compile(r"url\(#")

COLOR = re.compile(r"#[0-9a-f]{6}\b")

FONT = re.compile(r"(?P<before>[^;]*?)(?P<size>[\d.]+px)")
"""What older versions write in one word: weight, size and family."""


def inlined(svg: bytes, name: str, title: str, colors: Mapping[str, str]) -> str:
    """What matplotlib writes, made part of an HTML page.

    The page scales it and sets its font. Colors that have a name become variables of
    the page, so that it can be light or dark.

    Args:
        svg: The file.
        name: What its ids begin with.
        title: What is read out in its place.
        colors: Names of colors by their hexadecimal code.
    """
    root = ElementTree.fromstring(svg)
    for parent in [root, *root.iter(f"{{{SVG}}}defs")]:
        for child in list(parent):
            # A style sheet would hold for the whole page.
            if _local(child.tag) in ("metadata", "style"):
                parent.remove(child)
    for element in root.iter():
        element.tag = _local(element.tag)
        element.attrib = dict(
            _changed(_local(key), value, element.tag, name, colors)
            for key, value in element.items()
        )
        element.tail = None
        if element.tag != "text":
            element.text = None
    root.attrib = {
        "xmlns": SVG,
        "viewBox": root.attrib["viewBox"],
        "role": "img",
        "aria-label": title,
        "style": "stroke-linejoin: round; stroke-linecap: butt",
    }
    heading = ElementTree.Element("title")
    heading.text = title
    root.insert(0, heading)
    return ElementTree.tostring(root, encoding="unicode")


def _local(name: str) -> str:
    """A name without its namespace."""
    return name.rpartition("}")[2]


def _changed(
    key: str, value: str, tag: str, name: str, colors: Mapping[str, str]
) -> tuple[str, str]:
    """An attribute as it stands in the page."""
    if key == "id":
        return key, f"{name}-{value}"
    if key == "href":
        embedded = value.replace("\n", "")
        return key, f"#{name}-{value[1:]}" if value.startswith("#") else embedded
    if key == "clip-path":
        return key, REFERENCE.sub(f"url(#{name}-", value)
    if key == "style":
        return key, _style(value, colors)
    if key in ("d", "transform", "x", "y") and tag != "image":
        return key, ROUNDED.sub(_shorter, value).replace("\n", "")
    return key, value


def _style(value: str, colors: Mapping[str, str]) -> str:
    """Declarations with the page's own font and colors."""
    kept = []
    for declaration in value.split("; "):
        key, _, rest = declaration.partition(": ")
        if key == "font-family":
            continue
        if key == "font" and (found := FONT.match(rest)):
            key, rest = "font-size", found["size"]
        kept.append(f"{key}: {COLOR.sub(lambda c: _color(c[0], colors), rest)}")
    return "; ".join(kept)


def _color(code: str, colors: Mapping[str, str]) -> str:
    return f"var(--{colors[code]})" if code in colors else code


def _shorter(found: re.Match[str]) -> str:
    return f"{float(found[0]):.2f}".rstrip("0").rstrip(".")
