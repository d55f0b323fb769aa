"""Other frames for the same robot: z along every joint's axis.

Only the axes of the joints are physical. A frame may stand anywhere on its axis and
turn about it, so the same robot has many descriptions; a vendor's own, with offsets of
meters that cancel between parallel axes, is one of them, and a table of Denavit and
Hartenberg another.

Vendors' robot descriptions load one origin for each joint, in YAML. That of Universal
Robots takes `kinematics` with x y z roll pitch yaw of shoulder, upper_arm, forearm and
wrist_1 to wrist_3, and a `hash` which the driver compares with the robot; UFACTORY's
takes joint1 to jointn. All joints turn about z. The first origin of the former is that
behind `base_link_inertia`, half a turn from `base_link`. Frames are laid on the axes as
near as they can be to those of the user's own file.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from itertools import accumulate, pairwise
from operator import mul
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

import calib_pin.io.exchange.base as base
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.measurements import encode_table
from calib_pin.io.urdf_tree import ORIGIN, origin_of, placed
from calib_pin.io.yaml_tree import Tree, read_tree
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.units import DISPLAY

EXACT = 1e-9
"""Largest distance that is rounding [m, rad]."""

ACROSS = 0.9
"""Cosine from which a direction is too near an axis to tell a turn about it."""

ROOT = "kinematics"

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")

ALIKE = 0.05
"""Largest distance between an axis of the nominal robot and of the user's own file, a
meter along it [m]: factories correct by millimeters."""

BASES = (pin.SE3.Identity(), placed([0.0, 0.0, 0.0, 0.0, 0.0, np.pi]))
"""Where the first origin may be in the base link."""

PARALLEL = np.deg2rad(1.0)
"""Angle between axes below which beta stands for d."""

NUMBERS = ("theta", "d", "a", "alpha", "beta")
"""Of a joint [rad, m]."""

DH_USE = """\
Denavit-Hartenberg tables of the corrected chain.

    standard   A_i = Rz(theta_i) Tz(d) Tx(a) Rx(alpha) Ry(beta)
    modified   A_i = Tx(a) Rx(alpha) Ry(beta) Rz(theta_i) Tz(d)

(Denavit and Hartenberg, 1955; Craig, 1986) with `theta_i = theta + q_i`, or `d + q_i`
of a prismatic joint. Between nearly parallel axes d is zero and beta tilts the next one
(Hayati and Mirmirani, 1985).
base and tip: the frames before the first and behind the last joint
"""


def axis_frames(chain: Chain) -> list[tuple[Floats, Floats]]:
    """A point and the direction of every joint's axis in the base, at zero positions.

    Directions are those in which joints count, also of joints that are traversed from
    child to parent.
    """
    axes = np.where(chain.reversed, -1.0, 1.0)[:, None] * chain.axes
    pairs = zip(chain.joint_frames(), axes, strict=True)
    return [(frame[:3, 3], frame[:3, :3] @ axis) for frame, axis in pairs]


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


def _tip(chain: Chain) -> pin.SE3:
    return pin.SE3(chain.poses(np.zeros((1, len(chain.joints))))[0])


@partial(Format, "ur-kinematics", base.RIGID, "required")
def ur(exported: Exported, template: Path | None) -> Encoded:
    """Calibration file of Universal Robots' description and driver."""
    return _vendor(exported, template, UR_LINKS)


@partial(Format, "xarm-kinematics", base.RIGID, "required")
def xarm(exported: Exported, template: Path | None) -> Encoded:
    """Kinematics file of UFACTORY's xArm description."""
    names = (f"joint{k + 1}" for k in range(len(exported.nominal.joints)))
    return _vendor(exported, template, [*names])


def _vendor(exported: Exported, template: Path | None, names: Sequence[str]) -> Encoded:
    """The file of a vendor, with entries of these names.

    Raises:
        InputError: If the template is no such file, or one of another robot.
        OptionError: If the robot is none of this vendor.
    """
    assert template is not None
    chain, tree = exported.chain, read_tree(template)
    count, tip = len(chain.joints), _tip(chain)
    if len(names) != count:
        reason = f"has {count} joints, this format is for robots with {len(names)}"
        raise exported.error(f"the chain {reason} revolute ones")
    origins = [_origin(tree, name) for name in names]
    root = _base(exported, origins, template)
    # The last frame is that of the flange.
    near = [*accumulate([root, *origins[:-1]], mul), tip][1:]
    frames = list(map(along, *zip(*axis_frames(chain), strict=True), near))
    for name, (before, frame) in zip(names, pairwise([root, *frames]), strict=True):
        numbers = zip(ORIGIN, origin_of(before.actInv(frame)), strict=True)
        tree.data[ROOT][name] = dict(numbers)
    flange, remarks = frames[-1].actInv(tip), list[str]()
    if np.abs(pin.log6(flange).vector).max() >= EXACT:
        six = zip(ORIGIN, origin_of(flange), strict=True)
        tool = ", ".join(f"{name} {value:.9g}" for name, value in six)
        reason = "the flange is elsewhere; into the tool of the controller"
        remarks.append(f"{reason}: {tool}")
    if (kept := tree.data[ROOT].get("hash")) is not None:
        remarks.append(f"the hash of {template} is kept: {kept}")
    text = yaml.safe_dump(tree.data, sort_keys=False)
    return Encoded(text.encode(), tuple(remarks))


def _origin(tree: Tree, name: str) -> pin.SE3:
    """The origin of an entry of the user's own file."""
    with suppress(LookupError, TypeError, ValueError):
        numbers = [float(tree.data[ROOT][name][key]) for key in ORIGIN]
        if np.isfinite(numbers).all():
            return placed(numbers)
    allowed = f"'{ROOT}: {name}:' with the numbers {', '.join(ORIGIN)}"
    reason = "is no kinematics file of such a robot"
    raise tree.error(reason, (ROOT, name), allowed=allowed)


def _base(exported: Exported, origins: Sequence[pin.SE3], template: Path) -> pin.SE3:
    """The frame of the first origin in the base link, by the user's own file.

    Where the flange is in the last frame is not asked: they share the axis.
    """
    nominal, sizes = exported.nominal, []
    for root in BASES:
        frames = [*accumulate([root, *origins], mul)][1:]
        away = [
            (np.linalg.norm(f.actInv(point)[:2]), np.linalg.norm(f.rotation[:, 2] - z))
            for f, (point, z) in zip(frames, axis_frames(nominal), strict=True)
        ]
        sizes.append(float(np.max(away)))
    unit, factor = DISPLAY["m"]
    far = f"{factor * min(sizes):.3g} {unit} away from those of the nominal robot"
    allowed = f"the file of '{nominal.robot.name}', from {nominal.base} on"
    reason = f"is of another robot: its axes are up to {far}"
    base.require(min(sizes) < ALIKE, reason, template, None, allowed)
    return BASES[int(np.argmin(sizes))]


@partial(Format, "dh", (*base.RIGID, base.PRISMATIC), "")
def dh(exported: Exported, _: Path | None) -> Encoded:
    """Denavit-Hartenberg tables, standard and modified.

    Each with the frames before its first and behind its last joint.
    """
    chain = exported.chain
    first, *others = axis_frames(chain)
    frame = root = along(*first, pin.SE3.Identity())
    steps = list[list[float]]()
    for after in others:
        steps.append(_step(frame, *after))
        frame = frame * _standard(steps[-1])
    # Everything behind the last joint is in the tip frame.
    tip = frame.actInv(_tip(chain))
    # Before the first axis, and behind the last, nothing moves or turns.
    zero = [0.0] * len(NUMBERS)
    steps = [zero, *steps, zero]
    modified = [[*after[:2], *before[2:]] for before, after in pairwise(steps)]
    kinds = np.where(chain.revolute, "revolute", "prismatic").tolist()
    rows, no_step, no_frame = list[list[Any]](), [""] * len(NUMBERS), [""] * len(ORIGIN)
    for convention, numbers in (("standard", steps[1:]), ("modified", modified)):
        rows.append([convention, "base", "frame", *no_step, *origin_of(root)])
        for joint, kind, row in zip(chain.joints, kinds, numbers, strict=True):
            rows.append([convention, joint, kind, *row, *no_frame])
        rows.append([convention, "tip", "frame", *no_step, *origin_of(tip)])
    headers = ("convention", "joint", "type", *NUMBERS, *ORIGIN)
    table = dict(zip(headers, zip(*rows, strict=True), strict=True))
    return Encoded(encode_table(table, [DH_USE]))


def _step(frame: pin.SE3, point: Floats, axis: Floats) -> list[float]:
    """Theta, d, a, alpha and beta from a frame on an axis to the next axis."""
    point = frame.rotation.T @ (point - frame.translation)
    axis = frame.rotation.T @ axis
    cross = np.hypot(axis[0], axis[1])
    if meet := bool(cross > np.sin(PARALLEL)):
        # x along the common normal, away from this axis where it has a length.
        x = np.array([-axis[1], axis[0], 0.0]) / cross
        x *= -1.0 if x @ point < 0.0 else 1.0
        # Foot of the common normal on this axis.
        foot = axis * ((point[0] * axis[0] + point[1] * axis[1]) / cross**2)
        theta, d, a = np.arctan2(x[1], x[0]), (point - foot)[2], x @ point
    else:
        # Where the next axis meets the plane across this one.
        met = point - axis * (point[2] / axis[2])
        d, a = 0.0, np.hypot(met[0], met[1])
        theta = np.arctan2(met[1], met[0]) if a > 1e-9 else 0.0
    # Rx(alpha) Ry(beta) z = (sin b, -sin a cos b, cos a cos b)
    turned = pin.utils.rotate("z", float(theta)).T @ axis
    alpha = np.arctan2(-turned[1], turned[2])
    beta = 0.0 if meet else np.arctan2(turned[0], np.hypot(turned[1], turned[2]))
    return [float(number) for number in (theta, d, a, alpha, beta)]


def _standard(row: Sequence[float]) -> pin.SE3:
    """The matrix of a joint at zero."""
    theta, d, a, *tilts = row
    turn, *others = map(pin.utils.rotate, "zxy", (theta, *tilts))
    return pin.SE3(turn @ others[0] @ others[1], turn @ np.array([a, 0.0, d]))
