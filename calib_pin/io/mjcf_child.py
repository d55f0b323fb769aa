"""Turns MuJoCo's description of a robot into a URDF; `children` calls it.

MuJoCo reads the file. Bodies and sites become links, joints come one by one, with
their limits and reference positions, and inertias are those of the compiled model.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
import pinocchio as pin

from calib_pin.errors import RobotError, words_of
from calib_pin.io.urdf_tree import branch, origin_of, words
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
        self.model, self.free, self.lines = model, list[str](), list[str]()
        self.bodies = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
        names = [model.joint(j).name for j in range(model.njnt)]
        self.used = {*self.bodies, *names}
        owners = [self.bodies[b] for b in model.jnt_bodyid]
        usual = [f"{owner}_joint{j}" for j, owner in enumerate(owners)]
        pairs = zip(names, usual, strict=True)
        self.joints = [name or self._unused(other) for name, other in pairs]

    def write(self) -> str:
        """The text of the URDF."""
        model, mimics = self.model, self._mimics()
        for b, name in enumerate(self.bodies[1:], start=1):
            parent, shift = self.bodies[model.body_parentid[b]], np.zeros(3)
            place = _placement(model.body_pos[b], model.body_quat[b])
            end = model.body_jntadr[b] + model.body_jntnum[b]
            for j in range(model.body_jntadr[b], end):
                # From where the joint before it turned about to where this one does.
                place = place * pin.SE3(np.eye(3), model.jnt_pos[j] - shift)
                shift = model.jnt_pos[j]
                last = j == end - 1 and not shift.any()
                child = name if last else self._unused(f"{self.joints[j]}_link")
                place, kind, more = self._moving(j, place)
                more += mimics.get(j, "")
                self._joint((self.joints[j], kind, parent, child), place, more)
                parent, place = child, pin.SE3.Identity()
            if parent != name:
                place = place * pin.SE3(np.eye(3), -shift)
                self._fixed(parent, name, place)
        for k in range(model.nsite):
            if name := model.site(k).name:
                site = name if name not in self.bodies else self._unused(name)
                place = _placement(model.site_pos[k], model.site_quat[k])
                self._fixed(self.bodies[model.site_bodyid[k]], site, place)
        name = model.names.partition(b"\0")[0].decode()  # The first is the model's.
        world = f"  <link name={quoteattr(self.bodies[0])}/>\n"
        start = f"<robot name={quoteattr(name or 'robot')}>\n"
        return "".join([start, world, *self.lines, "</robot>\n"])

    def _unused(self, name: str) -> str:
        """A name that nothing else has."""
        while name in self.used:
            name += "_"
        self.used.add(name)
        return name

    def _fixed(self, parent: str, child: str, place: pin.SE3) -> None:
        joint = self._unused(f"{child}_fixed"), "fixed", parent, child
        self._joint(joint, place)

    def _joint(self, joint: Sequence[str], place: pin.SE3, more: str = "") -> None:
        """Write a joint and its link, with the inertia of a body, see `branch`."""
        model, child, inside = self.model, joint[-1], ""
        body = self.bodies.index(child) if child in self.bodies else 0
        if model.body_mass[body] > LIGHTEST:
            six = origin_of(_placement(model.body_ipos[body], model.body_iquat[body]))
            (x, y, z), mass = model.body_inertia[body], model.body_mass[body]
            inside = _tag("mass", value=mass) + _tag("origin", xyz=six[:3], rpy=six[3:])
            inside += _tag("inertia", ixx=x, iyy=y, izz=z, ixy=0.0, ixz=0.0, iyz=0.0)
            inside = f"<inertial>\n{inside}  </inertial>"
        origin = np.add(origin_of(place), 0.0).tolist()
        self.lines.append(branch(joint, origin, more, inside))

    def _moving(self, j: int, place: pin.SE3) -> tuple[pin.SE3, str, str]:
        """Placement, kind, axis and limits of one of MuJoCo's joints."""
        model, kind = self.model, self.model.jnt_type[j]
        if kind == BALL:
            name = self.joints[j]
            raise RobotError(f"joint '{name}' is a ball joint, which no URDF can hold")
        if kind == FREE:
            return place, "floating", ""
        # At its reference position the body is where it is drawn.
        axis, back = model.jnt_axis[j], np.zeros((2, 3))
        back[int(kind == HINGE)] = -model.qpos0[model.jnt_qposadr[j]] * axis
        limited = bool(model.jnt_limited[j])
        ends = zip(("lower", "upper"), model.jnt_range[j], strict=True)
        limit = _tag("limit", **dict(ends if limited else ()), effort=0.0, velocity=0.0)
        turning = "revolute" if limited else "continuous"
        word = turning if kind == HINGE else "prismatic"
        return place * pin.exp6(pin.Motion(*back)), word, _tag("axis", xyz=axis) + limit

    def _mimics(self) -> dict[int, str]:
        """Elements of joints that follow others, as far as a URDF can hold them."""
        model, elements = self.model, dict[int, str]()
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
            elements[one] = _tag("mimic", joint=self.joints[other], **numbers)
        return elements


def _tag(tag: str, **about: Any) -> str:
    """An element with attributes, of numbers with all their digits, in a line."""
    for key, value in about.items():
        if not isinstance(value, str):  # Adding zero turns -0.0 into 0.0.
            value = words(np.atleast_1d(value) + 0.0)
        tag += f" {key}={quoteattr(value)}"
    return f"    <{tag}/>\n"


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
