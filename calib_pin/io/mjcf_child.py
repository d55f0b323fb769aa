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
from calib_pin.io.mjcf_text import WORLD, Refused, Stated

CONFIGURATIONS = 10

EXACT = 1e-9
"""Largest difference of forward kinematics that is rounding [m, rad]."""

KINDS = (
    (re.compile(r"JointModelR(X|Y|Z|evoluteUnaligned)"), "revolute", slice(3, 6)),
    (re.compile(r"JointModelP(X|Y|Z|rismaticUnaligned)"), "prismatic", slice(0, 3)),
)
"""Joints that a URDF has, and where their axes are in what they span."""


BODIES = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)
"""Frames of bodies and sites."""


class Writer:
    """The URDF of a model.

    Args:
        model: The model.
        stated: What the file itself says.
    """

    def __init__(self, model: pin.Model, stated: Stated) -> None:
        """Nothing is written yet."""
        self.model, self.stated = model, stated
        self.root = ElementTree.Element("robot", name=model.name or "robot")
        self.bodies: dict[int, list[pin.Frame]] = {}
        for frame in model.frames:
            if frame.type in BODIES:
                self.bodies.setdefault(frame.parentJoint, []).append(frame)
        self.links: dict[str, None] = {}
        self.carriers: dict[int, str] = {}
        self.joints: dict[str, int] = {}
        """Place of each joint's position in those of the model; -1 without one."""

    def write(self) -> bytes:
        """The bytes of the URDF."""
        model = self.model
        self._link(WORLD, model.inertias[0])
        for j in range(1, model.njoints):
            at = model.getFrameId(model.names[j], pin.FrameType.JOINT)
            parent = self._above(at)
            name = self._carrier(j) or self._free(f"{model.names[j]}_link")
            place = parent.placement.actInv(model.jointPlacements[j])
            self._joints(j, parent.name, name, place)
            self._link(name, model.inertias[j])
            self.carriers[j] = name
        for k, frame in enumerate(model.frames):
            if frame.type not in BODIES or frame.name in self.links:
                continue
            parent = self._above(k)
            before, place = parent.name, parent.placement.actInv(frame.placement)
            if parent.parentJoint != frame.parentJoint:  # It is not where its joint is.
                before, place = self.carriers[frame.parentJoint], frame.placement
            name = self._free_joint(f"{frame.name}_fixed")
            self._end(self._joint(name, "fixed", before), frame.name, place)
            self._link(frame.name)
        ElementTree.indent(self.root)
        return ElementTree.tostring(self.root) + b"\n"

    def _carrier(self, joint: int) -> str:
        """Name of the body that is where its joint is; empty if there is none."""
        frames = self.bodies.get(joint, [])
        bodies = (f for f in frames if f.type == pin.FrameType.BODY)
        return next((f.name for f in bodies if f.placement.isIdentity(0.0)), "")

    def _above(self, index: int) -> pin.Frame:
        """The body that a frame is in."""
        frame = self.model.frames[self.model.frames[index].parentFrame]
        while frame.type != pin.FrameType.BODY:
            frame = self.model.frames[frame.parentFrame]
        return frame

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

    def _joints(self, j: int, parent: str, child: str, place: pin.SE3) -> None:
        """The joints of one body: several are one joint to Pinocchio."""
        whole, name = self.model.joints[j], self.model.names[j]
        if whole.shortname() == "JointModelFreeFlyer":
            self._end(self._joint(name, "floating", parent), child, place)
            return
        parts, places, names = [whole], [place], [name]
        if whole.shortname() == "JointModelComposite":
            several = whole.extract()
            parts = list(several.joints)
            first, *others = several.jointPlacements
            places = [place * first, *others]
            first = self.stated.joints.get(name.removeprefix("Composite_"))
            names = [name] if first is None else [*first.together]
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
        axis = np.ravel(data.S)[rows]
        stated = self.stated.joints[name]
        # At its reference position the body is where it is drawn.
        back = np.zeros(6)
        back[rows] = -stated.ref * axis
        free = kind == "revolute" and stated.limits is None
        joint = self._joint(name, "continuous" if free else kind, parent)
        self.joints[name] = part.idx_q
        self._end(joint, child, place * pin.exp6(pin.Motion(back)))
        ElementTree.SubElement(joint, "axis", xyz=_words(axis))
        ends = zip(("lower", "upper"), map(repr, stated.limits or ()), strict=False)
        ElementTree.SubElement(joint, "limit", dict(ends), effort="0", velocity="0")


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


def require_same(model: pin.Model, data: bytes, writer: Writer) -> None:
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
        for name, place in writer.joints.items():
            if place < 0:
                continue
            at = rng.uniform(-3.0, 3.0)
            q[place] = at - writer.stated.joints[name].ref
            j = other.getJointId(name)
            start, two = other.idx_qs[j], other.nqs[j] == 2
            value = [np.cos(at), np.sin(at)] if two else [at]
            own[start : start + len(value)] = value
        pin.framesForwardKinematics(model, states[0], q)
        pin.framesForwardKinematics(other, states[1], own)
        for k, frame in enumerate(model.frames):
            if frame.type not in BODIES:
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
    writer = Writer(model, stated)
    data = writer.write()
    require_same(model, data, writer)
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
