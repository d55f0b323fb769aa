"""MuJoCo's descriptions as text: in one piece, and as Pinocchio understands them.

Pinocchio knows no includes, and not all that stands in defaults: so included files are
put in their places, and every element gets what its class says.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

DEEPEST = 20
"""Most files that include one another."""

KEPT = ("asset", "compiler", "worldbody")
"""Sections that kinematics needs; others may name what Pinocchio does not know."""

WORLD = "world"
"""Name of the world, which is no body's."""

MAIN = "main"
"""Name of the defaults that all others begin with."""

Attributes = dict[str, dict[str, str]]
"""Attributes of elements by tag."""

TURNS = {"quat", "axisangle", "euler", "xyaxes", "zaxis"}
"""Attributes of which an element has one."""


class Refused(Exception):
    """A description that cannot be a URDF, with the reason."""


class Joint(NamedTuple):
    """A joint as it is stated.

    Attributes:
        together: Names of the joints of its body.
        ref: Position at which the body is where it is drawn [rad, m].
        limits: Its range, if it has one [rad, m].
    """

    together: tuple[str, ...]
    ref: float
    limits: tuple[float, ...] | None


class Stated:
    """A description in one piece.

    Args:
        path: The file.

    Attributes:
        root: Its outermost element.
        elements: All elements in it.
        joints: The hinges, slides and others by name; all have one.
    """

    def __init__(self, path: Path) -> None:
        """Read it, and what it includes.

        Raises:
            Refused: If that cannot be done, or Pinocchio would misunderstand it.
        """
        self.root = _complete(path, path.parent, 0)
        sections: dict[str, ElementTree.Element] = {}
        for section in list(self.root):
            first = sections.setdefault(section.tag, section)
            if first is not section:
                first.attrib |= section.attrib
                first.extend(section)
                self.root.remove(section)
        defaults = sections.get("default", ElementTree.Element("default"))
        classes = _classes(defaults, MAIN, {})
        if "class" in defaults.attrib:
            classes[defaults.attrib["class"]] = classes[MAIN]
        if "default" in sections:
            self.root.remove(defaults)
        _state(self.root, classes, MAIN)
        for section in list(self.root):
            if section.tag not in KEPT:
                self.root.remove(section)
        for section in self.root.findall("worldbody"):
            # Of several bodies Pinocchio takes the first, and forgets where it is.
            body = ElementTree.Element("body", name=WORLD)
            body.extend(section)
            section[:] = [body]
        self.elements = list(self.root.iter())
        self.joints = {j.attrib["name"]: self._joint(j, k) for j, k in self._joints()}
        fixed = self._setting("eulerseq").lower() != self._setting("eulerseq")
        if fixed and any("euler" in e.attrib for e in self.elements):
            raise Refused("'eulerseq' in capitals, turns about fixed axes, is unknown")

    def _joints(self) -> Iterator[tuple[ElementTree.Element, list[str]]]:
        """Joints, all with a name, and those of the same body."""
        taken = self.names("joint")
        for body in (e for e in self.elements if e.tag == "body"):
            joints = body.findall("joint")
            for k, joint in enumerate(joints):
                name = joint.get("name") or f"{body.get('name', 'body')}_joint{k}"
                while "name" not in joint.attrib and name in taken:
                    name += "_"
                joint.set("name", name)
                taken.add(name)
            names = [joint.attrib["name"] for joint in joints]
            yield from ((joint, names) for joint in joints)

    def _joint(self, joint: ElementTree.Element, names: list[str]) -> Joint:
        """A joint, without what Pinocchio does not understand of it."""
        unit = math.pi / 180.0 if self.degrees else 1.0
        if joint.get("type", "hinge") != "hinge":
            unit = 1.0
        ends, limited = joint.get("range", "").split(), joint.get("limited", "auto")
        if limited == "auto" and self._setting("autolimits") != "false":
            limited = "true"
        return Joint(
            tuple(names),
            unit * self._number(joint.attrib.pop("ref", "0")),
            tuple(unit * self._number(end) for end in ends)
            if limited == "true" and len(ends) == 2
            else None,
        )

    def _number(self, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            raise Refused(f"'{text}' is not a number") from None

    def _setting(self, key: str) -> str:
        """A setting of the compiler, the last that is stated."""
        stated = [e.get(key, "") for e in self.elements if e.tag == "compiler"]
        return next(filter(None, reversed(stated)), "")

    @property
    def degrees(self) -> bool:
        """Whether angles are in degrees."""
        return self._setting("angle") != "radian"

    def names(self, tag: str) -> set[str]:
        """Names of the bodies or joints."""
        found = (e for e in self.elements if e.tag == tag)
        return {e.attrib["name"] for e in found if "name" in e.attrib}


def _complete(path: Path, folder: Path, depth: int) -> ElementTree.Element:
    """The tree of a file, with the content of others where it includes them."""
    if depth > DEEPEST:
        raise Refused("files include one another without end")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise Refused(f"{path} is not well-formed XML: {error}") from None
    except OSError as error:
        raise Refused(f"{path} cannot be read: {error.strerror}") from None
    for parent in list(root.iter()):
        for place in range(len(parent) - 1, -1, -1):
            if parent[place].tag == "include":
                # From the folder of the first file, whichever includes it.
                file = folder / parent[place].get("file", "")
                parent[place : place + 1] = list(_complete(file, folder, depth + 1))
    return root


def _classes(
    section: ElementTree.Element, name: str, above: Attributes
) -> dict[str, Attributes]:
    """Attributes of a class of defaults, and of those inside, which go on from it."""
    own = {tag: dict(attributes) for tag, attributes in above.items()}
    for element in section:
        if element.tag != "default":
            own.setdefault(element.tag, {}).update(element.attrib)
    found = {name: own}
    for inner in section.findall("default"):
        found |= _classes(inner, inner.get("class", ""), own)
    return found


def _state(
    parent: ElementTree.Element, classes: Mapping[str, Attributes], usual: str
) -> None:
    """Give all elements inside what their classes say, in place."""
    for element in parent:
        name = element.attrib.pop("class", usual)
        if name not in classes:
            raise Refused(f"the class '{name}' is not among its defaults")
        stated = classes[name].get(element.tag, {})
        if TURNS & element.attrib.keys():
            stated = {key: text for key, text in stated.items() if key not in TURNS}
        element.attrib |= {**stated, **element.attrib}
        _state(element, classes, element.attrib.pop("childclass", usual))
