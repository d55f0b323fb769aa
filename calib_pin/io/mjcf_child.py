"""Turns MuJoCo's description of a robot into a URDF; `children` calls it.

MuJoCo reads the file. Bodies and sites become links, joints come one by one, with
their limits and reference positions, and inertias are those of the compiled model.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import mujoco
import numpy as np
import pinocchio as pin

from calib_pin.errors import RobotError, words_of
from calib_pin.io.urdf_tree import origin_of, unused, words
from calib_pin.kinematics.spatial import Floats

REMARK = "read from MJCF: bodies and sites are links, shapes are not taken over"

LIGHTEST = 1e-12
"""Mass, and inertia, of a body that has none of its own [kg, kg m2]."""

FREE, BALL, SLIDE, HINGE = range(4)
"""Kinds of joints, as `mjtJoint` numbers them."""


class Writer:
    """The URDF of a compiled model.

    Args:
        model: The model.

    Attributes:
        free: Joints whose coupling no URDF can hold.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Give names to what has none; nothing is written yet."""
        name = model.names.partition(b"\0")[0].decode()  # The first is the model's.
        self.root = Element("robot", name=name or "robot")
        self.model, self.free = model, list[str]()
        self.bodies = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
        names = [model.joint(j).name for j in range(model.njnt)]
        self.used = {*self.bodies, *names}
        owners = [self.bodies[b] for b in model.jnt_bodyid]
        usual = [f"{owner}_joint{j}" for j, owner in enumerate(owners)]
        pairs = zip(names, usual, strict=True)
        self.joints = [name or unused(other, self.used) for name, other in pairs]

    def write(self) -> str:
        """The text of the URDF."""
        model, mimics = self.model, self._mimics()
        SubElement(self.root, "link", name=self.bodies[0])
        for b, name in enumerate(self.bodies[1:], start=1):
            parent, shift = self.bodies[model.body_parentid[b]], np.zeros(3)
            place = _placement(model.body_pos[b], model.body_quat[b])
            end = model.body_jntadr[b] + model.body_jntnum[b]
            for j in range(model.body_jntadr[b], end):
                # From where the joint before it turned about to where this one does.
                place = place * pin.SE3(np.eye(3), model.jnt_pos[j] - shift)
                shift = model.jnt_pos[j]
                last = j == end - 1 and not shift.any()
                child = name if last else unused(f"{self.joints[j]}_link", self.used)
                joint = self._moving(j, parent, child, place)
                if j in mimics:
                    _add(joint, "mimic", **mimics[j])
                parent, place = child, pin.SE3.Identity()
            if parent != name:
                place = place * pin.SE3(np.eye(3), -shift)
                self._fixed(parent, name, place)
        for k in range(model.nsite):
            if name := model.site(k).name:
                site = name if name not in self.bodies else unused(name, self.used)
                place = _placement(model.site_pos[k], model.site_quat[k])
                self._fixed(self.bodies[model.site_bodyid[k]], site, place)
        indent(self.root)
        return tostring(self.root, "unicode")

    def _fixed(self, parent: str, child: str, place: pin.SE3) -> None:
        name = unused(f"{child}_fixed", self.used)
        self._joint(name, "fixed", parent, child, place)

    def _joint(
        self, name: str, kind: str, parent: str, child: str, place: pin.SE3
    ) -> Element:
        """Write a link, with the inertia of a body, and the joint that carries it."""
        model, link = self.model, SubElement(self.root, "link", name=child)
        body = self.bodies.index(child) if child in self.bodies else 0
        if model.body_mass[body] > LIGHTEST:
            inertial, (x, y, z) = SubElement(link, "inertial"), model.body_inertia[body]
            _add(inertial, "mass", value=model.body_mass[body])
            _place(inertial, _placement(model.body_ipos[body], model.body_iquat[body]))
            _add(inertial, "inertia", ixx=x, iyy=y, izz=z, ixy=0.0, ixz=0.0, iyz=0.0)
        joint = SubElement(self.root, "joint", name=name, type=kind)
        _add(joint, "parent", link=parent)
        _add(joint, "child", link=child)
        _place(joint, place)
        return joint

    def _moving(self, j: int, parent: str, child: str, place: pin.SE3) -> Element:
        """Write one of MuJoCo's joints."""
        model, name, kind = self.model, self.joints[j], self.model.jnt_type[j]
        if kind == BALL:
            raise RobotError(f"joint '{name}' is a ball joint, which no URDF can hold")
        if kind == FREE:
            return self._joint(name, "floating", parent, child, place)
        # At its reference position the body is where it is drawn.
        axis, back = model.jnt_axis[j], np.zeros((2, 3))
        back[int(kind == HINGE)] = -model.qpos0[model.jnt_qposadr[j]] * axis
        place, limited = place * pin.exp6(pin.Motion(*back)), bool(model.jnt_limited[j])
        turning = "revolute" if limited else "continuous"
        word = turning if kind == HINGE else "prismatic"
        joint = self._joint(name, word, parent, child, place)
        _add(joint, "axis", xyz=axis)
        ends = zip(("lower", "upper"), model.jnt_range[j], strict=True)
        _add(joint, "limit", **dict(ends if limited else ()), effort=0.0, velocity=0.0)
        return joint

    def _mimics(self) -> dict[int, dict[str, Any]]:
        """How joints follow others, as far as a URDF can hold it, by their number."""
        model, mimics = self.model, dict[int, dict[str, Any]]()
        couplings = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 == 1)
        for k in np.flatnonzero(couplings):
            one, other = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            offset, factor, *more = model.eq_data[k, :5]
            if other < 0 or any(more):
                self.free.append(self.joints[one])
                continue
            # Coupled are the distances from the reference positions.
            zero, leader = (model.qpos0[model.jnt_qposadr[j]] for j in (one, other))
            numbers = {"multiplier": factor, "offset": zero + offset - factor * leader}
            mimics[one] = {"joint": self.joints[other], **numbers}
        return mimics


def _add(parent: Element, tag: str, **about: Any) -> None:
    """Add an element with attributes, of numbers with all their digits."""
    element = SubElement(parent, tag)
    for key, value in about.items():
        text = isinstance(value, str)  # Adding zero turns -0.0 into 0.0.
        element.set(key, value if text else words(np.atleast_1d(value) + 0.0))


def _place(parent: Element, place: pin.SE3) -> None:
    six = origin_of(place)
    _add(parent, "origin", xyz=six[:3], rpy=six[3:])


def _placement(position: Floats, quaternion: Floats) -> pin.SE3:
    """A placement by MuJoCo's numbers, of which w comes first."""
    return pin.SE3(pin.Quaternion(*map(float, quaternion)).matrix(), position)


def _compiled(file: Path) -> mujoco.MjModel:
    """The model, in which every body keeps its place."""
    mujoco.set_mju_user_warning(lambda _: None)  # It would write them into a file.
    spec = mujoco.MjSpec.from_file(str(file))
    spec.compiler.fusestatic = False  # Every body is a link.
    for bound in ("boundmass", "boundinertia"):
        setattr(spec.compiler, bound, max(getattr(spec.compiler, bound), LIGHTEST))
    return spec.compile()


def read(file: str) -> tuple[str, str]:
    """The URDF of a robot in MuJoCo's language, and a sentence about what it lacks.

    Args:
        file: The file.

    Raises:
        RobotError: If MuJoCo cannot read it, or no URDF can hold it.
    """
    try:
        writer = Writer(_compiled(Path(file)))
        urdf = writer.write()
    except Exception as failure:
        raise RobotError(f"this MJCF cannot be used: {words_of(failure)}") from None
    remark = REMARK
    if writer.free:
        text = f"{', '.join(writer.free)} moves freely"
        remark += f"; a URDF holds couplings by one factor only: {text}"
    return urdf, remark
