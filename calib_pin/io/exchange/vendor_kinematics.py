"""Kinematics files of vendors' robot descriptions: one origin for each joint, in YAML.

Universal Robots' description loads `kinematics` with x y z roll pitch yaw of shoulder,
upper_arm, forearm and wrist_1 to wrist_3, and a `hash` which the driver compares with
the robot; UFACTORY's loads joint1 to jointn. All joints turn about z. The first origin
of the former is that behind `base_link_inertia`, half a turn from `base_link`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from calib_pin.errors import InputError, OptionError
from calib_pin.io.exchange.axes import along, axis_frames, relative, revolute_poses
from calib_pin.io.exchange.base import (
    EXACT,
    ORIGIN,
    Encoded,
    Exported,
    Format,
    origin_of,
    placed,
)
from calib_pin.io.yaml_tree import Tree, read_tree
from calib_pin.kinematics.spatial import Floats
from calib_pin.units import DISPLAY

ROOT = "kinematics"

ALIKE = 0.05
"""Largest difference of the nominal robot and the user's own file, rms [m]: factories
correct by millimeters."""

FARTHEST = 1e5
"""Largest number of an origin [m, rad]; offsets that cancel may be large."""

BASES = (pin.SE3.Identity(), placed([0.0, 0.0, 0.0, 0.0, 0.0, np.pi]))
"""Where the first origin may be in the base link."""


def encode(
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
    near = [base]
    for origin in own:
        near.append(near[-1] * origin)
    # The last frame is that of the flange.
    tip = pin.SE3(chain.poses(np.zeros((1, len(names))))[0])
    near[-1] = tip
    frames = []
    for (point, axis), frame in zip(axis_frames(chain), near[1:], strict=True):
        frames.append(along(point, axis, frame))
    origins = relative(frames, base)
    flange = frames[-1].actInv(tip)
    data = tree.data if isinstance(tree.data, dict) else {}
    for name, origin in zip(names, origins, strict=True):
        data[ROOT][name] = dict(zip(ORIGIN, origin_of(origin), strict=True))
    text = yaml.safe_dump(data, sort_keys=False)

    def poses(q: Floats) -> Floats:
        read = _read(yaml.safe_load(text), names)
        return np.asarray(revolute_poses(base, read, q) @ flange.homogeneous)

    exported.require_same(poses, "the file")
    return Encoded(text.encode(), (*_remarks(flange), *_hash(data, template)))


def _remarks(flange: pin.SE3) -> list[str]:
    twist = pin.log6(flange).vector
    moved, turned = np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])
    if max(moved, turned) < EXACT:
        return []
    unit, factor = DISPLAY["m"]
    return [
        f"the flange is off by {factor * moved:.3g} {unit} and {1e3 * turned:.3g} mrad "
        "from where this format has it; put that into the tool of the controller: "
        + ", ".join(
            f"{name} {value:.9g}"
            for name, value in zip(ORIGIN, origin_of(flange), strict=True)
        )
    ]


def _hash(data: dict[str, Any], template: Path) -> list[str]:
    kept = data[ROOT].get("hash")
    return [] if kept is None else [f"the hash of {template} is kept: {kept}"]


def _origin(tree: Tree, name: str) -> pin.SE3:
    root = tree.data.get(ROOT) if isinstance(tree.data, dict) else None
    entry = root.get(name) if isinstance(root, dict) else None
    if not isinstance(entry, dict):
        raise InputError(
            f"is no kinematics file of such a robot: it lacks '{ROOT}: {name}'",
            file=tree.file,
        )
    numbers = []
    for key in ORIGIN:
        number = entry.get(key)
        if (
            isinstance(number, bool)
            or not isinstance(number, int | float)
            or not abs(number) < FARTHEST
        ):
            raise tree.error(
                f"'{key}' of '{name}' is not a number that can be",
                (ROOT, name, key),
                value=number,
                allowed=f"a number below {FARTHEST:g}",
            )
        numbers.append(float(number))
    return placed(numbers)


def _read(data: Any, names: Sequence[str]) -> list[pin.SE3]:
    return [placed([data[ROOT][name][key] for key in ORIGIN]) for name in names]


def _base(exported: Exported, own: Sequence[pin.SE3], template: Path) -> pin.SE3:
    """The frame of the first origin in the base link, by the user's own file.

    Where the flange is in the last frame is not asked: they share the axis.
    """
    q, nominal = exported.configurations, exported.nominal
    points = nominal.poses(q)[:, :3, 3]
    sizes = []
    for base in BASES:
        found = revolute_poses(base, own, q)
        # Only the way along the last axis may differ.
        away = np.einsum(
            "nij,nj->ni", found[:, :3, :3].transpose(0, 2, 1), points - found[:, :3, 3]
        )
        rest = away - away.mean(axis=0)
        sizes.append(float(np.sqrt(np.mean(np.sum(rest**2, axis=1)))))
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
    partial(encode, UR_LINKS, ""),
    "required",
)
XARM = Format(
    "xarm-kinematics",
    ".yaml",
    "kinematics file of UFACTORY's xArm description",
    partial(encode, (), "joint"),
    "required",
)
