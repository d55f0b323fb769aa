"""Turns MuJoCo's description of a robot into a URDF; `children` calls it.

MuJoCo reads the file. Bodies and sites become links, joints come one by one, with
their limits and reference positions, and inertias are those of the compiled model.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin

from calib_pin.errors import RobotError
from calib_pin.kinematics.spatial import Floats

HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)
"""Kinds of joints, as a model numbers them."""

FILES = ("meshes", "hfields", "skins", "materials", "textures")
"""Parts of a description that come from files of their own."""

REMARK = "read from MJCF: bodies and sites are links, shapes are not taken over"

EQUAL = int(mujoco.mjtEq.mjEQ_JOINT)
"""Kind of a coupling of joints."""

FEW_DEGREES = 12.6
"""Ranges of all hinges that are no larger are those of joints in rad: two turns."""

LIGHTEST = 1e-12
"""Mass, and inertia, of a body that has none of its own [kg, kg m2]."""


class Writer:
    """The URDF of a compiled model.

    Args:
        model: The model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Only the world is written yet."""
        self.model = model
        name = model.names.partition(b"\0")[0].decode()  # The first is the model's.
        self.root = ElementTree.Element("robot", name=name or "robot")
        bodies, joints = range(model.nbody), range(model.njnt)
        self.bodies = [model.body(b).name or f"body{b}" for b in bodies]
        self.joints = [model.joint(j).name for j in joints]
        self.taken, self.names = {*self.bodies, *self.joints}, dict[int, str]()
        self.free = list[str]()
        _add(self.root, "link", name=self.bodies[0])

    def write(self) -> bytes:
        """The bytes of the URDF."""
        model = self.model
        for b, name in enumerate(self.bodies[1:], start=1):
            parent = self.bodies[model.body_parentid[b]]
            place = _place(model.body_pos[b], model.body_quat[b])
            first, shift = model.body_jntadr[b], np.zeros(3)
            for j in range(first, first + model.body_jntnum[b]):
                # From where the joint before it turned about to where this one does.
                place = place * pin.SE3(np.eye(3), model.jnt_pos[j] - shift)
                shift = model.jnt_pos[j]
                last = j == first + model.body_jntnum[b] - 1 and not shift.any()
                parent = self._moving(j, parent, name if last else "", place)
                place = pin.SE3.Identity()
            if parent != name:
                place = place * pin.SE3(np.eye(3), -shift)
                self._joint(self._free(f"{name}_fixed"), "fixed", parent, name, place)
            self._inertia(_add(self.root, "link", name=name), b)
        for k in range(model.nsite):
            if name := model.site(k).name:
                place = _place(model.site_pos[k], model.site_quat[k])
                site = name if name not in self.bodies else self._free(name)
                body, joint = self.bodies[model.site_bodyid[k]], f"{site}_fixed"
                self._joint(self._free(joint), "fixed", body, site, place)
                _add(self.root, "link", name=site)
        self._couple()
        ElementTree.indent(self.root)
        return ElementTree.tostring(self.root) + b"\n"

    def _couple(self) -> None:
        """Let joints mimic those that they are coupled to, as far as a URDF can."""
        model = self.model
        moving = {e.get("name"): e for e in self.root.iter("joint")}
        for k in np.flatnonzero((model.eq_type == EQUAL) & (model.eq_active0 == 1)):
            one, other = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            offset, factor, *more = map(float, model.eq_data[k, :5])
            if other < 0 or any(more):
                self.free.append(self.names[one])
                continue
            # Coupled are the distances from the reference positions.
            zero, leader = (model.qpos0[model.jnt_qposadr[j]] for j in (one, other))
            about = {"joint": self.names[other], "multiplier": repr(factor)}
            about["offset"] = repr(float(zero + offset - factor * leader))
            _add(moving[self.names[one]], "mimic", about)

    def _free(self, name: str) -> str:
        """A name that nothing else has."""
        while name in self.taken:
            name += "_"
        self.taken.add(name)
        return name

    def _inertia(self, link: ElementTree.Element, body: int) -> None:
        model = self.model
        if (mass := float(model.body_mass[body])) <= LIGHTEST:
            return
        turn = _place(np.zeros(3), model.body_iquat[body]).rotation
        inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
        six = [repr(float(number)) for number in inertia[np.triu_indices(3)]]
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        element = _add(link, "inertial")
        _add(element, "mass", value=repr(mass))
        _add(element, "origin", xyz=_words(model.body_ipos[body]))
        _add(element, "inertia", dict(zip(keys, six, strict=True)))

    def _joint(
        self, name: str, kind: str, parent: str, child: str, place: pin.SE3
    ) -> ElementTree.Element:
        joint = _add(self.root, "joint", name=name, type=kind)
        _add(joint, "parent", link=parent)
        _add(joint, "child", link=child)
        rpy = pin.rpy.matrixToRpy(place.rotation)
        _add(joint, "origin", xyz=_words(place.translation), rpy=_words(rpy))
        return joint

    def _moving(self, j: int, parent: str, child: str, place: pin.SE3) -> str:
        """Write one joint, of a link of its own without another; the link's name."""
        model, body = self.model, self.model.jnt_bodyid[j]
        count = j - model.body_jntadr[body]
        name = self.joints[j] or self._free(f"{self.bodies[body]}_joint{count}")
        self.names[j] = name
        if not child:
            child = self._free(f"{name}_link")
            _add(self.root, "link", name=child)
        if model.jnt_type[j] == FREE:
            self._joint(name, "floating", parent, child, place)
            return child
        if model.jnt_type[j] not in (HINGE, SLIDE):
            raise RobotError(f"joint '{name}' is a ball joint, which no URDF can hold")
        # At its reference position the body is where it is drawn.
        axis, hinge = model.jnt_axis[j], model.jnt_type[j] == HINGE
        back, none = -model.qpos0[model.jnt_qposadr[j]] * axis, np.zeros(3)
        place = place * pin.exp6(pin.Motion(*((none, back) if hinge else (back, none))))
        limited = bool(model.jnt_limited[j])
        kind = ("revolute" if limited else "continuous") if hinge else "prismatic"
        joint = self._joint(name, kind, parent, child, place)
        _add(joint, "axis", xyz=_words(axis))
        ends = map(repr, map(float, model.jnt_range[j])) if limited else ()
        limits = dict(zip(("lower", "upper"), ends, strict=False))
        _add(joint, "limit", limits, effort="0", velocity="0")
        return child


_add = ElementTree.SubElement


def _place(position: Floats, quaternion: Floats) -> pin.SE3:
    """A placement by MuJoCo's numbers, of which w comes first."""
    return pin.SE3(pin.Quaternion(*map(float, quaternion)).matrix(), position)


def _words(numbers: Iterable[float]) -> str:
    # Adding zero turns -0.0 into 0.0.
    return " ".join(repr(float(number) + 0.0) for number in numbers)


def _compiled(path: str) -> tuple[mujoco.MjModel, str]:
    """The model, and what is to be said of it."""
    mujoco.set_mju_user_warning(lambda _: None)  # It would write them into a file.
    spec = mujoco.MjSpec.from_file(path)
    _check_angles(spec, Path(path))
    spec.compiler.fusestatic = False  # Every body is a link.
    for bound in ("boundmass", "boundinertia"):
        setattr(spec.compiler, bound, max(getattr(spec.compiler, bound), LIGHTEST))
    try:
        return spec.compile(), REMARK
    except ValueError:
        shapes = [g for g in spec.geoms if g.meshname or g.hfieldname]
        if not shapes:
            raise
    # The kinematics do not need their files, which may not be there.
    for part in (*spec.geoms, *spec.sites):
        part.material = ""
    for part in (*shapes, *(part for kind in FILES for part in getattr(spec, kind))):
        spec.delete(part)
    return spec.compile(), f"{REMARK}, nor are the masses of meshes"


def _check_angles(spec: mujoco.MjSpec, file: Path) -> None:
    """Refuse a file that means radians, and does not say so.

    Raises:
        RobotError: If it states no unit, and all hinges would turn by few degrees.
    """
    hinges = [j for j in spec.joints if int(j.type) == HINGE and any(j.range)]
    widest = max((float(np.abs(j.range).max()) for j in hinges), default=np.inf)
    if spec.compiler.degree and widest <= FEW_DEGREES and not _states_angle(file):
        raise RobotError(
            f"no joint turns farther than {widest:g} degrees, and <compiler> states no "
            'angle, which means degrees; are they radians, add angle="radian"',
            allowed='<compiler angle="radian"/> or <compiler angle="degree"/>',
        )


def _states_angle(file: Path) -> bool:
    """Whether a file, or one that it includes, states the unit of angles."""
    root = ElementTree.parse(file).getroot()
    stated = any("angle" in element.attrib for element in root.iter("compiler"))
    names = (element.get("file", "") for element in root.iter("include"))
    return stated or any(_states_angle(file.parent / name) for name in names)


def read(file: str) -> tuple[dict[str, object], bytes]:
    """A sentence about what is not in the URDF of a robot, and the URDF.

    Args:
        file: A file in MuJoCo's language.

    Raises:
        RobotError: If MuJoCo cannot read it, or no URDF can hold it.
    """
    try:
        model, remark = _compiled(file)
        writer = Writer(model)
        source = writer.write()
        if writer.free:
            told = f"{', '.join(writer.free)} moves freely"
            remark += f"; a URDF holds couplings by one factor only: {told}"
        return {"remark": remark}, source
    except Exception as failure:
        words = " ".join(str(failure).split()) or type(failure).__name__
        raise RobotError(f"this MJCF cannot be used: {words}") from None
