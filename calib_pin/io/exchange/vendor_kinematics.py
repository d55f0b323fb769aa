"""Other frames for the same robot: z along every joint's axis, as vendors have it.

Only the axes of the joints are physical. A frame may stand anywhere on its axis and
turn about it, so the same robot has many descriptions; a vendor's own, with offsets of
meters that cancel between parallel axes, is one of them. Frames are laid on the axes as
near as they can be to given ones, and the forward kinematics stays what it was.

Vendors' robot descriptions load one origin for each joint, in YAML. That of Universal
Robots takes `kinematics` with x y z roll pitch yaw of shoulder, upper_arm, forearm and
wrist_1 to wrist_3, and a `hash` which the driver compares with the robot; UFACTORY's
takes joint1 to jointn. All joints turn about z. The first origin of the former is that
behind `base_link_inertia`, half a turn from `base_link`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import accumulate, pairwise
from operator import mul
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from calib_pin.errors import InputError, OptionError
from calib_pin.io.exchange.base import (
    EXACT,
    ORIGIN,
    RIGID,
    Encoded,
    Exported,
    Format,
    origin_of,
    placed,
    rms,
)
from calib_pin.io.yaml_tree import Tree, read_tree
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, se3_exp
from calib_pin.setup.values import number
from calib_pin.units import DISPLAY

ACROSS = 0.9
"""Cosine from which a direction is too near an axis to tell a turn about it."""


def axis_frames(chain: Chain) -> list[tuple[Floats, Floats]]:
    """A point and the direction of every joint's axis in the base, at zero positions.

    Directions are those in which joints count, also of joints that are traversed from
    child to parent.
    """
    frames = chain.joint_frames()
    signs = np.where(chain.reversed, -1.0, 1.0)
    return [
        (frame[:3, 3], sign * frame[:3, :3] @ axis)
        for frame, axis, sign in zip(frames, chain.axes, signs, strict=True)
    ]


def along(point: Floats, axis: Floats, near: pin.SE3) -> pin.SE3:
    """The frame with z along an axis that is nearest to another.

    Args:
        point: A point of the axis, shape (3,) [m].
        axis: Unit vector, shape (3,).
        near: The other.

    Examples:
        >>> frame = along(np.array([1.0, 0, 5]), np.array([0, 0, 1.0]), pin.SE3(1))
        >>> frame.translation.tolist(), frame.rotation.tolist() == np.eye(3).tolist()
        ([1.0, 0.0, 0.0], True)
    """
    # Of a frame that lies across, another axis tells the turn.
    k = 0 if abs(axis @ near.rotation[:, 0]) < ACROSS else 1
    x = near.rotation[:, k] - axis * (axis @ near.rotation[:, k])
    x /= np.linalg.norm(x)
    origin = point + axis * (axis @ (near.translation - point))
    return pin.SE3(np.column_stack([x, np.cross(axis, x), axis]), origin)


def poses_about_z(
    origins: Sequence[pin.SE3], turns: Sequence[bool], q: Floats
) -> Floats:
    """Poses of the tip of joints that turn about, or slide along, their own z axis.

    Args:
        origins: Of each of the n joints in the frame of the one before, and of the tip.
        turns: Whether each joint turns.
        q: Joint positions, shape (N, n) [rad, m].
    """
    T = origins[0].homogeneous
    for origin, turn, positions in zip(origins[1:], turns, q.T, strict=True):
        twists = np.zeros((len(q), 6))
        twists[:, 5 if turn else 2] = positions
        T = T @ se3_exp(twists) @ origin.homogeneous
    return np.asarray(T)


ROOT = "kinematics"

ALIKE = 0.05
"""Largest difference of the nominal robot and the user's own file, rms [m]: factories
correct by millimeters."""

BASES = (pin.SE3.Identity(), placed([0.0, 0.0, 0.0, 0.0, 0.0, np.pi]))
"""Where the first origin may be in the base link."""


def encode_vendor(
    links: Sequence[str], joint: str, exported: Exported, template: Path | None
) -> Encoded:
    """The file of a vendor.

    Args:
        links: Names of its entries, from base to tip; none where they are numbered.
        joint: Name of numbered entries, without their number.
        exported: The calibration.
        template: The user's own file.

    Raises:
        InputError: If the template is no such file, or one of another robot.
        OptionError: If the robot is none of this vendor.
    """
    assert template is not None
    chain, tree = exported.chain, read_tree(template)
    names = [*links] or [f"{joint}{k + 1}" for k in range(len(chain.joints))]
    if len(names) != len(chain.joints) or not chain.revolute.all():
        raise OptionError(
            f"the chain has {len(chain.joints)} joints, this format is for robots with "
            f"{len(names)} revolute ones",
            file=exported.file,
        )
    own = [_origin(tree, name) for name in names]
    base = _base(exported, own, template)
    tip = pin.SE3(chain.poses(np.zeros((1, len(names))))[0])
    # The last frame is that of the flange.
    near = [*accumulate([base, *own[:-1]], mul), tip]
    frames = [
        along(point, axis, frame)
        for (point, axis), frame in zip(axis_frames(chain), near[1:], strict=True)
    ]
    flange, entries = frames[-1].actInv(tip), tree.data[ROOT]
    for name, (before, frame) in zip(names, pairwise([base, *frames]), strict=True):
        numbers = origin_of(before.actInv(frame))
        entries[name] = dict(zip(ORIGIN, numbers, strict=True))
    text = yaml.safe_dump(tree.data, sort_keys=False)
    read = yaml.safe_load(text)[ROOT]
    origins = [placed([read[name][key] for key in ORIGIN]) for name in names]
    read = partial(_poses, base, [*origins, flange])
    exported.require_same(read, "the file")
    remarks = []
    twist = pin.log6(flange).vector
    moved, turned = np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])
    if max(moved, turned) >= EXACT:
        unit, factor = DISPLAY["m"]
        six = zip(ORIGIN, origin_of(flange), strict=True)
        remarks.append(
            f"the flange is off by {factor * moved:.3g} {unit} and {1e3 * turned:.3g} "
            "mrad from where this format has it; put that into the tool of the "
            f"controller: {', '.join(f'{name} {value:.9g}' for name, value in six)}"
        )
    if (kept := entries.get("hash")) is not None:
        remarks.append(f"the hash of {template} is kept: {kept}")
    return Encoded(text.encode(), tuple(remarks), read)


def _origin(tree: Tree, name: str) -> pin.SE3:
    """The origin of an entry of the user's own file."""
    root = tree.data.get(ROOT) if isinstance(tree.data, dict) else None
    entry = root.get(name) if isinstance(root, dict) else None
    if not isinstance(entry, dict):
        raise InputError(
            f"is no kinematics file of such a robot: it lacks '{ROOT}: {name}'",
            file=tree.file,
        )
    numbers = []
    for key in ORIGIN:
        try:
            numbers.append(number(entry.get(key)))
        except ValueError as error:
            reason, path = f"'{key}' of '{name}' cannot be used", (ROOT, name, key)
            raise tree.error(reason, path, entry.get(key), str(error)) from None
    return placed(numbers)


def _poses(base: pin.SE3, origins: Sequence[pin.SE3], _: Chain, q: Floats) -> Floats:
    """Poses of the flange by the origins of such a file, and of the flange."""
    return poses_about_z([base * origins[0], *origins[1:]], [True] * q.shape[1], q)


def _base(exported: Exported, own: Sequence[pin.SE3], template: Path) -> pin.SE3:
    """The frame of the first origin in the base link, by the user's own file.

    Where the flange is in the last frame is not asked: they share the axis.
    """
    q, nominal = exported.configurations, exported.nominal
    points, sizes = nominal.poses(q)[:, :3, 3], []
    for base in BASES:
        found = _poses(base, [*own, pin.SE3.Identity()], nominal, q)
        R, p = found[:, :3, :3], found[:, :3, 3]
        away = np.einsum("nji,nj->ni", R, points - p)
        sizes.append(rms(away - away.mean(axis=0)))
    if not min(sizes) < ALIKE:
        unit, factor = DISPLAY["m"]
        raise InputError(
            f"is of another robot: its flange is {factor * min(sizes):.3g} {unit} away "
            "from that of the nominal robot",
            file=template,
            allowed=f"the file of '{nominal.robot.name}', from {nominal.base} on",
        )
    return BASES[int(np.argmin(sizes))]


UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")

UR = Format(
    "ur-kinematics",
    ".yaml",
    "calibration file of Universal Robots' description and driver",
    partial(encode_vendor, UR_LINKS, ""),
    "required",
    RIGID,
)
XARM = Format(
    "xarm-kinematics",
    ".yaml",
    "kinematics file of UFACTORY's xArm description",
    partial(encode_vendor, (), "joint"),
    "required",
    RIGID,
)
