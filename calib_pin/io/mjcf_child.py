"""Turns MuJoCo's description of a robot into a URDF; `mjcf_files.py` runs it.

Pinocchio reads the file, in a process that may crash, and what it has understood is
written: bodies and sites as links, joints one by one, inertias, limits. The path comes
in as JSON, the URDF and what is not in it goes out, or the reason why there is none.
"""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import enumerated
from calib_pin.io.limits import limit

WORLD = "world"

CONFIGURATIONS = 10

DEEPEST = 20
"""Most files that include one another."""

EXACT = 1e-9
"""Largest difference of forward kinematics that is rounding [m, rad]."""

KINDS = (
    (re.compile(r"JointModelR(X|Y|Z|evoluteUnaligned)"), "revolute", slice(3, 6)),
    (re.compile(r"JointModelP(X|Y|Z|rismaticUnaligned)"), "prismatic", slice(0, 3)),
)
"""Joints that a URDF has, and where their axes are in what they span."""

SLIDE = """<mujoco><worldbody><body name="a"><joint name="j" type="slide" range="0 1"
limited="true"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
</mujoco>"""


class Refused(Exception):
    """A description that cannot be a URDF, with the reason."""


class Writer:
    """The URDF of a model.

    Args:
        model: The model.
        stated: What the file itself says.
        slide: Limits of slides in those that the model has.
    """

    def __init__(self, model: pin.Model, stated: Stated, slide: float) -> None:
        """Nothing is written yet."""
        self.model, self.stated, self.slide = model, stated, slide
        self.root = ElementTree.Element("robot", name=model.name or "robot")
        self.bodies: dict[int, list[pin.Frame]] = {}
        for frame in model.frames:
            if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME):
                self.bodies.setdefault(frame.parentJoint, []).append(frame)
        self.links: dict[str, None] = {}
        self.joints: dict[str, int] = {}
        """Place of each joint's position in those of the model; -1 without one."""

    def write(self) -> bytes:
        """The bytes of the URDF."""
        model = self.model
        carriers = [self._carrier(0) or WORLD]
        self._link(carriers[0], model.inertias[0])
        for j in range(1, model.njoints):
            name = self._carrier(j) or self._free(f"{model.names[j]}_link")
            self._joints(j, carriers[model.parents[j]], name)
            self._link(name, model.inertias[j])
            carriers.append(name)
        for j, frames in self.bodies.items():
            for frame in frames:
                if frame.name in carriers:
                    continue
                name = self._free_joint(f"{frame.name}_fixed")
                joint = self._joint(name, "fixed", carriers[j])
                self._end(joint, frame.name, frame.placement)
                self._link(frame.name)
        ElementTree.indent(self.root)
        return ElementTree.tostring(self.root) + b"\n"

    def _carrier(self, joint: int) -> str:
        """Name of the body that is where its joint is; empty if there is none."""
        frames = self.bodies.get(joint, [])
        bodies = (f for f in frames if f.type == pin.FrameType.BODY)
        return next((f.name for f in bodies if f.placement.isIdentity(0.0)), "")

    def _free(self, name: str) -> str:
        taken = {*self.links, *(f.name for fs in self.bodies.values() for f in fs)}
        while name in taken:
            name += "_"
        return name

    def _free_joint(self, name: str) -> str:
        while name in self.joints or name in self.model.names:
            name += "_"
        return name

    def _link(self, name: str, inertia: pin.Inertia | None = None) -> None:
        if name in self.links:
            raise Refused(f"the name '{name}' is that of two bodies or sites")
        self.links[name] = None
        link = ElementTree.SubElement(self.root, "link", name=name)
        if inertia is None or not inertia.mass > 0.0:
            return
        element = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(element, "mass", value=repr(float(inertia.mass)))
        ElementTree.SubElement(element, "origin", xyz=_words(inertia.lever))
        six = inertia.inertia[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        words = map(repr, map(float, six))
        ElementTree.SubElement(element, "inertia", dict(zip(keys, words, strict=True)))

    def _joint(self, name: str, kind: str, parent: str) -> ElementTree.Element:
        if name in self.joints:
            raise Refused(f"the name '{name}' is that of two joints")
        self.joints[name] = -1
        joint = ElementTree.SubElement(self.root, "joint", name=name, type=kind)
        ElementTree.SubElement(joint, "parent", link=parent)
        return joint

    def _end(self, joint: ElementTree.Element, child: str, place: pin.SE3) -> None:
        ElementTree.SubElement(joint, "child", link=child)
        rpy = pin.rpy.matrixToRpy(place.rotation)
        ElementTree.SubElement(
            joint, "origin", xyz=_words(place.translation), rpy=_words(rpy)
        )

    def _joints(self, j: int, parent: str, child: str) -> None:
        """The joints of one body: several are one joint to Pinocchio."""
        whole, place = self.model.joints[j], self.model.jointPlacements[j]
        name = self.model.names[j]
        if whole.shortname() == "JointModelFreeFlyer":
            self._end(self._joint(name, "floating", parent), child, place)
            return
        parts, places, names = [whole], [place], [name]
        if whole.shortname() == "JointModelComposite":
            several = whole.extract()
            parts = list(several.joints)
            first, *others = several.jointPlacements
            places = [place * first, *others]
            names = self.stated.names_of(name.removeprefix("Composite_"), len(parts))
        for k, (part, at, own) in enumerate(zip(parts, places, names, strict=True)):
            last = k == len(parts) - 1
            link = child if last else self._free(f"{own}_link")
            self._single(part, own, parent, link, at)
            if not last:
                self._link(link)
            parent = link

    def _single(
        self, part: pin.JointModel, name: str, parent: str, child: str, place: pin.SE3
    ) -> None:
        """One joint of a single degree of freedom."""
        found = (row for row in KINDS if row[0].fullmatch(part.shortname()))
        kind, rows = next(((row[1], row[2]) for row in found), ("", slice(0)))
        if not kind:
            word = part.shortname().removeprefix("JointModel").lower()
            word = {"spherical": "ball"}.get(word, word)
            raise Refused(f"joint '{name}' is a {word} joint, which no URDF can hold")
        data, q = part.createData(), np.zeros(self.model.nq)
        part.calc(data, q)
        ends = [
            float(bounds[part.idx_q])
            for bounds in (
                self.model.lowerPositionLimit,
                self.model.upperPositionLimit,
            )
        ]
        if kind == "prismatic":
            ends = [end * self.slide for end in ends]
        limited = bool(np.isfinite(ends).all())
        free = kind == "revolute" and not limited
        joint = self._joint(name, "continuous" if free else kind, parent)
        self.joints[name] = part.idx_q
        self._end(joint, child, place)
        ElementTree.SubElement(joint, "axis", xyz=_words(np.ravel(data.S)[rows]))
        stated = dict(zip(("lower", "upper"), map(repr, ends), strict=True))
        ElementTree.SubElement(
            joint, "limit", stated if limited else {}, effort="0", velocity="0"
        )


class Stated:
    """A description as it is written, with its includes in their places.

    Pinocchio does not know includes, and does not keep all names.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        """Read it, and what it includes."""
        self.root = _complete(path, path.parent, 0)
        sections: dict[str, ElementTree.Element] = {}
        for section in list(self.root):
            first = sections.setdefault(section.tag, section)
            if first is not section:
                first.attrib |= section.attrib
                first.extend(section)
                self.root.remove(section)
        self.elements = list(self.root.iter())

    def names_of(self, first: str, count: int) -> list[str]:
        """Names of the joints of a body, by that of the first one."""
        for element in self.elements:
            joints = element.findall("joint") if element.tag == "body" else []
            if len(joints) == count and joints[0].get("name", first) == first:
                named = first == joints[0].get("name") or first.startswith(
                    f"{element.get('name')}Joint"
                )
                if named:
                    return [
                        joint.get("name", first if k == 0 else f"{first}_{k}")
                        for k, joint in enumerate(joints)
                    ]
        return [first, *(f"{first}_{k}" for k in range(1, count))]

    @property
    def degrees(self) -> bool:
        """Whether angles are in degrees."""
        words = [e.get("angle") for e in self.elements if e.tag == "compiler"]
        return "radian" not in words

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


def _words(numbers: Iterable[float] | NDArray[np.float64]) -> str:
    # Adding zero turns -0.0 into 0.0.
    return " ".join(repr(float(number) + 0.0) for number in numbers)


def read(root: ElementTree.Element) -> pin.Model:
    """The model, with the reason for none in few words."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "robot.xml")
        file.write_bytes(ElementTree.tostring(root))
        try:
            return pin.buildModelFromMJCF(str(file))
        except Exception as failure:  # Whatever C++ throws.
            words = " ".join(str(failure).rpartition("message:")[2].split())
            if "::at" in words:
                words = "it names a class, mesh or other thing that is not there"
            raise Refused(f"Pinocchio cannot read it: {words}") from None


def slide_limits(stated: Stated) -> float:
    """Factor of the limits of slides: Pinocchio may take them for angles."""
    if not stated.degrees:
        return 1.0
    known = read(ElementTree.fromstring(SLIDE))
    return 1.0 / float(known.upperPositionLimit[0])


def require_same(model: pin.Model, data: bytes, joints: dict[str, int]) -> None:
    """Compare the URDF with the model at random positions.

    Raises:
        Refused: If a body or site is elsewhere.
    """
    try:
        other = pin.buildModelFromXML(data.decode())
    except Exception:  # Whoever asked will find out what is wrong with it.
        return
    rng = np.random.default_rng(0)
    states = model.createData(), other.createData()
    for _ in range(CONFIGURATIONS):
        q, own = pin.neutral(model), pin.neutral(other)
        for name, place in joints.items():
            if place < 0:
                continue
            q[place] = rng.uniform(-3.0, 3.0)
            j = other.getJointId(name)
            start, two = other.idx_qs[j], other.nqs[j] == 2
            value = [np.cos(q[place]), np.sin(q[place])] if two else [q[place]]
            own[start : start + len(value)] = value
        pin.framesForwardKinematics(model, states[0], q)
        pin.framesForwardKinematics(other, states[1], own)
        for k, frame in enumerate(model.frames):
            if frame.type not in (pin.FrameType.BODY, pin.FrameType.OP_FRAME):
                continue
            found = states[1].oMf[other.getFrameId(frame.name, pin.FrameType.BODY)]
            away = np.abs(found.homogeneous - states[0].oMf[k].homogeneous).max()
            if not away < EXACT:
                raise Refused(
                    f"as a URDF it would differ: '{frame.name}' by {away:.2g} m"
                )


def converted(path: Path) -> dict[str, str]:
    """The URDF, and a sentence about what is not in it.

    Raises:
        Exception: Of any kind, if there is none.
    """
    stated = Stated(path)
    model = read(stated.root)
    writer = Writer(model, stated, slide_limits(stated))
    data = writer.write()
    require_same(model, data, writer.joints)
    lost = [
        *(f"body '{n}'" for n in sorted(stated.names("body") - {*writer.links})),
        *(f"joint '{n}'" for n in sorted(stated.names("joint") - {*writer.joints})),
    ]
    if all(place < 0 for place in writer.joints.values()):
        raise Refused("Pinocchio finds no joints in it")
    remark = "read from MJCF: bodies and sites are links, shapes are not taken over"
    if lost:
        remark += f", nor does Pinocchio take over {enumerated(lost)}"
    return {"urdf": data.decode(), "remark": remark}


def main() -> None:
    """Answer one request."""
    limit()
    request = json.load(sys.stdin)
    # Nothing that the library prints is an answer.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    found: dict[str, str]
    try:
        found = converted(Path(request["file"]))
    except Exception as failure:
        words = " ".join(str(failure).split()) or type(failure).__name__
        found = {"reason": f"this MJCF cannot be used: {words}"}
    json.dump(found, answers)
    answers.close()


if __name__ == "__main__":
    main()
